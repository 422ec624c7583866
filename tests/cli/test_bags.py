"""Bags on the command line: listed, tracked, compared; what is unclear is one line."""

import json

import pytest

pytest.importorskip("cv2")
pytest.importorskip("rosbags")

from tests.frontend.bags import IMU, TOPICS, write_bag
from tests.frontend.studio import rendered
from vislam.cli.main import main


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bag"), "mcap", rendered(5))


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def test_inspect_lists_topics_and_what_is_taken(bag, capsys):
    assert main(["inspect", str(bag)]) == 0
    said = capsys.readouterr().out
    for name in (*TOPICS, IMU):
        assert name in said
    assert "sensor_msgs/msg/Imu" in said
    assert "5 pairs in 0.4 s (10.0 Hz), 320 x 200 px, radtan lenses, baseline 0.3000 m" in said
    assert "inertial samples: 120 (200 Hz), without velocity" in said
    assert main(["inspect", "--file", str(bag), "--imu", "none"]) == 0
    assert "inertial samples: none" in capsys.readouterr().out


def test_what_is_unclear_is_one_line_after_the_topics(bag, capsys):
    assert main(["inspect", str(bag), "--left", "/no"]) == 2
    said = capsys.readouterr()
    assert TOPICS[0] in said.out
    assert said.err.count("\n") == 1
    assert "must have images on the topic /no" in said.err


def test_a_bag_is_tracked_once(bag, tmp_path, capsys):
    wanted = ["track", str(bag), "-o", "a.npz", "--set", "features=60", "--set", "window_px=15"]
    assert main(wanted) == 0
    assert "5 frames" in capsys.readouterr().out
    assert json.loads((tmp_path / "a_front_end.json").read_text())["counts"]["images_listed"] == 10
    assert main(wanted) == 0
    assert "from the cache" in capsys.readouterr().out


@pytest.mark.slow
def test_images_alone_are_compared_with_rates_that_say_nothing(tmp_path):
    """A list without inertial samples: nothing is known of rates and velocities, and filters still run."""
    import yaml

    from tests.frontend.bags import write_camchain
    from tests.frontend.studio import write_asl

    write_asl(tmp_path, rendered(8))
    write_camchain(tmp_path / "camchain.yaml")
    cameras = "".join(
        f"{side}: {{images: 'mav0/{camera}/data/*.png', rate_hz: 10}}\n"
        for side, camera in (("left", "cam0"), ("right", "cam1"))
    )
    (tmp_path / "images.yaml").write_text(f"calibration: camchain.yaml\n{cameras}")
    command = ["compare", "--data", "images.yaml", "--estimators", "stereo_vo,ekf_invariant", "--no-report"]
    assert main(command) == 0
    config = yaml.safe_load((tmp_path / "results" / "images.yaml").read_text())
    density = config["noise"]["twist_density"]
    assert density[0] == density[1] == density[2] > 0.1
    assert density[3] == density[4] == density[5] > 1.0
