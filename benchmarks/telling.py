"""How the parts of a benchmark are run, printed and written."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from threadpoolctl import threadpool_info

from benchmarks.timing import Part
from vislam.base.files import replace_whole
from vislam.cli.console import Terminal
from vislam.comparison.compare import provenance


def tell(parts: Mapping[str, Callable[[], Part]], *, out: Path | None) -> None:
    """Measure the parts one after the other, print each, and write them all to ``out``."""
    terminal = Terminal()
    machine = {**provenance(), "blas": blas()}
    for key, value in machine.items():
        terminal.note(f"{key}: {value}")
    found = {}
    for name, measure in parts.items():
        part = measure()
        terminal.rows(part.header, part.rows, title=part.title)
        for note in part.notes:
            terminal.note(note)
        found[name] = {"title": part.title, **part.values}
    if out is not None:
        document = {"schema_version": 1, "provenance": machine, "parts": found}
        with replace_whole(out) as temporary:
            temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        terminal.note(f"numbers: {out}")


def blas() -> str:
    """Which BLAS libraries are loaded, numpy's and scipy's."""
    libraries = [item for item in threadpool_info() if item["user_api"] == "blas"]
    return ", ".join(
        sorted(f"{item['internal_api']} {item['version']} {item['architecture']}" for item in libraries)
    )
