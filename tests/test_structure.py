"""The rules of the house that can be checked: imports point one way, and every import is declared."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "geometry": ("sensors", "motion", "data", "ekf", "smoother", "evaluation", "report", "comparison"),
    "sensors": ("data", "ekf", "smoother", "evaluation", "report", "comparison"),
    "data": ("ekf", "smoother", "evaluation", "report", "comparison"),
    "simulation": ("ekf", "smoother", "evaluation", "report", "comparison"),
    "ekf": ("smoother", "evaluation", "report", "comparison"),
    "smoother": ("ekf", "evaluation", "report", "comparison"),
    "evaluation": ("ekf", "smoother", "estimator", "checks", "report", "results", "comparison"),
    "checks": ("ekf", "smoother", "estimator", "report", "results", "comparison"),
    "report": ("ekf", "smoother", "estimator", "results", "comparison"),
}


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("package", sorted(FORBIDDEN))
def test_imports_point_one_way(package):
    for path in (ROOT / "vislam" / package).rglob("*.py"):
        for name in imported(path):
            for other in FORBIDDEN[package]:
                assert not (name + ".").startswith(f"vislam.{other}."), f"{path.name} imports {name}"


def test_nothing_in_the_package_imports_the_baselines():
    for path in (ROOT / "vislam").rglob("*.py"):
        assert not any(name.startswith("baselines") for name in imported(path)), path
