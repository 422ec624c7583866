"""The benchmark on tiny drives: it counts right, and what it gives is finite; no time is judged."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import filter_speed, floor
from benchmarks.filter_speed import PARTS, Bench
from benchmarks.fits import Polynomial, exponent
from benchmarks.timing import MEMBERS, Drive, timed
from vislam.estimators.ekf.layout import LANDMARK
from vislam.models.odometry import NAV


@pytest.fixture(scope="module")
def drive(short, short_config) -> Drive:
    return Drive(short_config, short)


@pytest.mark.parametrize("member", MEMBERS)
def test_the_sizes_that_are_replayed_are_those_of_the_run(drive, member):
    run = timed(drive, MEMBERS[member])
    sequence = drive.dataset.sequence
    held = np.array([sizes.known + sizes.new for sizes in run.sizes])
    assert len(run.sizes) == len(run.step_time) == len(sequence)
    assert np.array_equal(run.dimension, NAV + LANDMARK * held)
    assert [sizes.held for sizes in run.sizes] == [0, *held[:-1]]
    assert all(sizes.fused <= sizes.known <= sizes.held for sizes in run.sizes)
    assert sum(sizes.new for sizes in run.sizes) == len(np.unique(sequence.track))
    assert run.memory > 0
    assert min(floor.replay(run.sizes, MEMBERS[member], repeats=1)) > 0.0


def test_fits_find_the_curve_that_the_times_lie_on():
    at = np.linspace(1.0, 50.0, 20)
    found = Polynomial.through(at, 2e-3 + 3e-6 * at**3)
    assert np.allclose(found(at), 2e-3 + 3e-6 * at**3, rtol=1e-6)
    assert found.residual < 1e-6
    assert exponent(at, 4.0 * at**1.7) == pytest.approx(1.7)


@pytest.mark.slow
def test_all_parts_are_measured_and_written(short_config, tmp_path, capsys):
    wide = replace(
        short_config,
        data=replace(
            short_config.data, simulation=replace(short_config.data.simulation, frames=10, tracks_in_view=80)
        ),
    )
    bench = Bench(
        main=short_config,
        many_tracks=wide,
        repeats=1,
        few=4,
        dense_seconds=0.01,
        drives=(12, 24),
        window=10,
        thinned=8,
    )
    filter_speed.run(bench, list(PARTS), out=tmp_path / "speed.json")
    document = json.loads((tmp_path / "speed.json").read_text())
    assert list(document["parts"]) == list(PARTS)
    assert {"cpu", "date", "numpy", "scipy", "blas"} <= set(document["provenance"])
    numbers = list(ratios(document["parts"]))
    assert len(numbers) > 30
    assert all(np.isfinite(number) and number > 0.0 for number in numbers)
    printed = capsys.readouterr().out
    assert "SIMULATED" in printed
    assert all(f"{name}: " in printed for name in PARTS)


def ratios(tree):
    """All numbers below keys that name a ratio, a share of a target or an exponent."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
            yield from ratios(value)
        elif any(word in str(key) for word in ("ratio", "of_target", "two_threads_", "exponent")):
            yield from np.atleast_1d(value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "nonsense"], "--part nonsense: no such part"),
        (["--dense-seconds", "0"], "--dense-seconds 0"),
        (["--data", "no/such/folder"], "no/such/folder: no such folder"),
        (["--out", "."], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(arguments, said, capsys):
    assert filter_speed.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
