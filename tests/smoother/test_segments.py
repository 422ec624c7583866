"""What is old leaves the tree for a time: the estimates are those of the whole one."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import ate, dark, drive, gap, member, teleporting_track
from vislam.comparison.config import VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.smoother import segments
from vislam.estimators.smoother.keys import X, landmark
from vislam.estimators.smoother.segments import Segments, _leaving

OFTEN = 12
SHORT = {"tracks_in_view": 12, "loss_probability": 0.2}
"""Tracks that end, so that what is old is tied to nothing new."""


UP_TO_DATE = 1e-12
"""Threshold by which all variables are updated at each step: else a tree that was rebuilt is ahead of one
that was not, whose old variables wait until they have changed by more."""


def parameters():
    found = gtsam.ISAM2Params()
    found.enableRelinearization = False
    return found


@pytest.fixture
def cuts(monkeypatch):
    """Lets old variables leave often; gives the numbers of those that stayed, at each cut."""
    found = []
    real = Segments.cut

    def counted(self, *arguments):
        done = real(self, *arguments)
        if done:
            found.append(self.linearization_point().size() - self._left.size())
        return done

    monkeypatch.setattr(Segments, "cut", counted)
    return found


def both(monkeypatch, config, dataset, **options):
    """Runs of the whole tree and of its segments."""
    runs = []
    for every in (10**6, OFTEN):
        monkeypatch.setattr(segments, "_EVERY", every)
        runs.append(member("isam2", config, dataset, **options))
    return runs


def test_estimates_and_covariances_are_those_of_the_whole_tree(monkeypatch, cuts):
    config, dataset = drive(seed=3, frames=50, **SHORT)
    options = {"pose_cov_every": 10, "marginals": "poses", "wildfire_threshold": UP_TO_DATE}
    whole, cut = both(monkeypatch, config, dataset, **options)
    assert len(cuts) >= 3
    assert max(cuts) < 0.6 * (len(whole.landmarks) + 2 * 50)
    for one, other in ((whole.filtered, cut.filtered), (whole.smoothed, cut.smoothed)):
        assert max(gap(one.world_T_imu, other.world_T_imu)) < 1e-6
        assert np.allclose(one.covariances, other.covariances, rtol=1e-5, atol=1e-14, equal_nan=True)
    assert np.allclose(whole.map.points_world, cut.map.points_world, atol=1e-5)
    assert np.array_equal(whole.used, cut.used)
    assert whole.log.counts == cut.log.counts
    assert whole.fit == pytest.approx(cut.fit, rel=1e-8)


def test_a_gap_is_crossed_as_with_the_whole_tree(monkeypatch, cuts):
    config, dataset = drive(seed=5, frames=50, **SHORT)
    dataset = replace(dataset, sequence=dark(32, 6)(dataset.sequence))
    whole, cut = both(monkeypatch, config, dataset, wildfire_threshold=UP_TO_DATE)
    assert cuts
    assert whole.log.counts == cut.log.counts
    assert max(gap(whole.filtered.world_T_imu, cut.filtered.world_T_imu)) < 1e-6
    assert max(gap(whole.smoothed.world_T_imu, cut.smoothed.world_T_imu)) < 1e-6


def test_steps_that_cannot_be_solved_are_survived(monkeypatch, cuts):
    config, dataset = drive(seed=5, frames=50, **SHORT)
    dataset = replace(dataset, sequence=teleporting_track(dataset.sequence))
    whole, cut = both(monkeypatch, config, dataset)
    assert cuts
    assert cut.complete
    assert cut.log.counts["recoveries"] > 0
    assert ate(cut.smoothed.world_T_imu, dataset) < 1.5 * ate(whole.smoothed.world_T_imu, dataset)


def test_where_all_observations_share_an_error_the_tree_stays_whole(monkeypatch, cuts):
    config, dataset = drive(seed=3, frames=30, **SHORT)
    config = replace(config, noise=replace(config.noise, disparity_offset_sigma_px=0.5))
    whole, cut = both(monkeypatch, config, dataset)
    assert not cuts
    assert np.array_equal(whole.smoothed.world_T_imu, cut.smoothed.world_T_imu)


@pytest.mark.parametrize("camera_rotation", [0.0, 0.01])
def test_what_poses_are_reported_by_stays(monkeypatch, cuts, camera_rotation):
    settings = {"navigation_frame_velocity": True, "hills_m": 10.0, **SHORT}
    config, _ = drive(seed=8, frames=100, **settings)
    data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
    noise = replace(
        config.noise,
        vertical_velocity=VerticalVelocityConfig(walk=0.05, tilt_sigma=0.05),
        camera_rotation_sigma=camera_rotation,
    )
    config, dataset = replace(config, data=data, noise=noise), open_dataset(data, seed=8)
    options = {"pose_cov_every": 10, "marginals": "poses", "wildfire_threshold": UP_TO_DATE}
    whole, cut = both(monkeypatch, config, dataset, **options)
    assert len(cuts) >= 3
    assert max(cuts) < 0.6 * (len(whole.landmarks) + 4 * 100)
    for one, other in ((whole.filtered, cut.filtered), (whole.smoothed, cut.smoothed)):
        assert max(gap(one.world_T_imu, other.world_T_imu)) < 1e-6
        assert np.allclose(one.covariances, other.covariances, rtol=1e-5, atol=1e-14, equal_nan=True)
    assert np.allclose(whole.map.points_world, cut.map.points_world, atol=1e-5)
    assert whole.log.counts == cut.log.counts


def test_where_old_poses_are_read_at_each_step_it_stays_whole(monkeypatch, cuts):
    config, dataset = drive(seed=3, frames=30, **SHORT)
    whole, cut = both(monkeypatch, config, dataset, wildfire_threshold=0.0)
    assert not cuts
    assert np.array_equal(whole.smoothed.world_T_imu, cut.smoothed.world_T_imu)


def test_what_leaves_shares_no_factor_with_what_moves():
    near, far, old = landmark(0, 5.0), landmark(1, 5.0), landmark(2, 5.0)
    keys = {0: [X(0)], 1: [X(0), X(1)], 2: [X(1), X(2)], 3: [X(2), X(3)], 4: [X(3), near], 5: [X(2), far]}
    keys |= {6: [X(1), far], 7: [X(0), old], 8: [X(1), old]}
    resting = {X(0), X(1), X(2), far, old}
    # X(2) is tied to X(3), which moves; the landmark that it has seen stays with it.
    assert _leaving(keys, resting, ()) == {X(0), X(1), old}
    # By a marginal it would be tied to whatever stays of it, for ever.
    assert _leaving(keys, resting, (5,)) == {X(0), X(1), old, far}
    # What is needed all along stays, and keeps nothing else.
    assert _leaving(keys, resting, (), {X(0)}) == {X(1), old}


def chain(count):
    """Poses one after the other; a graph and its values for each."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    for k in range(count):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        step = gtsam.Pose3(gtsam.Rot3.Ypr(0.1, 0.0, 0.0), np.array([1.0, 0.0, 0.0]))
        if k == 0:
            graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), noise))
        else:
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), step, noise))
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), step.compose(step), noise))
        values.insert(X(k), gtsam.Pose3())
        yield k, graph, values


def test_what_has_left_is_back_when_it_is_asked_for(monkeypatch):
    monkeypatch.setattr(segments, "_EVERY", 10)
    plain, parted = (Segments(parameters(), cut=cut) for cut in (False, True))
    for k, graph, values in chain(40):
        for one in (plain, parted):
            slots = one.update(graph, values, gtsam.ISAM2UpdateParams())
            one.cut({X(j) for j in range(k)}, gtsam.KeyGroupMap())
    assert slots == [77, 78]
    assert plain.whole
    assert not parted.whole
    assert parted.linearization_point().size() == 40
    newest, oldest = X(39), X(1)
    expected = plain.tree([newest]).marginalCovariance(newest)
    assert np.allclose(parted.tree([newest]).marginalCovariance(newest), expected, rtol=1e-9)
    assert not parted.whole
    # A factor of old variables is removed: all of them are in the tree again, and stay the same.
    for one in (plain, parted):
        one.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.ISAM2UpdateParams(), [4])
    assert parted.whole
    for key in (oldest, newest):
        poses = [one.tree([key]).calculateEstimatePose3(key).matrix() for one in (plain, parted)]
        assert np.allclose(*poses, atol=1e-9)
    assert not parted.factors.exists(4)
    assert parted.factors.size() == plain.factors.size() == 79


def test_a_factor_of_what_has_left_brings_it_back(monkeypatch):
    monkeypatch.setattr(segments, "_EVERY", 10)
    parted = Segments(parameters())
    for k, graph, values in chain(25):
        parted.update(graph, values, gtsam.ISAM2UpdateParams())
        parted.cut({X(j) for j in range(k)}, gtsam.KeyGroupMap())
    assert not parted.whole
    loop = gtsam.NonlinearFactorGraph()
    loop.add(gtsam.BetweenFactorPose3(X(24), X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    parted.update(loop, gtsam.Values(), gtsam.ISAM2UpdateParams())
    assert parted.whole
    assert parted.tree([X(0)]).calculateBestEstimate().size() == 25


def test_what_is_tied_to_poses_of_all_times_stays():
    parted, noise = Segments(parameters()), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    places, in_view, frames = 12, 5, 201
    place = [X(1000 + j) for j in range(places)]
    for k, graph, values in chain(frames):
        if k < places:
            values.insert(place[k], gtsam.Pose3())
        graph.add(gtsam.BetweenFactorPose3(X(k), place[k % places], gtsam.Pose3(), noise))
        parted.update(graph, values, gtsam.ISAM2UpdateParams())
    recent = {place[j % places] for j in range(frames - in_view, frames)}
    resting = {X(k) for k in range(frames - in_view)} | set(place) - recent
    last = gtsam.KeyGroupMap()
    for key in [*recent, X(frames - 1)]:
        last.insert2(key, 1)
    # More than half of the poses rest, but in pieces between those that have seen what is in view.
    assert not parted.cut(resting, last)
    assert parted.whole


def test_factors_that_stay_are_found_again(monkeypatch):
    """Of 6,345 factors on a chain the last 400 stay, and those that are taken out then are the right ones."""
    monkeypatch.setattr(segments, "_EVERY", 1)
    tree, length, stays = Segments(parameters()), 6344, 400
    noise = gtsam.noiseModel.Unit.Create(1)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorVector(0, np.zeros(1), noise))
    for key in range(length + 1):
        values.insert(key, np.zeros(1))
    for key in range(length):
        graph.add(gtsam.BetweenFactorVector(key, key + 1, np.ones(1), noise))
    slots = tree.update(graph, values, gtsam.ISAM2UpdateParams())
    assert tree.cut(range(length - stays), gtsam.KeyGroupMap())
    # One step from each variable to the next is stated again, ten times as long, and the first one taken out.
    for key in range(length - stays + 10, length, 50):
        again = gtsam.NonlinearFactorGraph()
        again.add(gtsam.BetweenFactorVector(key, key + 1, np.full(1, 10.0), noise))
        tree.update(again, gtsam.Values(), gtsam.ISAM2UpdateParams(), [slots[key + 1]])
        assert not tree.whole
    long = len(range(length - stays + 10, length, 50))
    found = tree.tree([length]).calculateEstimateVector(length)
    assert found == pytest.approx(length + 9.0 * long)
