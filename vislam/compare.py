"""``python -m vislam.compare``: run estimators on identical information, score and report.

Exit codes: 0 done, 1 an estimator failed (what it had done is kept and marked), 2 bad config or data.
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from vislam.errors import ConfigError, DataError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(
        level=logging.INFO if options.verbose else logging.ERROR, format="%(name)s: %(message)s"
    )
    try:
        return _compare(options)
    except (ConfigError, DataError) as error:
        print(f"vislam: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m vislam.compare", description=__doc__)
    add = parser.add_argument
    add("--config", type=Path, required=True, help="YAML configuration")
    add("--data-dir", type=Path, help="first folder to look for data, before $VISLAM_DATA and data/")
    add("--out", type=Path, default=Path("results"), help="folder of the results (default: results)")
    add("--estimators", help="comma-separated names, in place of the config's")
    add("--seed", type=int, help="seed of whatever is simulated")
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a config value by dotted path",
    )
    add("--no-stand-in", action="store_true", help="a missing recording is an error, not simulated")
    add("--dump-config", action="store_true", help="print the effective configuration and stop")
    add("--verbose", action="store_true", help="log what is read, cut and dropped")
    return parser


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    overrides: dict[str, Any] = {}
    for item in options.set:
        key, equals, text = item.partition("=")
        if not equals:
            raise ConfigError(f"--set {item}: expected KEY=VALUE")
        overrides[key] = yaml.safe_load(text)
    if options.seed is not None:
        overrides["seed"] = options.seed
    return overrides


def _compare(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam import config as configuration  # noqa: PLC0415

    config = configuration.load(options.config, overrides=_overrides(options))
    if options.estimators:
        names = [name.strip() for name in options.estimators.split(",") if name.strip()]
        chosen = {name: config.estimators.get(name, {}) for name in names}
        config = configuration.with_estimators(config, chosen)
    if options.dump_config:
        print(configuration.dump(config), end="")
        return 0
    from vislam.comparison import compare  # noqa: PLC0415
    from vislam.terminal import Terminal  # noqa: PLC0415

    outcome = compare(
        config,
        out=options.out,
        data_dir=options.data_dir,
        allow_stand_in=not options.no_stand_in,
        terminal=Terminal(),
    )
    return 0 if all(run.complete for run in outcome.runs.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
