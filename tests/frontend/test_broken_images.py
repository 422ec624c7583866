"""Folders as people have them: what is broken or missing is counted, and the rest is used."""

import shutil

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.base.progress import Silent
from vislam.datasets.images import open_images
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.track import track

CONFIG = FrontEndConfig(features=60, window_px=15)


@pytest.fixture
def folder(drive_folder, tmp_path):
    shutil.copytree(drive_folder, tmp_path / "run")
    return tmp_path / "run" / "mav0"


def images(folder, camera="cam0"):
    return sorted((folder / camera / "data").iterdir())


def counts_of(folder):
    found = track(open_images(folder), CONFIG, progress=Silent())
    return found.counts, found.sequence


def test_what_is_broken_is_left_out_and_tracks_go_on(folder):
    left, right = images(folder), images(folder, "cam1")
    left[2].write_bytes(b"")
    left[3].write_bytes(b"\x89PNG\r\n\x1a\n" + b"\0" * 200 + b"IEND\xaeB`\x82")
    right[5].write_bytes(right[5].read_bytes()[:-400])
    counts, sequence = counts_of(folder)
    assert counts["images_corrupt"] == 2
    assert counts["images_truncated"] == 1
    assert counts["frames"] == len(sequence) == 5
    assert np.allclose(np.diff(sequence.stamp), [0.1, 0.3, 0.2, 0.1])
    # Some tracks span the gap of three frames.
    assert (
        len(np.intersect1d(*(sequence.track[sequence.offset[k] : sequence.offset[k + 1]] for k in (1, 2))))
        > 5
    )


def test_missing_reordered_and_repeated_lines_are_counted(folder):
    images(folder, "cam1")[4].unlink()
    path = folder / "cam0" / "data.csv"
    lines = path.read_text().splitlines()
    lines[2], lines[6] = lines[6], lines[2]
    path.write_text("\n".join([*lines, lines[3]]) + "\n")
    counts, sequence = counts_of(folder)
    assert counts["images_missing_right"] == 1
    assert counts["images_unpaired"] == 1
    assert counts["images_duplicate"] == 1
    assert counts["images_out_of_order_left"] == 3
    assert len(sequence) == 7
    assert np.all(np.diff(sequence.stamp) > 0)


def test_a_pair_of_noise_is_held_back(folder, rng):
    import cv2

    for camera in ("cam0", "cam1"):
        noise = rng.integers(0, 255, (200, 320)).astype(np.uint8)
        assert cv2.imwrite(str(images(folder, camera)[4]), noise)
    counts, sequence = counts_of(folder)
    assert counts["frames_held"] == 1
    assert len(sequence) == 7
    around = [sequence.track[sequence.offset[k] : sequence.offset[k + 1]] for k in (3, 4)]
    assert len(np.intersect1d(*around)) > 0.4 * len(around[0])


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda f: shutil.rmtree(f / "cam1" / "data"),
            r"must have 2 pairs of images or more, got 0 .*missing_right 8",
        ),
        (lambda f: (f / "cam1" / "data.csv").unlink(), r"cam1/data.csv: no such file"),
        (lambda f: (f / "cam0" / "sensor.yaml").unlink(), r"sensor.yaml: no such file, nor a camchain"),
        (
            lambda f: change(f / "cam0" / "sensor.yaml", "[320, 200]", "[640, 400]"),
            r"must have images of 640 x 400 px as its calibration says",
        ),
        (
            lambda f: change(f / "cam0" / "sensor.yaml", "radial-tangential", "fov"),
            r"distortion_model must be radial-tangential or equidistant, got fov",
        ),
        (
            lambda f: change(f / "cam1" / "sensor.yaml", "  data: [", "  data: [7, "),
            r"cam1/sensor.yaml: T_BS must be a list of 16 numbers",
        ),
        (
            lambda f: shutil.copy(f / "cam0" / "sensor.yaml", f / "cam1" / "sensor.yaml"),
            r"baseline must be at least",
        ),
        (
            lambda f: (f / "cam0" / "data.csv").write_text("1,a\nx,b\n"),
            r"data.csv:2: must be a stamp \[ns\], a comma",
        ),
        (
            lambda f: (f / "cam0" / "sensor.yaml").write_text("a: [\n"),
            r"sensor.yaml: not YAML that can be read",
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(folder, spoil, said):
    spoil(folder)
    with pytest.raises(DataError, match=said) as caught:
        counts_of(folder)
    assert "\n" not in str(caught.value)


def test_swapped_cameras_are_one_line(folder):
    (folder / "cam0").rename(folder / "camx")
    (folder / "cam1").rename(folder / "cam0")
    (folder / "camx").rename(folder / "cam1")
    with pytest.raises(DataError, match="must stand to the right of the left one"):
        open_images(folder)


def test_another_folder_is_one_line(tmp_path):
    with pytest.raises(DataError, match="must hold mav0 with cam0 and cam1"):
        open_images(tmp_path)
    with pytest.raises(DataError, match="no such folder"):
        open_images(tmp_path / "none")


def test_blank_images_leave_no_track(folder):
    import cv2

    for camera in ("cam0", "cam1"):
        for path in images(folder, camera):
            assert cv2.imwrite(str(path), np.full((200, 320), 90, np.uint8))
    with pytest.raises(DataError, match="no track of 4 observations was found"):
        counts_of(folder)


@pytest.mark.parametrize(("vehicle", "sigma"), [("Asctec Firefly MAV", 0.001), ("a trolley", 0.0)])
def test_a_reference_has_the_accuracy_that_those_who_recorded_it_state(folder, vehicle, sigma):
    reference = folder / "state_groundtruth_estimate0" / "data.csv"
    reference.parent.mkdir()
    reference.write_text("#timestamp, p_RS_R_x [m]\n")
    (folder / "body.yaml").write_text(f"comment: {vehicle}\n")
    found = open_images(folder).reference
    assert found.sigma_m == sigma
    assert ("Burri" in found.limits) == (sigma > 0.0)
