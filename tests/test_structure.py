"""The rules of the house that can be checked: one list of rooms, and imports that point one way."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ORDER = (
    ("cli",),
    ("study", "calibration", "inspection", "ledger"),
    ("comparison",),
    ("checks", "report"),
    ("evaluation",),
    ("estimators",),
    ("frontend", "repair", "simulation", "initialisation"),
    ("datasets",),
    ("core",),
    ("models",),
    ("geometry",),
    ("base",),
)
"""The rooms from the top down: each may import what is below it, and nothing beside it."""
LEVEL = {room: level for level, rooms in enumerate(ORDER) for room in rooms}
COMMANDS = {"calibrate", "compare", "evaluate", "fetch", "inspect", "simulate", "study.__main__", "__main__"}
"""What stands for a command of its own: thin, above all rooms."""
AT_THE_ROOT = {"__init__", "api", "testing"}
APART = (
    ("estimators.ekf", "estimators.smoother"),
    ("estimators.ekf", "estimators.msckf"),
    ("estimators.msckf", "estimators.smoother"),
    ("estimators.smoother", "estimators.ekf"),
    ("estimators.smoother", "estimators.msckf"),
)
"""Parts of one room that do not know each other; ``msckf`` has the filter's model of motion."""


def modules():
    for path in sorted((ROOT / "vislam").rglob("*.py")):
        yield ".".join(path.relative_to(ROOT / "vislam").with_suffix("").parts), path


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def wrong(module, names):
    """Those of the imports that point up, beside, or to what is no room."""
    room = module.split(".")[0]
    for name in names:
        first, _, rest = name.partition(".")
        if first in ("baselines", "vislam_baselines", "experiments", "tests"):
            yield name
        if first != "vislam":
            continue
        other = rest.split(".")[0]
        if other != room and LEVEL.get(other, -1) <= LEVEL[room]:
            yield name
        if any(f"{module}.".startswith(f"{one}.") and f"{rest}.".startswith(f"{two}.") for one, two in APART):
            yield name


def test_every_module_is_in_a_room_that_is_listed():
    for module, path in modules():
        if "." not in module:
            assert module in COMMANDS | AT_THE_ROOT, f"{path}: which room does it belong to?"
        else:
            assert module.split(".")[0] in LEVEL, f"{path}: its room is not in the list"


def test_imports_point_one_way():
    found = {module: list(wrong(module, imported(path))) for module, path in modules() if "." in module}
    found = {module: names for module, names in found.items() if names and module not in COMMANDS}
    assert not found, found


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("core.sequence", "vislam.datasets.find"),
        ("report.page", "vislam.checks.judge"),
        ("datasets.oxts", "vislam.neverheardof.oxts"),
        ("base.files", "vislam.geometry"),
        ("estimators.ekf.filter", "vislam.estimators.smoother.keys"),
        ("estimators.loop", "vislam_baselines.landmarks"),
        ("comparison.running", "vislam.compare"),
    ],
)
def test_an_import_against_the_order_is_found(module, name):
    assert list(wrong(module, [name])) == [name]
