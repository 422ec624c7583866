"""Raw inertia as recordings have it: samples, their order, the mounting and the stated noise."""

import numpy as np
import pytest

from tests.frontend.studio import cameras, sensor_yaml
from vislam.base.errors import DataError
from vislam.datasets.calibration_yaml import imu_noise
from vislam.datasets.images import open_images
from vislam.geometry import se3
from vislam.models.imu import ImuNoise

FRAMES = 4
START, PERIOD = 10**18, 10**8
SAMPLES = 100
STATED = ImuNoise(1.7e-4, 2e-3, 2e-5, 3e-3)
NOISE = {
    "gyroscope_noise_density": "1.7e-4",
    "gyroscope_random_walk": "2e-05",
    "accelerometer_noise_density": "0.002",
    "accelerometer_random_walk": "3.0e-3",
}


def text_of(noise, *, indent=""):
    return "".join(f"{indent}{key}: {value}\n" for key, value in noise.items())


def rows():
    """Stamps [ns] and six numbers a sample, no two alike."""
    stamp = START - PERIOD + 5 * 10**6 * np.arange(SAMPLES)
    values = np.random.default_rng(5).normal(size=(SAMPLES, 6))
    return stamp, values


def written(stamp, values):
    lines = [
        ",".join([str(one), *map(repr, row)])
        for one, row in zip(stamp.tolist(), values.tolist(), strict=True)
    ]
    return "#timestamp [ns],w,w,w,a,a,a\r\n" + "\r\n".join(lines) + "\r\n"


@pytest.fixture
def rig(tmp_path):
    """A folder of EuRoC's kind; its images are empty files, which nobody opens here."""
    folder = tmp_path / "run"
    left, right, imu_T_left, imu_T_right = cameras()
    for name, camera, pose in (("cam0", left, imu_T_left), ("cam1", right, imu_T_right)):
        (folder / "mav0" / name / "data").mkdir(parents=True)
        (folder / "mav0" / name / "sensor.yaml").write_text(sensor_yaml(camera, pose))
        stamps = [START + PERIOD * k for k in range(FRAMES)]
        for stamp in stamps:
            (folder / "mav0" / name / "data" / f"{stamp}.png").touch()
        lines = "".join(f"{stamp},{stamp}.png\n" for stamp in stamps)
        (folder / "mav0" / name / "data.csv").write_text("#timestamp [ns],filename\n" + lines)
    (folder / "mav0" / "imu0").mkdir()
    (folder / "mav0" / "imu0" / "data.csv").write_text(written(*rows()))
    return folder


def imu0(rig, name="data.csv"):
    return rig / "mav0" / "imu0" / name


def refused(rig):
    with pytest.raises(DataError) as caught:
        open_images(rig)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_samples_are_those_of_the_file(rig):
    found = open_images(rig)
    stamp, values = rows()
    series = found.inertia.series
    assert np.allclose(series.stamp, 1e-9 * stamp, rtol=0.0, atol=2e-7)
    assert np.array_equal(series.gyro, values[:, :3])
    assert np.array_equal(series.accel, values[:, 3:])
    assert found.inertia.velocity is None
    assert found.counts["inertial_samples"] == SAMPLES
    assert found.counts["inertial_duplicates"] == found.counts["inertial_out_of_order"] == 0


def test_samples_are_put_in_order_and_duplicates_go(rig):
    stamp, values = rows()
    order = np.arange(SAMPLES)
    order[[10, 30]] = order[[30, 10]]
    order = np.insert(order, 50, [50, 50, 12])
    imu0(rig).write_text(written(stamp[order], values[order]))
    found = open_images(rig)
    assert np.array_equal(found.inertia.series.accel, values[:, 3:])
    assert found.counts["inertial_duplicates"] == 3
    assert found.counts["inertial_out_of_order"] == 3


def test_a_gap_is_counted_and_no_interval_of_it_is_known(rig):
    stamp, values = rows()
    kept = np.r_[0:30, 50:SAMPLES]
    imu0(rig).write_text(written(stamp[kept], values[kept]))
    found = open_images(rig)
    series = found.inertia.series
    assert series.counts["imu_gaps"] == 1
    missing = sum(step.missing for step in series.steps(found.stamp))
    assert missing == pytest.approx(1e-9 * (stamp[50] - stamp[29]), abs=1e-6)


def test_a_sensor_that_is_turned_in_the_body_turns_the_mounting(rig):
    plain = open_images(rig).pair.rig.imu_T_cam
    body_T_imu = se3.exp(np.array([0.3, -0.2, 1.1, 0.05, -0.02, 0.1]))
    imu0(rig, "sensor.yaml").write_text(
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: {body_T_imu.ravel().tolist()}\n"
    )
    turned = open_images(rig)
    assert np.allclose(body_T_imu @ turned.pair.rig.imu_T_cam, plain, atol=1e-9)
    assert turned.inertia.noise is None


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1,2,3", r"data\.csv:22: must hold 7 finite numbers or more, got 3 columns"),
        ("1,2,3,4,5,6,fast", r"data\.csv:22: must hold 7 finite numbers or more, got 'fast'"),
        ("1,2,3,nan,5,6,7", r"data\.csv:22: must hold 7 finite numbers or more, got nan"),
        ("1 2 3 4 5 6 7", r"data\.csv:22: must hold 7 finite numbers or more, got 1 columns"),
    ],
)
def test_a_broken_row_is_one_line(rig, line, said):
    lines = imu0(rig).read_text().splitlines()
    lines[21] = line
    imu0(rig).write_text("\n".join(lines))
    with pytest.raises(DataError, match=said):
        open_images(rig)


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (5, "'accelerometer' must be made of numbers up to 2000 m/s^2, got -9810: is it in another unit?"),
        (1, "'gyro' must be made of numbers up to 200 rad/s, got -9810: is it in another unit?"),
    ],
)
def test_samples_that_no_sensor_measures_are_one_line(rig, column, said):
    stamp, values = rows()
    values[7, column] = -9810.0
    imu0(rig).write_text(written(stamp, values))
    assert refused(rig) == f"{imu0(rig)}: {said}"


def test_one_sample_is_too_few(rig):
    stamp, values = rows()
    imu0(rig).write_text(written(stamp[:1], values[:1]))
    assert "must have 2 samples or more, got 1" in refused(rig)
    imu0(rig).unlink()
    assert "data.csv: cannot be read" in refused(rig)


def test_noise_is_that_of_the_sensor_file(rig):
    imu0(rig, "sensor.yaml").write_text("sensor_type: imu\nrate_hz: 200\n" + text_of(NOISE))
    assert open_images(rig).inertia.noise == STATED


@pytest.mark.parametrize("place", ["imu.yaml", "mav0/imu.yaml", "dso/imu_config.yaml"])
@pytest.mark.parametrize("inner", [True, False])
def test_noise_is_that_of_kalibr_where_the_sensor_file_has_none(rig, place, inner):
    imu0(rig, "sensor.yaml").write_text("sensor_type: imu\n")
    (rig / place).parent.mkdir(exist_ok=True)
    (rig / place).write_text("imu0:\n" + text_of(NOISE, indent="  ") if inner else text_of(NOISE))
    assert open_images(rig).inertia.noise == STATED


def test_the_sensor_s_own_file_comes_first(rig):
    imu0(rig, "sensor.yaml").write_text(text_of(NOISE))
    (rig / "imu.yaml").write_text(text_of({**NOISE, "gyroscope_noise_density": "9.0"}))
    assert open_images(rig).inertia.noise == STATED


@pytest.mark.parametrize("key", list(NOISE))
def test_noise_that_is_not_stated_whole_is_none(tmp_path, key):
    path = tmp_path / "imu.yaml"
    path.write_text(text_of({name: value for name, value in NOISE.items() if name != key}))
    assert imu_noise(path) is None


@pytest.mark.parametrize("value", ["-1e-3", "much", ".nan", ".inf", "[1, 2]", "true"])
@pytest.mark.parametrize("key", list(NOISE))
def test_noise_that_cannot_be_is_one_line(tmp_path, key, value):
    path = tmp_path / "imu.yaml"
    path.write_text(text_of({**NOISE, key: value}))
    with pytest.raises(DataError, match=rf"imu\.yaml: {key} must be a number .*, got ") as caught:
        imu_noise(path)
    assert "\n" not in str(caught.value)
