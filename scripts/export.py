"""The same as `manip export`; see `python scripts/export.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("export")
