"""The same as `manip results`; see `python scripts/results.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("results")
