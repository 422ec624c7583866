"""What a result rests on: whatever of it changes, the hash does."""

import contextlib
import os
import shutil
import sys
import time
from importlib import metadata
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from vislam.comparison import identity
from vislam.comparison.compare import identify, result_id
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.identity import code_digest, inputs_digest
from vislam.comparison.open import Dataset
from vislam.datasets.find import search_path
from vislam.simulation import SimulationConfig

SOURCE = "def build(problem, options):\n    return {speed}\n"


@pytest.fixture(autouse=True)
def computed_anew():
    code_digest.cache_clear()
    yield
    code_digest.cache_clear()


def digest():
    code_digest.cache_clear()
    return code_digest()


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Give a function that installs an estimator: its entry point, and files by name."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(value, files, **more):
        info = tmp_path / "mine-1.dist-info"
        info.mkdir()
        entries = f"[vislam.estimators]\nmine = {value}\n"
        texts = {"METADATA": "Name: mine\nVersion: 1\n", "entry_points.txt": entries, **more}
        for folder, found in ((info, texts), (tmp_path, files)):
            for name, text in found.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text, encoding="utf-8")
        return tmp_path

    return install


PLUGINS = {
    "package": ("my_package:build", "my_package/__init__.py", ()),
    "module of a package": (
        "my_package.inner.solver:build",
        "my_package/inner/solver.py",
        ("inner/__init__.py",),
    ),
    "neighbour in a package": ("my_package.solver:build", "my_package/deep/helper.py", ("solver.py",)),
    "data of a package": ("my_package:build", "my_package/weights.bin", ("__init__.py",)),
    "compiled": ("my_package:build", "my_package/core.so", ("__init__.py",)),
    "one module": ("mine:build", "mine.py", ()),
    "attribute of one": ("mine:Family.build", "mine.py", ()),
    "extras": ("mine:build [fast]", "mine.py", ()),
    "namespace": ("my_company.mine:build", "my_company/mine.py", ()),
    "neighbour in a namespace": ("my_company.mine:build", "my_company/shared/helper.py", ()),
}


@pytest.mark.parametrize("case", PLUGINS)
def test_a_changed_estimator_has_another_hash(case, installed):
    value, changed, others = PLUGINS[case]
    files = {changed: "1", **{f"my_package/{name}": "" for name in others}}
    if changed.startswith("my_package"):
        files.setdefault("my_package/__init__.py", "")
    folder = installed(value, files)
    first = digest()
    assert digest() == first
    (folder / changed).write_text("2", encoding="utf-8")
    assert digest() != first


def test_an_estimator_that_is_installed_counts(installed):
    before = digest()
    installed("mine:build", {"mine.py": ""})
    assert digest() != before


@pytest.mark.parametrize(
    "more",
    [{"top_level.txt": "mine\nmine_core\n"}, {"RECORD": "mine.py,,\nmine_core.py,,\n../../../bin/mine,,\n"}],
)
def test_modules_that_were_installed_along_count(more, installed):
    folder = installed("mine:build", {"mine.py": "import mine_core\n", "mine_core.py": "SPEED = 1\n"}, **more)
    before = digest()
    (folder / "mine_core.py").write_text("SPEED = 2\n", encoding="utf-8")
    assert digest() != before


def test_what_an_estimator_requires_counts_by_its_version(installed, monkeypatch):
    needs = "Name: mine\nVersion: 1\nRequires-Dist: pydantic>=2\nRequires-Dist: nowhere; extra == 'x'\n"
    installed("mine:build", {"mine.py": ""}, METADATA=needs)
    before = digest()
    told = metadata.version
    monkeypatch.setattr(identity, "version", lambda name: "0" if name == "pydantic" else told(name))
    assert digest() != before


@pytest.mark.parametrize("text", ["raise RuntimeError('at import')\n", "import sys\nsys.exit(0)\n", "def ("])
@pytest.mark.parametrize("value", ["mine:build", "mine.deep.solver:build"])
def test_nothing_is_imported(text, value, installed):
    installed(value, {"mine/__init__.py": text, "mine/deep/solver.py": ""})
    assert len(digest()) == 10
    assert "mine" not in sys.modules


@pytest.mark.parametrize(
    "value", ["nowhere:build", "nowhere", ":build", "", "..", "a b", "__main__:x", "sys:exit"]
)
def test_an_entry_point_that_leads_nowhere_is_no_error(value, installed):
    installed(value, {})
    assert len(digest()) == 10


def test_a_finder_that_raises_is_no_error(installed, monkeypatch):
    class Broken:
        def find_spec(self, name, path=None, target=None):
            if name == "mine":
                raise RuntimeError("no")

    installed("mine:build", {"mine.py": ""})
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    assert len(digest()) == 10


def test_traces_of_use_do_not_count(installed):
    folder = installed("my_package:build", {"my_package/__init__.py": ""})
    before = digest()
    for name in ("__pycache__/x.cpython-311.pyc", ".mypy_cache/x.json", ".x.py.swp", "x.py~"):
        (folder / "my_package" / name).parent.mkdir(exist_ok=True)
        (folder / "my_package" / name).write_text("1", encoding="utf-8")
    assert digest() == before


def test_the_same_estimator_in_another_folder_has_the_same_hash(installed, tmp_path, monkeypatch):
    folder = installed("my_package:build", {"my_package/__init__.py": "1"})
    before = digest()
    other = tmp_path / "elsewhere"
    for name in ("my_package", "mine-1.dist-info"):
        shutil.move(folder / name, other / name)
    monkeypatch.syspath_prepend(other)
    assert digest() == before


@pytest.mark.parametrize("name", ["gtsam", "numpy", "scipy"])
def test_versions_of_what_computes_count(name, monkeypatch):
    before, told = digest(), metadata.version
    monkeypatch.setattr(identity, "version", lambda asked: "9.9" if asked == name else told(asked))
    assert digest() != before


def test_versions_of_what_is_imported_and_of_python_count(monkeypatch):
    found = {digest()}
    for package in (np, scipy):
        with monkeypatch.context() as patch:
            patch.setattr(package, "__version__", "9.9")
            found.add(digest())
    monkeypatch.setattr(identity, "python_version_tuple", lambda: ("3", "99", "0"))
    assert len(found | {digest()}) == 4


def tree(**sections):
    """Config as plain data, with all the ways in which ours names what it reads."""
    return {"name": "x", "data": {}, "estimators": {}, **sections}


PLACES = {
    "recording": {"data": {"file": "sub/it"}},
    "reference": {"data": {"reference": {"file": "sub/it", "format": "kitti"}}},
    "path of a simulation": {"data": {"simulation": {"recorded": {"file": "sub/it"}}}},
    "camera stamps": {"data": {"inertial": {"folder": "none", "camera_timestamps": "sub/it"}}},
    "map": {"estimators": {"known_map": {"map": "sub/it"}}},
    "poses": {"estimators": {"mapping_only": {"poses": "sub/it"}}},
    "nested option": {"estimators": {"theirs": {"models": [{"parts": ("a", "sub/it")}]}}},
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    return tmp_path


@pytest.mark.parametrize("case", PLACES)
@pytest.mark.parametrize("way", ["current folder", "search folder", "absolute", "home", "variable"])
def test_the_content_of_a_file_that_a_config_names_counts(case, way, here, tmp_path_factory, monkeypatch):
    root, folders = here, []
    config = tree(**PLACES[case])
    if way == "search folder":
        root = tmp_path_factory.mktemp("data")
        (root / "sub").mkdir()
        folders = [root]
    spelled = {"absolute": f"{root}/sub/it", "home": "~/sub/it", "variable": "$ROOT/sub/it"}
    monkeypatch.setenv("HOME", str(root))
    monkeypatch.setenv("ROOT", str(root))
    config = swapped(config, "sub/it", spelled.get(way, "sub/it"))
    assert inputs_digest(config, folders) == ""
    found = set()
    for text in ("one", "two"):
        (root / "sub" / "it").write_text(text, encoding="utf-8")
        found.add(inputs_digest(config, folders))
    assert len(found | {""}) == 3
    (root / "other").write_text("three", encoding="utf-8")
    assert inputs_digest(config, folders) in found


def swapped(value, old, new):
    """Plain data with one text in place of another."""
    if isinstance(value, dict):
        return {key: swapped(item, old, new) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [swapped(item, old, new) for item in value]
    return new if value == old else value


def test_a_reference_is_found_beside_its_recording(here, tmp_path_factory):
    data = tmp_path_factory.mktemp("data")
    (data / "kitti").mkdir()
    (data / "kitti" / "03.npz").write_text("drive", encoding="utf-8")
    config = tree(data={"file": "kitti/03.npz", "reference": {"file": "poses.txt"}})
    before = inputs_digest(config, [data])
    (data / "kitti" / "poses.txt").write_text("poses", encoding="utf-8")
    assert inputs_digest(config, [data]) != before


def test_a_folder_counts_with_its_files(here):
    config = tree(data={"inertial": {"folder": "oxts"}})
    (here / "oxts" / "data").mkdir(parents=True)
    found = [inputs_digest(config, [])]
    for name, text in (
        ("data/1.txt", "a"),
        ("data/2.txt", "a"),
        ("data/2.txt", "bb"),
        ("timestamps.txt", ""),
    ):
        (here / "oxts" / name).write_text(text, encoding="utf-8")
        found.append(inputs_digest(config, []))
    (here / "oxts" / "data" / "2.txt").rename(here / "oxts" / "data" / "3.txt")
    found.append(inputs_digest(config, []))
    assert len(set(found)) == len(found)


def test_a_folder_that_bears_the_name_of_a_format_does_not_count(here):
    config = tree(data={"reference": {"file": "none", "format": "kitti"}})
    (here / "kitti").mkdir()
    (here / "kitti" / "large").write_text("x", encoding="utf-8")
    assert inputs_digest(config, []) == ""


def test_a_folder_is_bounded(here, monkeypatch):
    config = tree(estimators={"theirs": {"folder": "many"}})
    (here / "many").mkdir()
    for name in "abcd":
        (here / "many" / name).write_text(name, encoding="utf-8")
    monkeypatch.setattr(identity, "_MOST_FILES", 3)
    monkeypatch.setattr(identity, "_MOST_BYTES", 2)
    read = []
    whole = identity._read
    monkeypatch.setattr(identity, "_read", lambda path, *of: read.append(Path(path).name) or whole(path, *of))
    before = inputs_digest(config, [])
    assert read == ["a", "b"]
    # Too far down the list; too much to read, and so known by its size.
    (here / "many" / "d").write_text("changed", encoding="utf-8")
    assert inputs_digest(config, []) == before
    (here / "many" / "c").write_text("changed", encoding="utf-8")
    assert inputs_digest(config, []) != before


def test_links_that_lead_back_and_special_files_end(here):
    (here / "odd").mkdir()
    (here / "odd" / "again").symlink_to(here / "odd")
    (here / "odd" / "nowhere").symlink_to(here / "none")
    os.mkfifo(here / "odd" / "pipe")
    os.mkfifo(here / "pipe")
    config = tree(estimators={"theirs": {"folder": "odd", "file": "pipe", "null": "/dev/zero"}})
    before = inputs_digest(config, [])
    (here / "odd" / "file").write_text("x", encoding="utf-8")
    assert inputs_digest(config, []) != before


def test_a_file_that_cannot_be_read_is_no_error(here, monkeypatch):
    (here / "secret").write_text("x", encoding="utf-8")
    config = tree(estimators={"theirs": {"file": "secret"}})
    known = inputs_digest(config, [])

    def refuse(*of):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(identity, "_read", refuse)
    assert inputs_digest(config, []) not in ("", known)


def test_a_file_is_read_once_as_long_as_it_stays_the_same(here, monkeypatch):
    path = here / "it"
    path.write_text("one", encoding="utf-8")
    config = tree(estimators={"theirs": {"file": "it"}})
    monkeypatch.setattr(identity, "_YOUNG", 0)
    first = inputs_digest(config, [])
    with monkeypatch.context() as patch:
        patch.setattr(identity, "_read", None)
        assert inputs_digest(config, []) == first
    time.sleep(0.02)
    path.write_text("two", encoding="utf-8")
    assert inputs_digest(config, []) != first


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers()
    | st.text()
    | st.just("x" * 5000)
    | st.just("a\0b"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(PLAIN, PLAIN)
def test_whatever_a_config_holds_has_a_hash(data, estimators):
    small = mock.patch.multiple(identity, _MOST_FILES=5, _MOST_BYTES=10_000)
    with contextlib.chdir(Path(__file__).parent), small:
        config = tree(data=data, estimators=estimators)
        assert inputs_digest(config, [Path("nowhere")]) == inputs_digest(config, [Path("nowhere")])


def test_a_comparison_is_known_by_the_files_that_it_reads(here, short: Dataset):
    config = Config(
        name="map",
        data=DataConfig(simulation=SimulationConfig()),
        estimators={"known_map": {"map": "run.npz"}},
    )

    def named(data_dir: Path | None = None) -> str:
        return result_id(config, identify(config, short, folders=search_path(data_dir)))

    found = [named()]
    for text in ("one", "two"):
        (here / "run.npz").write_text(text, encoding="utf-8")
        found.append(named())
    (here / "run.npz").rename(here / "sub" / "run.npz")
    assert named(here / "sub") == found[-1]
    assert len(set(found)) == 3
    assert all(name.startswith("map-") for name in found)
