"""Sources by their format: the union in the config, files told by content, readers of other packages."""

import pickle
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from tests.cli.test_compare import course_file
from tests.conftest import recorded
from tests.data.test_tracks_npz import tracks_file
from vislam.base.errors import ConfigError, DataError
from vislam.cli import export_tracks
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.comparison.open import open_dataset, open_recording
from vislam.datasets import registry
from vislam.datasets.clement_mat import load_clement_mat
from vislam.datasets.course_npy import load_course_npy
from vislam.datasets.course_npz import load_course_npz
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.registry import source_of
from vislam.geometry import se3

CAMERA = np.array([[0, 0, 1.0, 2.0], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1]])


def data(**keys):
    return configuration.parse(Config, {"name": "n", "data": keys}).data


def npy_file(path, **changes):
    left_T_imu = se3.inverse(CAMERA)
    right_T_imu = left_T_imu.copy()
    right_T_imu[0, 3] -= 0.5
    features = np.full((4, 3, 6), -1.0, np.float32)
    features[:, 1] = np.array([120.0, 50, 100, 50])[:, None]
    arrays = {
        "v_t": np.ones((6, 3)),
        "w_t": np.zeros((6, 3)),
        "timestamps": 1.7e9 + 0.1 * np.arange(6),
        "features": features,
        "K_l": np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]),
        "K_r": np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]),
        "extL_T_imu": left_T_imu,
        "extR_T_imu": right_T_imu,
        **changes,
    }
    np.save(path, {key: value for key, value in arrays.items() if value is not None}, allow_pickle=True)
    return path


def mat_file(path, **changes):
    pixels = np.full((4, 6, 2), -1.0)
    pixels[:, :4, 1] = np.array([120.0, 50, 100, 50])[:, None]
    arrays = {
        "y_k_j": pixels,
        "t": 0.1 * np.arange(6)[None],
        "v_vk_vk_i": np.ones((3, 9)),
        "w_vk_vk_i": np.zeros((3, 9)),
        "C_c_v": CAMERA[:3, :3].T,
        "rho_v_c_v": CAMERA[:3, 3:],
        "theta_vk_i": np.tile([[0.0], [0.0], [0.5 * np.pi]], 9),
        "r_i_vk_i": np.arange(27.0).reshape(3, 9),
        "fu": 400.0,
        "fv": 400.0,
        "cu": 320.0,
        "cv": 240.0,
        "b": 0.2,
        **changes,
    }
    savemat(path, {key: value for key, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ({"format": "clement_mat"}, r"^data\.source\.file: Field required"),
        ({"format": "course_npz", "fil": "a"}, r"^data\.source\.file: Field required"),
        ({"format": "kitti00", "gyro": 1}, r"^data\.source\.gyro: unknown key; known are format, gyro_sigma"),
        ({"format": "kitti00", "gyro_sigma": -1}, r"^data\.source\.gyro_sigma: "),
        (
            {"format": "simulation", "rig": {"foo": 1}},
            r"^data\.source\.rig\.foo: unknown key; known are base",
        ),
        ({"format": "rosbag"}, r"^data\.source: expected a section with a format .*tracks_npz"),
        ({}, r"^data\.source: expected a section with a format"),
        (3, r"^data\.source: expected a section with a format"),
    ],
)
def test_a_source_that_is_none_is_told(source, told):
    with pytest.raises(ConfigError, match=told):
        data(source=source)


def test_the_data_is_named_once():
    with pytest.raises(ConfigError, match="source and file each name the data"):
        data(source={"format": "kitti00"}, file="a.npz")
    with pytest.raises(ConfigError, match="one of source, file, simulation and packaged"):
        data()


def test_a_source_is_written_as_it_was_read():
    tree = {"name": "n", "data": {"source": {"format": "simulation", "frames": 20}}}
    config = configuration.parse(Config, tree)
    assert configuration.parse(Config, yaml.safe_load(configuration.dump(config))) == config
    assert config.data.simulated


def test_a_simulation_is_a_source_like_others(caplog):
    settings = {"frames": 12, "tracks_in_view": 15}
    named = open_dataset(data(source={"format": "simulation", **settings}), seed=3)
    plain = open_dataset(data(simulation=settings), seed=3)
    assert np.array_equal(named.sequence.pixels, plain.sequence.pixels)
    assert np.array_equal(named.reference.points_world, plain.reference.points_world)
    assert named.sequence.synthetic
    assert len(named.reference.track) == len(np.unique(named.sequence.track))


def test_the_format_is_told_by_the_content(tmp_path):
    course_file(tmp_path / "course.npz")
    files = {
        "course_npz": tmp_path / "course.npz",
        "course_npy": npy_file(tmp_path / "course.npy"),
        "clement_mat": mat_file(tmp_path / "set.mat"),
        "tracks_npz": tracks_file(tmp_path / "tracks.npz"),
    }
    for name, path in files.items():
        unnamed = path.rename(path.with_suffix(".dat")) if path.suffix != ".mat" else path
        assert source_of(unnamed).format == name
        found = open_recording(data(file=str(unnamed)), Opening([tmp_path]))
        assert len(found.sequence) == 6


@pytest.mark.parametrize(
    ("content", "told"),
    [(b"", "begins with b''"), (b"ply\nformat ascii", "begins with b'ply"), (b"PK\x03\x04", "begins with")],
)
def test_a_file_of_no_format_is_told_the_page(tmp_path, content, told):
    (tmp_path / "a.bin").write_bytes(content)
    with pytest.raises(DataError, match=rf"{told}.*track_format\.md"):
        source_of(tmp_path / "a.bin")
    np.savez(tmp_path / "b.npz", x=np.zeros(3))
    with pytest.raises(DataError, match=r"'features' of a course file.*the file has x; .*track_format\.md"):
        source_of(tmp_path / "b.npz")


def test_the_edition_of_2025(tmp_path):
    found = load_course_npy(npy_file(tmp_path / "a.npy"))
    assert np.allclose(found.rig.imu_T_cam, CAMERA)
    assert found.rig.baseline == pytest.approx(0.5)
    assert (found.observations, set(found.track)) == (6, {1})
    assert np.array_equal(found.twist, np.tile([0, 0, 0, 1.0, 1, 1], (6, 1)))


class Evil:
    def __reduce__(self):
        return (print, ("run",))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"v_t": None}, "'v_t' is missing"),
        ({"features": np.zeros((4, 3, 5))}, r"'features' must be of shape \(4, M, 6\)"),
        ({"K_r": np.diag([410.0, 400, 1])}, "rectified pair"),
        ({"extR_T_imu": np.eye(4)}, "'extR_T_imu' must be"),
        ({"v_t": "fast"}, "'v_t' must be an array of real numbers"),
        ({"w_t": Evil()}, "builtins.print is no part of an array"),
    ],
)
def test_an_edition_of_2025_that_cannot_be(tmp_path, capsys, changes, told):
    path = npy_file(tmp_path / "a.npy", **changes)
    with pytest.raises(DataError, match=told) as raised:
        load_course_npy(path)
    assert "\n" not in str(raised.value)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_broken_files_end_in_one_line(tmp_path, share):
    for path, load in (
        (npy_file(tmp_path / "a.npy"), load_course_npy),
        (mat_file(tmp_path / "a.mat"), load_clement_mat),
    ):
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(DataError) as raised:
            load(path)
        assert "\n" not in str(raised.value)


def test_a_plain_array_is_no_edition(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(DataError, match="pickled dictionary of arrays"):
        load_course_npy(tmp_path / "a.npy")


def test_old_pickles_of_arrays_are_read():
    import io

    from vislam.datasets.course_npy import _ArraysOnly

    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        array = np.arange(6.0).reshape(2, 3)
        read = _ArraysOnly(io.BytesIO(pickle.dumps({"a": array, "n": np.float64(2)}, protocol))).load()
        assert np.array_equal(read["a"], array)
        assert read["n"] == 2.0


def test_a_set_of_clement_has_poses_and_landmarks(tmp_path):
    landmarks = np.arange(6.0).reshape(3, 2)
    found = load_clement_mat(mat_file(tmp_path / "a.mat", rho_i_pj_i=landmarks))
    assert np.allclose(found.sequence.rig.imu_T_cam, CAMERA)
    assert (len(found.sequence), found.sequence.observations) == (6, 4)
    assert np.allclose(found.reference.pose[0, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert np.array_equal(found.reference.position[2], [2, 11, 20])
    assert np.array_equal(found.points_world, np.tile(landmarks[:, 1], (4, 1)))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"theta_vk_i": None}, "'theta_vk_i' is missing: only the sets of Clement"),
        ({"r_i_vk_i": np.zeros((3, 4))}, r"'r_i_vk_i' must be of shape \(3, 6\) or longer"),
        ({"C_c_v": 2 * np.eye(3)}, "'C_c_v' must be a rigid transform"),
        ({"rho_i_pj_i": np.zeros((3, 7))}, "'rho_i_pj_i' must be of shape"),
        ({"t": np.array(["a"])}, "'t' must be an array of real numbers"),
    ],
)
def test_a_set_of_clement_that_cannot_be(tmp_path, changes, told):
    with pytest.raises(DataError, match=told):
        load_clement_mat(mat_file(tmp_path / "a.mat", **changes))


def test_a_stretch_of_a_set_is_read_from_where_it_is(tmp_path):
    path = mat_file(tmp_path / "a.mat")
    whole = load_clement_mat(path)
    frames = len(whole.sequence)
    part = load_clement_mat(path, steps=(2, frames))
    assert len(part.sequence) == frames - 1
    assert np.array_equal(part.sequence.stamp, whole.sequence.stamp[1:])
    assert np.array_equal(part.sequence.twist, whole.sequence.twist[1:])
    assert np.array_equal(part.sequence.pixels, whole.sequence.pixels[whole.sequence.offset[1] :])
    assert np.array_equal(part.reference.pose, whole.reference.pose[1:])
    assert part.reference.frame[0] == 0
    with pytest.raises(DataError, match=f"source.steps must be within 1 to {frames}, the frames of the file"):
        load_clement_mat(path, steps=(1, frames + 1))
    with pytest.raises(ConfigError, match="steps must be first and last, the last one later"):
        configuration.parse(
            Config, {"name": "a", "data": {"source": {"format": "clement_mat", "file": "a", "steps": [3, 3]}}}
        )


def test_reprojected_landmarks_of_starry_night_are_near():
    """The stated landmarks at the stated poses: some pixels off, as the set is, and no turn or sign wrong."""
    found = load_clement_mat(recorded("clement2015/dataset3.mat"))
    sequence, rig = found.sequence, found.sequence.rig
    cam_T_world = se3.inverse(found.reference.pose @ rig.imu_T_cam)[sequence.frame_of]
    predicted = rig.project(se3.transform(cam_T_world, found.points_world[:, None])[:, 0])
    off = np.median(np.abs(predicted - sequence.z), axis=0)
    assert np.all(off < [8.0, 8.0, 12.0])


def test_a_reader_of_another_package(monkeypatch, tmp_path):
    course_file(tmp_path / "a.npz")
    mine = EntryPoint("mine", "tests.data.test_sources:mine", "g")
    known = {**registry.installed(registry.GROUP, registry.OWN), "mine": mine}
    monkeypatch.setattr(registry, "installed", lambda group, own: known)
    config = data(source={"format": "mine", "options": {"file": str(tmp_path / "a.npz")}})
    assert len(open_recording(config, Opening([])).sequence) == 6
    with pytest.raises(ConfigError, match=r"data\.source\.options"):
        open_recording(data(source={"format": "mine", "options": {"files": "a"}}), Opening([]))


def mine(options: configuration.CourseNpz, opening: Opening) -> Recording:
    return Recording(load_course_npz(opening.find(options.file)))


def test_tracks_are_exported_from_a_file_and_from_a_config(tmp_path, capsys):
    course_file(tmp_path / "a.npz")
    assert export_tracks.main([str(tmp_path / "a.npz"), "-o", str(tmp_path / "b.npz")]) == 0
    assert source_of(tmp_path / "b.npz").format == "tracks_npz"
    (tmp_path / "c.yaml").write_text("name: n\ndata: {simulation: {frames: 8, tracks_in_view: 8}}\n")
    assert export_tracks.main([str(tmp_path / "c.yaml"), "-o", str(tmp_path / "d.npz")]) == 0
    assert "SIMULATED" in capsys.readouterr().out
    found = open_dataset(data(file=str(tmp_path / "d.npz")), seed=0)
    assert len(found.reference.track)
    assert export_tracks.main([str(tmp_path / "nope"), "-o", str(tmp_path / "e.npz")]) == 2
    assert export_tracks.main([str(tmp_path / "a.npz"), "-o", str(tmp_path / "e.txt")]) == 2


def test_a_reference_of_the_camera_lies_where_the_repaired_mounting_has_it(tmp_path):
    course_file(tmp_path / "drive.npz", imu_T_cam=CAMERA)
    poses = np.tile(np.eye(4)[:3].ravel(), (6, 1))
    np.savetxt(tmp_path / "poses.txt", poses)
    camera = {"file": "poses.txt", "format": "kitti", "name": "poses", "limits": "", "pose_of": "left_camera"}
    stored = open_dataset(data(file="drive.npz", reference=camera), seed=0, data_dir=tmp_path)
    turned = open_dataset(
        data(
            file="drive.npz",
            reference=camera,
            repair={"extrinsic": {"rotation": "stored", "translation": "inverse"}},
        ),
        seed=0,
        data_dir=tmp_path,
    )
    for found in (stored, turned):
        assert np.allclose(found.reference.imu_T_point, found.sequence.rig.imu_T_cam)
    assert not np.allclose(stored.reference.imu_T_point, turned.reference.imu_T_point)


def test_a_reference_beside_the_data_has_the_accuracy_that_the_config_knows_and_no_pose_that_was_filled_in(
    tmp_path,
):
    rng = np.random.default_rng(3)
    place = np.cumsum(1.0 + 0.01 * rng.standard_normal((3, 20)), axis=1)
    for k in range(1, 9):
        place[:, k] = place[:, 0] + k / 9 * (place[:, 9] - place[:, 0])
    pixels = np.full((4, 20, 2), -1.0)
    pixels[:, :9, 1] = np.array([120.0, 50, 100, 50])[:, None]
    file = mat_file(
        tmp_path / "set.mat",
        y_k_j=pixels,
        t=0.1 * np.arange(20)[None],
        v_vk_vk_i=np.ones((3, 20)),
        w_vk_vk_i=np.zeros((3, 20)),
        theta_vk_i=0.01 * rng.standard_normal((3, 20)),
        r_i_vk_i=place,
    )
    config = data(
        source={"format": "clement_mat", "file": str(file)},
        reference_accuracy={"sigma_m": 0.02, "sigma_deg": 0.1},
    )
    dataset = open_dataset(config, seed=0)
    assert list(dataset.reference.frame) == list(range(9, 20))
    assert any("filled in" in note for note in dataset.notes)
    assert dataset.reference.sigma == 0.02
    assert np.isclose(dataset.reference.sigma_rotation, np.deg2rad(0.1))
    with pytest.raises(ConfigError, match="state it in reference"):
        data(
            source={"format": "clement_mat", "file": str(file)},
            reference_accuracy={"sigma_m": 0.02},
            reference={"file": "a.txt", "format": "tum", "name": "a", "limits": "none"},
        )
