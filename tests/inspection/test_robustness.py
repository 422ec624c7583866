"""Whatever loads can be inspected: findings, figures and a config come out of any sequence, no traceback."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vislam.comparison import config as configuration
from vislam.comparison.config import Config, DataConfig
from vislam.inspection import inspect_sequence
from vislam.inspection import page as inspection_page
from vislam.inspection.page import write_inspection
from vislam.inspection.written import proposed_config
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig, simulate

VERDICTS = {"ok", "fault", "unclear", "note"}
TREE = {"name": "s", "data": {"file": "s.npz", "repair": {"duplicated_tracks": False, "disparity": False}}}


def no_tracks(sequence):
    return sequence.select(np.zeros(sequence.observations, bool))


def one_track(sequence):
    return sequence.select(sequence.track == sequence.track[0])


def one_frame_of_tracks(sequence):
    return sequence.select(sequence.frame_of == 1)


def identical_pixels(sequence):
    return replace(sequence, pixels=np.tile(sequence.pixels[:1], (sequence.observations, 1)))


def zero_disparity(sequence):
    pixels = sequence.pixels.copy()
    pixels[:, 2] = pixels[:, 0]
    return replace(sequence, pixels=pixels)


def swapped(sequence):
    return replace(sequence, pixels=sequence.pixels[:, [2, 3, 0, 1]])


def stationary(sequence):
    first = {}
    for row, track in enumerate(sequence.track):
        first.setdefault(int(track), row)
    rows = [first[int(track)] for track in sequence.track]
    return replace(sequence, pixels=sequence.pixels[rows], twist=np.zeros_like(sequence.twist))


def constant_twist(sequence):
    return replace(sequence, twist=np.tile(sequence.twist[:1], (len(sequence.twist), 1)))


def no_twist(sequence):
    return replace(sequence, twist=np.zeros_like(sequence.twist))


def single_axis(sequence):
    return replace(sequence, twist=sequence.twist * np.array([0, 0, 1.0, 0, 0, 0]))


def huge_gap(sequence):
    late = np.where(np.arange(len(sequence)) >= len(sequence) // 2, 1e5, 0.0)
    return replace(sequence, stamp=sequence.stamp + late, inertial_stamp=sequence.inertial_stamp + late)


def milliseconds(sequence):
    return replace(sequence, stamp=1e3 * sequence.stamp, inertial_stamp=1e3 * sequence.inertial_stamp)


def short_steps(sequence):
    return replace(sequence, stamp=1e-5 * sequence.stamp, inertial_stamp=1e-5 * sequence.inertial_stamp)


def wide_baseline(sequence):
    return replace(sequence, rig=replace(sequence.rig, baseline=1e3 * sequence.rig.baseline))


def fast_turns(sequence):
    return replace(sequence, twist=sequence.twist + np.array([100.0, -100, 50, 0, 0, 0]))


FAULTS = (
    no_tracks,
    one_track,
    one_frame_of_tracks,
    identical_pixels,
    zero_disparity,
    swapped,
    stationary,
    constant_twist,
    no_twist,
    single_axis,
    huge_gap,
    milliseconds,
    short_steps,
    wide_baseline,
    fast_turns,
)


def look_at(sequence, folder):
    """All that the command makes of a sequence; the config that it writes is one that parses."""
    nothing = RepairConfig(duplicated_tracks=None, disparity=None)
    config = Config(name="s", data=DataConfig(file="s.npz", repair=nothing))
    result = inspect_sequence(sequence, config)
    assert {finding.verdict for finding in result.findings} <= VERDICTS
    assert len({finding.check for finding in result.findings}) == len(result.findings)
    write_inspection(folder, result, synthetic=False)
    json.loads((folder / "inspection.json").read_text(), parse_constant=pytest.fail)
    target = folder / "written.yaml"
    target.write_text(proposed_config(TREE, result, folders=[], written_to=target))
    return result, configuration.load(target)


def drive(frames, tracks, *, seed=1, period=0.1046, speed=12.7):
    settings = SimulationConfig(frames=frames, tracks_in_view=tracks, period=period, speed=speed)
    return simulate(settings, seed=seed, name="s")[0]


each_fault = pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)


@each_fault
def test_each_fault_alone(tmp_path, fault, monkeypatch):
    # Its figures are made here and rendered below, which takes as long again.
    monkeypatch.setattr(inspection_page, "drawings", lambda result, *, title: {})
    look_at(fault(drive(20, 12.0)), tmp_path)


@pytest.mark.slow
@each_fault
def test_each_fault_alone_is_drawn(tmp_path, fault):
    look_at(fault(drive(26, 14.0)), tmp_path)


@pytest.mark.slow
@settings(
    max_examples=60,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    shape=st.tuples(st.integers(2, 40), st.sampled_from([1.0, 3.0, 7.0, 15.0, 30.0])),
    seed=st.integers(0, 1000),
    period=st.sampled_from([0.005, 0.07, 0.1, 2.0]),
    faults=st.lists(st.sampled_from(FAULTS), max_size=3, unique=True),
)
def test_any_faults_together(tmp_path, shape, seed, period, faults):
    sequence = drive(*shape, seed=seed, period=period, speed=1.0 if period > 1 else 12.7)
    for fault in faults:
        if sequence.observations:
            sequence = fault(sequence)
    look_at(sequence, tmp_path)


@pytest.mark.parametrize(("frames", "tracks"), [(2, 10.0), (3, 10.0), (5, 1.0), (30, 2.0)])
def test_short_sequences(tmp_path, frames, tracks):
    result, _ = look_at(drive(frames, tracks), tmp_path)
    assert "fault" not in {
        item.verdict for item in result.findings if item.check in ("clock", "stereo scale")
    }
