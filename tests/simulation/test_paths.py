"""The shapes of simulated drives: where they turn, stop, close and climb; old ones stay as they are."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from vislam.geometry import se3
from vislam.simulation import SimulationConfig, shapes, simulate
from vislam.simulation.path import DrivePath

DRIVE = SimulationConfig(frames=1010, speed=9.0)
PATHS = ("town", "straight", "loop", "urban", "figure_eight", "highway", "helix")
FAULTY = {
    "inertial_noise": "step",
    "duplication_probability": 0.1,
    "moving_share": 0.1,
    "drift_px": 0.2,
    "matching_bias_px": 0.3,
    "outlier_probability": 0.02,
    "navigation_frame_velocity": True,
    "clock_offset": 0.03,
}
# Of everything that a simulation gives, to 1e-4, written down before other paths and settings came.
DIGESTS = {
    ("town", False): "5476edb2cc5418a3",
    ("town", True): "58c23c062c4b7435",
    ("straight", False): "1040e4914ff852f6",
    ("straight", True): "2d709e7619646c95",
    ("loop", False): "c0f810d030bc2bf5",
    ("loop", True): "57803cf92afdd147",
    ("urban", False): "79e1f89cebaea610",
    ("urban", True): "007f40efad410cdb",
    ("figure_eight", False): "d36d498930b5e162",
    ("figure_eight", True): "1bc04c723a201900",
    ("highway", False): "b495e415276d8da5",
    ("highway", True): "1d887dfdeb4b89e1",
    ("helix", False): "46e26e4492b52edf",
    ("helix", True): "c40cd1ae44b2b9db",
}


def fine(config, *, seed=1, step=0.01):
    """Times every 10 ms and the path there."""
    path = DrivePath(config, np.random.default_rng(seed))
    return np.arange(0.0, config.frames * config.period, step), path


def way(path, time):
    """Places in the plane and steps of the point that moves straight ahead, a metre behind the body [m]."""
    pose = path.pose(time)
    ahead = pose[:, :2, 0] / np.linalg.norm(pose[:, :2, 0], axis=1, keepdims=True)
    rear = pose[:, :2, 3] - ahead
    return rear, np.linalg.norm(np.diff(rear, axis=0), axis=1)


def digest(config):
    sequence, truth = simulate(config, seed=7, name="s")
    parts = (
        sequence.twist,
        sequence.pixels,
        sequence.track,
        sequence.inertial_stamp,
        truth.world_T_imu,
        truth.points_world,
        truth.bias,
    )
    rounded = [(np.round(np.asarray(part, float), 4) + 0.0).tobytes() for part in parts]
    return hashlib.sha256(b"".join(rounded)).hexdigest()[:16]


@pytest.mark.parametrize(("path", "faulty"), sorted(DIGESTS))
def test_old_paths_and_settings_simulate_what_they_always_did(path, faulty):
    config = SimulationConfig(frames=60, path=path, tracks_in_view=20, **(FAULTY if faulty else {}))
    assert digest(config) == DIGESTS[path, faulty]


def test_dropped_frames_and_walking_biases_are_what_they_were_before_front_ends_re_detected():
    config = SimulationConfig(
        frames=60,
        tracks_in_view=20,
        dropped_probability=0.1,
        gyro_bias_walk=1e-3,
        velocity_bias_walk=0.01,
        **FAULTY,
    )
    assert digest(config) == "a993f72d19f0b20c"


@pytest.mark.parametrize("name", PATHS)
def test_the_twist_integrates_to_the_pose(name):
    time, path = fine(replace(DRIVE, path=name, frames=400))
    half = 0.5 * np.diff(time)
    # Midpoint rule: a step of 10 ms is off by some 1e-7.
    step = se3.exp(path.twist(time[:-1] + half) * 2.0 * half[:, None])
    wanted = se3.inverse(path.pose(time[:-1])) @ path.pose(time[1:])
    assert np.abs(se3.local(wanted, step)).max() < 5e-7
    pose = path.pose(time[:1])[0]
    for change in step:
        pose = pose @ change
    assert np.abs(se3.local(path.pose(time[-1:])[0], pose)).max() < 1e-4


@pytest.mark.parametrize("name", PATHS)
def test_the_twist_is_bounded_and_continuous(name):
    time, path = fine(replace(DRIVE, path=name))
    twist = path.twist(time)
    assert np.abs(twist[:, :3]).max() < 1.2
    # Within 10 ms: 1 rad/s^2 and, with the metre from axle to body, 6 m/s^2, the hardest braking there is.
    assert np.abs(np.diff(twist[:, :3], axis=0)).max() < 0.02
    assert np.abs(np.diff(twist[:, 3:], axis=0)).max() < 0.1


@pytest.mark.parametrize("name", ["urban", "figure_eight", "highway", "helix"])
def test_the_mean_speed_is_the_configured_one(name):
    time, path = fine(replace(DRIVE, path=name, hills_m=0.0))
    _, driven = way(path, time)
    assert driven.sum() / time[-1] == pytest.approx(DRIVE.speed, rel=0.03 if name == "highway" else 2e-3)


def test_an_urban_drive_turns_by_right_angles_and_drives_straight_between():
    time, path = fine(replace(DRIVE, path="urban", hills_m=0.0))
    pose = path.pose(time)
    heading = np.unwrap(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]))
    straight = np.abs(np.gradient(heading, time)) < 1e-4
    quarters = heading[straight] / (np.pi / 2.0)
    assert straight.mean() > 0.6
    assert np.abs(quarters - np.round(quarters)).max() < 1e-3
    turns = np.diff(np.round(quarters))
    assert set(np.abs(turns[turns != 0.0])) == {1.0}
    assert np.count_nonzero(turns) >= 4


def test_an_urban_drive_stands_still_before_some_turns_and_drives_through_others():
    time, path = fine(replace(DRIVE, path="urban"))
    twist = path.twist(time)
    standing = np.abs(twist).max(axis=1) < 1e-9
    stops = np.count_nonzero(np.diff(standing.astype(int)) == 1)
    turning = np.abs(twist[:, 2]) > 0.1
    turns = np.count_nonzero(np.diff(turning.astype(int)) == 1)
    assert 2 <= stops < turns
    # Each stands for 2.5 s, up to one that the end may cut.
    assert 2.5 * (stops - 1) - 0.1 < 0.01 * standing.sum() < 2.5 * stops + 0.1 * stops
    assert not np.any(standing & turning)


def test_a_figure_eight_closes_and_crosses_itself_once():
    config = replace(DRIVE, path="figure_eight", hills_m=0.0)
    time, path = fine(config)
    end = np.array([0.0, config.frames * config.period])
    start, finish = path.pose(end)
    gap = finish[:2, 3] - start[:2, 3]
    assert np.abs(gap).max() < 1e-6 * config.speed * end[1]
    rear, _ = way(path, time)
    # It comes to where it began half-way and at the end.
    near = np.linalg.norm(rear - rear[0], axis=1) < 1.0
    visits = np.count_nonzero(np.diff(near.astype(int)) == 1)
    assert visits == 2
    rate = path.twist(time)[:, 2]
    assert rate.max() > 0.05
    assert rate.min() < -0.05


def test_a_helix_climbs_by_six_percent_and_comes_round_three_times():
    time, path = fine(replace(DRIVE, path="helix", hills_m=0.0))
    rear, driven = way(path, time)
    pose = path.pose(time)
    heading = np.unwrap(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]))
    assert (heading[-1] - heading[0]) / (2.0 * np.pi) == pytest.approx(3.0, rel=1e-3)
    assert (pose[-1, 2, 3] - pose[0, 2, 3]) / driven.sum() == pytest.approx(0.06, rel=1e-3)
    assert path.vertical_velocity(time) == pytest.approx(0.06 * DRIVE.speed, rel=1e-6)
    third = len(time) // 3
    assert np.linalg.norm(rear[third] - rear[0]) < 0.5


def test_a_highway_curves_gently():
    time, path = fine(replace(DRIVE, path="highway", speed=33.0))
    twist = path.twist(time)
    # Less than the comfort limit of 1 m/s^2 sideways.
    assert np.abs(twist[:, 2] * twist[:, 3]).max() < 1.0
    assert twist[:, 3].min() > 30.0
    pose = path.pose(time)
    assert np.ptp(np.unwrap(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]))) > 0.2


@pytest.mark.parametrize("laps", [1, 2, 3])
def test_a_circuit_comes_back_to_where_it_was(laps):
    config = replace(DRIVE, path="circuit", frames=300, laps=laps, hills_m=0.0)
    lap = config.frames * config.period / laps
    time = np.linspace(0.0, lap * (laps - 1), 50)
    path = DrivePath(config, np.random.default_rng(1))
    apart = path.pose(time)[:, :3, 3] - path.pose(time + lap)[:, :3, 3]
    assert np.abs(apart).max() < 1e-6
    assert np.abs(path.pose(np.array([0.5 * lap]))[0, :2, 3] - path.pose(np.zeros(1))[0, :2, 3]).max() > 10.0


def test_a_path_through_a_town_is_the_same_in_blocks_of_any_size(monkeypatch):
    config, phases = SimulationConfig(path="town", frames=2000), np.linspace(0.0, 5.0, 8)
    time = np.linspace(0.0, 200.0, 1001)
    found = []
    for size in (1_000_000, 50):
        monkeypatch.setattr(shapes, "_AT_ONCE", size)
        one = shapes.shape(config, phases, np.random.default_rng(1))
        found.append((one.heading(time), one.pace(time)))
    np.testing.assert_array_equal(*found)
