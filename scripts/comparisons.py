"""The same as `manip comparisons`; see `python scripts/comparisons.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("comparisons")
