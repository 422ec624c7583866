"""A tiny comparison, run once, and pages written of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from vislam import config as configuration
from vislam.compare import main
from vislam.data.source import Dataset, open_dataset
from vislam.evaluation import Evaluation, evaluate
from vislam.report.figures import all_figures
from vislam.report.page import write_page
from vislam.report.scene import scene_data
from vislam.report.shown import Shown
from vislam.run import Run

TINY = Path(__file__).parents[2] / "configs" / "tiny.yaml"


@dataclass(frozen=True)
class Tiny:
    folder: Path
    dataset: Dataset
    runs: Mapping[str, Run]
    evaluation: Evaluation

    @property
    def shown(self) -> Shown:
        return Shown.of(self.runs, self.dataset.reference, self.evaluation, self.dataset.sequence)

    def page(self, path: Path, **changes: Any) -> str:
        """Write a page of the comparison, changed in some of its parts, and return its text."""
        shown = self.shown
        parts: dict[str, Any] = {
            "title": "tiny",
            "notes": (),
            "runs": self.runs,
            "evaluation": self.evaluation,
            "rungs": (),
            "reference": self.dataset.reference,
            "counts": self.dataset.sequence.counts,
            "repairs": self.dataset.sequence.repairs,
            "frozen": "",
            "figures": all_figures(shown),
            "scene": scene_data(shown),
            "provenance": "code: 1234",
            "config": "name: tiny",
        }
        write_page(path, **(parts | changes))
        return path.read_text("utf-8")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> Tiny:
    out = tmp_path_factory.mktemp("tiny")
    assert main(["--config", str(TINY), "--out", str(out)]) == 0
    (folder,) = out.iterdir()
    config = configuration.load(TINY)
    dataset = open_dataset(config.data, seed=config.seed)
    runs = {name: Run.load(folder / "runs" / f"{name}.npz") for name in config.estimators}
    return Tiny(folder, dataset, runs, evaluate(runs, dataset.reference))
