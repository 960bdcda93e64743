"""Train, evaluate, film: the main job in one command; see --help."""

from manip.programs.main import run_script

if __name__ == "__main__":
    run_script("demo")
