"""``vislam table results/<id>/metrics.json``: the results table for a README, in Markdown."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.base.errors import DataError
from vislam.base.files import open_regular
from vislam.cli.command import Parser, answer
from vislam.report.markdown import results_table


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="vislam table", description=__doc__)
    parser.add_argument("metrics", type=Path, help="metrics.json of a comparison")
    options = parser.parse_args(arguments)
    return answer(lambda: _print(options.metrics), verbose=False)


def _print(path: Path) -> int:
    with open_regular(path) as file:
        content = file.read()
    try:
        table = results_table(json.loads(content))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(f"{path}: expected the metrics.json of a comparison, got {error!r}") from None
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
