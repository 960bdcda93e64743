"""The same as `manip label`; see `python scripts/label.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("label")
