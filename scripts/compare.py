"""The same as `manip compare`; see `python scripts/compare.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("compare")
