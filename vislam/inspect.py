"""``python -m vislam.inspect``: the command ``vislam inspect``; called, :func:`vislam.api.inspect`."""

import sys

from vislam.api import make_callable
from vislam.cli.inspect import main

__all__ = ["main"]

make_callable(__name__)

if __name__ == "__main__":
    sys.exit(main())
