"""The same as `manip sweep`; see `python scripts/sweep.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("sweep")
