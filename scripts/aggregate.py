"""The same as `manip aggregate`; see `python scripts/aggregate.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("aggregate")
