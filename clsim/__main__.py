"""`python -m clsim` is the command line."""

import sys

from clsim.cli import main

if __name__ == "__main__":
    sys.exit(main())
