"""Bags of ROS 1, ROS 2 in sqlite and MCAP: the tracks of the folder, and one line for what cannot be used."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags")

from tests.frontend.bags import IMU, KINDS, TOPICS, Pen, write_bag, write_camchain
from tests.frontend.studio import rendered
from vislam.base.errors import DataError
from vislam.base.progress import Silent
from vislam.datasets.bag_topics import Choice, pairs_by_name
from vislam.datasets.images import is_images, open_images
from vislam.datasets.recording import Recording
from vislam.datasets.tracks_npz import load_tracks_npz, write_tracks_npz
from vislam.frontend.decoding import decoded
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.track import track

FUZZED = int(os.environ.get("VISLAM_FUZZED", "8"))
"""Damaged bags that are tried; more by the environment."""
CONFIG = FrontEndConfig(features=60, window_px=15)


@pytest.fixture(scope="module")
def short():
    return rendered(4)


@pytest.fixture(scope="module")
def of_folder(short, tmp_path_factory):
    from tests.frontend.studio import write_asl

    return tracked(write_asl(tmp_path_factory.mktemp("folder"), short))


@pytest.fixture(scope="module")
def bags(short, tmp_path_factory):
    return {kind: write_bag(tmp_path_factory.mktemp(kind), kind, short) for kind in KINDS}


def tracked(path):
    return track(open_images(path), CONFIG, progress=Silent())


def same(one, other, *, to=0.0):
    assert np.array_equal(one.sequence.track, other.sequence.track)
    assert np.allclose(one.sequence.pixels, other.sequence.pixels, rtol=0.0, atol=to)
    assert np.allclose(one.sequence.stamp, other.sequence.stamp, rtol=0.0, atol=1e-9)
    assert np.allclose(one.sequence.twist, other.sequence.twist)
    assert np.allclose(one.sequence.rig.imu_T_cam, other.sequence.rig.imu_T_cam, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_has_the_tracks_of_the_folder(bags, of_folder, kind):
    assert is_images(bags[kind])
    same(tracked(bags[kind]), of_folder, to=1e-9)


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_file_of_ros_2_alone_is_enough(bags, of_folder, tmp_path, kind):
    file = next(bags[kind].glob(f"*.{kind}"))
    for name in (file, next(bags[kind].parent.glob("camchain*"))):
        (tmp_path / name.name).write_bytes(name.read_bytes())
    same(tracked(tmp_path / file.name), of_folder, to=1e-9)
    same(tracked(tmp_path), of_folder, to=1e-9)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_camera_info_and_static_transforms_are_a_calibration(short, of_folder, tmp_path, kind):
    found = tracked(write_bag(tmp_path, kind, short, camchain=False))
    same(found, of_folder, to=1e-6)


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_compressed_images(short, of_folder, tmp_path, kind):
    import cv2

    def packed(pen, stamp, picture):
        return pen.compressed(stamp, cv2.imencode(".png", picture)[1].tobytes())

    topics = tuple(f"{topic}/compressed" for topic in TOPICS)
    path = write_bag(tmp_path, kind, short, content=packed, topics=topics, camchain=False)
    same(tracked(path), of_folder, to=1e-6)


def test_colour_and_padded_rows(short, of_folder, tmp_path):
    def coloured(pen, stamp, picture):
        if stamp % 2:
            return pen.image(stamp, np.repeat(picture[..., None], 3, axis=2), "rgb8")
        padded = np.pad(picture, ((0, 0), (0, 8)))
        message = pen.image(stamp, padded)
        message.width -= 8
        return message

    same(tracked(write_bag(tmp_path, "mcap", short, content=coloured)), of_folder, to=1e-9)


def raw(pixels, encoding):
    from vislam.core.images import RawImage

    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    return RawImage(encoding, pixels.shape[0], pixels.shape[1], rows.shape[1], rows.ravel())


def test_layouts_of_pixels_are_the_grey_image(rng):
    """A Bayer pattern of a smooth colour image has, inside, its grey; 16 bits have their upper eight."""
    column, row = np.meshgrid(np.arange(40), np.arange(30))
    red, green, blue = (
        (3 * column + 20).astype(np.uint8),
        (2 * row + 60).astype(np.uint8),
        np.full((30, 40), 90),
    )
    grey = 0.299 * red + 0.587 * green + 0.114 * blue
    colours = {"r": red, "g": green, "b": blue.astype(np.uint8)}
    for pattern in ("rggb", "bggr", "gbrg", "grbg"):
        mosaic = np.zeros((30, 40), np.uint8)
        for place, colour in enumerate(pattern):
            mosaic[place // 2 :: 2, place % 2 :: 2] = colours[colour][place // 2 :: 2, place % 2 :: 2]
        found = decoded(raw(mosaic, f"bayer_{pattern}8")).astype(float)
        assert np.abs(found - grey)[2:-2, 2:-2].max() < 1.5, pattern
        wide = decoded(raw(mosaic.astype(np.uint16) * 256 + 77, f"bayer_{pattern}16"))
        assert np.array_equal(wide, decoded(raw(mosaic, f"bayer_{pattern}8")))
    rgb = np.dstack([red, green, colours["b"]])
    for encoding, pixels in (
        ("rgb8", rgb),
        ("bgr8", rgb[..., ::-1]),
        ("rgba8", np.dstack([rgb, red])),
        ("bgra8", np.dstack([rgb[..., ::-1], red])),
    ):
        assert np.abs(decoded(raw(pixels, encoding)) - grey).max() < 1.0
    noise = rng.integers(0, 255, (30, 40, 2)).astype(np.uint8)
    assert np.array_equal(decoded(raw(noise, "uyvy")), noise[..., 1])
    assert np.array_equal(decoded(raw(noise, "yuv422_yuy2")), noise[..., 0])


def test_images_out_of_order_are_put_in_order(short, of_folder, tmp_path):
    found = tracked(write_bag(tmp_path, "bag", short, arrival=[1, 0, 3, 2]))
    same(found, of_folder, to=1e-9)
    assert found.counts["images_out_of_order_left"] == 2


def test_an_image_that_arrives_far_too_late_is_left_out(tmp_path):
    with Pen(tmp_path, "mcap") as pen:
        for k in range(60):
            for topic in TOPICS:
                # The first image of the left camera arrives last.
                late = 100 if (k, topic) == (0, TOPICS[0]) else k
                pen.write(
                    topic, 10**8 * (late + 1), pen.image(10**8 * (k + 1), np.zeros((200, 320), np.uint8))
                )
    write_camchain_beside(tmp_path)
    recording = open_images(pen.path)
    assert recording.counts["images_late"] == 1
    assert len(recording) == 59
    assert recording.stamp[0] == pytest.approx(0.2)


def write_camchain_beside(folder, topics=TOPICS):
    from tests.frontend.bags import write_camchain

    write_camchain(folder / "camchain.yaml", topics)


def test_stamps_of_arrival_where_headers_have_none(short, of_folder, tmp_path):
    found = tracked(write_bag(tmp_path, "mcap", short, header=False))
    same(found, of_folder, to=1e-9)
    assert found.counts["images_stamped_by_arrival"] == 8


def test_broken_images_in_a_bag_are_counted(short, tmp_path):
    broken = iter(range(8))

    def some(pen, stamp, picture):
        message = pen.image(stamp, picture)
        match next(broken):
            case 2:
                message.data = message.data[:1000]
            case 5:
                message.encoding = "32FC1"
        return message

    recording = open_images(write_bag(tmp_path, "mcap", short, content=some))
    config = FrontEndConfig(features=60, window_px=15, fewest_observations=2)
    counts = track(recording, config, progress=Silent()).counts
    assert counts["images_truncated"] == counts["images_of_unknown_encoding"] == 1
    assert counts["frames"] == 2


def many(tmp_path, topics, kind="Image", calibration=True):
    with Pen(tmp_path, "mcap") as pen:
        for stamp in (10**9, 2 * 10**9):
            for topic in topics:
                is_imu = kind == "Imu" and topic.startswith("/imu")
                message = (
                    pen.imu(stamp, (0, 0, 0), (0, 0, 9.8))
                    if is_imu
                    else pen.image(stamp, np.zeros((200, 320), np.uint8))
                )
                pen.write(topic, stamp, message)
    if calibration:
        write_camchain_beside(tmp_path, ("/somewhere", "/else"))
    return pen.path


@pytest.mark.parametrize(
    ("topics", "kind", "choice", "said"),
    [
        (
            ["/grey/left/image", "/grey/right/image", "/col/left/image", "/col/right/image"],
            "Image",
            Choice(),
            r"more than one pair of images may be meant: /col/left/image and /col/right/image, "
            r"/grey/left/image and /grey/right/image; choose with --left TOPIC and --right TOPIC",
        ),
        (
            ["/front", "/back", "/top"],
            "Image",
            Choice(),
            r"must have images of a left and a right .* /back, /front",
        ),
        (
            [*TOPICS, "/imu0", "/imu1"],
            "Imu",
            Choice(),
            r"more than one inertial sensor .* /imu0, /imu1; .*--imu TOPIC",
        ),
        (
            TOPICS,
            "Image",
            Choice(left="/no"),
            r"must have images on the topic /no, got /cam0/image_raw, /cam1",
        ),
        (TOPICS, "Image", Choice(imu="/no"), r"must have sensor_msgs/msg/Imu on the topic /no, got none"),
        (TOPICS, "Image", Choice(left=TOPICS[0], right=TOPICS[0]), r"must be two topics"),
    ],
)
def test_ambiguous_topics_are_one_line_with_the_option(tmp_path, topics, kind, choice, said):
    path = many(tmp_path, topics, kind)
    with pytest.raises(DataError, match=said) as caught:
        open_images(path, choice)
    assert "\n" not in str(caught.value)


def test_topics_that_are_named_settle_it(tmp_path):
    path = many(tmp_path, ["/grey/left", "/grey/right", "/col/left", "/col/right"])
    for choice in (Choice(left="/col/left"), Choice(left="/col/left", right="/col/right")):
        assert open_images(path, choice).left.topic == "/col/left"
    mixed = Choice(left="/grey/left", right="/col/right")
    assert open_images(path, mixed).right.topic == "/col/right"


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (["/cam0/image_raw", "/cam1/image_raw"], 1),
        (["/stereo/left/image_raw", "/stereo/right/image_raw"], 1),
        (["/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"], 1),
        (["/leftImage", "/rightImage"], 1),
        (["/kitti/image_00", "/kitti/image_01"], 1),
        (["/cam_l", "/cam_r"], 1),
        (["/cam0", "/cam1", "/cam2"], 2),
        (["/front", "/back"], 0),
    ],
)
def test_names_of_a_pair(names, pairs):
    assert len(pairs_by_name(names)) == pairs


def test_a_bag_without_calibration_is_one_line(tmp_path):
    with pytest.raises(DataError, match=r"has no calibration of .*camchain file with --calibration"):
        open_images(many(tmp_path, TOPICS, calibration=False))


def test_inertia_of_unknown_mounting_is_left_out(short, tmp_path):
    path = write_bag(tmp_path, "mcap", short)
    file = next(tmp_path.glob("camchain*"))
    text = file.read_text()
    lines = text.splitlines()
    start = lines.index("  T_cam_imu:")
    del lines[start : start + 5]
    second = lines.index("  T_cam_imu:")
    lines[second] = "  T_cn_cnm1:"
    file.write_text("\n".join(lines))
    recording = open_images(path)
    assert recording.inertia is None
    assert recording.counts["inertial_samples_without_mounting"] > 10


def test_the_clock_of_the_calibration_is_used(short, tmp_path):
    path = write_bag(tmp_path, "mcap", short)
    file = next(tmp_path.glob("camchain*"))
    before = open_images(path).inertia.stamp
    file.write_text(file.read_text().replace("timeshift_cam_imu: 0.0", "timeshift_cam_imu: 0.02"))
    assert np.allclose(open_images(path).inertia.stamp, before - 0.02)


@settings(max_examples=FUZZED, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(KINDS), share=st.floats(0.0, 1.0), change=st.integers(0, 255))
def test_a_damaged_bag_is_one_line_or_read(bags, tmp_path_factory, kind, share, change):
    """Cut anywhere, or with a byte changed anywhere: a DataError of one line, or what is left."""
    source = bags[kind] if kind == "bag" else next(bags[kind].glob(f"*.{kind}"))
    content = bytearray(source.read_bytes())
    at = min(int(share * len(content)), len(content) - 1)
    if change:
        content[at] ^= change
    else:
        del content[at:]
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / source.name
    path.write_bytes(content)
    write_camchain_beside(folder)
    said = read_or_said(path)
    assert "\n" not in said
    assert not said or str(path) in said


def read_or_said(path):
    """What is said of a bag that cannot be read; nothing of one of which all that is listed can be."""
    try:
        recording = open_images(path)
        assert sum(1 for images in (recording.left, recording.right) for _ in images) == 2 * len(recording)
    except DataError as error:
        return str(error)
    return ""


def test_the_calibration_of_a_folder_is_one_of_a_bag(short, of_folder, tmp_path):
    from tests.frontend.studio import write_asl

    path = write_bag(tmp_path, "mcap", short)
    next(tmp_path.glob("camchain*")).unlink()
    folder = write_asl(tmp_path / "folder", short)
    found = track(open_images(path, Choice(calibration=folder)), CONFIG, progress=Silent())
    same(found, of_folder, to=1e-9)


def test_folder_and_bag_count_alike(short, tmp_path):
    """A frame twice, two out of order: one mechanism for all readers."""
    from dataclasses import replace

    from tests.frontend.studio import write_asl

    order = [0, 2, 1, 3, 3]
    made = replace(short, pose=short.pose[order], pictures=[short.pictures[k] for k in order])
    stamps = [100.0, 100.2, 100.1, 100.3, 100.3]
    type(made).stamp, before = property(lambda _: np.array(stamps)), type(made).stamp
    try:
        folder = open_images(write_asl(tmp_path / "folder", made))
        bag = open_images(write_bag(tmp_path, "bag", made, arrival=range(5)))
    finally:
        type(made).stamp = before
    for name in ("images_listed", "images_duplicate", "images_out_of_order_left", "images_unpaired", "pairs"):
        assert bag.counts[name] == folder.counts[name]
    assert folder.counts["images_duplicate"] == 2
    assert folder.counts["images_out_of_order_left"] == 1
    assert np.array_equal(bag.stamp, folder.stamp)


def test_a_folder_with_images_and_a_bag_is_one_of_images(short, bags, tmp_path):
    from tests.frontend.studio import write_asl

    folder = write_asl(tmp_path, short)
    (folder / "run.bag").write_bytes(bags["bag"].read_bytes())
    (folder / "metadata.yaml").write_text("of: something else")
    assert open_images(folder).left.place.endswith("cam0/data")


def test_what_is_no_bag_is_one_line(tmp_path):
    for name in ("a.bag", "b.mcap", "c.db3"):
        (tmp_path / name).write_bytes(b"nothing of the kind")
        with pytest.raises(DataError, match="cannot be read as a rosbag"):
            open_images(tmp_path / name)
        with pytest.raises(DataError, match="no such file"):
            open_images(tmp_path / f"x{name}")


def test_options_of_bags_for_a_folder_are_one_line(drive_folder):
    with pytest.raises(DataError, match="are of bags, and this is none"):
        open_images(drive_folder, Choice(imu=IMU))


@pytest.mark.parametrize("kind", KINDS)
def test_inertial_samples_are_those_of_the_topic(tmp_path, kind, short):
    """In order, one a stamp; what is no number is left out and counted."""
    write_camchain(tmp_path / "camchain-imucam-run.yaml", TOPICS)
    stamps = np.rint(1e9 * short.stamp).astype(np.int64).tolist()
    at = stamps[0] + 10**7 * np.arange(40)
    values = np.random.default_rng(2).normal(size=(40, 6))
    with Pen(tmp_path, kind) as pen:
        for stamp in stamps:
            for topic in TOPICS:
                pen.write(topic, stamp, pen.image(stamp, np.zeros((200, 320), np.uint8)))
        for arrived, row in enumerate([0, 2, 1, 1, *range(3, 40)]):
            sample = pen.imu(int(at[row]), values[row, :3], values[row, 3:])
            pen.write(IMU, stamps[0] + arrived, sample)
        pen.write(IMU, stamps[-1], pen.imu(int(at[-1]) + 10**7, (0.0, np.nan, 0.0), (0.0, 0.0, 9.8)))
    found = open_images(pen.path)
    series = found.inertia.series
    assert np.allclose(series.stamp, 1e-9 * at, rtol=0.0, atol=1e-6)
    assert np.array_equal(series.gyro, values[:, :3])
    assert np.array_equal(series.accel, values[:, 3:])
    assert found.counts["inertial_duplicates"] == found.counts["inertial_out_of_order"] == 1
    assert found.counts["inertial_corrupt"] == 1


def test_tracks_keep_the_inertial_samples(of_folder, tmp_path):
    """Through the open track file and back."""
    write_tracks_npz(tmp_path / "tracks.npz", Recording(of_folder.sequence))
    found = load_tracks_npz(tmp_path / "tracks.npz").sequence
    for name in ("stamp", "gyro", "accel"):
        assert np.array_equal(getattr(found.imu, name), getattr(of_folder.sequence.imu, name))
    assert found.counts["imu_samples"] == of_folder.counts["imu_samples"] == len(found.imu)
