"""The API of Python: what the commands do, without a word and without a file."""

import doctest
import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import vislam
from vislam import api
from vislam.base.errors import ConfigError, DataError
from vislam.comparison.compare import make_problem
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find

CALLED = ("compare", "evaluate", "inspect")


@pytest.fixture(scope="module")
def outcome():
    return vislam.compare("tiny", estimators=["dead_reckoning", "ekf"])


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_examples_run(elsewhere):
    found = doctest.testmod(api)
    assert found.attempted >= 8
    assert not found.failed
    assert not list(elsewhere.iterdir())


def test_nothing_is_printed_and_nothing_written(elsewhere, capfd):
    vislam.compare("tiny", estimators=["dead_reckoning"])
    assert capfd.readouterr() == ("", "")
    assert not list(elsewhere.iterdir())


def test_it_has_the_metrics_of_the_command(outcome, elsewhere):
    command = import_module("vislam.cli.compare")
    arguments = ["tiny", "--estimators", "dead_reckoning,ekf", "--no-report"]
    assert command.main(arguments) == 0
    document = json.loads(next(Path("results").glob("*/metrics.json")).read_text(encoding="utf-8"))
    timed = ("time", "rss")
    compared = [item for item in document["metrics"] if not any(word in item["key"] for word in timed)]
    assert len(compared) > 20
    for item in compared:
        found = outcome.evaluation.value(item["estimator"], item["key"], item["estimate"])
        assert found == pytest.approx(item["value"], rel=1e-9)


@pytest.mark.slow
def test_what_is_saved_is_scored_again_to_the_same(outcome, elsewhere):
    folder = outcome.save()
    assert not (folder / "report.html").exists()
    again = vislam.evaluate(folder)
    assert again.value("ekf", "ate_rmse") == outcome.metric("ate_rmse", "ekf")
    page = outcome.report()
    assert page == folder / "report.html"
    assert "ekf" in page.read_text(encoding="utf-8")


def test_results_show_themselves(outcome):
    assert "| ATE, SE(3) aligned [m] |" in outcome.table()
    assert len(outcome.table(every=True)) > len(outcome.table())
    assert "[SIMULATED]" in repr(outcome)
    shown = outcome._repr_html_()
    assert shown.count("<table>") == shown.count("</table>") == 1
    assert shown.count("<svg") == shown.count("</svg>") == 1
    assert "[SIMULATED]" in shown


@pytest.mark.parametrize(
    ("key", "estimator", "message"),
    [
        ("ate_rmse", "nobody", "no run 'nobody'; there are dead_reckoning, ekf"),
        ("ate", "ekf", "ekf has no metric 'ate'; it has .*ate_rmse"),
    ],
)
def test_a_wrong_name_is_told_with_those_that_there_are(key, estimator, message, outcome):
    with pytest.raises(ConfigError, match=message):
        outcome.metric(key, estimator)


def test_a_built_estimator_runs_like_one_that_is_named():
    config = vislam.load_config("tiny")
    dataset = open_dataset(config.data, seed=config.seed, data_dir=None, allow_substitute=True)
    built = find("ekf")(make_problem(config, dataset), {})
    one, other = vislam.run(built, dataset, config=config), vislam.run("ekf", config)
    assert one.complete
    assert np.array_equal(one.final.world_T_imu, other.final.world_T_imu)
    with pytest.raises(ConfigError, match="has no noise"):
        vislam.run("ekf", dataset)


def test_an_option_reaches_the_estimator():
    with pytest.raises(ConfigError, match="unknown key"):
        vislam.run("ekf", "tiny", options={"nothing": 1})


def test_a_recording_is_read_and_inspected(elsewhere):
    simulate = import_module("vislam.cli.simulate")
    assert simulate.main(["tiny", "--out", "drive.npz", "--set", "data.simulation.frames=16"]) == 0
    sequence = vislam.datasets.open("drive.npz")
    assert sequence.observations > 100
    found = [vislam.inspect(sequence), vislam.inspect("drive.npz"), vislam.inspect(Path("drive.npz"))]
    assert {tuple(item.text for item in one.findings) for one in found} == {
        tuple(item.text for item in found[0].findings)
    }
    with pytest.raises(DataError, match="not found"):
        vislam.datasets.open("nothing.npz")


def run_python(code, *arguments):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True)


def told(name, order):
    steps = {
        "before": f"import vislam.{name}",
        "after": f"import vislam; vislam.{name}; import vislam.{name}",
        "both": f"import vislam.{name}; from vislam import {name}",
    }
    return f"""
import sys
from inspect import signature
{steps[order]}
from vislam.base.errors import ConfigError, DataError
assert callable(vislam.{name})
assert vislam.{name} is sys.modules["vislam.{name}"]
assert vislam.{name}.main is not None
assert "Examples" in vislam.{name}.__doc__
assert list(signature(vislam.{name}).parameters)[0] in ("config", "results", "data")
try:
    vislam.{name}("nothing-of-that-name")
except (ConfigError, DataError):
    print("called")
"""


FORKS = """
import json, os, sys
import gtsam, matplotlib.figure, numpy, pydantic, rich.progress, scipy.optimize, scipy.stats, yaml
assert not [name for name in sys.modules if name.partition(".")[0] == "vislam"]
for name, code in json.loads(sys.argv[1]).items():
    print(name, end=" ", flush=True)
    if os.fork() == 0:
        exec(code, {"__name__": "__main__"})
        sys.stdout.flush()
        os._exit(0)
    if os.wait()[1]:
        print("failed", flush=True)
"""
"""Runs each code in a process that has loaded nothing of vislam; what vislam needs is loaded once for all."""


@pytest.fixture(scope="module")
def forked():
    """What the code for each name and order prints, run on its own."""
    codes = {f"{name}-{order}": told(name, order) for name in CALLED for order in ("before", "after", "both")}
    done = run_python(FORKS, json.dumps(codes))
    return dict(line.split(" ", 1) for line in done.stdout.splitlines()), done.stderr


@pytest.mark.parametrize("name", CALLED)
@pytest.mark.parametrize("order", ["before", "after", "both"])
def test_a_name_is_called_whether_its_command_is_imported_or_not(name, order, forked):
    printed, said = forked
    assert printed[f"{name}-{order}"] == "called", said


def test_the_package_alone_loads_nothing_heavy():
    heavy = "{'numpy', 'scipy', 'gtsam', 'pydantic', 'matplotlib', 'rich', 'dask'}"
    done = run_python(f"import vislam, sys; print(sorted({heavy} & set(sys.modules)))")
    assert done.stdout == "[]\n", done.stderr


@pytest.mark.parametrize("name", vislam.__all__)
def test_every_public_name_is_there(name):
    assert getattr(vislam, name).__doc__
    assert name in dir(vislam)


def test_a_name_that_is_not_there_is_said():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        vislam.nothing  # noqa: B018
