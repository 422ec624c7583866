"""Recordings for the Rerun viewer, read back; and what a command says where the SDK is missing."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.evaluation.test_evaluation import circle, made_run
from tests.records import altered, made_record
from vislam import compare, evaluate
from vislam.base.errors import ConfigError
from vislam.cli import command
from vislam.core.record import Tracks
from vislam.core.reference import Reference, truth_reference
from vislam.core.trajectory import Poses
from vislam.geometry import se3

ROOT = Path(__file__).parents[2]
FRAMES = 40
FLOAT32 = 1e-5
"""Tolerance at the tens of metres of the circle: float32 has a spacing of 4e-6 there."""
TITLE = "vislam short: drive"
LEVER = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 0.2, -0.5]))


@pytest.fixture
def recording():
    """The module that needs the SDK."""
    pytest.importorskip("rerun", reason="needs the extra vislam[rerun]")
    from vislam.report import recording

    return recording


class Read:
    """The columns of a recording, by entity."""

    def __init__(self, path):
        from rerun.chunk import RrdReader

        reader = RrdReader(path)
        (store,) = reader.recordings()
        self.application = store.application_id
        self.chunks = reader.stream(store=store).to_chunks()
        self.entities = {chunk.entity_path for chunk in self.chunks}

    def column(self, entity, name):
        """Rows of a column, which the chunks of the entity may share out."""
        batches = [chunk.to_record_batch() for chunk in self.chunks if chunk.entity_path == entity]
        found = [batch.column(name) for batch in batches if name in batch.schema.names]
        assert found, f"{entity} has no {name}"
        return [row for part in found for row in part.to_pylist()]

    def values(self, entity, name):
        """Rows that hold one instance each, as an array."""
        return np.array([row[0] for row in self.column(entity, name)])

    def seconds(self, entity):
        (time,) = (
            chunk.to_record_batch().column("time")
            for chunk in self.chunks
            if chunk.entity_path == entity and not chunk.is_static
        )
        return 1e-9 * time.cast("int64").to_numpy()


@pytest.fixture
def written(recording, tmp_path):
    """Write runs beside a reference and read them back."""

    def write(runs, reference, **values):
        record = made_record(reference, frames=FRAMES, **values)
        recording.write_recording(tmp_path / "out.rrd", runs, record, title=TITLE)
        assert [path.name for path in tmp_path.iterdir()] == ["out.rrd"]
        return Read(tmp_path / "out.rrd")

    return write


def bare_run(name, pose, **values):
    none = {"track": np.empty(0, np.int64), "points_world": np.empty((0, 3))}
    return made_run(name, pose, **{**none, **values})


def far_reference(pose):
    """Poses of a point off the body, in map coordinates."""
    far = se3.exp(np.array([0.0, 0.0, 1.0, 4e5, -5e6, 100.0])) @ pose @ LEVER
    return Reference("survey", "exact", np.arange(FRAMES), far[:, :3, 3], far, LEVER)


def tilted(run):
    """The same run in a world whose z axis does not point up."""
    turn = se3.exp(np.array([0.4, -0.3, 0.0, 0.0, 0.0, 0.0]))
    return replace(run, filtered=run.filtered.moved(turn), map=run.map.moved(turn), up=turn[:3, 2])


def test_a_perfect_run_lies_on_its_reference_whatever_its_world(written):
    pose = circle(FRAMES)
    reference = far_reference(pose)
    read = written({"own": bare_run("own", pose), "other": tilted(bare_run("other", pose))}, reference)
    assert read.application == "vislam"
    wanted = reference.position - reference.position[0]
    (drawn,) = read.column("/reference", "Points3D:positions")
    assert np.allclose(drawn, wanted, atol=FLOAT32)
    for name in ("own", "other"):
        assert {f"/{name}/path", f"/{name}/pose", f"/{name}/step_time_ms"} <= read.entities
        # A covariance, an innovation or a landmark is not made up, and a causal path not said twice.
        for part in ("position_3_sigma", "position_sigma", "nis_per_dof", "landmarks", "causal_path"):
            assert f"/{name}/{part}" not in read.entities
        assert read.column(f"/{name}/pose", "frame") == list(range(FRAMES))
        assert np.allclose(read.seconds(f"/{name}/pose"), 0.1 * np.arange(FRAMES), atol=1e-8)
        assert np.allclose(read.values(f"/{name}/pose", "Transform3D:translation"), wanted, atol=FLOAT32)
        turned = Rotation.from_quat(read.values(f"/{name}/pose", "Transform3D:quaternion")).as_matrix()
        assert np.allclose(turned, reference.pose[:, :3, :3], atol=1e-6)
        ((strip,),) = read.column(f"/{name}/path", "LineStrips3D:strips")
        assert np.allclose(strip, wanted, atol=FLOAT32)
        assert np.allclose(read.values(f"/{name}/step_time_ms", "Scalars:scalars"), 2.0)


def test_the_run_is_drawn_where_it_is_wrong(written):
    truth = circle(FRAMES)
    wrong = truth.copy()
    wrong[7, :3, 3] += [3.0, 0.0, 0.0]
    read = written({"run": bare_run("run", wrong)}, far_reference(truth))
    pose = read.values("/run/pose", "Transform3D:translation")
    (reference,) = read.column("/reference", "Points3D:positions")
    distance = np.linalg.norm(pose - reference, axis=1)
    assert distance.argmax() == 7
    assert 2.5 < distance[7] < 3.0


def test_a_planar_reference_leaves_heights_alone_and_gaps_open(written):
    pose = circle(FRAMES)
    frame = np.r_[0:10, 12, 20:30]
    reference = Reference("bursts", "planar", frame, pose[frame, :2, 3] + [1e5, 2e5], None, np.eye(4))
    read = written({"run": bare_run("run", pose)}, reference)
    wanted = pose[:, :3, 3] - np.append(pose[0, :2, 3], 0.0)
    assert np.allclose(read.values("/run/pose", "Transform3D:translation"), wanted, atol=FLOAT32)
    (points,) = read.column("/reference", "Points3D:positions")
    assert np.allclose(points, wanted[frame] * [1.0, 1.0, 0.0], atol=FLOAT32)
    (strips,) = read.column("/reference", "LineStrips3D:strips")
    assert [len(strip) for strip in strips] == [10, 10]


@pytest.mark.parametrize("common", [0, 2])
def test_a_run_that_cannot_be_aligned_stays_in_its_own_world(written, common):
    pose = circle(FRAMES)
    reference = None
    if common:
        reference = far_reference(pose)
        reference = replace(
            reference, frame=np.arange(2), position=reference.position[:2], pose=reference.pose[:2]
        )
    read = written({"run": bare_run("run", pose)}, reference)
    assert ("/reference" in read.entities) == bool(common)
    wanted = (pose @ (LEVER if common else np.eye(4)))[:, :3, 3]
    assert np.allclose(read.values("/run/pose", "Transform3D:translation"), wanted, atol=FLOAT32)


def test_ellipsoids_are_those_of_the_point_that_is_drawn(written, rng):
    pose, step = circle(FRAMES), 1e-6
    root = rng.normal(size=(FRAMES, 6, 6)) * [0.01, 0.01, 0.01, 0.2, 0.2, 0.2]
    cov = root @ root.transpose(0, 2, 1)
    cov[[3, 17]] = np.nan
    reference = far_reference(pose)
    read = written({"run": tilted(bare_run("run", pose, cov=cov))}, reference)
    rows = read.column("/run/position_3_sigma", "Ellipsoids3D:half_sizes")
    assert [len(row) for row in rows] == [0 if k in (3, 17) else 1 for k in range(FRAMES)]
    centres = read.column("/run/position_3_sigma", "Ellipsoids3D:centers")
    quaternions = read.column("/run/position_3_sigma", "Ellipsoids3D:quaternions")
    # Where the world begins is nothing to a covariance, and at map coordinates a difference has no digits.
    drawn_T_imu = reference.pose @ se3.inverse(LEVER)
    drawn_T_imu[:, :3, 3] = 0.0
    for k in (0, 5, 39):
        moved = [se3.retract(drawn_T_imu[k], step * axis) @ LEVER for axis in np.eye(6)]
        jacobian = (np.array(moved) - drawn_T_imu[k] @ LEVER)[:, :3, 3].T / step
        turn = Rotation.from_quat(quaternions[k][0]).as_matrix()
        found = turn @ np.diag(np.square(rows[k][0]) / 9.0) @ turn.T
        # A one-sided difference over 1e-6, and the float32 of the file.
        assert np.allclose(found, jacobian @ cov[k] @ jacobian.T, rtol=0.0, atol=5e-6 * np.trace(found))
        assert np.allclose(centres[k][0], reference.position[k] - reference.position[0], atol=FLOAT32)
    assert [k for k in range(FRAMES) if k not in (3, 17)] == read.column("/run/position_sigma", "frame")
    widest = [max(row[0]) / 3.0 for row in rows if row]
    assert np.allclose(read.values("/run/position_sigma", "Scalars:scalars"), widest, rtol=1e-6)


def test_landmarks_come_with_the_frame_that_first_saw_them(written):
    track, frame = np.array([4, 9, 4, 2, 7, 2]), np.array([3, 3, 8, 8, 8, 30])
    given = Tracks(frame, track, np.zeros((6, 3)), np.ones((6, 3)))
    points = {2: [2.0, 0.0, 0.0], 4: [4.0, 1.0, 0.0], 9: [9.0, 0.0, 1.0]}
    run = made_run(
        "run", circle(FRAMES), track=np.array(list(points)), points_world=np.array(list(points.values()))
    )
    read = written({"run": tilted(run)}, None, given=given)
    frames = read.column("/run/landmarks", "frame")
    drawn = dict(zip(frames, read.column("/run/landmarks", "Points3D:positions"), strict=True))
    assert frames == [3, 8]
    assert np.allclose(drawn[3], [points[4], points[9]], atol=FLOAT32)
    assert np.allclose(drawn[8], [points[2]], atol=FLOAT32)
    assert np.allclose(read.seconds("/run/landmarks"), [0.3, 0.8])


def test_scalars_are_where_the_run_has_them(written):
    dof = np.where(np.arange(FRAMES) % 2, 0, 6)
    causal = circle(FRAMES, radius=51.0)
    ekf = bare_run("ekf", circle(FRAMES), nis=2.0 * dof, dof=dof, filtered=Poses(causal))
    late = altered(bare_run("late", circle(FRAMES), step_time=np.empty(0)), error="lost at frame 39")
    read = written({"ekf": ekf, "late": late}, truth_reference(circle(FRAMES), np.arange(3), np.eye(3)))
    assert read.column("/ekf/nis_per_dof", "frame") == list(range(0, FRAMES, 2))
    assert np.allclose(read.values("/ekf/nis_per_dof", "Scalars:scalars"), 2.0)
    assert {"/ekf/causal_path", "/true\\ landmarks"} <= read.entities
    assert "/late/step_time_ms" not in read.entities


def test_the_text_says_what_the_pictures_do_not(written):
    notes = ("03.npz is missing: this is a synthetic substitute",)
    run = altered(bare_run("late", circle(FRAMES)), error="lost at frame 39")
    read = written({"late": run}, far_reference(circle(FRAMES)), notes=notes, provenance={"cpu": "abacus"})
    ((text,),) = read.column("/about", "TextDocument:text")
    for said in (
        "# vislam short: drive",
        "data are simulated",
        notes[0],
        "late is incomplete: lost",
    ):
        assert said in text
    assert "survey (exact)" in text
    assert "cpu: abacus" in text
    recorded = written({"late": run}, None, synthetic=False)
    ((text,),) = recorded.column("/about", "TextDocument:text")
    assert "imulated" not in text.lower()


def test_nothing_in_the_file_names_the_machine(written, tmp_path):
    read = written({"run": bare_run("run", circle(FRAMES))}, None)
    batches = [chunk.to_record_batch() for chunk in read.chunks]
    said = "".join(f"{batch.schema} {batch.schema.metadata} {batch.to_pylist()}" for batch in batches)
    assert "TextDocument" in said
    for path in (tmp_path, ROOT, sys.prefix):
        assert str(path) not in said


def test_a_recording_that_cannot_be_whole_is_not_written(recording, tmp_path, monkeypatch):
    import rerun as rr

    path = tmp_path / "out.rrd"
    path.write_bytes(b"the one before")
    runs, record = {"run": bare_run("run", circle(FRAMES))}, made_record(frames=FRAMES)
    times = recording._times
    with monkeypatch.context() as patch:
        # One row short: of this the SDK alone would only warn.
        patch.setattr(recording, "_times", lambda frame, record: times(frame[1:], record))
        with pytest.raises(rr.error_utils.RerunWarning):
            recording.write_recording(path, runs, record, title=TITLE)
    with monkeypatch.context() as patch:
        patch.setenv("RERUN", "off")
        with pytest.raises(ConfigError, match="RERUN"):
            recording.write_recording(path, runs, record, title=TITLE)
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("out.rrd", b"the one before")]


@pytest.mark.usefixtures("recording")
def test_both_commands_write_it(tmp_path):
    config, out = str(ROOT / "configs" / "tiny.yaml"), tmp_path / "results"
    given = ["--config", config, "--out", str(out), "--estimators", "dead_reckoning"]
    assert compare.main([*given, "--rerun", str(tmp_path / "one.rrd")]) == 0
    (folder,) = out.iterdir()
    assert evaluate.main([str(folder), "--rerun", str(tmp_path / "two.rrd")]) == 0
    for name in ("one", "two"):
        assert len(Read(tmp_path / f"{name}.rrd").column("/dead_reckoning/pose", "frame")) == 30
    assert not list(folder.rglob("*.rrd"))


@pytest.mark.parametrize("main", [compare.main, evaluate.main])
def test_without_the_sdk_a_command_names_the_remedy_before_any_work(main, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    given = ["--config", str(ROOT / "configs" / "tiny.yaml"), "--out", str(tmp_path / "results")]
    if main is evaluate.main:
        given = [str(tmp_path)]
    assert main([*given, "--rerun", str(tmp_path / "out.rrd")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "pip install 'vislam[rerun]'" in said.err
    assert not list(tmp_path.iterdir())


def test_a_bad_place_is_refused_before_any_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "find_spec", lambda name: object())
    given = ["--config", str(ROOT / "configs" / "tiny.yaml"), "--out", str(tmp_path / "results")]
    assert compare.main([*given, "--rerun", str(tmp_path)]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_commands_do_not_import_the_sdk_unasked():
    rooms = ", ".join(f"vislam.comparison.{name}" for name in ("compare", "imported", "results"))
    loaded = f"vislam.compare, vislam.evaluate, {rooms}"
    asked = f"import sys, {loaded}; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", asked], cwd=ROOT, check=False).returncode == 0
