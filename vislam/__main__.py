"""``python -m vislam``: the command ``vislam``."""

import sys

from vislam.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
