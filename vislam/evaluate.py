"""``python -m vislam.evaluate``: the command ``vislam evaluate``."""

import sys

from vislam.cli.evaluate import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
