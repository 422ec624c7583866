"""``python -m vislam.compare``: the command ``vislam compare``."""

import sys

from vislam.cli.compare import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
