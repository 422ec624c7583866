"""Whatever becomes of a results folder, evaluate scores it or says in one line what is wrong with it."""

import io
import json
import math
import os
import shutil
import subprocess
import sys
import tracemalloc
import zipfile
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.records import altered, on_frames
from vislam import compare, evaluate
from vislam.base.errors import DataError
from vislam.base.npy import PackedArray
from vislam.core import archive, record, run
from vislam.core.archive import read_archive
from vislam.core.record import Record
from vislam.core.run import Run, StateHistory
from vislam.core.schema import Each, Numbers, Plain, real, whole
from vislam.core.step import TWIST_BIAS

CONFIG = """\
name: small
data: {simulation: {frames: 12, tracks_in_view: 14, gyro_bias: [0.004, -0.003, 0.005]}}
noise: {pixel_sigma_px: 0.5}
estimators: {dead_reckoning: {}, ekf: {}, isam2: {marginals: all}}
common_set_from: [ekf]
held_out: {share: 0.2}
lags: [0, 3]
ablation_chain: {ekf: the camera, isam2: smoothing}
checks: [{metric: ate_rmse, estimator: ekf, at_most: 5.0}]
"""
ARCHIVES = ("record.npz", "runs/dead_reckoning.npz", "runs/ekf.npz", "runs/isam2.npz")
TABLES = {name: record._TABLE if name == "record.npz" else run._TABLE for name in ARCHIVES}
LONGEST_LINE = 1000
fuzz = settings(
    derandomize=True,
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Results of a short comparison, which nobody may change."""
    out = tmp_path_factory.mktemp("made")
    (out / "small.yaml").write_text(CONFIG, encoding="utf-8")
    arguments = ["--config", str(out / "small.yaml"), "--out", str(out / "results"), "--no-report"]
    assert compare.main(arguments) == 0
    (folder,) = (out / "results").iterdir()
    return folder


@pytest.fixture
def copy(made, tmp_path):
    """Function that gives a fresh copy of them."""

    def give():
        shutil.rmtree(tmp_path / "results", ignore_errors=True)
        return Path(shutil.copytree(made, tmp_path / "results"))

    return give


def score(folder, capsys, *more, report=False):
    """Evaluate: finite metrics and 0, 1 or 3, or one line of bounded length and 2. Returns that line."""
    code = evaluate.main([str(folder), *([] if report else ["--no-report"]), *map(str, more)])
    said = capsys.readouterr().err
    if code == 2:
        assert said.startswith("vislam: ")
        assert said.count("\n") == 1
        assert said.rstrip("\n").isprintable()
        assert len(said) < LONGEST_LINE
        return said
    assert code in (0, 1, 3)
    assert said == ""
    document = json.loads((folder / "metrics.json").read_text(encoding="utf-8"), parse_constant=refused)
    assert all(math.isfinite(metric["value"]) for metric in document["metrics"])
    return ""


def refused(constant):
    raise AssertionError(f"{constant} in metrics.json")


# Edits of the members of an archive ------------------------------------------------------------------------


def members(path):
    with zipfile.ZipFile(path) as packed:
        return [(name, packed.read(name)) for name in packed.namelist()]


def pack(path, parts, *, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as packed:
        for name, content in parts:
            packed.writestr(name, content)


def npy(values):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asanyarray(values), allow_pickle=True)
    return buffer.getvalue()


def edit_array(path, name, change):
    """Replace an array by what ``change`` makes of it; None leaves it out."""
    parts = dict(members(path))
    values = change(np.load(io.BytesIO(parts.pop(f"{name}.npy"))))
    new = [] if values is None else [(f"{name}.npy", npy(values))]
    pack(path, [*parts.items(), *new])


def edit_plain(path, change):
    """Replace the plain data by what ``change`` makes of its text."""
    edit_array(path, "plain", lambda text: np.array(change(str(text))))


TYPES = (
    "object",
    "U5",
    "S3",
    "complex128",
    "int64",
    "int8",
    "uint64",
    "float16",
    "float32",
    ">f8",
    "bool",
    "M8[s]",
)
SHAPES = {
    "transposed": lambda a: a.T,
    "one less": lambda a: a[:-1] if a.ndim else a,
    "one more": lambda a: np.concatenate([a, a[-1:]]) if a.ndim else a[None],
    "none": lambda a: a[:0] if a.ndim else a.reshape(1)[:0],
    "a number": lambda a: a.reshape(-1)[0] if a.size else np.float64(0.0),
    "flat": lambda a: a.reshape(-1),
    "deeper": lambda a: a[..., None],
    "narrower": lambda a: a[..., :-1] if a.ndim else a,
    "backwards": lambda a: a[::-1] if a.ndim else a,
    "twice": lambda a: np.concatenate([a, a]) if a.ndim else a,
}
NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e9, -1e9, 1e29, -1e29, 1e31, 1e300, -1e300, 5e-324, 2.0**62)


def typed(array, dtype):
    """The array as another type; zeros where its values have no place in that."""
    if dtype == "M8[s]" or array.dtype.kind == "U":
        return np.zeros(array.shape, dtype)
    with np.errstate(all="ignore"):
        return array.astype(dtype)


def with_number(array, place, number):
    """The array with a number somewhere, or everywhere."""
    array = array.copy()
    if array.dtype.kind == "i":
        number = int(np.clip(np.nan_to_num(number), -(2.0**62), 2.0**62))
    if array.size:
        array.reshape(-1)[slice(None) if place is None else int(place * array.size)] = number
    return array


places = st.none() | st.floats(0.0, 1.0, exclude_max=True)
array_changes = st.one_of(
    st.just(lambda a: None),
    st.sampled_from(TYPES).map(lambda dtype: lambda a: typed(a, dtype)),
    st.sampled_from(sorted(SHAPES)).map(lambda name: SHAPES[name]),
    st.tuples(places, st.sampled_from(NUMBERS)).map(lambda to: lambda a: with_number(a, *to)),
)


def one_of(data, path):
    """Name of one of an archive's arrays."""
    return data.draw(st.sampled_from([name.removesuffix(".npy") for name, _ in members(path)]))


@settings(fuzz, max_examples=20)
@given(data=st.data(), name=st.sampled_from(ARCHIVES), change=array_changes)
def test_an_array_that_is_another(data, name, change, copy, capsys):
    folder = copy()
    edit_array(folder / name, one_of(data, folder / name), change)
    score(folder, capsys)


@pytest.mark.slow
@settings(fuzz, max_examples=400)
@given(data=st.data(), name=st.sampled_from(ARCHIVES), change=array_changes)
def test_arrays_that_are_others_at_length(data, name, change, copy, capsys):
    folder = copy()
    edit_array(folder / name, one_of(data, folder / name), change)
    score(folder, capsys)


@pytest.mark.slow
@settings(fuzz, max_examples=25)
@given(data=st.data(), name=st.sampled_from(ARCHIVES), change=array_changes)
def test_figures_and_page_of_arrays_that_are_others(data, name, change, copy, capsys):
    folder = copy()
    edit_array(folder / name, one_of(data, folder / name), change)
    score(folder, capsys, report=True)


# Plain data ------------------------------------------------------------------------------------------------

ODD = (
    None,
    True,
    0,
    -1,
    1.5,
    1e300,
    10**400,
    math.nan,
    math.inf,
    "",
    "x",
    "a\nb\x1b[31m",
    "\ud800",
    "y" * 5000,
    [],
    {},
    [[[]]],
    {"array": "stamp"},
    {"a": {"b": {}}},
    [1, "2", None],
)


def paths(tree, at=()):
    """Path of each value of a tree of plain data, below its root."""
    inside = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inside:
        yield (*at, key)
        yield from paths(value, (*at, key))


def edited(data, tree):
    """Put something odd somewhere into a tree of plain data, take something out, or add something."""
    *parents, last = data.draw(st.sampled_from(list(paths(tree))))
    inside = tree
    for key in parents:
        inside = inside[key]
    how = data.draw(st.sampled_from(["put", "put", "take", "add"]))
    if how == "put":
        inside[last] = data.draw(st.sampled_from(ODD))
    elif how == "take":
        del inside[last]
    elif isinstance(inside, dict):
        inside[data.draw(st.sampled_from(["x", "", "given", "run\n", "array"]))] = data.draw(
            st.sampled_from(ODD)
        )
    else:
        inside.append(data.draw(st.sampled_from(ODD)))
    return tree


@settings(fuzz, max_examples=20)
@given(data=st.data(), name=st.sampled_from(ARCHIVES))
def test_plain_data_that_are_others(data, name, copy, capsys):
    folder = copy()
    edit_plain(folder / name, lambda text: json.dumps(edited(data, json.loads(text))))
    score(folder, capsys)


@pytest.mark.slow
@settings(fuzz, max_examples=400)
@given(data=st.data(), name=st.sampled_from(ARCHIVES))
def test_plain_data_that_are_others_at_length(data, name, copy, capsys):
    folder = copy()
    edit_plain(folder / name, lambda text: json.dumps(edited(data, json.loads(text))))
    score(folder, capsys)


@pytest.mark.slow
@fuzz
@given(data=st.data())
def test_metrics_to_be_held_against_that_are_others(data, made, tmp_path, capsys):
    tree = edited(data, json.loads((made / "metrics.json").read_text(encoding="utf-8")))
    (tmp_path / "old.json").write_text(json.dumps(tree), encoding="utf-8")
    code = evaluate.main(
        [str(made), "--no-report", "--against", str(tmp_path / "old.json"), "--out", str(tmp_path)]
    )
    said = capsys.readouterr()
    assert code in (0, 2, 3)
    assert said.err.count("\n") == (code == 2)
    assert len(said.err) < LONGEST_LINE
    assert max(map(len, said.out.splitlines()), default=0) < LONGEST_LINE


TEXTS = {
    "nothing": lambda text: "",
    "no JSON": lambda text: "hello",
    "half of it": lambda text: text[: len(text) // 2],
    "a list": lambda text: "[1, 2]",
    "null": lambda text: "null",
    "twice a key": lambda text: '{"name": "other", ' + text[1:],
    "nested deeply": lambda text: '{"name": ' + "[" * 90_000 + "]" * 90_000 + "}",
    "nested": lambda text: '{"name": ' + "[" * 200 + "]" * 200 + "}",
    "many digits": lambda text: text.replace("12", "1" * 6000, 1),
}


@pytest.mark.parametrize("case", sorted(TEXTS))
@pytest.mark.parametrize("name", ["record.npz", "runs/ekf.npz"])
def test_plain_data_that_are_no_fields(case, name, copy, capsys):
    folder = copy()
    edit_plain(folder / name, TEXTS[case])
    assert f"{name}: expected" in score(folder, capsys)


# Files -----------------------------------------------------------------------------------------------------

FILES = (*ARCHIVES, "config.yaml")
CONTENTS = {
    "nothing": lambda old: b"",
    "text": lambda old: b"hello\n",
    "binary": lambda old: bytes(range(256)) * 40,
    "zeros": lambda old: bytes(5000),
    "an empty archive": lambda old: b"PK\x05\x06" + bytes(18),
    "more behind it": lambda old: old + bytes(100),
    "twice": lambda old: old + old,
    "NUL in front": lambda old: b"\0" + old,
}


@fuzz
@given(name=st.sampled_from(FILES), share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_short(name, share, copy, capsys):
    folder = copy()
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(share * len(content))])
    said = score(folder, capsys)
    assert said or name == "config.yaml"


@fuzz
@given(
    name=st.sampled_from(ARCHIVES),
    flips=st.lists(
        st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4
    ),
)
def test_a_file_with_flipped_bits(name, flips, copy, capsys):
    folder = copy()
    content = bytearray((folder / name).read_bytes())
    for place, bits in flips:
        content[int(place * len(content))] ^= bits
    (folder / name).write_bytes(content)
    score(folder, capsys)


@pytest.mark.parametrize("case", sorted(CONTENTS))
@pytest.mark.parametrize("name", FILES)
def test_a_file_with_other_content(case, name, copy, capsys):
    folder = copy()
    (folder / name).write_bytes(CONTENTS[case]((folder / name).read_bytes()))
    score(folder, capsys)


@pytest.mark.parametrize("kind", ["no file", "pipe", "folder", "link to nowhere", "link to a device"])
@pytest.mark.parametrize("name", [*FILES, "metrics.json"])
def test_what_is_no_regular_file_is_refused_and_not_waited_for(kind, name, copy, capsys):
    folder = copy()
    (folder / name).unlink()
    match kind:
        case "pipe":
            os.mkfifo(folder / name)
        case "folder":
            (folder / name).mkdir()
        case "link to nowhere":
            (folder / name).symlink_to("nowhere")
        case "link to a device":
            (folder / name).symlink_to("/dev/zero")
        case "no file" if name.startswith("runs/"):
            pytest.skip("a run that is not there has not begun, as a killed comparison leaves it")
    assert score(folder, capsys, "--against", folder / "metrics.json", "--out", folder / "new")


@pytest.mark.parametrize("one", ["runs/ekf.npz", "runs/isam2.npz", "record.npz"])
@pytest.mark.parametrize("other", ["runs/dead_reckoning.npz", "runs/isam2.npz", "record.npz"])
def test_files_in_each_others_place(one, other, copy, capsys):
    folder = copy()
    first, second = (folder / one).read_bytes(), (folder / other).read_bytes()
    (folder / one).write_bytes(second)
    (folder / other).write_bytes(first)
    assert bool(score(folder, capsys)) == (one != other)


def changed_run(folder, of="ekf", **changes):
    """Write a run with other values, as if it had been saved so."""
    path = folder / "runs" / f"{of}.npz"
    altered(Run.load(path), **changes).save(path)


FOREIGN = {
    "another run": ({"name": "isam2"}, "got the run 'isam2'"),
    "of another drive": ({"frames_expected": 13}, "frames up to 11 of 13 for 12"),
    "other observations": ({"used": np.zeros(5, bool), "gated": np.zeros(5, bool)}, "5 observations for "),
    "other stamps": ({"stamp": np.arange(12.0)}, "got other stamps"),
    "frames beyond": ({"frame": np.arange(12) + 5}, "frames up to 16"),
}


@pytest.mark.parametrize("case", sorted(FOREIGN))
def test_a_sound_run_of_something_else_is_refused(case, copy, capsys):
    folder = copy()
    changes, message = FOREIGN[case]
    changed_run(folder, **changes)
    said = score(folder, capsys)
    assert message in said
    assert "runs/ekf.npz: expected a run of the drive in the record" in said
    assert "run the comparison again" in said


def test_a_complete_run_has_all_frames(copy, capsys):
    folder = copy()
    path = folder / "runs" / "ekf.npz"
    on_frames(Run.load(path), slice(7)).save(path)
    assert "a complete run with 7 of 12 frames" in score(folder, capsys)
    changed_run(folder, error="frame 7: lost")
    assert score(folder, capsys) == ""


# Claims ----------------------------------------------------------------------------------------------------


def header(shape, descr="<f8"):
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\0" + len(text).to_bytes(2, "little") + text


BOMBS = {
    "more than there is": header("(1000000000000,)"),
    "more than a number can say": header("(" + "9" * 5000 + ",)"),
    "many axes": header("(" + "1, " * 60 + ")"),
    "negative": header("(-4,)"),
    "no shape": header("'all'"),
    "objects": npy(np.array([{}], object)),
    "a header that never ends": b"\x93NUMPY\x02\0\xff\xff\xff\x7f{",
    "no array": b"hello",
    # A few hundred kB that unpack to 60 MB, twice of what may be taken, and keep every promise but that of
    # their shape.
    "zeros without end": header("(7500000,)") + bytes(60_000_000),
    "a text without end": header("()", "<U15000000") + bytes(60_000_000),
}


@pytest.mark.parametrize("case", sorted(BOMBS))
@pytest.mark.parametrize(
    ("name", "field"), [("record.npz", "stamp"), ("runs/ekf.npz", "used"), ("runs/ekf.npz", "plain")]
)
def test_no_memory_is_taken_for_what_an_array_claims(case, name, field, copy, capsys):
    folder = copy()
    parts = [(m, BOMBS[case] if m == f"{field}.npy" else content) for m, content in members(folder / name)]
    pack(folder / name, parts)
    tracemalloc.start()
    try:
        assert f"'{field}'" in score(folder, capsys) or field == "plain"
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()


def test_more_bytes_than_any_results_have_are_refused_before_they_are_read(copy, capsys, monkeypatch):
    folder, read = copy(), []
    chunks = PackedArray.chunks
    monkeypatch.setattr(archive, "_MOST_BYTES", 5_000)
    monkeypatch.setattr(PackedArray, "chunks", lambda self: read.append(self.size) or chunks(self))
    assert "bytes of arrays, of which 5e+03 are the most" in score(folder, capsys)
    # The text of the plain data, and nothing else.
    assert read == [1]


def test_two_members_of_one_name_are_refused(copy, capsys):
    folder = copy()
    parts = members(folder / "runs" / "ekf.npz")
    with pytest.warns(UserWarning, match="Duplicate name"):
        pack(folder / "runs" / "ekf.npz", [*parts, parts[0]])
    assert "two members of one name" in score(folder, capsys)


# The tables ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARCHIVES)
def test_each_field_is_asked_for_and_no_other_is_taken(name, made, copy, capsys):
    there = {member.removesuffix(".npy") for member, _ in members(made / name)}
    table = dict(archive._expanded(TABLES[name], {"states": {TWIST_BIAS: {}}}))
    fields_of = {field for field, kind in table.items() if isinstance(kind, Numbers)}
    assert there - {"plain"} <= fields_of
    assert all(
        table[field].optional or getattr(table.get(field.rpartition(".")[0]), "optional", False)
        for field in fields_of - there
    )
    for field in sorted(there - {"plain"}):
        folder = copy()
        edit_array(folder / name, field, lambda a: None)
        assert f"{name}: expected" in score(folder, capsys)
    folder = copy()
    pack(folder / name, [*members(folder / name), ("another.npy", npy(np.zeros(3)))])
    assert "an unknown field 'another'" in score(folder, capsys)


def test_the_tables_have_the_fields_of_their_classes():
    assert {item.name for item in fields(Run)} == {name.partition(".")[0] for name in run._TABLE}
    for part, kind in run._PARTS.items():
        own = {name.partition(".")[2] for name in run._TABLE if name.startswith(f"{part}.")}
        assert {item.name for item in fields(kind)} == own
    assert {item.name for item in fields(StateHistory)} == set(run._TABLE["states"].fields)
    assert {item.name for item in fields(Record)} == {name.partition(".")[0] for name in record._TABLE}


def test_what_a_table_says_is_what_comes_out(tmp_path):
    table = {"a": real("n 2"), "b": whole("n", below="n"), "c": Plain(tuple[str, ...])}
    table |= {"d": real("n", later=True), "e": Plain(str, later=True)}
    path = tmp_path / "x.npz"
    parts = {"a": np.ones((3, 2), np.float32), "b": np.array([0, 2, 1], np.int8)}
    pack(
        path,
        [(f"{k}.npy", npy(v)) for k, v in parts.items()] + [("plain.npy", npy(np.array('{"c": ["d"]}')))],
    )
    found = read_archive(path, table, what="it")
    assert found["a"].dtype == np.float64
    assert found["b"].dtype == np.int64
    assert found["b"].tolist() == [0, 2, 1]
    assert found["c"] == ("d",)
    # What older versions did not write is left to the defaults of the class.
    assert found.keys() == {"a", "b", "c"}
    edit_array(path, "b", lambda b: b + 1)
    with pytest.raises(
        DataError, match=r"x.npz: expected it, got 'b', which must be below 3, the length of 'a'"
    ):
        read_archive(path, table, what="it")
    edit_array(path, "b", lambda b: b[:2])
    with pytest.raises(DataError, match=r"of shape \(n\) with n = 3 as in 'a', of shape \(2,\)"):
        read_archive(path, table, what="it")


def archive_of(path, arrays, plain):
    pack(path, [(f"{k}.npy", npy(v)) for k, v in {**arrays, "plain": np.array(json.dumps(plain))}.items()])


def test_sections_are_named_by_who_writes_them_and_each_has_a_size_of_its_own(tmp_path):
    table = {"t": real("T"), "s": Each({"a": real("T *"), "b": real("T *", gaps=True)})}
    path = tmp_path / "x.npz"
    arrays = {"t": np.zeros(3)}
    for name, size in {"one": 1, "T": 2}.items():
        arrays |= {f"s.{name}.a": np.full((3, size), float(size)), f"s.{name}.b": np.full((3, size), np.nan)}
    sound = {"s": {"one": {}, "T": {}}}
    archive_of(path, arrays, sound)
    found = read_archive(path, table, what="it")
    assert {name: part["a"].shape for name, part in found["s"].items()} == {"one": (3, 1), "T": (3, 2)}
    archive_of(path, {"t": np.zeros(3)}, {"s": {}})
    assert read_archive(path, table, what="it")["s"] == {}
    wrong = {
        "got no 's'": ({"t": np.zeros(3)}, {}),
        "an unknown field 's.one.a'": (arrays, {"s": {}}),
        "no 's.two.a'": (arrays, {"s": {"one": {}, "T": {}, "two": {}}}),
        "'s' with the name 'o.ne'": (arrays, {"s": {"o.ne": {}}}),
        "'s' with the name ''": (arrays, {"s": {"": {}}}),
        "'s', which must be a mapping, as list": ({"t": np.zeros(3)}, {"s": []}),
        "'s', which must be a mapping, as null": ({"t": np.zeros(3)}, {"s": None}),
        "'s.one', which must be a mapping, as int": (arrays, {"s": {"one": 3, "T": {}}}),
        "an unknown field 's.one.c'": (arrays, {"s": {"one": {"c": 1}, "T": {}}}),
        "'s.one.b', which must be of shape": (
            arrays | {"s.one.b": np.zeros((3, 2))},
            {"s": {"one": {}, "T": {}}},
        ),
    }
    for message, (given_arrays, plain) in wrong.items():
        archive_of(path, given_arrays, plain)
        with pytest.raises(DataError) as refused_one:
            read_archive(path, table, what="it")
        assert message in str(refused_one.value)


def test_a_run_of_the_earlier_form_is_refused_in_one_line(copy, capsys):
    folder = copy()
    edit_plain(folder / "runs/ekf.npz", lambda text: json.dumps({"error": "", **json.loads(text)}))
    said = score(folder, capsys)
    assert "expected a run as this version of vislam saves it, got an unknown field 'error'" in said
    assert "run the comparison again" in said


# The real command ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("edit", ["sound", "objects", "pipe", "half", "swapped"])
def test_the_command_itself_answers_alike(edit, copy):
    folder = copy()
    path = folder / "runs" / "ekf.npz"
    match edit:
        case "objects":
            edit_array(path, "stamp", lambda a: a.astype(object))
        case "pipe":
            path.unlink()
            os.mkfifo(path)
        case "half":
            path.write_bytes(path.read_bytes()[:500])
        case "swapped":
            shutil.copy(folder / "runs" / "isam2.npz", path)
    command = [sys.executable, "-m", "vislam.evaluate", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == (0 if edit == "sound" else 2)
    assert done.stderr.count("\n") == (edit != "sound")
    assert "Traceback" not in done.stderr
