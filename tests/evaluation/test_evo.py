"""The trajectory errors are those of evo, an independent implementation that many papers used."""

import ast
from pathlib import Path

import numpy as np
import pytest
from evo.core.geometry import umeyama_alignment
from evo.core.metrics import APE, RPE, PoseRelation, Unit
from evo.core.trajectory import PosePath3D

from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.rpe import RelativeErrors, rpe_by_distance, rpe_by_time
from vislam.evaluation.trajectory import ate

AGREE = 1e-9
"""[m], [rad]."""
ALIGNED = {
    "none": lambda estimate, reference: None,
    "first_pose": lambda estimate, reference: estimate.align_origin(reference),
    "se3": lambda estimate, reference: estimate.align(reference),
    "sim3": lambda estimate, reference: estimate.align(reference, correct_scale=True),
}
POSITION, ROTATION = PoseRelation.translation_part, PoseRelation.rotation_angle_rad


def paths(matched):
    return PosePath3D(poses_se3=list(matched.pose)), PosePath3D(poses_se3=list(matched.estimate))


def measured(metric, pair):
    metric.process_data(pair)
    return metric


def told(metric):
    values = metric.get_all_statistics()
    return [values[name] for name in ("rmse", "mean", "median", "max")]


def ours(statistics):
    return [statistics.rmse, statistics.mean, statistics.median, statistics.max]


@pytest.mark.parametrize("kind", ALIGNED)
@pytest.mark.parametrize("keep", [slice(None), slice(5, None, 3)])
def test_absolute_errors_are_those_of_evo(drive, kind, keep):
    matched = drive.matched(keep)
    reference, estimate = paths(matched)
    ALIGNED[kind](estimate, reference)
    errors = ate(matched, find_alignment(kind, matched))
    position, rotation = (measured(APE(part), (reference, estimate)) for part in (POSITION, ROTATION))
    assert np.allclose(errors.position_error, position.E, rtol=0.0, atol=AGREE)
    assert np.allclose(errors.rotation_error, rotation.error, rtol=0.0, atol=AGREE)
    assert np.allclose(ours(errors.position), told(position), rtol=0.0, atol=AGREE)
    assert np.allclose(ours(errors.rotation), told(rotation), rtol=0.0, atol=AGREE)


def test_the_planar_alignment_is_that_of_evo_on_points_of_the_plane(drive):
    matched = drive.matched()
    rotation, translation, _ = umeyama_alignment(matched.estimate[:, :2, 3].T, matched.position[:, :2].T)
    found = find_alignment("planar", matched)
    assert np.allclose(found.rotation[:2, :2], rotation, rtol=0.0, atol=AGREE)
    assert np.allclose(found.translation[:2], translation, rtol=0.0, atol=AGREE)
    error = matched.estimate[:, :2, 3] @ rotation.T + translation - matched.position[:, :2]
    assert np.allclose(ate(matched, found).position_error, error, rtol=0.0, atol=AGREE)


@pytest.mark.parametrize("length", [1.0, 10.0, 50.0, 100.0, 400.0])
def test_relative_errors_over_a_distance_are_those_of_evo(drive, length):
    matched = drive.matched()
    holds_to_evo(rpe_by_distance(matched, length), matched, length, Unit.meters)


@pytest.mark.parametrize("frames", [1, 10, 100])
def test_relative_errors_over_a_time_are_those_of_evo_over_as_many_frames(drive, frames):
    """The stamps of both drives are even, so as many frames are as much time, except at the end.

    There a segment may be up to a tenth too short, as one of a distance may, where evo counts frames exactly.
    """
    matched = drive.matched()
    seconds = frames * np.median(np.diff(matched.stamp))
    errors = rpe_by_time(matched, seconds)
    whole = errors.first <= matched.frame[-1] - frames
    short = matched.stamp[errors.last[~whole]] - matched.stamp[errors.first[~whole]]
    assert len(short) == frames // 10
    assert np.all(np.abs(short - seconds) <= 0.1 * seconds)
    parts = (errors.first, errors.last, errors.translation_error, errors.rotation_error)
    holds_to_evo(RelativeErrors(*(part[whole] for part in parts)), matched, frames, Unit.frames)


def holds_to_evo(errors, matched, delta, unit):
    pair = paths(matched)
    settings = {"delta": delta, "delta_unit": unit, "all_pairs": True, "pairs_from_reference": True}
    position, rotation = (measured(RPE(part, **settings), pair) for part in (POSITION, ROTATION))
    assert np.array_equal(errors.last, matched.frame[position.delta_ids])
    assert np.allclose(errors.translation_error, position.error, rtol=0.0, atol=AGREE)
    assert np.allclose(errors.rotation_error, rotation.error, rtol=0.0, atol=AGREE)
    assert np.allclose(ours(errors.translation), told(position), rtol=0.0, atol=AGREE)
    assert np.allclose(ours(errors.rotation), told(rotation), rtol=0.0, atol=AGREE)


def test_evo_is_for_the_tests_alone():
    root = Path(__file__).parents[2]
    for path in [*(root / "vislam").rglob("*.py"), *(root / "baselines").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] == "evo" for name in names), path
