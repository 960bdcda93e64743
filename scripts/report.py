"""The same as `manip report`; see `python scripts/report.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("report")
