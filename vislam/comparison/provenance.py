"""When, by what command, on what machine and with which versions something was computed."""

import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

from vislam.base.legible import one_line
from vislam.comparison.identity import code_digest

_PACKAGES = ("vislam", "gtsam", "numpy", "scipy")
_HOME = Path(__file__).parents[1]
_LONGEST = 2000
"""Letters of a command line that are kept."""
_PATIENCE = 10.0
"""How long git may take to answer [s]."""


def provenance() -> dict[str, str]:
    """Date, command line, machine and versions, as plain text by name."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "command": command_line(sys.orig_argv),
        "cpu": _cpu(),
        "cores": f"{len(os.sched_getaffinity(0))} of {os.cpu_count()}",
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
        "code": code_digest(),
        "commit": commit(),
    }


def command_line(arguments: list[str]) -> str:
    """A command line as it can be given again: programs by their names, what follows them as it was."""
    program, *rest = arguments or [""]
    if rest and Path(rest[0]).name == "vislam":
        program, *rest = rest
    return one_line(shlex.join([Path(program).name, *rest]), limit=_LONGEST)


@cache
def commit() -> str:
    """Commit of the checkout that this package is imported from, and whether it was changed since.

    Of an installed package, the version says as much.
    """
    if _git("ls-files", "--error-unmatch", "__init__.py") is None:
        return "installed, no checkout"
    head, changed = _git("rev-parse", "HEAD"), _git("status", "--porcelain", "--", ".")
    return f"{head or 'none'}{', with changes' if changed else ''}"


def _git(*arguments: str) -> str | None:
    """What git says in the folder of this package; None if it refuses, or there is none."""
    try:
        found = subprocess.run(
            ["git", "-C", str(_HOME), *arguments],
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            check=True,
        )
    except (OSError, subprocess.SubprocessError, UnicodeError):
        return None
    return found.stdout.strip()


def _cpu() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
