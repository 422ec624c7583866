"""``python -m vislam.calibrate``: the command ``vislam calibrate``."""

import sys

from vislam.cli.calibrate import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
