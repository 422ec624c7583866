"""Rendered recordings, as arrays and as a folder of the ASL layout."""

from dataclasses import dataclass

import numpy as np

from vislam.geometry import se3
from vislam.models import CAMERA_AXES
from vislam.models.camera import Camera, Lens
from vislam.models.stereo_pair import rectified
from vislam.simulation.pictures import Studio, street

RADTAN = (-0.28, 0.07, 2e-4, 2e-5)
KANNALA_BRANDT = (0.003, 0.0007, -0.002, 0.0002)


def cameras(lens=Lens.RADTAN, *, width=320, height=200):
    coefficients = {Lens.RADTAN: RADTAN, Lens.KANNALA_BRANDT: KANNALA_BRANDT, Lens.NONE: ()}[lens]
    left = Camera(width, height, 200.0, 199.0, 158.0, 103.0, lens, coefficients)
    right = Camera(width, height, 201.0, 200.0, 163.0, 98.0, lens, coefficients)
    imu_T_left = se3.from_rotation_translation(CAMERA_AXES, np.array([0.1, 0.15, 0.05]))
    left_T_right = se3.exp(np.array([0.004, -0.012, 0.008, 0.3, 0.004, -0.003]))
    return left, right, imu_T_left, imu_T_left @ left_T_right


def pair(lens=Lens.RADTAN):
    left, right, imu_T_left, imu_T_right = cameras(lens)
    return rectified(left, right, imu_T_left=imu_T_left, imu_T_right=imu_T_right)


@dataclass
class Rendered:
    studio: Studio
    pose: np.ndarray
    pictures: list

    stamp = property(lambda self: 100.0 + 0.1 * np.arange(len(self.pose)))


def rendered(frames, *, lens=Lens.RADTAN):
    """A drive along a street, 0.25 m and half a degree a frame."""
    studio = Studio(street(half_width=4.0, camera_height=1.5, length=30.0, seed=1), pair(lens))
    step = se3.exp(np.array([0.0, 0.0, 0.008, 0.25, 0.0, 0.0]))
    pose = [se3.exp(np.array([0.0, 0.0, -0.06, 0.0, 0.0, 0.0]))]
    for _ in range(frames - 1):
        pose.append(pose[-1] @ step)
    return Rendered(studio, np.array(pose), [studio.pictures(one) for one in pose])


def sensor_yaml(camera, pose):
    model = {Lens.RADTAN: "radial-tangential", Lens.KANNALA_BRANDT: "equidistant"}[camera.lens]
    return (
        "#Default camera\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: {np.array(pose).ravel().tolist()}\nresolution: [{camera.width}, {camera.height}]\n"
        f"camera_model: pinhole\nintrinsics: [{camera.fx}, {camera.fy}, {camera.cx}, {camera.cy}]\n"
        f"distortion_model: {model}\ndistortion_coefficients: {list(camera.coefficients)}\n"
    )


def write_asl(folder, made, *, lens=Lens.RADTAN, write=None):
    """Write a folder mav0; ``write`` takes path and picture."""
    import cv2

    left, right, imu_T_left, imu_T_right = cameras(lens)
    stamps = np.rint(1e9 * made.stamp).astype(np.int64)
    for name, side, camera, pose in (("cam0", 0, left, imu_T_left), ("cam1", 1, right, imu_T_right)):
        (folder / "mav0" / name / "data").mkdir(parents=True)
        (folder / "mav0" / name / "sensor.yaml").write_text(sensor_yaml(camera, pose))
        lines = ["#timestamp [ns],filename"]
        for stamp, both in zip(stamps, made.pictures, strict=True):
            path = folder / "mav0" / name / "data" / f"{stamp}.png"
            assert cv2.imwrite(str(path), both[side])
            lines.append(f"{stamp},{path.name}")
        (folder / "mav0" / name / "data.csv").write_text("\r\n".join(lines) + "\r\n")
    imu = folder / "mav0" / "imu0"
    imu.mkdir()
    at = np.arange(stamps[0] - 10**8, stamps[-1] + 10**8, 5 * 10**6)
    rows = [f"{stamp},0.0,0.0,0.08,0.0,0.0,9.81" for stamp in at.tolist()]
    (imu / "data.csv").write_text("#timestamp [ns],w,w,w,a,a,a\n" + "\n".join(rows) + "\n")
    return folder
