"""The same as `manip clips`; see `python scripts/clips.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("clips")
