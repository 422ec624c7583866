"""``python -m vislam.study``: the command ``vislam study``."""

import sys

from vislam.cli.study import main

if __name__ == "__main__":
    sys.exit(main())
