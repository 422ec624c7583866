"""A tiny comparison, run once, and pages written of it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from vislam.compare import main
from vislam.comparison.results import Results
from vislam.core.record import Record
from vislam.core.run import Run
from vislam.evaluation import Evaluation, evaluate
from vislam.report.figures import all_figures
from vislam.report.page import Content, write_page
from vislam.report.scene import scene_data
from vislam.report.shown import Shown

TINY = Path(__file__).parents[2] / "configs" / "tiny.yaml"


@dataclass(frozen=True)
class Tiny:
    folder: Path
    results: Results
    evaluation: Evaluation

    @property
    def runs(self) -> dict[str, Run]:
        return self.results.runs

    @property
    def record(self) -> Record:
        return self.results.record

    @property
    def shown(self) -> Shown:
        return Shown.of(self.runs, self.record, self.evaluation, ())

    def page(self, path: Path, **changes: Any) -> str:
        """Write a page of the comparison, changed in some of its parts, and return its text."""
        shown, record = self.shown, self.record
        content = Content(
            title="tiny",
            runs=self.runs,
            record=replace(record, notes=(), provenance={"code": "1234"}),
            evaluation=self.evaluation,
            steps=(),
            figures=all_figures(shown),
            scene=scene_data(shown),
            travelled=shown.travelled(),
            config="name: tiny",
        )
        write_page(path, replace(content, **changes))
        return path.read_text("utf-8")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> Tiny:
    out = tmp_path_factory.mktemp("tiny")
    assert main(["--config", str(TINY), "--out", str(out), "--no-report"]) == 0
    (folder,) = out.iterdir()
    results = Results.load(folder)
    return Tiny(folder, results, evaluate(results.runs, results.record))
