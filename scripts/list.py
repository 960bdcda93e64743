"""The same as `manip list`; see `python scripts/list.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("list")
