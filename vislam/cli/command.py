"""What the commands share: the options that name a config, and how errors become a line and an exit code."""

import argparse
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from vislam.base.errors import (
    INTERRUPTED,
    ConfigError,
    ContractError,
    DataError,
    DivergedError,
    Interrupted,
    first_line,
    interruption,
)
from vislam.base.files import check_writable
from vislam.base.legible import one_line, quoted
from vislam.base.shipped import find_config, shipped_configs
from vislam.base.yaml_text import parse_yaml
from vislam.cli.streams import lasting_streams

_log = logging.getLogger("vislam.cli.command")


class Parser(argparse.ArgumentParser):
    """Parser of a command's options, whose errors are one line."""

    needs_config = False

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; a reader of ``--help`` may stop in the middle."""
        with lasting_streams():
            options = super().parse_args(args, namespace)
            named = vars(options).pop("named", None)
            if named is not None and options.config is not None:
                self.error("a config is named twice, with --config and without")
            if named is not None:
                options.config = named
            if self.needs_config and options.config is None:
                self.error("a config is required: a file, or the name of a shipped one")
            return options

    def error(self, message: str) -> NoReturn:
        """Report the error in one line and exit."""
        self.exit(2, f"vislam: {one_line(message)}; --help lists the options\n")


def add_config_options(parser: Parser, *, required: bool = True) -> None:
    """Add the options that name a config, override its values and locate the data."""
    add_override_options(parser, required=required)
    add = parser.add_argument
    add("--data-dir", type=Path, help="first folder to look for data, before $VISLAM_DATA and data/")
    add(
        "--no-substitute",
        "--no-stand-in",
        action="store_true",
        dest="no_substitute",
        help="a missing recording is an error, not simulated (--no-stand-in is its former name)",
    )


def add_override_options(parser: Parser, *, required: bool = True) -> None:
    """Add the options that name a config and override its values."""
    parser.needs_config = required
    add = parser.add_argument
    what = "YAML file, or the name of a shipped config (vislam configs lists them)"
    add("named", nargs="?", type=_config, metavar="CONFIG", help=what)
    add("--config", type=_config, help="the same")
    add("--seed", type=int, help="seed of whatever is simulated")
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a config value by dotted path",
    )
    add("--verbose", action="store_true", help="log what is read, cut and dropped")


def _config(text: str) -> Path:
    found = find_config(text)
    if found is None and not os.path.exists(text) and text.replace("_", "").isalnum():
        names = ", ".join(shipped_configs())
        raise argparse.ArgumentTypeError(f"no config {quoted(text)} here, and none is shipped: {names}")
    return Path(text) if found is None else found


def add_check_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of checks: what results are compared with, and where the outcome is written."""
    add = parser.add_argument
    add("--against", type=Path, metavar="METRICS", help="saved metrics.json, or its folder, to compare with")
    add(
        "--tolerance",
        type=float,
        default=0.05,
        help="share by which an error may exceed the saved one, unless checks state it (default: 0.05)",
    )
    add("--no-report", action="store_true", help="metrics and checks only: no figures, no page")
    add("--png", action="store_true", help="write the figures as PNG, beside the SVG of each")
    add("--junit", type=Path, metavar="FILE", help="write the checks as JUnit XML, too")
    add(
        "--rerun",
        type=Path,
        metavar="FILE",
        help="write a recording for the Rerun viewer, too (.rrd; needs the extra vislam[rerun])",
    )


def refuse_bad_check_options(options: argparse.Namespace) -> None:
    """Raise ConfigError or DataError for options that would fail after the run."""
    if not 0.0 <= options.tolerance < float("inf"):
        raise ConfigError(f"--tolerance must be >= 0 and finite, got {options.tolerance}")
    if options.rerun is not None and find_spec("rerun") is None:
        raise ConfigError("--rerun needs the Rerun SDK, which is not installed: pip install 'vislam[rerun]'")
    for path in (options.junit, options.rerun):
        if path is not None:
            check_writable(path)


def load_config(options: argparse.Namespace) -> Any:
    """Load the config that the options name, with their overrides."""
    from vislam.comparison import config as configuration  # noqa: PLC0415

    return configuration.load(options.config, overrides=overrides(options))


def begin(what: str) -> None:
    """Say what begins, before the imports and the reading that take seconds."""
    print(one_line(f"vislam {what}"), flush=True)


def overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Values that the options put in place of the config's, by dotted path."""
    found: dict[str, Any] = {}
    for item in options.set:
        key, equals, text = item.partition("=")
        if not equals:
            raise ConfigError(f"--set {quoted(item)}: expected KEY=VALUE")
        try:
            found[key] = parse_yaml(text)
        except ValueError as error:
            raise ConfigError(f"--set {quoted(key)}: not a YAML value ({error})") from None
    if options.seed is not None:
        found["seed"] = options.seed
    return found


def answer(work: Callable[[], int], *, verbose: bool) -> int:
    """Do the work of a command and return its exit code; an error becomes one line."""
    with lasting_streams():
        logging.basicConfig(level=logging.INFO if verbose else logging.ERROR, format="%(name)s: %(message)s")
        # Former names of options are noted in any case.
        logging.getLogger("vislam.base.settings").setLevel(logging.WARNING)
        try:
            with interruptible():
                return _interrupted_as_such(work)
        except (ConfigError, DataError, ContractError) as error:
            return _fail(str(error), 2)
        except DivergedError as error:
            return _fail(str(error), 1)
        except KeyboardInterrupt:
            return _fail("interrupted", INTERRUPTED)
        except MemoryError:
            return _fail("there is not enough memory; use fewer frames, tracks, estimators or processes", 2)
        except (OSError, UnicodeError) as error:
            _log.info("where it came from", exc_info=True)
            file = getattr(error, "filename", None)
            return _fail(f"{'' if file is None else f'{file}: '}{first_line(error)}", 2)


def _interrupted_as_such(work: Callable[[], int]) -> int:
    """Do the work; what comes of a signal is the signal, whatever it has become on the way."""
    try:
        return work()
    except Exception as error:
        if (stopped := interruption(error)) is not None:
            raise stopped from None
        raise


def _fail(said: str, code: int) -> int:
    print(f"vislam: {one_line(said)}", file=sys.stderr)
    return code


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise :class:`Interrupted` inside the block on Ctrl-C and on SIGTERM, so that workers are ended."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise Interrupted(signal.Signals(number).name)
