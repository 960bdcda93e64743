"""The same as `manip view`; see `python scripts/view.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("view")
