"""The same as `manip train`; see `python scripts/train.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("train")
