"""Images of any kind by a YAML file: the recording of the folder, whichever way they are listed."""

import numpy as np
import pytest

pytest.importorskip("cv2")

from tests.frontend.bags import write_camchain
from vislam.base.errors import DataError
from vislam.core.images import ReferenceFile
from vislam.datasets.images import is_images, open_images

CALIBRATED = "calibration: camchain.yaml\n"
LISTED = (
    "left: {images: left.csv, unit: ns}\nright: {images: right.txt, unit: ns}\n"
    "inertial: {file: run/mav0/imu0/data.csv, unit: ns}\n"
)
BY_NAME = "".join(
    f"{side}: {{images: 'run/mav0/{camera}/data/*.png', stamps: name, unit: ns}}\n"
    for side, camera in (("left", "cam0"), ("right", "cam1"))
)
BY_FILE = BY_NAME.replace("stamps: name, unit: ns", "stamps: times.txt")
BY_RATE = BY_NAME.replace("stamps: name, unit: ns", "rate_hz: 10")


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    from tests.frontend.studio import rendered, write_asl

    home = tmp_path_factory.mktemp("home")
    write_asl(home / "run", rendered(3))
    write_camchain(home / "camchain.yaml")
    for side, camera, comma in (("left.csv", "cam0", ","), ("right.txt", "cam1", " ")):
        files = sorted((home / "run" / "mav0" / camera / "data").iterdir())
        lines = [f"{file.stem}{comma}{file.relative_to(home)}" for file in files]
        (home / side).write_text("# stamp, file\n" + "\n".join(lines) + "\n")
    (home / "times.txt").write_text("100.0\n100.1\n100.2\n")
    return home


def opened(home, text, name="images.yaml"):
    (home / name).write_text(text)
    assert is_images(home / name)
    return open_images(home / name)


@pytest.mark.parametrize(
    ("text", "begin"), [(LISTED, 100.0), (BY_NAME, 100.0), (BY_FILE, 100.0), (BY_RATE, 0.0)]
)
def test_any_way_of_listing(home, text, begin):
    recording, folder = opened(home, CALIBRATED + text), open_images(home / "run")
    assert np.allclose(recording.stamp - begin, [0.0, 0.1, 0.2], atol=1e-9)
    assert list(recording.left) == list(folder.left)
    assert list(recording.right) == list(folder.right)
    assert np.allclose(recording.pair.rig.imu_T_cam, folder.pair.rig.imu_T_cam)
    if text is LISTED:
        assert np.allclose(recording.inertia.gyro, folder.inertia.gyro)
        assert np.allclose(recording.inertia.stamp, folder.inertia.stamp, atol=1e-6)


def test_numbers_in_names_are_in_order_and_a_reference_is_named(home):
    for number in (9, 10, 8):
        for side in "lr":
            (home / f"{side}{number}.png").write_bytes(str(number).encode())
    text = "".join(f"{side}: {{images: '{side[0]}*.png', rate_hz: 5}}\n" for side in ("left", "right"))
    reference = "name: mine\nreference: {file: poses.txt, format: tum}\n"
    recording = opened(home, CALIBRATED + text + reference)
    assert list(recording.left) == [b"8", b"9", b"10"]
    assert recording.name == "mine"
    assert recording.reference == ReferenceFile(home / "poses.txt", "tum")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CALIBRATED, r"images.yaml: left: "),
        (
            CALIBRATED + BY_NAME + "imu: x\n",
            r"images.yaml: imu: unknown key; known are calibration, inertial",
        ),
        (
            CALIBRATED + BY_NAME.replace("stamps: name, ", ""),
            r"a pattern of images needs one of stamps and rate",
        ),
        (
            CALIBRATED + LISTED.replace("left.csv, unit", "left.csv, stamps: name, unit"),
            r"a list of images has its",
        ),
        (
            CALIBRATED + BY_NAME.replace("*.png", "*.tif"),
            r"must be a pattern of images, got no file that matches",
        ),
        (
            CALIBRATED + BY_FILE.replace("times.txt", "left.csv"),
            r"left.csv:2: must have a stamp \[s\], got '1000",
        ),
        (CALIBRATED + BY_FILE.replace("times.txt", "none.txt"), r"none.txt: cannot be read"),
        (
            CALIBRATED + LISTED.replace("left.csv", "times.txt"),
            r"times.txt:1: must be a stamp and a file name",
        ),
        (BY_NAME + "calibration: none.yaml\n", r"none.yaml: cannot be read"),
        ("[1, 2]", r"must be a mapping"),
    ],
)
def test_what_cannot_be_used_is_one_line(home, text, said):
    with pytest.raises(DataError, match=said) as caught:
        opened(home, text)
    assert "\n" not in str(caught.value)
