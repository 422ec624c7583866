"""``vislam``: one command with subcommands."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from vislam.base.legible import quoted
from vislam.cli.streams import lasting_streams

COMMANDS = {
    "compare": "run estimators on identical information, score and report",
    "evaluate": "score saved runs again, beside trajectories from elsewhere",
    "inspect": "find what is wrong with a recording, from the data alone",
    "track": "make tracks of a folder of stereo images",
    "calibrate": "find noise, biases and clock from the data alone",
    "study": "repeat a comparison over seeds and values, on many processes",
    "results": "list the results in a folder, export them, show what differs between two",
    "simulate": "write a simulated recording",
    "export-tracks": "write the tracks of any source in the open track format",
    "fetch": "download the public recordings",
    "configs": "list the shipped configs, or print one",
    "table": "print the results table of a metrics.json in Markdown",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given and given[0] in COMMANDS:
        return int(import_module(f"vislam.cli.{given[0].replace('-', '_')}").main(given[1:]))
    with lasting_streams():
        if given == ["--version"]:
            print(f"vislam {version('vislam')}")
            return 0
        if given in ([], ["--help"], ["-h"]):
            print(_usage())
            return 0 if given else 2
        print(
            f"vislam: no command {quoted(given[0])}; there are {', '.join(COMMANDS)}, --version",
            file=sys.stderr,
        )
        return 2


def _usage() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:{width}}  {what}" for name, what in COMMANDS.items()]
    return "\n".join(
        [
            "usage: vislam COMMAND ...   (vislam COMMAND --help lists its options)",
            "",
            *lines,
            "",
            "  --version",
        ]
    )
