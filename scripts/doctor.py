"""The same as `manip doctor`; see `python scripts/doctor.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("doctor")
