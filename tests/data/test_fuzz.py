"""Whatever a file holds, its reader answers with data or with one line, and takes no memory that it names."""

import io
import tracemalloc
import zipfile
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.cli.test_compare import config_file, course_file
from vislam import repair
from vislam.base.errors import DataError
from vislam.compare import main
from vislam.datasets import course_npz
from vislam.datasets.course_npz import load_course_npz
from vislam.datasets.oxts import with_oxts
from vislam.datasets.settings import ReferenceConfig
from vislam.datasets.trajectories import load_reference

MOST_MEMORY = 40e6
KEYS = ("time_stamps", "features", "linear_velocity", "angular_velocity", "K", "b", "imu_T_cam")

fuzz = settings(
    derandomize=True,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@contextmanager
def little_memory(most=MOST_MEMORY):
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def read(path, most=MOST_MEMORY):
    """The sequence, or the one line that says why there is none; what is read must also be of use."""
    with little_memory(most):
        try:
            sequence = load_course_npz(path)
        except DataError as error:
            assert_one_line(error, path)
            return str(error)
    assert np.isfinite(sequence.step_means()[0]).all()
    with np.errstate(divide="ignore"):
        repair.apply(sequence, repair.RepairConfig())
    return sequence


def assert_one_line(error, path):
    assert str(error).startswith(str(path.parent))
    assert "\n" not in str(error)
    assert len(str(error)) < 1000


def whole_file(*, deflated=False, **changes):
    buffer = io.BytesIO()
    course_file(buffer, **changes)
    if not deflated:
        return buffer.getvalue()
    return repacked(buffer.getvalue(), method=zipfile.ZIP_DEFLATED)


def repacked(content, *, replaced=None, method=zipfile.ZIP_STORED, declared=None):
    """The archive with members replaced, and sizes declared that they do not have."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(buffer, "w", method) as target:
        for name in source.namelist():
            target.writestr(name, (replaced or {}).get(name, source.read(name)))
        for information in target.filelist:
            information.file_size = (declared or {}).get(information.filename, information.file_size)
    return buffer.getvalue()


def member(shape, *, descr="'<f8'", order="False", version=1, data=b""):
    """A member whose header claims a type and a shape."""
    text = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    length = len(text).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + text + data


GOOD = {False: whole_file(), True: whole_file(deflated=True)}


@fuzz
@given(deflated=st.booleans(), share=st.floats(0.0, 1.0))
def test_a_file_cut_short(tmp_path, deflated, share):
    content = GOOD[deflated]
    (tmp_path / "a.npz").write_bytes(content[: int(share * (len(content) - 1))])
    assert "not a whole npz archive" in read(tmp_path / "a.npz")


flips = st.lists(
    st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=6
)


def flipped(content, changes):
    out = bytearray(content)
    for place, bits in changes:
        out[int(place * len(out))] ^= bits
    return bytes(out)


@fuzz
@given(deflated=st.booleans(), changes=flips)
def test_a_file_with_flipped_bits(tmp_path, deflated, changes):
    (tmp_path / "a.npz").write_bytes(flipped(GOOD[deflated], changes))
    read(tmp_path / "a.npz")


@settings(fuzz, max_examples=150)
@given(key=st.sampled_from(KEYS), changes=flips)
def test_a_member_with_flipped_bits_and_a_right_check_sum(tmp_path, key, changes):
    with zipfile.ZipFile(io.BytesIO(GOOD[False])) as archive:
        content = archive.read(f"{key}.npy")
    # Half of the flips go to the header, which is what is hard to get right.
    changes = [
        (place * (128 / len(content) if k % 2 else 1.0), bits) for k, (place, bits) in enumerate(changes)
    ]
    replaced = {f"{key}.npy": flipped(content, changes)}
    (tmp_path / "a.npz").write_bytes(repacked(GOOD[False], replaced=replaced))
    read(tmp_path / "a.npz")


WRONG_TYPES = (object, complex, "U3", "S3", bool, [("x", float)], "datetime64[s]", np.float16, ">f8", np.int8)


@pytest.mark.parametrize("kind", WRONG_TYPES, ids=str)
def test_other_types(tmp_path, kind):
    good = {"K": np.diag([500, 500, 1]), "b": np.ones(()), "features": np.ones((4, 8, 6))}
    for key in KEYS:
        course_file(tmp_path / "a.npz", **{key: np.zeros(np.shape(good.get(key, 0)), dtype=kind)})
        assert (
            f"'{key}' must be" in read(tmp_path / "a.npz") if key != "features" else read(tmp_path / "a.npz")
        )
    if kind not in (np.float16, ">f8", np.int8):
        assert "plain array of real numbers" in read(tmp_path / "a.npz")


extents = st.lists(st.sampled_from([0, 1, 3, 4, 6, 8, 1000, 10**6, 2**31, 2**63, 10**30, -1]), max_size=5)


@fuzz
@given(
    key=st.sampled_from(KEYS),
    shape=extents.map(tuple),
    descr=st.sampled_from(["'<f8'", "'|i1'", "'>u2'", "'<f16'", "'|V0'", "[('a', '<f8')]", "''", "5"]),
    order=st.sampled_from(["False", "True", "1"]),
    version=st.sampled_from([1, 2, 3, 4]),
    lie=st.booleans(),
)
def test_a_header_that_claims_anything(tmp_path, *, key, shape, descr, order, version, lie):
    """Both with the archive's size of the member left alone, and with one declared that fits the claim."""
    content = member(shape, descr=descr, order=order, version=version, data=bytes(192))
    declared = {}
    if lie and all(0 <= extent < 10**8 for extent in shape):
        size = int(np.prod([float(extent) for extent in shape])) * 8
        declared = {f"{key}.npy": min(len(content) - 192 + size, 2**62)}
    whole = repacked(GOOD[False], replaced={f"{key}.npy": content}, declared=declared)
    (tmp_path / "a.npz").write_bytes(whole)
    read(tmp_path / "a.npz")


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("shape", [(4, 10**6, 10**6), (4, 10**6, 6), (4, 2**59, 6), (4, 8, 6)])
def test_a_huge_claim_is_refused_before_memory_is_taken(tmp_path, shape, version):
    content = member(shape, version=version, data=bytes(192))
    replaced = {"features.npy": content}
    (tmp_path / "a.npz").write_bytes(repacked(GOOD[False], replaced=replaced))
    assert "bytes long as its shape" in read(tmp_path / "a.npz", most=2e6)
    size = len(content) - 192 + 8 * 4 * shape[1] * shape[2]
    if size < 2**62:
        lying = repacked(GOOD[False], replaced=replaced, declared={"features.npy": size})
        (tmp_path / "a.npz").write_bytes(lying)
        said = read(tmp_path / "a.npz", most=12e6)
        assert "an array ends early" in said or "must be at most" in said


@pytest.mark.parametrize(
    "shape",
    [
        "(" + "9" * 60 + ", 2)",
        "(4, -8, 6)",
        "(4, 8" + " 6" * 900 + ")",
        "(4, x)",
        "7",
        "(,)",
        "(" + 40 * f"{10**17}, " + ")",
    ],
)
def test_a_shape_that_is_none(tmp_path, shape):
    (tmp_path / "a.npz").write_bytes(repacked(GOOD[False], replaced={"features.npy": member(shape)}))
    assert "'features' must be a numpy array" in read(tmp_path / "a.npz")


@pytest.mark.parametrize("version", [2, 3])
def test_headers_of_later_versions_are_read(tmp_path, version):
    content = member(
        (3, 3), version=version, data=np.array([[500, 0, 320], [0, 500, 240], [0, 0, 1.0]]).tobytes()
    )
    (tmp_path / "a.npz").write_bytes(repacked(GOOD[False], replaced={"K.npy": content}))
    assert read(tmp_path / "a.npz").rig.fx == 500.0


def test_a_bomb_costs_its_sentinels_nothing_and_its_values_no_more_than_the_limit(tmp_path, monkeypatch):
    columns = 400_000
    for value, message in ((-1, None), (0, "mostly -1")):
        data = np.full(4 * columns * 6, value, np.int8).tobytes()
        replaced = {"features.npy": member((4, columns, 6), descr="'|i1'", data=data)}
        bomb = repacked(GOOD[False], replaced=replaced, method=zipfile.ZIP_DEFLATED)
        assert len(bomb) < 20_000
        (tmp_path / "a.npz").write_bytes(bomb)
        monkeypatch.setattr(course_npz, "_MOST_SEEN_VALUES", 100_000)
        answer = read(tmp_path / "a.npz", most=20e6)
        assert message in answer if message else answer.observations == 0


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_unpack_without_a_limit_are_refused(tmp_path, method):
    (tmp_path / "a.npz").write_bytes(repacked(GOOD[False], method=method))
    assert "must be stored or deflated" in read(tmp_path / "a.npz")


numbers = st.one_of(
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, 1e6, -1e6, 1e11, np.nan, np.inf, -np.inf, 5e-324]),
    st.floats(-1e7, 1e7),
)


@settings(fuzz, max_examples=150)
@given(
    key=st.sampled_from(KEYS),
    places=st.lists(st.tuples(st.integers(0, 191), numbers), min_size=1, max_size=8),
)
def test_numbers_that_cannot_be(tmp_path, key, places):
    with np.load(io.BytesIO(GOOD[False])) as archive:
        values = archive[key].astype(float)
    flat = values.reshape(-1)
    for place, number in places:
        flat[place % len(flat)] = number
    course_file(tmp_path / "a.npz", **{key: values})
    read(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "content", [b"", b"frame x y\n1 2 3\n", b"PK\x03\x04", b"PK\x05\x06" + bytes(18), bytes(500)]
)
def test_what_is_no_archive(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    assert isinstance(read(tmp_path / "a.npz"), str)


def test_a_member_without_the_suffix_is_missing(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("angular_velocity\nK", b"")
        archive.writestr("angular_velocity", b"")
    assert "key 'angular_velocity' or 'rotational_velocity' is missing" in read(tmp_path / "a.npz")


words = st.one_of(
    st.floats().map(str),
    st.integers(0, 12).map(str),
    st.sampled_from(["1", "0", "-1", "1e400", "nan", "x", "#", ",", "0x10", "1_0", "é", "\0", "1" * 5000]),
)
table = st.lists(st.lists(words, max_size=14).map(" ".join), max_size=8).map("\n".join).map(str.encode)
rows_of_numbers = st.integers(1, 14).flatmap(
    lambda columns: st.lists(
        st.lists(st.floats(-2, 12).map(str), min_size=columns, max_size=columns).map(" ".join), max_size=6
    )
).map("\n".join).map(str.encode)  # fmt: skip


@settings(fuzz, max_examples=150)
@given(
    content=st.one_of(table, rows_of_numbers, st.binary(max_size=300)),
    form=st.sampled_from(["planar_xy", "kitti", "kitti360", "tum", "euroc"]),
)
def test_references_of_any_text(tmp_path, content, form):
    path = tmp_path / "reference.txt"
    path.write_bytes(content.replace(b" ", b",") if form == "euroc" else content)
    config = ReferenceConfig(file=path.name, format=form, name="r", limits="l", max_time_difference=9.0)
    with little_memory():
        try:
            reference = load_reference(path, config, imu_T_cam=np.eye(4), stamp=np.arange(10.0))
        except DataError as error:
            assert_one_line(error, path)
            return
    assert np.all(np.diff(reference.frame) > 0)
    assert np.isfinite(reference.position).all()


def test_a_reference_in_one_endless_line(tmp_path):
    config = ReferenceConfig(file="r.txt", format="kitti", name="r", limits="l")
    (tmp_path / "r.txt").write_bytes(b"1 " * 2_000_000)
    with little_memory(2e6), pytest.raises(DataError, match=r"r\.txt:1: must hold 12 or 16 finite numbers"):
        load_reference(tmp_path / "r.txt", config, imu_T_cam=np.eye(4), stamp=np.arange(10.0))


stamps = st.lists(
    st.one_of(
        st.integers(0, 59).map(lambda second: f"2011-09-30 12:40:{second:02d}.0"),
        st.sampled_from(["2011-02-30 00:00:00", "2099-12-31 23:59:60", "0000-00-00 00:00:00", "", "é", "#"]),
    ),
    max_size=8,
)


@fuzz
@given(own=stamps, camera=st.one_of(st.none(), stamps), rows=st.lists(words, max_size=8))
def test_oxts_folders_of_anything(tmp_path_factory, own, camera, rows):
    folder = tmp_path_factory.mktemp("oxts")
    (folder / "data").mkdir()
    course_file(folder / "a.npz")
    sequence = load_course_npz(folder / "a.npz")
    for k, row in enumerate(rows):
        (folder / "data" / f"{k}.txt").write_text(" ".join([row] * 30))
    (folder / "timestamps.txt").write_text("\n".join(own))
    (folder / "camera.txt").write_text("\n".join(camera or []))
    try:
        read_in = with_oxts(
            sequence, folder, camera_timestamps=None if camera is None else folder / "camera.txt"
        )
    except DataError as error:
        assert_one_line(error, folder / "data")
        return
    assert np.all(np.diff(read_in.inertial_stamp) > 0)
    assert np.isfinite(read_in.step_means()[0]).all()


def claim():
    return repacked(GOOD[False], replaced={"features.npy": member((4, 10**6, 10**6), data=bytes(64))})


AT_THE_COMMAND_LINE = {
    "cut short": (GOOD[True][:900], "", "not a whole npz archive"),
    "a huge claim": (claim(), "", "bytes long as its shape"),
    "no archive": (b"frame x y", "", "not a whole npz archive"),
    "a member of text": (repacked(GOOD[False], replaced={"b.npy": b"0.5"}), "", "'b' must be a numpy array"),
    "a bad reference": (
        GOOD[False],
        ", reference: {file: small.npz, format: kitti, name: r, limits: l}",
        "small.npz: must be a text file of numbers, got a binary one",
    ),
    "a bad folder": (
        GOOD[False],
        ", inertial: {format: oxts, folder: .}",
        "must have 2 to 1000000 files data/*.txt",
    ),
}


@pytest.mark.parametrize("case", sorted(AT_THE_COMMAND_LINE))
def test_the_command_says_one_line_and_gives_2(case, tmp_path, capsys, monkeypatch):
    content, section, message = AT_THE_COMMAND_LINE[case]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    (tmp_path / "small.npz").write_bytes(content)
    config = config_file(tmp_path / "c.yaml", f"name: s\ndata: {{file: small.npz{section}}}\n")
    assert main(["--config", config, "--data-dir", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("vislam: ")
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "results").exists()
