"""``python -m vislam.simulate``: the command ``vislam simulate``."""

import sys

from vislam.cli.simulate import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
