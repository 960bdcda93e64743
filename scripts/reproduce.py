"""The same as `manip reproduce`; see `python scripts/reproduce.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("reproduce")
