"""The backward pass: every landmark and every pose against the dense filter, which never lets one go."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import plain_motion, recorded
from vislam.base.types import Array
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, load
from vislam.comparison.open import Dataset, open_dataset
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.backward import Smoothed
from vislam.estimators.ekf.dense import DenseFilter
from vislam.estimators.ekf.linear import Update
from vislam.estimators.loop import run

FORMS = [
    pytest.param({"error": error, "landmarks": landmarks}, id=f"{error}-{landmarks}")
    for error in ("standard", "fej", "invariant")
    for landmarks in ("point", "anchored_uvd")
]
CONFIGS = Path(__file__).parents[2] / "configs"
RELATIVE = 1e-8


def both(dataset: Dataset, config: Config, **options) -> tuple[Smoothed, DenseFilter, EkfEstimator]:
    """What the backward pass says, and the dense filter after the same frames."""
    problem = make_problem(config, dataset)
    working = EkfEstimator(problem, EkfOptions(gate=False, smoothed=True, track_errors="states", **options))
    form = {key: value for key, value in options.items() if key in ("error", "landmarks")}
    dense = DenseFilter(problem, keep_poses=True, **form)
    for frame in dataset.sequence.frames(pixel_sigma(config, dataset)):
        working.process(frame)
        dense.process(frame)
    return working.smooth(), dense, working


def off(found: Array, expected: Array) -> float:
    """Largest relative difference of any item along the first axis."""
    item = tuple(range(1, expected.ndim))
    return float((np.linalg.norm(found - expected, axis=item) / np.linalg.norm(expected, axis=item)).max())


def world(dense: DenseFilter) -> tuple[Array, Array, Array]:
    """Points, marginal covariances and cross-covariances with the pose, tracks ascending."""
    order = np.argsort(dense.track)
    parametrisation = dense._camera.parametrisation
    points, jacobian = parametrisation.points(dense.landmarks[order, :3])
    anchors = dense.anchors[order]
    turned = anchors[:, :3, :3] @ jacobian
    places = [dense.place["landmark", dense.track[slot]].start for slot in order]
    cov = np.array([dense.cov[p : p + 3, p : p + 3] for p in places])
    cross = np.array([dense.cov[p : p + 3, :6] for p in places])
    points = np.einsum("nij,nj->ni", anchors[:, :3, :3], points) + anchors[:, :3, 3]
    return points, turned @ cov @ turned.transpose(0, 2, 1), turned @ cross


def check_equal(smoothed: Smoothed, dense: DenseFilter) -> None:
    points, cov, cross = world(dense)
    landmarks = smoothed.landmarks
    assert np.array_equal(landmarks.track, np.sort(dense.track))
    assert off(landmarks.points_world, points) < RELATIVE
    assert off(landmarks.points_cov, cov) < RELATIVE
    assert off(landmarks.points_pose_cov, cross) < RELATIVE
    assert np.allclose(smoothed.world_T_imu, dense.past, atol=1e-9)
    places = [dense.place["pose", k] for k in range(len(dense.past))]
    expected = np.array([dense.cov[place, place] for place in places])
    assert off(smoothed.pose_cov, expected) < RELATIVE


@pytest.mark.parametrize("options", FORMS)
def test_landmarks_and_poses_equal_those_of_the_dense_filter(short, short_config, options):
    smoothed, dense, working = both(short, short_config, **options)
    assert len(working.state.track) < 0.7 * len(smoothed.landmarks.track)
    check_equal(smoothed, dense)


def test_it_is_later_data_that_make_the_difference(short: Dataset, short_config: Config):
    """Guards the tests above: a landmark as it left is not what the dense filter has."""
    _, dense, _ = both(short, short_config)
    problem = make_problem(short_config, short)
    left = run(
        EkfEstimator(
            problem, EkfOptions(gate=False, marginalised_landmarks="filtered", track_errors="states")
        ),
        short.sequence,
        pixel_sigma(short_config, short),
        name="left",
    )
    assert left.complete
    points, cov, _ = world(dense)
    assert off(left.map.points_world, points) > 1e-4
    assert off(left.map.points_cov, cov) > 1e-4
    assert np.all(np.trace(cov - left.map.points_cov, axis1=1, axis2=2) < 1e-7)


def test_little_memory_changes_nothing_but_the_work(short_config: Config):
    longer = replace(short_config.data.simulation, frames=140)
    config = replace(short_config, data=replace(short_config.data, simulation=longer))
    dataset = open_dataset(config.data, seed=3)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    runs, recorders = [], []
    for memory in (1000.0, 4.0, 2.0):
        estimator = EkfEstimator(problem, EkfOptions(smoothed=True, error="invariant", memory_mb=memory))
        runs.append(run(estimator, dataset.sequence, sigma, name="eks"))
        recorders.append(estimator._recorder)
    assert runs[0].log.counts["frames_computed_again"] == 0
    assert 100 < runs[1].log.counts["frames_computed_again"] < runs[2].log.counts["frames_computed_again"]
    for other, recorder, memory in zip(runs[1:], recorders[1:], (4.0, 2.0), strict=True):
        assert np.array_equal(other.final.world_T_imu, runs[0].final.world_T_imu)
        assert np.array_equal(other.landmarks.points_world, runs[0].landmarks.points_world)
        assert np.array_equal(other.landmarks.points_cov, runs[0].landmarks.points_cov)
        assert recorder.peak < 1.1e6 * memory


def test_a_wrong_way_back_is_caught(short: Dataset, short_config: Config, monkeypatch: pytest.MonkeyPatch):
    true = Update.back

    def forgets_the_gain(self, after):
        back = true(self, after)
        back.vectors[:, 0] *= 0.999
        return back

    monkeypatch.setattr(Update, "back", forgets_the_gain)
    smoothed, dense, _ = both(short, short_config)
    with pytest.raises(AssertionError):
        check_equal(smoothed, dense)


@pytest.mark.slow
@pytest.mark.parametrize("options", FORMS)
def test_it_is_exact_on_the_recording(options):
    """The first 100 frames of 03.npz, one track in eight, so that the dense filter can keep them all."""
    config = plain_motion(load(CONFIGS / "ds3.yaml"))
    dataset = open_dataset(config.data, seed=0, data_dir=recorded("03.npz").parent, allow_substitute=False)
    sequence = dataset.sequence.first(100)
    dataset = replace(dataset, sequence=sequence.select(sequence.track % 8 == 0))
    smoothed, dense, _ = both(dataset, config, **options)
    assert len(dense.track) > 100
    check_equal(smoothed, dense)


def test_a_stretch_ends_before_it_takes_much_of_the_memory(short: Dataset, short_config: Config):
    """Large steps are dropped a few frames at a time, so that the memory holds for many tracks as well."""
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    estimator = EkfEstimator(problem, EkfOptions(memory_mb=0.35))
    for frame in short.sequence.frames(sigma):
        estimator.process(frame)
    assert estimator._recorder is not None
    assert max(len(stretch.inputs) for stretch in estimator._recorder._stretches[-2:]) < 8
    assert estimator._recorder.peak < 1.5 * 0.35e6
