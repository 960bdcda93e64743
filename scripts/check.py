"""The same as `manip check`; see `python scripts/check.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("check")
