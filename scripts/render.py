"""The same as `manip render`; see `python scripts/render.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("render")
