"""The command line as `python -m vrcaps`, for the interpreter of one environment."""

from vrcaps.cli import main

if __name__ == "__main__":
    main()
