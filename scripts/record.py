"""The same as `manip record`; see `python scripts/record.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("record")
