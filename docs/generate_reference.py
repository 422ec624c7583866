"""Pages of the reference that are generated from the code: command line, configuration, metrics, saved runs.

``docs/conf.py`` calls :func:`write_all` when a build begins; the pages are not kept in the repository.
"""

import argparse
import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, get_args, get_type_hints
from unittest.mock import patch

from pydantic.fields import FieldInfo

from vislam.base.settings import inline
from vislam.checks.settings import Check
from vislam.cli.command import Parser
from vislam.cli.main import COMMANDS
from vislam.comparison.config import Config
from vislam.core import record, run
from vislam.core.schema import Each, Numbers, Plain, Section, Table
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.msckf.options import MsckfOptions
from vislam.estimators.smoother.options import SmootherOptions
from vislam.evaluation.definitions import DEFINITIONS
from vislam.evaluation.metric import METRICS
from vislam.study.settings import StudyConfig
from vislam_baselines.dead_reckoning import DeadReckoningOptions
from vislam_baselines.known_map import KnownMapOptions
from vislam_baselines.mapping_only import MappingOnlyOptions
from vislam_baselines.report_ekf import ReportEkfOptions
from vislam_baselines.stereo_vo import StereoVoOptions

BETTER = {"less": "less", "one": "near 1", "": ""}


def write_all(folder: Path) -> None:
    """Write every generated page into a folder; a page that has not changed is left alone."""
    pages = {
        "command_line.md": command_line(),
        "config.md": configuration(),
        "metrics.md": metrics(),
        "saved_runs.md": saved_runs(),
    }
    for name, text in pages.items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


FORMAT = "Format of the file, by which its reader is chosen."
"""What the key ``format`` is, where its class does not say more."""


class _Found(Exception):
    """Carries the parser of a command out of its call."""


def parser_of(command: str) -> argparse.ArgumentParser:
    """Build the parser of a command, without running it."""
    return parsing(command, [])[0]


def parsing(command: str, given: list[str]) -> tuple[argparse.ArgumentParser, list[str]]:
    """Find the parser that a command has for what it is given, and what is left for it to parse."""

    def stop(self: Parser, args: Any = None, namespace: Any = None) -> Any:
        raise _Found(self, list(args))

    with patch.object(Parser, "parse_args", stop):
        try:
            import_module(f"vislam.cli.{command.replace('-', '_')}").main(given)
        except _Found as found:
            return found.args[0], found.args[1]
    raise LookupError(command)


def command_line() -> str:
    """Page of all commands with their options."""
    lines = [
        "# Command line",
        "",
        "`vislam COMMAND ...`, or `python -m vislam.COMMAND ...`. Every command answers `--help`.",
        "",
    ]
    for command, what in COMMANDS.items():
        parser = parser_of(command)
        lines += [f"(command-{command})=", f"## vislam {command}", "", f"{what[0].upper()}{what[1:]}.", ""]
        codes = re.search(r"Exit codes?:.*", parser.description or "", re.DOTALL)
        if codes:
            lines += [" ".join(codes.group().split()), ""]
        lines += ["| option | meaning |", "|---|---|"]
        lines += [f"| {_option(action)} | {_cell(action.help or '')} |" for action in parser._actions]
        lines.append("")
    return "\n".join(lines)


def _option(action: argparse.Action) -> str:
    value = action.metavar or (action.dest.upper() if action.nargs != 0 else "")
    if action.choices:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    if not action.option_strings:
        return f"`{action.metavar or action.dest}`"
    return f"`{', '.join(action.option_strings)}{f' {value}' if action.nargs != 0 and value else ''}`"


def _markdown(text: str) -> str:
    """Text of a docstring, whose literals stand in two backquotes."""
    return re.sub(r"``([^`]+)``", r"`\1`", text)


def _cell(text: str) -> str:
    return " ".join(text.replace("%%", "%").split()).replace("|", "\\|").replace("<", "&lt;")


def configuration() -> str:
    """Page of all keys of a config, and of the options of the estimators that come along."""
    lines = [
        "# Configuration",
        "",
        "A config is one YAML file. It may build on another (`extends: ds3.yaml`): values are laid over",
        "those of the other key by key; `estimators` and `ablation_chain` are replaced as a whole. An",
        "unknown key is an error. `vislam compare CONFIG --dump-config` prints the effective",
        "configuration with all defaults, and `--set dotted.path=value` overrides one value.",
        "",
        "Six numbers are (omega, v) along the body's axes: three of rotation, three of translation.",
        "",
    ]
    lines += _section(Config, "", "The config")
    lines += _section(StudyConfig, "study", "study")
    lines += _section(Check, "checks[]", "checks")
    for kind, title in (
        (EkfOptions, "Options of the filters"),
        (MsckfOptions, "Options of msckf"),
        (SmootherOptions, "Options of the smoothers"),
        (DeadReckoningOptions, "Options of dead_reckoning"),
        (StereoVoOptions, "Options of stereo_vo"),
        (MappingOnlyOptions, "Options of mapping_only"),
        (KnownMapOptions, "Options of known_map"),
        (ReportEkfOptions, "Options of report_ekf"),
    ):
        lines += _section(kind, "", title)
    return "\n".join(lines)


def _section(kind: Any, path: str, title: str) -> list[str]:
    """A table of the fields of a settings class, and after it those of the classes in it."""
    heading = f"## {title}" if not path or "." not in path else f"### {title}"
    first = (inspect.getdoc(kind) or "").partition("\n")[0]
    lines = [heading, "", _markdown(first), "", "| key | type | default | meaning |", "|---|---|---|---|"]
    documents, hints, inside = _documented(kind), get_type_hints(kind, include_extras=False), []
    for field in fields(kind):
        nested = [found for found in _nested(hints[field.name]) if found is not kind]
        dotted = f"{path}.{field.name}" if path else field.name
        inside += [(found, dotted, len(nested) > 1) for found in nested]
        meaning = _cell(documents.get(field.name, FORMAT if field.name == "format" else ""))
        lines.append(f"| `{field.name}` | {_kind(hints[field.name])} | {_default(field)} | {meaning} |")
    lines.append("")
    for found, dotted, one_of_several in inside:
        if found is not Check:
            name = f"{dotted} ({_format(found)})" if one_of_several else dotted
            lines += _section(found, dotted, name)
    return lines


def _format(kind: Any) -> str:
    """Format by which a section is told from others in its place."""
    default = kind.__dataclass_fields__["format"].default
    return "any other format" if default is MISSING else f"format: {default}"


def _documented(kind: Any) -> dict[str, str]:
    """Texts under the fields of a class and of its bases."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for above, below in zip(body.body, body.body[1:], strict=False):
            is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            if isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name) and is_text:
                found[above.target.id] = _markdown(str(below.value.value))  # type: ignore[attr-defined]
    return found


def _nested(hint: Any) -> list[Any]:
    """Settings classes that an annotation holds."""
    if is_dataclass(hint):
        return [hint]
    return [found for part in get_args(hint) for found in _nested(part)]


def _kind(hint: Any) -> str:
    text = hint.__name__ if isinstance(hint, type) and not get_args(hint) else str(hint)
    text = re.sub(r"vislam\S*\.(\w+)", r"\1", text).replace("typing.", "")
    text = re.sub(r"tuple\[(float(?:, float){5})\]", "6 floats", text)
    text = re.sub(
        r"Literal\[([^\]]*)\]", lambda found: found.group(1).replace("'", "").replace(", ", " or "), text
    )
    return f"{text.replace('NoneType', 'None').replace('|', 'or')}"


def _default(field: Any) -> str:
    default = field.default
    if isinstance(default, FieldInfo):
        value = default.get_default(call_default_factory=True, validated_data={})
    elif default is not MISSING:
        value = default
    elif field.default_factory is not MISSING:
        value = field.default_factory()
    else:
        return "required"
    if is_dataclass(value):
        return "see below"
    return f"`{inline(value).removesuffix(' ...') if value is not None else 'null'}`"


def metrics() -> str:
    """Page of all metrics of the registry, an anchor each."""
    lines = [
        "# Metrics",
        "",
        "Keys are those of `metrics.json`. Each metric of the poses is computed of the filtered estimate",
        "(each pose from the data up to its frame) and, where a run has one, of the smoothed estimate",
        "(each pose from all data); `estimate` says which. Every metric states there what it was measured",
        "against, and with which alignment. [Families of metrics](metric_families.md) has those without a",
        "row in the tables.",
        "",
    ]
    for key, spec in METRICS.items():
        unit = spec.unit or "none"
        better = f" Better: {BETTER[spec.better]}." if spec.better else ""
        lines += [
            f"({key})=",
            f"## {spec.title}",
            "",
            f"`{key}`, unit: {unit}.{better}",
            "",
            DEFINITIONS.get(key, ""),
            "",
        ]
    return "\n".join(lines)


def saved_runs() -> str:
    """Page of the archives in a results folder, from the tables that they are checked against."""
    lines = [
        "# Saved runs and records",
        "",
        "`results/<id>/runs/<name>.npz` holds a run, `results/<id>/record.npz` the sequence behind the",
        "runs: all that evaluation and report need. They are zip archives of plain arrays under dotted",
        "names, without pickled objects. A letter in a shape is a size; fields with the same letter share",
        "it. `vislam evaluate` checks every field for type, shape and range.",
        "",
    ]
    for title, module in (("A run", run), ("A record", record)):
        table: Table = module._TABLE
        lines += [f"## {title}", "", "| field | shape | holds |", "|---|---|---|"]
        lines += [f"| `{name}` | {shape} | {what} |" for name, shape, what in _rows(table)]
        lines.append("")
    lines += [
        "## Units and frames",
        "",
        "Poses are `world_T_imu`, metres; covariances (omega, v) on the right, rad² and m²; points in the",
        "world frame, metres; `z` and `sigma` are (uL, uR, v) in px; stamps in seconds; `twist` is",
        "(omega, v) of the body in rad/s and m/s. See [conventions](../concepts/conventions.md).",
        "",
    ]
    return "\n".join(lines)


def _rows(table: Table) -> Iterator[tuple[str, str, str]]:
    for name, what in table.items():
        if isinstance(what, Numbers):
            rules = [rule.expected for rule in what.rules]
            rules += ["NaN where not given"] if what.gaps else []
            rules += ["or null"] if what.optional else []
            yield (
                name,
                f"({what.shape.replace('|', ') or (').replace(' ', ', ')})",
                f"{what.kind}; {_cell('; '.join(rules))}".strip("; "),
            )
        elif isinstance(what, Section):
            yield name, "", "section" + (", or null" if what.optional else "")
        elif isinstance(what, Each):
            yield name, "", "a section for each name, with " + ", ".join(f"`{key}`" for key in what.fields)
        elif isinstance(what, Plain):
            yield name, "", f"{_kind(what.type)}".split("Annotated")[0].strip("[ ") or "value"
