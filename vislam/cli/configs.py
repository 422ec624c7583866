"""``vislam configs``: the configs that come along, with a line each; with a name, the text of one."""

import sys
from collections.abc import Sequence

from vislam.base.errors import ConfigError
from vislam.base.shipped import about, shipped_configs
from vislam.cli.command import Parser, answer


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="vislam configs", description=__doc__)
    parser.add_argument(
        "name", nargs="?", help="print this one, to be changed: vislam configs ds3 > mine.yaml"
    )
    options = parser.parse_args(arguments)
    return answer(lambda: _print(options.name), verbose=False)


def _print(name: str | None) -> int:
    configs = shipped_configs()
    if name is None:
        width = max(map(len, configs), default=0)
        for key, file in configs.items():
            print(f"{key:{width}}  {about(file)}")
        return 0
    path = configs.get(name.removesuffix(".yaml"))
    if path is None:
        raise ConfigError(f"{name}: no such config is shipped; there are {', '.join(configs)}")
    print(path.read_text(encoding="utf-8"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
