"""``python -m vislam.inspect``: the command ``vislam inspect``."""

import sys

from vislam.cli.inspect import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
