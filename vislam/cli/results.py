"""``vislam results [FOLDER]``: a ledger of the comparisons, studies and inspections below a folder.

It is read from their saved files, each time anew. ``vislam results diff A B`` shows what differs between two.
Exit codes: 0 done; 2 bad folder or option.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vislam.base.errors import DataError
from vislam.cli.command import Parser, answer

if TYPE_CHECKING:
    from vislam.ledger.entries import Entry


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["diff"]:
        options = _diff_parser().parse_args(given[1:])
        return answer(lambda: _diff(options.first, options.second), verbose=False)
    options = _parser().parse_args(given)
    return answer(lambda: _list(options), verbose=False)


def _parser() -> Parser:
    parser = Parser(prog="vislam results", description=__doc__)
    add = parser.add_argument
    add("folder", nargs="?", type=Path, default=Path(), help="where to look (default: here)")
    add(
        "--where",
        action="append",
        default=[],
        metavar="CONDITION",
        help="KEY=TEXT, KEY!=TEXT, KEY<NUMBER or KEY>NUMBER; keys: kind, config, data, when, commit, code, "
        "folder, estimators, checks, error, held-out, NEES, time, or ESTIMATOR.METRIC",
    )
    add("--sort", metavar="KEY", help="sort by a key (default: the newest first)")
    add("--descending", action="store_true", help="the largest first")
    add("--export", type=Path, metavar="FILE", help="write a row for each run to .csv or .parquet")
    add("--no-page", action="store_true", help="do not write index.html")
    return parser


def _diff_parser() -> Parser:
    parser = Parser(prog="vislam results diff", description="What differs between two results.")
    parser.add_argument("first", type=Path, help="folder of a comparison, study or inspection")
    parser.add_argument("second", type=Path, help="another")
    return parser


def _list(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help answers at once.
    from vislam.base.files import check_writable  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.ledger.entries import find  # noqa: PLC0415
    from vislam.ledger.page import INDEX, write_index  # noqa: PLC0415
    from vislam.ledger.select import order, select  # noqa: PLC0415
    from vislam.ledger.table import HEADER, check_export, export, rows  # noqa: PLC0415

    folder: Path = options.folder
    if not folder.is_dir():
        raise DataError(f"{folder}: expected a folder with results, got none; name the one given to --out")
    if options.export is not None:
        check_export(options.export)
    if not options.no_page:
        check_writable(folder / INDEX)
    entries = select(find(folder), options.where)
    if options.sort is not None:
        entries = order(entries, options.sort, descending=options.descending)
    terminal = Terminal()
    if entries:
        terminal.rows(HEADER, rows(entries, below=folder), title=f"results in {folder}")
    else:
        terminal.note(f"{folder}: no result{' that meets the conditions' if options.where else ''} in it")
    if options.export is not None:
        export(entries, options.export)
        terminal.note(f"exported: {options.export}")
    if not options.no_page:
        terminal.note(f"page: {write_index(folder, entries)}")
    return 0


def _diff(first: Path, second: Path) -> int:
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.ledger.diff import differences  # noqa: PLC0415

    terminal, same = Terminal(), []
    for what, table in differences(_entry(first), _entry(second)).items():
        if table.rows:
            terminal.rows(table.header, table.rows, title=f"{what}: {first} and {second}")
        else:
            same.append(what)
    if same:
        terminal.note(f"no difference in {', '.join(same)}")
    return 0


def _entry(folder: Path) -> "Entry":
    from vislam.ledger.entries import read  # noqa: PLC0415

    found = read(folder)
    if found is None:
        raise DataError(
            f"{folder}: expected a folder of results, got no metrics.json, study.json or inspection.json in "
            "it; vislam results lists those that there are"
        )
    if found.problem:
        raise DataError(f"{folder}: cannot be used ({found.problem}); make it anew with this version")
    return found


if __name__ == "__main__":
    sys.exit(main())
