"""evo's own test data, by this command and by evo: the same numbers to all digits that floats carry."""

import os
import subprocess
import sys
import tarfile
from importlib.metadata import version

import numpy as np
import pytest

import vislam

file_interface = pytest.importorskip("evo.tools.file_interface")
EXACT = 1e-9


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Folder ``test/data`` of evo's source distribution: ``$VISLAM_EVO_DATA``, or from the package index."""
    from pathlib import Path

    if given := os.environ.get("VISLAM_EVO_DATA"):
        return Path(given)
    folder = tmp_path_factory.mktemp("evo")
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", ":all:"]
    wanted = f"evo=={version('evo')}"
    if subprocess.run([*command, "-d", str(folder), wanted], capture_output=True, check=False).returncode:
        pytest.skip(
            f"the source distribution of {wanted} cannot be downloaded here ($VISLAM_EVO_DATA names one)"
        )
    with tarfile.open(next(folder.glob("evo-*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    return next(folder.glob("evo-*")) / "test" / "data"


def by_evo(reference, estimate, *, scale=False, pairs=()):
    import copy

    from evo.core import metrics

    aligned = copy.deepcopy(estimate)
    aligned.align(reference, correct_scale=scale)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    found = {"ate": ape.get_statistic(metrics.StatisticsType.rmse)}
    for delta, unit in pairs:
        rpe = metrics.RPE(
            metrics.PoseRelation.translation_part,
            delta,
            unit,
            rel_delta_tol=0.1,
            all_pairs=True,
            pairs_from_reference=True,
        )
        rpe.process_data((reference, estimate))
        found[delta, unit] = rpe.get_statistic(metrics.StatisticsType.rmse)
    return found


STAMPED = {
    "freiburg1_xyz-rgbdslam.txt": "freiburg1_xyz-groundtruth.txt",
    "freiburg1_xyz-ORB_kf_mono.txt": "freiburg1_xyz-groundtruth.txt",
    "fr2_desk_ORB.txt": "fr2_desk_groundtruth.txt",
    "fr2_desk_ORB_kf_mono.txt": "fr2_desk_groundtruth.txt",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(STAMPED))
def test_stamped_trajectories_score_as_by_evo(name, data):
    from evo.core import sync
    from evo.core.units import Unit

    reference = file_interface.read_tum_trajectory_file(data / STAMPED[name])
    estimate = file_interface.read_tum_trajectory_file(data / name)
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=0.01)
    expected = by_evo(reference, estimate, pairs=[(5.0, Unit.meters)])
    outcome = vislam.evaluate(
        reference=data / STAMPED[name], trajectories={"x": data / name}, association="nearest"
    )
    assert outcome.metric("rows_matched", "x") == estimate.num_poses
    assert np.isclose(outcome.metric("ate_rmse", "x"), expected["ate"], rtol=EXACT)
    scaled = by_evo(reference, estimate, scale=True)["ate"]
    assert np.isclose(outcome.metric("ate_sim3_rmse", "x"), scaled, rtol=EXACT)
    if np.isfinite(expected[5.0, Unit.meters]) and "rpe_5m_rmse" in outcome.evaluation.keys("x"):
        assert np.isclose(outcome.metric("rpe_5m_rmse", "x"), expected[5.0, Unit.meters], rtol=EXACT)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["KITTI_00_ORB.txt", "KITTI_00_SPTAM.txt"])
def test_kitti_trajectories_score_as_by_evo(name, data):
    from evo.core.units import Unit

    reference = file_interface.read_kitti_poses_file(data / "KITTI_00_gt.txt")
    estimate = file_interface.read_kitti_poses_file(data / name)
    expected = by_evo(reference, estimate, pairs=[(100.0, Unit.meters)])
    outcome = vislam.evaluate(reference=data / "KITTI_00_gt.txt", trajectories={"x": data / name})
    assert np.isclose(outcome.metric("ate_rmse", "x"), expected["ate"], rtol=EXACT)
    assert np.isclose(outcome.metric("rpe_100m_rmse", "x"), expected[100.0, Unit.meters], rtol=EXACT)
    timed = vislam.evaluate(
        reference={"file": str(data / "KITTI_00_gt.txt"), "times": str(data / "KITTI_00_gt_times.txt")},
        trajectories={"x": {"file": str(data / name), "times": str(data / "KITTI_00_gt_times.txt")}},
    )
    for key in ("ate_rmse", "kitti_t_rel", "kitti_r_rel"):
        assert np.isclose(timed.metric(key, "x"), outcome.metric(key, "x"), rtol=EXACT)


@pytest.mark.slow
def test_every_trajectory_among_it_is_read(data):
    from vislam.datasets.trajectory_formats import ReadOptions, read_rows

    names = [*STAMPED, *STAMPED.values(), "V102.txt", "V102_groundtruth.csv", "georeferenced.tum"]
    assert all(len(read_rows(data / name)) > 30 for name in names)
    bag = read_rows(data / "ROS_example.bag", options=ReadOptions(topic="groundtruth"))
    assert len(bag) > 100
    odometry = read_rows(data / "nav2_turtlebot.mcap", options=ReadOptions(topic="/odom"))
    assert odometry.convention is None or str(odometry.convention) == "position first, world"
