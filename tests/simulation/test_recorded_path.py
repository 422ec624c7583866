"""Drives along recorded poses: smooth, exact in themselves, near what was recorded; and bad files."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.conftest import recorded
from vislam.base.errors import ConfigError, DataError
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.open import open_dataset
from vislam.comparison.simulated import load_recorded_path
from vislam.datasets.trajectories import UPRIGHT, read_poses
from vislam.geometry import se3
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.drive import stereo_rig
from vislam.simulation.path import DrivePath
from vislam.simulation.recorded_path import RecordedPath
from vislam.simulation.settings import RecordedPathConfig
from vislam.study.trial import run_trial

FRAMES = 200
ORIGINAL = SimulationConfig(frames=FRAMES, path="helix", speed=9.0)
ALONG = SimulationConfig(
    frames=FRAMES,
    path="recorded",
    tracks_in_view=10,
    recorded=RecordedPathConfig(file="poses.txt", format="kitti", pose_of="left_camera", up="-y"),
)


def original(time):
    return DrivePath(ORIGINAL, np.random.default_rng(1)).pose(time)


def stamps():
    return ORIGINAL.period * np.arange(FRAMES)


def write_kitti(folder, pose):
    """Poses of the left camera in a world of camera axes, as in KITTI odometry."""
    camera = se3.inverse(UPRIGHT) @ pose @ stereo_rig(ALONG).imu_T_cam
    np.savetxt(folder / "poses.txt", camera[:, :3].reshape(-1, 12))
    return folder / "poses.txt"


def jittered(pose, rng):
    return se3.retract(pose, rng.normal(0.0, [3e-3] * 3 + [0.02] * 3, (len(pose), 6)))


def test_camera_poses_in_camera_axes_become_body_poses_in_an_upright_world(tmp_path):
    pose = original(stamps())
    path = load_recorded_path(write_kitti(tmp_path, pose), ALONG)
    # The splines have a knot every fourth pose; of that much the sway is not a polynomial.
    assert np.abs(se3.local(path.pose(stamps()), pose)).max() < 2e-3


def test_the_mounting_matters(tmp_path):
    file = write_kitti(tmp_path, original(stamps()))
    wrong = replace(ALONG, recorded=replace(ALONG.recorded, pose_of="imu"))
    off = load_recorded_path(file, wrong).pose(stamps())[:, :3, 3] - original(stamps())[:, :3, 3]
    assert np.linalg.norm(off, axis=1).min() > 1.0


def test_stamped_body_poses_start_at_their_first_stamp(tmp_path):
    pose = original(stamps())
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    # Both signs stand for the same rotation.
    quaternion[::2] *= -1.0
    at = 1.3e9 + stamps()
    np.savetxt(tmp_path / "poses.tum", np.column_stack([at, pose[:, :3, 3], quaternion]), fmt="%.9f")
    settings = RecordedPathConfig(file="poses.tum", format="tum")
    path = load_recorded_path(tmp_path / "poses.tum", replace(ALONG, recorded=settings))
    assert np.abs(se3.local(path.pose(stamps()), pose)).max() < 2e-3


def test_the_twist_integrates_to_the_pose_and_is_continuous(rng):
    path = RecordedPath(stamps(), jittered(original(stamps()), rng), knot_spacing=0.4)
    time = np.arange(0.0, stamps()[-1], 0.01)
    half = 0.5 * np.diff(time)
    step = se3.exp(path.twist(time[:-1] + half) * 2.0 * half[:, None])
    wanted = se3.inverse(path.pose(time[:-1])) @ path.pose(time[1:])
    assert np.abs(se3.local(wanted, step)).max() < 5e-6
    # Within 10 ms; the jitter makes for most of it, above all at the ends.
    assert np.abs(np.diff(path.twist(time), axis=0)).max() < 0.2
    climbed = np.diff(path.pose(time)[:, 2, 3])
    assert path.vertical_velocity(time[:-1] + half) * 2.0 * half == pytest.approx(climbed, abs=1e-5)


def test_jitter_is_left_out(rng):
    pose = original(stamps())
    noisy = jittered(pose, rng)
    inner = slice(10, -10)
    rms = [
        np.sqrt(np.mean(se3.local(pose, found)[inner] ** 2, axis=0))
        for found in (noisy, RecordedPath(stamps(), noisy, knot_spacing=0.4).pose(stamps()))
    ]
    # One coefficient for every four poses: half the error.
    assert np.all(rms[1] < 0.65 * rms[0])
    true = DrivePath(ORIGINAL, np.random.default_rng(1)).twist(stamps())
    raw = se3.local(noisy[:-1], noisy[1:]) / ORIGINAL.period - true[:-1]
    smooth = RecordedPath(stamps(), noisy, knot_spacing=0.4).twist(stamps()) - true
    assert np.all(smooth[inner].std(axis=0) < 0.4 * raw[inner].std(axis=0))


def test_a_gap_is_bridged():
    time = np.delete(stamps(), slice(80, 90))
    path = RecordedPath(time, original(time), knot_spacing=0.2)
    gap = stamps()[80:90]
    assert np.abs(path.pose(gap)[:, :3, 3] - original(gap)[:, :3, 3]).max() < 0.1


def test_the_truth_of_a_drive_is_the_path(tmp_path):
    path = load_recorded_path(write_kitti(tmp_path, original(stamps())), ALONG)
    _, truth = simulate(ALONG, seed=1, name="s", path=path)
    steps = [se3.inverse(pose[:-1]) @ pose[1:] for pose in (truth.world_T_imu, path.pose(stamps()))]
    assert np.abs(se3.local(*steps)).max() < 1e-9


def test_a_drive_cannot_be_simulated_without_the_poses():
    with pytest.raises(ValueError, match="needs the poses"):
        simulate(ALONG, seed=1, name="s")


@pytest.mark.parametrize(
    "settings", [{"path": "recorded"}, {"path": "town", "recorded": ALONG.recorded}], ids=["none", "unheard"]
)
def test_a_recorded_path_and_its_poses_are_given_together(settings):
    with pytest.raises(ValueError, match="go together"):
        SimulationConfig(**settings)


@pytest.mark.parametrize(
    ("spoil", "config", "error", "said"),
    [
        (lambda text: text, replace(ALONG, frames=FRAMES + 1), ConfigError, f"must be at most {FRAMES}"),
        (lambda text: text[:11], ALONG, DataError, "12 poses or more"),
        (lambda text: [*text[:50], "1 2 3\n"], ALONG, DataError, ":51: must hold 12 finite numbers"),
        (lambda text: [*text[:50], "2 " * 12 + "\n"], ALONG, DataError, ":51: must have a rotation"),
        (lambda text: [], ALONG, DataError, "got 0"),
    ],
    ids=["long", "few", "ragged", "no rotation", "empty"],
)
def test_a_file_that_cannot_be_used_says_so(tmp_path, spoil, config, error, said):
    file = write_kitti(tmp_path, original(stamps()))
    file.write_text("".join(spoil(file.read_text().splitlines(keepends=True))))
    with pytest.raises(error) as raised:
        load_recorded_path(file, config)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_says_where_it_was_looked_for(tmp_path):
    with pytest.raises(DataError, match=r"poses\.txt: not found in .*--data-dir or \$VISLAM_DATA"):
        open_dataset(DataConfig(simulation=ALONG), seed=1, data_dir=tmp_path)


@pytest.mark.slow
def test_other_processes_find_the_file_too(tmp_path, monkeypatch):
    write_kitti(tmp_path, original(stamps()))
    monkeypatch.setenv("VISLAM_DATA", str(tmp_path))
    drive = replace(ALONG, frames=20)
    tree = asdict(Config(name="n", data=DataConfig(simulation=drive), estimators={"dead_reckoning": {}}))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(run_trial, tree, 1).result()["status"] == "done"
    monkeypatch.setenv("VISLAM_DATA", str(tmp_path / "elsewhere"))
    found = run_trial(tree, 1)
    assert (found["status"], "poses.txt: not found" in found["reason"]) == ("failed", True)


def test_the_drive_of_the_kitti_poses_has_their_shape():
    file = recorded("0027_poses.txt")
    config = replace(ALONG, frames=1101, period=0.104)
    time = 0.104 * np.arange(1101)
    path = load_recorded_path(file, config)
    _, camera = read_poses(file, "kitti")
    body = UPRIGHT @ camera @ se3.inverse(stereo_rig(config).imu_T_cam)
    off = se3.local(body, path.pose(time))
    assert np.linalg.norm(off[:, 3:], axis=1).max() < 0.05
    assert np.abs(off[:, :3]).max() < 0.01
    twist = path.twist(np.arange(0.0, 114.4, 0.01))
    # A car that does not slide, with 10 m/s ahead and a turn of 0.8 rad/s at most.
    assert np.abs(np.diff(twist[:, 3:], axis=0)).max() < 0.1
    assert np.abs(np.diff(twist[:, :3], axis=0)).max() < 0.02
