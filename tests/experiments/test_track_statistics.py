"""The statistics that recorded and simulated tracks are compared by."""

from pathlib import Path

import numpy as np
import pytest

from experiments.track_statistics import load_sequence, main, one_frame_spread, statistics
from tests.conftest import recorded
from vislam.comparison import config as configuration
from vislam.comparison.config import DataConfig
from vislam.comparison.open import open_dataset
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

CONFIGS = Path(__file__).parents[2] / "configs"
# The presets say 15 % at most; room is left for other versions of the libraries.
WITHIN = 1.2


def sequence_of(**settings):
    config = DataConfig(
        simulation=SimulationConfig(frames=80, tracks_in_view=40, **settings),
        repair=RepairConfig(consensus=None, single_observations=None),
    )
    return open_dataset(config, seed=4).sequence


def test_lengths_follow_the_chance_of_a_loss():
    # Without motion out of view, lengths are geometric: mean 1 / p, share of length 1 p.
    found = statistics(sequence_of(path="straight", speed=0.01, hills_m=0.0, loss_probability=0.5))
    assert found["share of tracks of length 1"] == pytest.approx(0.5, abs=0.05)
    assert found["share of tracks of length 2"] == pytest.approx(0.25, abs=0.05)
    assert found["track length, mean [frames]"] == pytest.approx(2.0, rel=0.1)
    assert found["tracks in view, mean"] == pytest.approx(40.0, rel=0.1)


def test_the_one_frame_residual_is_that_of_the_pixels():
    quiet, loud = (one_frame_spread(sequence_of(pixel_sigma_px=sigma)) for sigma in (0.1, 0.4))
    assert np.allclose(loud / quiet, 4.0, rtol=0.2)
    # A row is the mean of two, in both frames: 0.1 px in all; half of that lies beyond 0.067 px.
    assert 0.03 < quiet[2] < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recording", "preset"), [("ds3.yaml", "like_03.yaml"), ("kitti07.yaml", "like_0027.yaml")]
)
def test_a_preset_has_the_tracks_of_its_recording(recording, preset):
    config = configuration.load(CONFIGS / recording)
    folder = recorded(config.data.file).parent
    wanted = statistics(load_sequence(config, data_dir=folder, recorded=True))
    like = configuration.load(CONFIGS / preset)
    found = statistics(load_sequence(like, data_dir=None, recorded=False))
    for name, value in wanted.items():
        assert value / WITHIN < found[name] < value * WITHIN, name


def test_configs_with_other_repairs_are_refused(capsys):
    assert main([str(CONFIGS / "ds3.yaml"), str(CONFIGS / "tiny.yaml")]) == 2
    assert "data.repair" in capsys.readouterr().err
