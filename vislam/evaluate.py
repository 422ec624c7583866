"""``python -m vislam.evaluate``: the command ``vislam evaluate``; called, :func:`vislam.api.evaluate`."""

import sys

from vislam.api import make_callable
from vislam.cli.evaluate import main

__all__ = ["main"]

make_callable(__name__)

if __name__ == "__main__":
    sys.exit(main())
