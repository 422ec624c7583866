"""The cuts, on arrays small enough to count by hand and on the recorded files."""

from dataclasses import replace

import numpy as np
import pytest

from tests.cli.test_compare import course_file
from tests.conftest import recorded
from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig, HeldOutConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.imu import ImuSeries
from vislam.core.rigid_fit import continuations
from vislam.core.sequence import Sequence
from vislam.datasets.course_npz import load_course_npz
from vislam.evaluation.held_out import FEWEST_VIEWS, hold_out
from vislam.geometry.axes import axes_rotation
from vislam.models import StereoRig
from vislam.repair import RepairConfig, apply
from vislam.repair.consensus import Consensus, step_residuals
from vislam.repair.inertial import ImuUnits
from vislam.repair.mounting import Axes, Baseline, Extrinsic
from vislam.repair.pixels import Disparity, DisparityOffset
from vislam.repair.tracks import DuplicatedTracks, Interruptions, Thinning, duplicated_observations
from vislam.simulation import SimulationConfig, simulate


def made_up(rows):
    """Rows of (frame, track, uL, uR) as a sequence of five frames."""
    table = np.array(sorted(rows), dtype=float)
    frames = table[:, 0].astype(int)
    offset = np.concatenate([[0], np.cumsum(np.bincount(frames, minlength=5))])
    pixels = np.column_stack([table[:, 2], np.full(len(table), 7.0), table[:, 3], np.full(len(table), 7.0)])
    return Sequence(
        name="made up",
        stamp=np.arange(5.0),
        inertial_stamp=np.arange(5.0),
        twist=np.zeros((5, 6)),
        vertical_velocity=np.full(5, np.nan),
        rig=StereoRig(500.0, 500.0, 320.0, 200.0, 0.5, np.eye(4)),
        offset=offset,
        track=table[:, 1].astype(np.int64),
        pixels=pixels,
        row=np.arange(len(table)),
    )


def test_a_duplicated_frame_starts_new_landmarks_and_loses_nothing():
    rows = [
        (0, 0, 100, 90),
        (0, 1, 200, 180),
        (1, 0, 101, 90),
        (1, 1, 202, 180),
        (2, 0, 101, 90),
        (2, 1, 202, 180),
        (2, 2, 50, 40),
        (3, 0, 110, 95),
        (3, 1, 215, 190),
    ]
    cut = DuplicatedTracks().apply(made_up(rows))
    assert cut.observations == len(rows)
    assert cut.counts == {"duplicated_frames": 1, "duplicated_cuts": 2, "lone_repeats": 0}
    assert cut.track.tolist() == [0, 1, 0, 1, 2, 3, 4, 2, 3]


def test_a_lone_repeat_is_no_duplicated_frame():
    rows = [(k, j, 100 + 10 * j + (0 if (j, k) == (0, 1) else k), 90) for k in range(3) for j in range(4)]
    cut = DuplicatedTracks().apply(made_up(rows))
    assert cut.counts == {"duplicated_frames": 0, "duplicated_cuts": 0, "lone_repeats": 1}
    assert len(np.unique(cut.track)) == 4


def test_a_track_never_comes_back():
    split = Interruptions().apply(made_up([(0, 0, 9, 1), (1, 0, 9, 1), (3, 0, 9, 1)]))
    assert split.track.tolist() == [0, 0, 1]


def test_the_disparity_gate_keeps_what_a_started_track_shows_later():
    rows = [(0, 0, 10, 9), (1, 0, 10, 6), (2, 0, 10, 9.5), (3, 0, 10, 11)]
    gated = Disparity(minimum_px=2.0, row_difference_px=1.0).apply(made_up(rows))
    assert gated.frame_of.tolist() == [1, 2]
    assert gated.counts["dropped_disparity_not_positive"] == 1
    assert gated.counts["dropped_too_far_to_start"] == 1


@pytest.mark.parametrize(("axes", "good"), [(("x", "-y", "-z"), True), (("x", "y", "-z"), False)])
def test_only_proper_turns_are_axes(axes, good):
    if good:
        assert np.allclose(axes_rotation(axes), np.diag([1.0, -1.0, -1.0]))
    else:
        with pytest.raises(ValueError, match="right-handed"):
            axes_rotation(axes)


def test_units_of_raw_inertia_are_mended_and_with_them_a_twist_that_is_of_the_gyro(short: Dataset):
    stamp = np.arange(short.sequence.stamp[0] - 0.1, short.sequence.stamp[-1] + 0.1, 0.01)
    samples = np.random.default_rng(2).normal(size=(len(stamp), 6))
    imu = ImuSeries(stamp, np.degrees(samples[:, :3]), samples[:, 3:] / 9.80665)
    of_gyro = np.hstack([imu.gyro, np.zeros_like(imu.gyro)])
    given = replace(short.sequence, imu=imu, inertial_stamp=stamp, twist=of_gyro)
    given = replace(given, vertical_velocity=np.full(len(stamp), np.nan))
    mended = apply(given, RepairConfig(imu_units=ImuUnits(gyro="deg/s", accel="g")))
    assert np.allclose(np.hstack([mended.imu.gyro, mended.imu.accel]), samples)
    assert np.allclose(mended.twist[:, :3], samples[:, :3])
    other = replace(short.sequence, imu=imu)
    kept = apply(other, RepairConfig(imu_units=ImuUnits(gyro="deg/s")))
    assert np.array_equal(kept.twist, short.sequence.twist)
    with pytest.raises(DataError, match="expected an accelerometer and a gyro"):
        apply(short.sequence, RepairConfig(imu_units=ImuUnits(accel="g")))


def test_step_means_average_the_lines_between_samples():
    sequence = made_up([(0, 0, 9, 1)])
    ramp = replace(sequence, twist=np.arange(5.0)[:, None] * np.ones(6), clock_offset=0.25)
    twist, _ = ramp.step_means()
    # The mean of a straight line over a step is its value at the middle, moved by the offset.
    assert np.allclose(twist[1:4, 0], [0.75, 1.75, 2.75])


def test_planted_duplicated_frames_are_all_found():
    config = SimulationConfig(frames=120, duplication_probability=0.15, tracks_in_view=30)
    sequence, _ = simulate(config, seed=5, name="planted")
    duplicated, repeats = duplicated_observations(sequence)
    clean, _ = simulate(SimulationConfig(frames=120, tracks_in_view=30), seed=5, name="clean")
    assert 5 < duplicated.sum() < 40
    assert repeats.sum() > 10 * duplicated.sum()
    assert not duplicated_observations(clean)[0].any()


def test_tracks_on_a_moving_object_are_cut(short: Dataset):
    sequence = short.sequence
    moving = np.isin(sequence.track, np.unique(sequence.track)[::9]) & (sequence.age() > 0)
    pixels = sequence.pixels.copy()
    pixels[moving, 0] += 6.0 * sequence.age()[moving]
    pixels[moving, 2] += 6.0 * sequence.age()[moving]
    residual = np.linalg.norm(step_residuals(replace(sequence, pixels=pixels)), axis=1)
    assert np.nanmedian(residual[moving]) > 8.0
    assert np.nanmedian(residual[~moving]) < 2.5
    untouched = Consensus(threshold=8.0).apply(sequence).counts["inconsistent_cuts"]
    assert untouched < 0.02 * sequence.observations


def test_where_ids_are_those_of_landmarks_none_is_split(short: Dataset):
    sequence, rng = short.sequence, np.random.default_rng(2)
    off = rng.random(sequence.observations) < 0.08
    pixels = sequence.pixels.copy()
    pixels[off] += np.tile(rng.choice([-1.0, 1.0], (int(off.sum()), 2)) * rng.uniform(20.0, 50.0), 2)
    spoilt = replace(sequence, pixels=pixels)
    cut, kept = Consensus().apply(spoilt), Consensus(recognised=True).apply(spoilt)
    assert len(np.unique(cut.track)) > 1.5 * len(np.unique(sequence.track))
    assert np.isin(kept.track, sequence.track).all()
    assert len(np.unique(kept.track)) > 0.9 * len(np.unique(sequence.track))
    left = np.isin(sequence.row, kept.row)
    neighbours = np.isin(np.arange(sequence.observations), _with_neighbour(sequence))
    assert np.mean(left[off & neighbours]) < 0.1
    assert np.mean(left[~off]) > 0.9
    assert kept.counts["dropped_inconsistent"] == np.sum(~left)


def _with_neighbour(sequence):
    """Rows of observations of a track that was seen in the frame before or after, too."""
    pairs = continuations(sequence)
    return np.union1d(pairs.before, pairs.after)


def test_a_wild_inertial_sample_does_not_stop_the_vote(tmp_path):
    turned = np.zeros((3, 6))
    turned[1, 0] = 32.0
    course_file(tmp_path / "a.npz", angular_velocity=turned)
    sequence = load_course_npz(tmp_path / "a.npz")
    assert Consensus().apply(sequence).observations == sequence.observations


@pytest.mark.parametrize(("name", "duplicated", "columns"), [("03.npz", 153, 5105), ("0027.npz", 91, 3950)])
def test_recorded_files_have_the_duplicated_frames_that_are_known(name, duplicated, columns):
    sequence = DuplicatedTracks().apply(load_course_npz(recorded(name)))
    assert sequence.counts["feature_columns"] == columns
    assert sequence.counts["duplicated_frames"] == duplicated


def test_repairs_bring_back_what_the_simulation_spoilt():
    faults = SimulationConfig(
        frames=30,
        extrinsic_axes=("x", "-y", "-z"),
        extrinsic_rotation="stored",
        extrinsic_translation="inverse",
        stated_baseline=0.7,
        clock_offset=0.03,
        disparity_offset_px=0.4,
    )
    clean = replace(
        faults,
        extrinsic_axes=("x", "y", "z"),
        extrinsic_translation="stored",
        stated_baseline=None,
        disparity_offset_px=0.0,
    )
    spoilt, _ = simulate(faults, seed=1, name="spoilt")
    right, _ = simulate(clean, seed=1, name="right")
    steps = RepairConfig(
        axes=Axes(body=("x", "-y", "-z")),
        extrinsic=Extrinsic(rotation="stored"),
        baseline=Baseline(metres=0.59418),
        disparity_offset=DisparityOffset(pixels=0.4),
        duplicated_tracks=None,
        disparity=None,
        consensus=None,
        interruptions=None,
        single_observations=None,
    )
    repaired = apply(spoilt, steps)
    assert not np.allclose(spoilt.rig.imu_T_cam, right.rig.imu_T_cam)
    assert np.allclose(repaired.rig.imu_T_cam, right.rig.imu_T_cam)
    assert repaired.rig.baseline == right.rig.baseline
    assert np.allclose(repaired.pixels, right.pixels)
    assert [step.name for step in repaired.repairs if step.applied] == [
        "extrinsic",
        "axes",
        "baseline",
        "disparity_offset",
    ]


def test_each_step_counts_what_it_did():
    sequence, _ = simulate(
        SimulationConfig(frames=60, duplication_probability=0.2, outlier_probability=0.05), seed=2, name="s"
    )
    done = {step.name: step for step in apply(sequence, RepairConfig()).repairs}
    assert done["duplicated_tracks"].counts["duplicated_cuts"] > 50
    assert done["disparity"].options == {"minimum_px": 2.5, "row_difference_px": 2.0}
    assert done["disparity"].counts["dropped_row_difference"] > 50
    assert not done["axes"].applied
    assert done["axes"].counts == {}


def test_thinning_keeps_whole_tracks_one_in_so_many_after_the_other_steps():
    sequence, _ = simulate(SimulationConfig(frames=60, duplication_probability=0.2), seed=2, name="s")
    whole = apply(sequence, RepairConfig())
    thin = apply(sequence, RepairConfig(thinning=Thinning(every=5)))
    kept = whole.track % 5 == 0
    assert np.array_equal(thin.track, whole.track[kept])
    assert np.array_equal(thin.pixels, whole.pixels[kept])
    done = {step.name: step for step in thin.repairs}
    assert done["thinning"].counts == {"dropped_thinning": thin.counts["dropped_thinning"]}
    assert thin.counts["dropped_thinning"] > 3 * thin.observations
    same = apply(sequence, RepairConfig(thinning=Thinning(every=1)))
    assert np.array_equal(same.track, whole.track)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_held_out_tracks_have_no_say_in_the_repairs_of_the_others(share):
    faults = SimulationConfig(
        frames=40, duplication_probability=0.1, outlier_probability=0.02, moving_share=0.1
    )
    data = DataConfig(simulation=faults)
    bare = replace(data, repair=RepairConfig(**dict.fromkeys(RepairConfig.__dataclass_fields__)))
    raw = open_dataset(bare, seed=5).sequence
    held = hold_out(raw.track, share=share, seed=2)
    assert held.any() == (share > 0.0)
    dataset = open_dataset(data, seed=5, held_out=HeldOutConfig(share=share, seed=2))
    alone = apply(raw.select(~held), data.repair)
    assert np.array_equal(dataset.sequence.row, alone.row)
    assert np.array_equal(dataset.sequence.track, alone.track)
    kept = dataset.held_out
    assert held[kept.row].all()
    assert not np.isin(kept.track, alone.track).any()
    assert (np.bincount(kept.track)[kept.track] >= FEWEST_VIEWS).all()
    # What is cut by the vote of all is not given in part: no piece of a held-out track is.
    assert not np.isin(raw.track[alone.row], raw.track[held]).any()
