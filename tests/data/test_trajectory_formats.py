"""Trajectory files of every format, as editors, shells and loggers leave them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.datasets.trajectory_formats import FORMATS, ReadOptions, read_rows
from vislam.geometry import se3
from vislam.geometry.pose_covariance import FRAMES, ORDERS, CovarianceConvention, from_right, to_right

STAMP = 1403715529.1 + 0.1 * np.arange(12)
KINDS = (
    "swap",
    "duplicate",
    "nan",
    "zero",
    "bom",
    "utf16",
    "header",
    "commas",
    "tabs",
    "ms",
    "us",
    "ns",
    "norm",
)
"""Ways in which files are left, for the mutations."""


@pytest.fixture
def pose(rng):
    turn = Rotation.random(12, rng=rng).as_matrix()
    return se3.from_rotation_translation(turn, rng.uniform(-9, 9, (12, 3)))


def table(pose, stamp=STAMP):
    return np.column_stack([stamp, pose[:, :3, 3], Rotation.from_matrix(pose[:, :3, :3]).as_quat()])


def lines(values, separator=" "):
    return [separator.join(f"{value:.17g}" for value in row) for row in values]


def write(path, rows, *, header=()):
    path.write_text("\n".join([*header, *rows]) + "\n")
    return path


def covariance(rng, count=12):
    root = rng.normal(size=(count, 6, 6))
    return root @ root.transpose(0, 2, 1) + np.eye(6)


def test_every_format_is_guessed_and_read(tmp_path, pose, rng):
    tum = table(pose)
    matrix = pose[:, :3].reshape(12, 12)
    whole = pose.reshape(12, 16)
    frame = np.arange(12)[:, None] + 3
    cov = covariance(rng)
    upper = np.column_stack([cov[:, i, j] for b in (0, 3) for i in range(b, b + 3) for j in range(i, b + 3)])
    lower = np.column_stack([cov[:, i, j] for i in range(6) for j in range(i + 1)])
    contents = {
        "tum": lines(tum),
        "kitti": lines(matrix),
        "kitti360": lines(np.column_stack([frame, whole])),
        "positions": lines(tum[:, :4]),
        "openvins": lines(np.column_stack([tum, upper])),
        "smfeval": lines(np.column_stack([tum, lower])),
        "tum_cov": lines(np.column_stack([tum, cov.reshape(12, 36)])),
        "matrices": lines(np.column_stack([STAMP, matrix])),
    }
    for name, text in contents.items():
        rows = read_rows(write(tmp_path / f"{name}.txt", text))
        assert f"read as {name}" in rows.told
        assert np.allclose(rows.position, pose[:, :3, 3], atol=1e-12), name
        if rows.pose is not None:
            assert np.allclose(rows.pose, pose, atol=1e-9), name
        if rows.stamp is not None:
            assert np.array_equal(rows.stamp, STAMP), name
    assert np.allclose(read_rows(tmp_path / "tum_cov.txt").cov, cov)
    assert np.allclose(read_rows(tmp_path / "smfeval.txt").cov, cov)
    assert np.allclose(read_rows(tmp_path / "openvins.txt").cov[:, :3, :3], cov[:, :3, :3])
    assert read_rows(tmp_path / "kitti360.txt").frame.tolist() == list(range(3, 15))
    assert {"euroc", "planar_xy", "npz", "rosbag"} == FORMATS.keys() - contents.keys()


def test_our_own_archive_comes_back_with_its_covariances(tmp_path, pose, rng):
    cov = covariance(rng)
    np.savez(tmp_path / "a.npz", stamp=STAMP, world_T_imu=pose, pose_cov=cov)
    rows = read_rows(tmp_path / "a.npz")
    assert np.array_equal(rows.pose, pose)
    assert np.array_equal(rows.cov, cov)
    assert str(rows.convention) == "rotation first, right"
    np.savez(tmp_path / "b.npz", points=pose)
    with pytest.raises(DataError, match=r"b\.npz: must hold stamp and world_T_imu, got points"):
        read_rows(tmp_path / "b.npz")


def test_names_of_the_columns_tell_the_order_of_the_quaternion(tmp_path, pose):
    tum = table(pose)[:, [0, 1, 2, 3, 7, 4, 5, 6]]
    file = write(tmp_path / "a.csv", lines(tum, ","), header=["timestamp,tx,ty,tz,qw,qx,qy,qz"])
    rows = read_rows(file)
    assert np.allclose(rows.pose, pose)
    assert "quaternions wxyz, as the header says" in rows.told
    assert np.allclose(
        read_rows(write(tmp_path / "b.txt", lines(tum)), "tum", ReadOptions(quaternion="wxyz")).pose, pose
    )


def test_a_column_of_ids_is_passed_over(tmp_path, pose):
    values = np.column_stack([np.arange(12), table(pose)])
    assert np.allclose(read_rows(write(tmp_path / "a.txt", lines(values))).pose, pose)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_units_are_told_by_the_size_of_the_stamps(tmp_path, pose, unit, factor):
    rows = read_rows(write(tmp_path / "a.txt", lines(table(pose, STAMP * factor))))
    assert np.allclose(rows.stamp, STAMP, rtol=0, atol=1e-6)
    assert any(unit in text for text in rows.told)


def test_nanoseconds_since_the_start_are_told_by_their_steps(tmp_path, pose):
    rows = read_rows(write(tmp_path / "a.txt", lines(table(pose, 1e8 * np.arange(12)))))
    assert np.allclose(rows.stamp, 0.1 * np.arange(12))
    assert read_rows(tmp_path / "a.txt", "tum", ReadOptions(unit="s")).stamp[1] == 1e8


def test_what_is_mended_is_counted_and_refused_if_strict(tmp_path, pose):
    text = lines(table(pose))
    text[2], text[3] = text[3], text[2]
    text[5] = text[5].split()[0] + " nan" * 7
    text[7] = " ".join(text[7].split()[:4]) + " 0 0 0 0"
    text.insert(9, text[8])
    file = write(tmp_path / "a.txt", text)
    rows = read_rows(file)
    assert rows.counts == {"rows_lost": 2, "rows_sorted": 1, "duplicates_dropped": 1}
    assert np.array_equal(rows.stamp, STAMP[[0, 1, 2, 3, 4, 6, 8, 9, 10, 11]])
    with pytest.raises(DataError, match=r"a\.txt:6: must hold 8 finite numbers, got nan"):
        read_rows(file, options=ReadOptions(strict=True))


def test_a_line_cut_off_is_left_out_and_a_short_one_is_not(tmp_path, pose):
    text = "\n".join(lines(table(pose)))
    (tmp_path / "a.txt").write_text(text[:-60])
    rows = read_rows(tmp_path / "a.txt")
    assert rows.counts == {"rows_cut_off": 1}
    assert len(rows) == 11
    short = lines(table(pose))
    short[4] = "1 2 3"
    with pytest.raises(DataError, match=r"b\.txt:5: must hold 8 finite numbers, got 3 columns"):
        read_rows(write(tmp_path / "b.txt", short))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\0\1\2\3" * 20, "must be a text file of numbers, got a binary one"),
        (b"ply\nformat ascii 1.0\n", "got a map of points"),
        (b"", "must have 2 lines of numbers or more, got 0"),
        (b"1 2 3 4 5\n" * 4, "must be of a known format, got 5 columns"),
        (b"a b c d e f g h\n" * 3, "must hold finite numbers, got 'a'"),
        (b"1 0 0 0 0 0 0 3\n" * 3, "must have a quaternion of norm 1, got norm 3"),
        (b"\xff\xfe1", "must be utf-16-le as it begins"),
        (b"\x89MCAP0\r\n" + b"\0" * 60, "rosbag"),
    ],
)
def test_what_is_no_trajectory_is_one_line(tmp_path, content, message):
    (tmp_path / "x.txt").write_bytes(content)
    with pytest.raises(DataError, match=message) as caught:
        read_rows(tmp_path / "x.txt")
    assert "\n" not in str(caught.value)


def mutated(text, kind, rng):
    """Lines as somebody leaves them, the bytes of the file, and the rows that must be gone then."""
    rows, gone = [row.split() for row in text], set()
    k = int(rng.integers(1, len(rows) - 2))
    if kind == "swap":
        rows[k], rows[k + 1] = rows[k + 1], rows[k]
    elif kind == "duplicate":
        rows.insert(k, list(rows[k]))
    elif kind in ("nan", "zero"):
        rows[k] = [rows[k][0], *(["nan"] * 7 if kind == "nan" else [*rows[k][1:4], "0", "0", "0", "0"])]
        gone.add(k)
    elif kind in ("ms", "us", "ns"):
        for row in rows:
            row[0] = f"{float(row[0]) * {'ms': 1e3, 'us': 1e6, 'ns': 1e9}[kind]:.6f}"
    elif kind == "norm":
        factor = rng.uniform(0.93, 1.07)
        for row in rows:
            row[4:] = [f"{factor * float(value):.15g}" for value in row[4:]]
    separator = {"commas": ",", "tabs": "\t"}.get(kind, " ")
    joined = "\n".join(separator.join(row) for row in rows) + "\n"
    if kind == "header":
        joined = "timestamp tx ty tz qx qy qz qw\n" + joined
    encoding = {"bom": "utf-8-sig", "utf16": "utf-16"}.get(kind, "utf-8")
    return joined.encode(encoding), gone


def test_no_mutation_changes_a_number_in_silence(tmp_path, pose):
    """100 files, each left in one or two ways: every row that is read is the row that was written."""
    rng = np.random.default_rng(24)
    text = lines(table(pose))
    for trial in range(100):
        kind = KINDS[trial % len(KINDS)]
        content, gone = mutated(text, kind, rng)
        if trial % 2 and kind not in ("bom", "utf16"):
            content = b"\xef\xbb\xbf" + content
        (tmp_path / "m.txt").write_bytes(content)
        rows = read_rows(tmp_path / "m.txt")
        kept = np.array([row for row in range(12) if row not in gone])
        assert np.allclose(rows.stamp, STAMP[kept], rtol=0, atol=1e-6), kind
        assert np.allclose(rows.pose, pose[kept], rtol=0, atol=1e-9), kind
        assert rows.counts or len(rows.told) > 1 or kind in ("commas", "tabs", "norm", "header"), kind


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("frame", FRAMES)
def test_conventions_of_covariances_are_what_they_are_said_to_be(order, frame, pose, rng):
    """An error drawn in a convention has, to first order, the covariance that it is turned into."""
    root = 1e-5 * rng.normal(size=(6, 6))
    draws = rng.normal(size=(4000, 6)) @ root.T
    one = pose[0]
    turn, place = (draws[:, :3], draws[:, 3:]) if order == "rotation_first" else (draws[:, 3:], draws[:, :3])
    moved = se3.exp(np.column_stack([turn, place]))
    if frame == "right":
        true = one @ moved
    elif frame == "left":
        true = moved @ one
    else:
        own = se3.exp(np.column_stack([turn, np.zeros((4000, 3))]))[:, :3, :3]
        rotation = one[:3, :3] @ own if frame == "split" else own @ one[:3, :3]
        true = se3.from_rotation_translation(rotation, one[:3, 3] + place)
    found = se3.local(np.broadcast_to(one, true.shape), true)
    sample = np.cov(draws.T, bias=True)
    convention = CovarianceConvention(order, frame)
    expected = to_right(pose[:1], sample[None], convention)
    assert np.allclose(expected[0], np.cov(found.T, bias=True), rtol=1e-3, atol=1e-3 * np.abs(expected).max())
    assert np.allclose(from_right(pose[:1], expected, convention)[0], sample, rtol=1e-9)


def test_bags_are_read_by_topic(tmp_path, pose, rng):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types["nav_msgs/msg/Odometry"]
    names = {
        name: store.types[f"geometry_msgs/msg/{name}"]
        for name in (
            "Pose",
            "PoseWithCovariance",
            "Twist",
            "TwistWithCovariance",
            "Point",
            "Quaternion",
            "Vector3",
        )
    }
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    cov = covariance(rng)
    zero = names["Vector3"](x=0.0, y=0.0, z=0.0)
    twist = names["Twist"](linear=zero, angular=zero)
    still = names["TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/odom", kind.__msgtype__, typestore=store)
        for k in range(12):
            nanoseconds = round(1e9 * STAMP[k])
            at = time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
            x, y, z, w = Rotation.from_matrix(pose[k, :3, :3]).as_quat()
            here = names["Pose"](
                position=names["Point"](*pose[k, :3, 3]), orientation=names["Quaternion"](x=x, y=y, z=z, w=w)
            )
            message = kind(
                header=header(stamp=at, frame_id="world"),
                child_frame_id="base",
                pose=names["PoseWithCovariance"](pose=here, covariance=cov[k].ravel()),
                twist=still,
            )
            writer.write(topic, nanoseconds, store.serialize_cdr(message, kind.__msgtype__))
    for path in (tmp_path / "bag", next((tmp_path / "bag").glob("*.mcap"))):
        rows = read_rows(path)
        assert np.allclose(rows.pose, pose)
        assert np.allclose(rows.cov, cov)
        assert np.allclose(rows.stamp, STAMP, atol=1e-6)
        assert "topic /odom" in rows.told
    with pytest.raises(DataError, match="must have the topic /pose with poses, got /odom"):
        read_rows(tmp_path / "bag", options=ReadOptions(topic="/pose"))


def test_what_we_write_is_what_we_read(tmp_path, pose, rng):
    from vislam.core.stamped import Stamped
    from vislam.datasets.layouts import write_layouts

    cov = covariance(rng)
    rows = Stamped(STAMP, pose[:, :3, 3], pose, cov)
    files = write_layouts(tmp_path, "orb", rows, rows)
    for file in files:
        back = read_rows(file)
        assert np.allclose(back.pose, pose, atol=1e-12), file
        if back.stamp is not None:
            assert np.allclose(back.stamp, STAMP, atol=1e-6), file
        if back.cov is not None:
            ours = to_right(back.pose, back.cov, back.convention)
            known = cov.copy()
            if back.format == "openvins":
                known[:, :3, 3:] = known[:, 3:, :3] = 0.0
            assert np.allclose(ours, known, atol=1e-9), file
    assert {file.parts[-2] for file in files} >= {"evo", "openvins", "smfeval", "kitti", "orb"}


def test_maps_are_read_plain_and_binary(tmp_path, rng):
    from vislam.datasets.export import write_ply
    from vislam.datasets.maps import read_points

    points = rng.uniform(-50, 50, (30, 3))
    write_ply(tmp_path / "a.ply", points)
    assert np.allclose(read_points(tmp_path / "a.ply"), points, atol=1e-4)
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 30\nproperty double x\nproperty uchar red\n"
    )
    header += "property double y\nproperty double z\nend_header\n"
    kind = np.dtype([("x", "<f8"), ("r", "u1"), ("y", "<f8"), ("z", "<f8")])
    packed = np.zeros(30, kind)
    for column, axis in enumerate("xyz"):
        packed[axis] = points[:, column]
    (tmp_path / "b.ply").write_bytes(header.encode() + packed.tobytes())
    assert np.array_equal(read_points(tmp_path / "b.ply"), points)
    np.savez(tmp_path / "c.npz", points_world=points)
    assert np.array_equal(read_points(tmp_path / "c.npz"), points)
    (tmp_path / "d.ply").write_bytes(header.encode() + packed.tobytes()[:-5])
    with pytest.raises(DataError, match=r"d\.ply: not a PLY file of points"):
        read_points(tmp_path / "d.ply")
