"""The same as `manip replay`; see `python scripts/replay.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("replay")
