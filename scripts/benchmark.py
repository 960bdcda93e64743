"""The same as `manip benchmark`; see `python scripts/benchmark.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("benchmark")
