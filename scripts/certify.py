"""The same as `manip certify`; see `python scripts/certify.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("certify")
