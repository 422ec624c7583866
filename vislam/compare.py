"""``python -m vislam.compare``: the command ``vislam compare``; called, :func:`vislam.api.compare`."""

import sys

from vislam.api import make_callable
from vislam.cli.compare import main

__all__ = ["main"]

make_callable(__name__)

if __name__ == "__main__":
    sys.exit(main())
