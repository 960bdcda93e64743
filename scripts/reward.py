"""The same as `manip reward`; see `python scripts/reward.py --help`."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("reward")
