"""What the file system refuses a command: one line and exit code 2, nothing half-written or replaced."""

import os
import random
import shutil
from pathlib import Path

import pytest

from tests.limits import limited
from vislam import calibrate, compare, evaluate, inspect, simulate
from vislam.cli import table
from vislam.comparison import compare as comparison

TINY = str(Path(__file__).parents[2] / "configs" / "tiny.yaml")
QUICK = ("--config", TINY, "--set", "data.simulation.frames=12")
ALONE = (*QUICK, "--estimators", "dead_reckoning")


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A results folder to be evaluated."""
    folder = tmp_path_factory.mktemp("results")
    assert compare.main([*ALONE, "--no-report", "--out", str(folder)]) == 0
    return next(folder.iterdir())


# Every way in which a command is told where to write, by what is to be written there.
PLACES = {
    "compare --out": lambda place, _: (compare.main, [*ALONE, "--no-report", "--out", place]),
    "compare --junit": lambda place, _: (compare.main, [*ALONE, "--no-report", "--junit", place]),
    "evaluate --out": lambda place, results: (evaluate.main, [str(results), "--no-report", "--out", place]),
    "evaluate --junit": lambda place, results: (
        evaluate.main,
        [str(results), "--no-report", "--junit", place],
    ),
    "simulate --out": lambda place, _: (simulate.main, [*QUICK, "--out", place]),
    "inspect --out": lambda place, _: (inspect.main, [*QUICK, "--out", place]),
    "inspect --write-config": lambda place, _: (inspect.main, [*QUICK, "--write-config", place]),
    "calibrate --out": lambda place, _: (calibrate.main, [*QUICK, "--out", place]),
}
FILES = [name for name in PLACES if name not in ("compare --out", "evaluate --out", "inspect --out")]


def complaint(capsys):
    said = capsys.readouterr().err
    assert said.startswith("vislam: ")
    assert said.count("\n") == 1
    return said


def everything():
    """What is there, and which file it is."""
    return {path: path.lstat().st_ino for path in Path.cwd().rglob("*")}


@pytest.mark.parametrize("place", ["file/a.npz", "n" * 300 + "/a.npz", "new/" + "n" * 300, "/proc/nowhere/a"])
@pytest.mark.parametrize("name", sorted(PLACES))
def test_a_place_that_cannot_be_is_refused_before_the_work(name, place, results, capsys, monkeypatch):
    monkeypatch.setattr(comparison, "run_comparison", None)
    Path("file").write_text("kept")
    before = everything()
    main, arguments = PLACES[name](place, results)
    assert main(arguments) == 2
    assert "cannot be written (" in complaint(capsys)
    assert everything() == before


def a_link(path):
    path.with_name("target").write_text("kept")
    path.symlink_to("target")


@pytest.mark.parametrize("make", [Path.mkdir, a_link, os.mkfifo], ids=["folder", "link", "pipe"])
@pytest.mark.parametrize("name", FILES)
def test_what_is_no_regular_file_is_not_replaced(name, make, results, capsys):
    make(Path("place.npz"))
    before = everything()
    main, arguments = PLACES[name]("place.npz", results)
    assert main(arguments) == 2
    assert "and is left alone" in complaint(capsys)
    assert everything() == before


@pytest.mark.parametrize("name", FILES)
def test_a_device_is_not_replaced(name, results, capsys):
    main, arguments = PLACES[name]("/dev/full", results)
    assert main(arguments) == 2
    # The truth of a simulated drive would lie beside it.
    assert "full" in complaint(capsys)
    assert Path("/dev/full").is_char_device()
    assert not Path("/dev/full_truth.tum").exists()


COMMANDS = {
    "compare": lambda _: (compare.main, [*ALONE, "--junit", "out/j.xml", "--out", "out"]),
    "evaluate": lambda results: (evaluate.main, [str(results), "--junit", "out/j.xml", "--out", "out"]),
    "simulate": lambda _: (simulate.main, [*QUICK, "--out", "out/a.npz"]),
    "inspect": lambda _: (inspect.main, [*QUICK, "--out", "out", "--write-config", "out/c.yaml"]),
}


SIZES = [0, 2000, 6000, 20_000, pytest.param(100_000, marks=pytest.mark.slow)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_disk_that_fills_up_at_any_moment_is_one_line_and_2(name, size, results, capsys):
    main, arguments = COMMANDS[name](results)
    with limited(size + random.Random(name).randrange(1000)):
        code = main(arguments)
    if code == 0:
        assert capsys.readouterr().err == ""
    else:
        assert code == 2
        assert "cannot be written (File too large); make room" in complaint(capsys)
    written = [path for path in Path("out").rglob("*") if path.is_file()]
    assert not [path for path in written if path.name.startswith(".")]
    assert name != "simulate" or len(written) == (2 if code == 0 else 0)


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_what_a_killed_process_left_goes_with_the_next_start(name, results):
    left = ".vislam-0123456789abcdef.tmp"
    main, arguments = COMMANDS[name](results)
    arguments += ["--no-report"] if name in ("compare", "evaluate") else []
    assert main(arguments) == 0
    folders = [Path("out"), *(path for path in Path("out").rglob("*") if path.is_dir())]
    folders += [path.parent / "figures" for path in Path("out").rglob("metrics.json")]
    for folder in folders:
        folder.mkdir(exist_ok=True)
        (folder / left).write_text("half")
    assert main(arguments) == 0
    assert not list(Path("out").rglob(left))


@pytest.mark.parametrize("others", [["mine.png"], []])
def test_no_page_of_earlier_results_stands_beside_newer_metrics(others, results, capsys):
    folder = Path(shutil.copytree(results, "out"))
    figures = folder / "figures"
    figures.mkdir()
    old = ["top_view.png", "top_view.svg"]
    for path in (folder / "report.html", *(figures / name for name in (*old, *others))):
        path.write_text("old")
    assert evaluate.main([str(folder), "--no-report"]) == 0
    assert not (folder / "report.html").exists()
    assert [path.name for path in figures.glob("*")] == others
    (folder / "report.html").mkdir()
    capsys.readouterr()
    assert evaluate.main([str(folder), "--no-report"]) == 2
    assert "report.html: cannot be written (it is a folder" in complaint(capsys)


UNREADABLE = {
    "a folder": (lambda path: path.mkdir(), "it is a folder, not a file"),
    "a pipe": (os.mkfifo, "it is a pipe, not a file"),
    "a device": (lambda path: path.symlink_to("/dev/zero"), "it is a device, not a file"),
    "a loop": (lambda path: path.symlink_to(path.name), "Too many levels of symbolic links"),
    "not UTF-8": (lambda path: path.write_bytes(b"name: \xff"), "can't decode byte 0xff"),
    "huge": (
        lambda path: os.truncate(os.open(path, os.O_CREAT | os.O_WRONLY), 10**11),
        "at most 262144 bytes",
    ),
    "NUL": (lambda path: path.write_bytes(b"\0" * 1000), "unacceptable character #x0000"),
}


@pytest.mark.parametrize("main", [compare.main, simulate.main, inspect.main, calibrate.main])
@pytest.mark.parametrize("case", sorted(UNREADABLE))
def test_a_config_that_cannot_be_read_is_one_line_and_2(main, case, capsys):
    make, why = UNREADABLE[case]
    make(Path("c.yaml"))
    assert main(["--config", "c.yaml", "--out", "out"]) == 2
    assert why in complaint(capsys)
    assert not Path("out").exists()


@pytest.mark.parametrize("name", ["nowhere", "folder", "pipe", "text", "deep", "bytes"])
def test_metrics_that_are_none_are_one_line_and_2(name, capsys):
    Path("folder").mkdir()
    os.mkfifo("pipe")
    Path("text").write_text('{"metrics": 3}')
    Path("deep").write_text("[" * 100_000)
    Path("bytes").write_bytes(b"\xff")
    assert table.main([name]) == 2
    complaint(capsys)
    assert compare.main([*ALONE, "--against", name]) == 2
    complaint(capsys)


def raising(error):
    def fail(*_, **__):
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied", "there/a.npz"), "there/a.npz: Permission denied"),
        (OSError("a line\nand another"), "a line"),
        (UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed"), "surrogates not allowed"),
        (MemoryError(), "not enough memory"),
        (TimeoutError(), "TimeoutError"),
    ],
)
def test_what_nobody_foresaw_of_a_system_is_one_line_and_2(error, message, capsys, monkeypatch):
    monkeypatch.setattr(comparison, "open_dataset", raising(error))
    assert compare.main([*ALONE, "--out", "out"]) == 2
    assert message in complaint(capsys)


@pytest.mark.parametrize("main", [compare.main, simulate.main, inspect.main, calibrate.main])
@pytest.mark.parametrize(
    "given",
    [
        ["--set", "=1"],
        ["--set", "noise..pixel_sigma_px=1"],
        ["--set", "noise"],
        ["--set", "seed.x=1"],
        ["--set", "seed=[1"],
        ["--set", "seed=" + "9" * 5000],
        ["--set", 'name="a\\0b"'],
        ["--set", "noise.pixel_sigma_px=.inf"],
        ["--set", "a" * 10**5 + "=1"],
        ["--set", "a." * 10**4 + "a=1"],
        ["--set", "checks.0.at_most=1"],
        ["--set", "name=[&a a, *a, *a]"],
        ["--set", "name=\x1b[31m\n: a"],
    ],
)
def test_a_bad_override_is_one_bounded_line_and_2(main, given, capsys):
    assert main(["--config", TINY, "--out", "out", *given]) == 2
    said = complaint(capsys)
    assert len(said) < 1100
    assert said.removesuffix("\n").isprintable()


@pytest.mark.parametrize("main", [compare.main, simulate.main, inspect.main, calibrate.main, table.main])
@pytest.mark.parametrize("given", [["--seed", "9" * 5000], ["--no\x1b[31m"], ["a", "b" * 10**5]])
def test_a_bad_option_is_one_bounded_line_and_2(main, given, capsys):
    with pytest.raises(SystemExit, match="2"):
        main([*given, "--config", TINY])
    assert len(complaint(capsys)) < 1100
