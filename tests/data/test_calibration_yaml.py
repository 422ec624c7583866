"""Kalibr's camchain gives the same cameras as the sensor files."""

import numpy as np
import pytest

from tests.frontend.studio import cameras
from vislam.base.errors import DataError
from vislam.datasets.calibration_yaml import read_camchain
from vislam.geometry import se3
from vislam.models.camera import Lens


def camchain(path, *, chained):
    left, right, imu_T_left, imu_T_right = cameras(Lens.KANNALA_BRANDT)
    text = ""
    for name, camera, imu_T_cam in (("cam0", left, imu_T_left), ("cam1", right, imu_T_right)):
        pose = se3.inverse(imu_T_cam)
        key = "T_cam_imu"
        if chained and name == "cam1":
            key, pose = "T_cn_cnm1", se3.inverse(imu_T_right) @ imu_T_left
        text += (
            f"{name}:\n  camera_model: pinhole\n  distortion_model: equidistant\n"
            f"  distortion_coeffs: {list(camera.coefficients)}\n"
            f"  intrinsics: [{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}]\n"
            f"  resolution: [{camera.width}, {camera.height}]\n  {key}:\n"
        ) + "".join(f"  - {row}\n" for row in pose.tolist())
    path.write_text("%YAML:1.0\n" + text)


@pytest.mark.parametrize("chained", [False, True])
def test_camchain(tmp_path, chained):
    path = tmp_path / "camchain-imucam.yaml"
    camchain(path, chained=chained)
    found = read_camchain(path)
    left, right, imu_T_left, imu_T_right = cameras(Lens.KANNALA_BRANDT)
    for one, camera, imu_T_cam in zip(
        (found.left, found.right), (left, right), (imu_T_left, imu_T_right), strict=True
    ):
        assert one.camera == camera
        assert np.allclose(one.imu_T_cam, imu_T_cam, atol=1e-12)


def test_a_camchain_of_one_camera_is_one_line(tmp_path):
    path = tmp_path / "camchain.yaml"
    camchain(path, chained=False)
    path.write_text(path.read_text().replace("cam1:", "cam7:"))
    with pytest.raises(DataError, match="must have cam0 and cam1, cam1 is missing"):
        read_camchain(path)


def test_a_number_without_a_dot_is_one(tmp_path):
    """YAML 1.1 takes 2e-05 for text."""
    path = tmp_path / "camchain.yaml"
    camchain(path, chained=False)
    path.write_text(path.read_text().replace("0.0002]", "2e-04]"))
    assert read_camchain(path).left.camera.coefficients[3] == 2e-4
