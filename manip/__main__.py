"""`python -m manip NAME ...`: as `manip NAME ...`."""

from manip.programs.main import main

if __name__ == "__main__":
    main()
