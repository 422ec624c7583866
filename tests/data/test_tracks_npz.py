"""The open track format: what the guide writes is read, and whatever is wrong is told in one line."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.core.reference import Reference
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.registry import read, source_of
from vislam.datasets.tracks_npz import REQUIRED, load_tracks_npz, write_tracks_npz

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs/guides/your_own_tracks.md"
PAGE = ROOT / "docs/reference/track_format.md"


def tracks_file(path, **changes):
    """A small file of tracks, with some keys changed, or left out where they are None."""
    rng = np.random.default_rng(1)
    frame, track = np.divmod(np.arange(24), 4)
    arrays = {
        "stamp": 0.1 * np.arange(6),
        "frame": frame,
        "track": track,
        "pixels": np.column_stack(
            [rng.uniform(100, 200, (24, 2)), rng.uniform(50, 90, 24), np.full(24, 60.0)]
        ),
        "K": np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]),
        "baseline": 0.2,
        "imu_T_cam": np.eye(4),
        "angular_velocity": np.zeros((6, 3)),
        "linear_velocity": np.ones((6, 3)),
        **changes,
    }
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


def the_guide_writes(folder, monkeypatch):
    monkeypatch.chdir(folder)
    block = re.search(r"```python\n(import numpy.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(block[1], "guide", "exec"), {})
    return folder / "mine.npz"


def test_what_the_guide_writes_is_read(tmp_path, monkeypatch):
    path = the_guide_writes(tmp_path, monkeypatch)
    source = source_of(path)
    found = read(source.format, source, Opening([])).sequence
    assert source.format == "tracks_npz"
    assert (len(found), found.observations, found.rig.baseline) == (20, 160, 0.2)
    assert np.array_equal(found.pixels[0], [320, 240, 300, 240])


def test_the_page_tells_every_key():
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"`{key}`" in page for key in REQUIRED)


@pytest.mark.parametrize("key", REQUIRED)
def test_a_missing_key_is_told_with_the_page(tmp_path, key):
    with pytest.raises(DataError, match=rf"'{key}' is missing.*track_format\.md"):
        load_tracks_npz(tracks_file(tmp_path / "a.npz", **{key: None}))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"frame": np.full(24, 6)}, "'frame' must be whole numbers from 0 to 5"),
        ({"track": np.full(24, 0.5)}, "'track' must be whole numbers"),
        ({"track": np.zeros(24)}, "track 0 twice in frame 0"),
        ({"pixels": np.ones((24, 3))}, r"'pixels' must be of shape \(24, 4\)"),
        ({"pixels": np.full((24, 4), np.nan)}, "'pixels' must be free of NaN"),
        ({"baseline": -1.0}, "'baseline' must be one baseline > 0"),
        ({"imu_T_cam": np.diag([1.0, 1, -1, 1])}, "'imu_T_cam' must be a rigid transform"),
        ({"K": np.zeros((3, 3))}, "'K' must be an intrinsic matrix"),
        ({"stamp": np.zeros(6)}, "'stamp' must be increasing"),
        ({"angular_velocity": np.full((6, 3), 1e3)}, "is it in another unit"),
        ({"linear_velocity": np.zeros((3, 6))}, "'linear_velocity' must be of shape"),
        ({"pixel": np.zeros(1)}, "'pixel' is unknown"),
        ({"version": 2}, "'version' must be 1"),
        ({"reference_pose": np.zeros((6, 4, 4))}, "'reference_pose' must be a rigid transform"),
        ({"reference_pose": np.eye(4)[None], "reference_frame": [9]}, "'reference_frame' must be whole"),
        ({"stamp": np.array(["a"] * 6)}, "'stamp' must be a plain array"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(tmp_path, changes, told):
    path = tracks_file(tmp_path / "a.npz", **changes)
    with pytest.raises(DataError, match=told) as raised:
        load_tracks_npz(path)
    assert "\n" not in str(raised.value)
    assert str(path) in str(raised.value)


def test_the_former_key_of_the_vertical_velocity_is_read(tmp_path):
    former = tracks_file(tmp_path / "a.npz", climb_rate=np.arange(6.0))
    assert np.array_equal(load_tracks_npz(former).sequence.vertical_velocity, np.arange(6.0))
    both = tracks_file(tmp_path / "b.npz", climb_rate=np.zeros(6), vertical_velocity=np.zeros(6))
    with pytest.raises(DataError, match="'climb_rate' is the former name of 'vertical_velocity'"):
        load_tracks_npz(both)


def test_rows_may_stand_in_any_order_and_ids_may_be_large(tmp_path, rng):
    plain = load_tracks_npz(tracks_file(tmp_path / "a.npz")).sequence
    with np.load(tmp_path / "a.npz") as file:
        arrays = dict(file)
    order = rng.permutation(24)
    shuffled = {key: arrays[key][order] for key in ("frame", "track", "pixels")}
    shuffled["track"] = shuffled["track"] * 10**9
    found = load_tracks_npz(tracks_file(tmp_path / "b.npz", **shuffled)).sequence
    assert np.array_equal(found.track, plain.track)
    assert np.array_equal(found.pixels, plain.pixels)


def test_what_is_written_is_read_again(tmp_path, short):
    # An open file numbers its rows anew.
    raw, reference = replace(short.sequence, row=np.arange(short.sequence.observations)), short.reference
    recording = Recording(
        raw,
        Reference(
            name="r",
            limits="",
            frame=reference.frame,
            position=reference.position,
            pose=reference.pose,
            imu_T_point=np.eye(4),
        ),
        np.column_stack([raw.track, raw.track, raw.track]).astype(float),
    )
    write_tracks_npz(tmp_path / "a.npz", recording)
    found = load_tracks_npz(tmp_path / "a.npz")
    by_id = np.lexsort((raw.track, raw.frame_of))
    for name in ("stamp", "inertial_stamp", "twist", "offset", "row"):
        assert np.array_equal(getattr(found.sequence, name), getattr(raw, name)), name
    for name in ("track", "pixels"):
        assert np.array_equal(getattr(found.sequence, name), getattr(raw, name)[by_id]), name
    assert np.allclose(found.reference.pose, reference.pose, atol=1e-12)
    assert np.array_equal(found.points_world, recording.points_world[by_id])
    assert found.sequence.synthetic
    assert found.notes[0].startswith("SIMULATED")
    first = (tmp_path / "a.npz").read_bytes()
    write_tracks_npz(tmp_path / "a.npz", recording)
    assert (tmp_path / "a.npz").read_bytes() == first


def test_a_track_that_goes_over_to_another_point_has_no_landmark(tmp_path):
    recording = load_tracks_npz(
        tracks_file(
            tmp_path / "a.npz",
            reference_pose=np.tile(np.eye(4), (6, 1, 1)),
            landmark_track=[0, 2],
            landmark_world=np.ones((2, 3)),
        )
    )
    moved = recording.points_world.copy()
    moved[recording.sequence.track == 2, 0] += np.arange(6)
    write_tracks_npz(tmp_path / "b.npz", Recording(recording.sequence, recording.reference, moved))
    found = load_tracks_npz(tmp_path / "b.npz").points_world
    known = np.isfinite(found).all(axis=1)
    assert set(recording.sequence.track[known]) == {0}
