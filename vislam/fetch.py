"""``python -m vislam.fetch``: the command ``vislam fetch``."""

import sys

from vislam.cli.fetch import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
