"""The same as `manip study`; see `python scripts/study.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("study")
