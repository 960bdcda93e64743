"""The same as `manip evaluate`; see `python scripts/evaluate.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("evaluate")
