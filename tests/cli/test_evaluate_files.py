"""``vislam evaluate`` on trajectory files: no run of ours, the same tables, page, checks and JUnit."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import vislam
from vislam.base.errors import ConfigError
from vislam.cli.evaluate import main
from vislam.geometry import se3

STAMP = 50.0 + 0.1 * np.arange(200)


def drive(stamp):
    place = np.column_stack([30 * np.sin(0.2 * stamp), 22 * np.sin(0.31 * stamp), 4 * np.sin(0.5 * stamp)])
    yaw, pitch = 0.9 * np.sin(0.3 * stamp), 0.3 * np.sin(0.4 * stamp)
    turn = Rotation.from_euler("zy", np.column_stack([yaw, pitch])).as_matrix()
    return se3.from_rotation_translation(turn, place)


def write(path, stamp, pose):
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    np.savetxt(path, np.column_stack([stamp, pose[:, :3, 3], quaternion]), fmt="%.9f")


@pytest.fixture
def files(tmp_path, monkeypatch, rng):
    """A dense reference and two trajectories, in the current folder."""
    monkeypatch.chdir(tmp_path)
    dense = np.arange(49.0, 71.0, 0.01)
    write("gt.tum", dense, drive(dense))
    for name, size in (("a", 0.01), ("b", 0.1)):
        noise = se3.exp(rng.normal(0, 1, (200, 6)) * np.repeat([1e-3, size], 3))
        write(f"{name}.tum", STAMP, drive(STAMP) @ noise)
    return tmp_path


def document(folder):
    return json.loads((folder / "metrics.json").read_text())


def values(folder):
    return {(m["estimator"], m["key"]): m["value"] for m in document(folder)["metrics"]}


TWO = ["--trajectory", "orb=a.tum", "--trajectory", "vins=b.tum"]


def test_a_reference_file_first_or_as_an_option_is_the_same(files, capsys):
    assert main(["gt.tum", *TWO, "--no-report", "--out", "one"]) == 0
    said = capsys.readouterr().out
    assert "share matched [%]" in said
    assert "orb: read as tum; 200 rows matched, nearest stamps" in said
    assert main(["--reference", "gt.tum", *TWO, "--no-report", "--out", "two"]) == 0
    assert values(files / "one") == values(files / "two")
    found = values(files / "one")
    assert 0.012 < found["orb", "ate_rmse"] < 0.022
    assert 0.12 < found["vins", "ate_rmse"] < 0.22
    assert found["orb", "share_matched"] == 100.0
    assert ("orb|vins", "trajectory_distance_rmse") in found


def test_nothing_is_scored_by_poses_of_the_reference_that_were_filled_in(files):
    """Two seconds on a straight line in equal steps, while the vehicle drove on as before."""
    dense = np.arange(49.0, 71.0, 0.01)
    pose = drive(dense)
    share = np.linspace(0.0, 1.0, 201)[:, None]
    pose[500:701, :3, 3] = (1 - share) * pose[500, :3, 3] + share * pose[700, :3, 3]
    write("lost.tum", dense, pose)
    assert main(["gt.tum", *TWO, "--no-report", "--out", "one"]) == 0
    assert main(["lost.tum", *TWO, "--no-report", "--out", "two"]) == 0
    whole, found = values(files / "one"), values(files / "two")
    assert found["orb", "ate_rmse"] == pytest.approx(whole["orb", "ate_rmse"], rel=0.15)
    assert found["orb", "share_matched"] == pytest.approx(100.0 * 181 / 200, abs=1.0)
    (remark,) = [note for note in document(files / "two")["dataset"]["notes"] if "equal steps" in note]
    assert "lost: 199 of 2200 poses, at stamps 54.01 to 55.99, lie between" in remark
    assert "filled in, not measured; nothing is scored by them" in remark
    assert not [note for note in document(files / "one")["dataset"]["notes"] if "equal steps" in note]


@pytest.mark.slow
def test_the_page_has_tables_figures_and_what_was_noticed(files):
    write("late.tum", STAMP + 0.3, drive(STAMP))
    assert main(["gt.tum", *TWO, "--trajectory", "late=late.tum", "--out", "out"]) == 0
    page = (files / "out" / "report.html").read_text()
    assert "Noticed: late: its clock is 0.3 s late" in page
    assert "orb has 0.02 m; vins is 0.16 m worse" in page


def test_names_with_spaces_and_paths_with_commas_are_yaml(files):
    (files / "a.tum").rename(files / "a, b.tum")
    arguments = [
        "--reference",
        "{file: gt.tum, name: motion capture, sigma_m: 0.01}",
        "--no-report",
        "--out",
        "out",
    ]
    assert main([*arguments, "--trajectory", "{name: my run, file: 'a, b.tum'}"]) == 0
    assert ("my run", "ate_rmse") in values(files / "out")
    assert document(files / "out")["dataset"]["reference"] == "motion capture"


def test_checks_junit_and_saved_results_work_as_for_a_comparison(files):
    checks = {"checks": [{"estimator": "orb", "metric": "ate_rmse", "at_most": 0.5, "times": "vins"}]}
    (files / "checks.yaml").write_text(yaml.safe_dump(checks))
    common = ["gt.tum", *TWO, "--no-report", "--checks", "checks.yaml"]
    assert main([*common, "--out", "out", "--junit", "j.xml"]) == 0
    assert ET.parse(files / "j.xml").getroot() is not None
    assert main(["gt.tum", *TWO, "--no-report", "--out", "again", "--against", "out"]) == 0
    write("a.tum", STAMP, drive(STAMP) @ se3.exp(np.random.default_rng(0).normal(0, 0.3, (200, 6))))
    assert main(["gt.tum", *TWO, "--no-report", "--out", "again", "--against", "out"]) == 3
    assert main([*common, "--out", "again"]) == 3


REFUSED = {
    "no trajectory": (["gt.tum"], "--reference needs a --trajectory"),
    "nothing": ([], "give a results folder, or --reference"),
    "twice": (["gt.tum", "--reference", "gt.tum", *TWO], "a reference is named twice"),
    "no file": (["gt.tum", "--trajectory", "x=none.tum"], "none.tum: not found"),
    "one name": (
        ["gt.tum", "--trajectory", "x=a.tum", "--trajectory", "x=b.tum"],
        "called x",
    ),
    "unknown key": (["gt.tum", "--trajectory", "x=a.tum,frmat=tum"], "any of format="),
    "bad value": (["gt.tum", "--trajectory", "x=a.tum,unit=min"], "--trajectory x.unit: Input should be"),
    "camera": (["gt.tum", "--trajectory", "x=a.tum,pose_of=left_camera"], "left_camera needs a recording"),
    "crop": (["gt.tum", *TWO, "--start", "5", "--end", "1"], "end must be after start"),
    "suite": (["--suite", "none.yaml"], "none.yaml: cannot be read"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_cannot_be_scored_is_one_line_and_2(case, files, capsys):
    arguments, message = REFUSED[case]
    assert main([*arguments, "--no-report", "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (files / "out").exists()


def test_frames_without_numbers_are_never_laid_on_the_first_ones(files, capsys):
    pose = drive(STAMP)
    np.savetxt("gt.kitti", pose[:, :3].reshape(-1, 12))
    kept = np.r_[0:40, 60:200]
    np.savetxt("some.kitti", pose[kept, :3].reshape(-1, 12))
    np.savetxt("frames.txt", kept, fmt="%d")
    arguments = ["--no-report", "--out", "out", "--trajectory"]
    assert main(["gt.kitti", *arguments, "x=some.kitti"]) == 2
    assert (
        "180 poses for 200 of the reference, and nothing says which belong together"
        in capsys.readouterr().err
    )
    assert main(["gt.kitti", *arguments, "x=some.kitti,frames=frames.txt"]) == 0
    found = values(files / "out")
    assert found["x", "ate_rmse"] < 1e-9
    assert ("x", "rpe_1s_rmse") not in found
    assert main(["gt.tum", *arguments, "x=some.kitti"]) == 2
    assert "has no stamps" in capsys.readouterr().err
    np.savetxt("times.txt", STAMP[kept])
    assert main(["gt.tum", *arguments, "x=some.kitti,times=times.txt"]) == 0
    assert values(files / "out")["x", "ate_rmse"] < 1e-6


def test_covariances_beside_a_file_are_scored(files, rng):
    sigma = np.repeat([1e-3, 0.05], 3)
    error = rng.normal(size=(200, 6)) * sigma
    error[0] = 0.0
    write("c.tum", STAMP, drive(STAMP) @ se3.inverse(se3.exp(error)))
    lower = np.zeros((200, 21))
    lower[:, [0, 2, 5, 9, 14, 20]] = np.r_[sigma[3:], sigma[:3]] ** 2
    np.savetxt("c.cov", np.column_stack([STAMP, lower]), header="%TANGENT_ORDER translation_rotation")
    assert main(["gt.tum", "--trajectory", "c=c.tum,cov=c.cov", "--no-report", "--out", "out"]) == 0
    found = values(files / "out")
    assert 0.85 < found["c", "nees_pose"] < 1.15
    assert {"coverage_pose_1sigma", "log_score_pose", "energy_score_position"} <= {key for _, key in found}
    np.savetxt("short.cov", np.column_stack([STAMP, lower])[:150])
    assert main(["gt.tum", "--trajectory", "c=c.tum,cov=short.cov", "--no-report", "--out", "out"]) == 2


def test_maps_of_points_are_compared(files, rng):
    points = rng.uniform(-60, 60, (300, 3))
    np.savez("truth.npz", points_world=points)
    np.savez("found.npz", points_world=points[:200] + rng.normal(0, 0.01, (200, 3)))
    reference = "{file: gt.tum, map: truth.npz}"
    arguments = ["--trajectory", "orb=a.tum,map=found.npz", "--trajectory", "vins=b.tum,map=found.npz"]
    assert main(["--reference", reference, *arguments, "--no-report", "--out", "out"]) == 0
    found = values(files / "out")
    assert 0.005 < found["orb", "map_error_nearest_median"] < 0.1
    assert 60.0 < found["orb", "map_points_complete"] < 90.0
    assert found["orb|vins", "map_points_complete"] > 90.0


def test_what_is_exported_is_scored_the_same(files):
    common = ["--no-report", "--out", "out"]
    assert main(["gt.tum", "--trajectory", "orb=a.tum", *common, "--export", "for"]) == 0
    exported = "for/rpg/orb/stamped_groundtruth.txt", "orb=for/rpg/orb/stamped_traj_estimate.txt"
    before = values(files / "out")["orb", "ate_rmse"]
    assert main([exported[0], "--trajectory", exported[1], *common]) == 0
    assert np.isclose(values(files / "out")["orb", "ate_rmse"], before, rtol=1e-9)


def test_a_suite_has_one_table_over_sequences_runs_and_failures(files, capsys):
    (files / "broken.tum").write_text("1 2 3\n")
    suite = {
        "sequences": [
            {
                "sequence": "first",
                "reference": "gt.tum",
                "trajectories": {"orb": ["a.tum", {"file": "b.tum"}], "vins": "b.tum"},
            },
            {
                "sequence": "second",
                "reference": "gt.tum",
                "trajectories": {"orb": "a.tum", "vins": "broken.tum"},
            },
        ]
    }
    (files / "suite.yaml").write_text(yaml.safe_dump(suite))
    assert main(["--suite", "suite.yaml", "--no-report", "--out", "out"]) == 1
    found = json.loads((files / "out" / "suite.json").read_text())["systems"]
    assert found["orb"]["runs"] == 3
    assert found["vins"] == {**found["vins"], "runs": 2, "failed": 1}
    assert found["orb"]["metrics"]["ate_rmse"]["sequences"] == 2
    assert found["orb"]["metrics"]["ate_rmse"]["most"] > 5 * found["orb"]["metrics"]["ate_rmse"]["least"]
    said = capsys.readouterr().out
    assert "1 of 2" in said
    assert "second, vins, run 0" in said


def test_the_same_from_python(files):
    outcome = vislam.evaluate(reference="gt.tum", trajectories={"orb": "a.tum", "late": {"file": "b.tum"}})
    assert 0.012 < outcome.metric("ate_rmse", "orb") < 0.022
    assert "share matched" in outcome.table(every=True)
    assert (outcome.save("saved") / "metrics.json").is_file()
    with pytest.raises(ConfigError, match="give results, or a reference"):
        vislam.evaluate()
