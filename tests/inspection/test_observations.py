"""Faults of all tracks at once: told by their kind, with a remedy, without a step that drops everything."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.data.test_plausibility import drive
from vislam.comparison.config import Config, DataConfig
from vislam.inspection import inspect_sequence
from vislam.inspection.observations import check_observations
from vislam.repair import RepairConfig

NOTHING = RepairConfig(duplicated_tracks=None, disparity=None, consensus=None)
SEQUENCE = drive(frames=30)


def looked_at(pixels, *, repair=NOTHING):
    finding = check_observations(replace(SEQUENCE, pixels=pixels), repair)
    assert not finding.proposal or finding.proposal == {"data.repair.disparity": True}
    return finding


def test_sound_observations_are_told_to_be():
    assert looked_at(SEQUENCE.pixels).verdict == "ok"


@pytest.mark.parametrize("repair", [NOTHING, RepairConfig()])
@settings(derandomize=True, deadline=None, max_examples=15)
@given(good=st.floats(0.0, 0.1), seed=st.integers(0, 100))
def test_swapped_cameras(repair, good, seed):
    pixels = SEQUENCE.pixels[:, [2, 3, 0, 1]].copy()
    right = np.random.default_rng(seed).random(len(pixels)) < good
    pixels[right] = SEQUENCE.pixels[right]
    finding = looked_at(pixels, repair=repair)
    assert finding.verdict == "fault"
    assert "left and right are swapped" in finding.text
    assert finding.proposal == {}


@pytest.mark.parametrize(
    "order", [item for item in permutations(range(4)) if item[0] in (1, 3) or item[1] == 2]
)
def test_channels_in_another_order(order):
    """Orders in which a row stands for a column; a swap of vL and vR alone changes nothing that tells."""
    finding = looked_at(SEQUENCE.pixels[:, order])
    assert finding.verdict == "fault"
    assert "features look to be in the order" in finding.text
    assert finding.proposal == {}


def test_the_order_that_is_named_is_the_one_of_the_file():
    # uL, uR, vL, vR
    finding = looked_at(SEQUENCE.pixels[:, [0, 2, 1, 3]])
    assert "in the order uL, uR, vL, vR;" in finding.text


@settings(derandomize=True, deadline=None, max_examples=20)
@given(shift=st.floats(3.0, 200.0), sign=st.sampled_from([-1.0, 1.0]), turn=st.floats(-0.03, 0.03))
def test_rows_that_differ(shift, sign, turn):
    pixels = SEQUENCE.pixels.copy()
    pixels[:, 1] += sign * shift + turn * (pixels[:, 0] - SEQUENCE.rig.cx)
    finding = looked_at(pixels)
    assert finding.verdict == "fault"
    assert "rectif" in finding.text
    assert finding.proposal == {}


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        ((SEQUENCE.pixels - 600.0) / 500.0, "normalised"),
        (SEQUENCE.pixels / 2.0, "K for a larger image"),
        (SEQUENCE.pixels * 3.0, "K for a smaller image"),
    ],
)
def test_pixels_of_another_image(pixels, said):
    finding = looked_at(pixels)
    assert finding.verdict == "fault"
    assert said in finding.text


@settings(derandomize=True, deadline=None, max_examples=20)
@given(share=st.floats(0.0, 1.0), seed=st.integers(0, 100))
def test_no_step_is_proposed_that_leaves_nearly_nothing(share, seed):
    pixels = SEQUENCE.pixels.copy()
    bad = np.random.default_rng(seed).random(len(pixels)) < share
    # Far beyond the image of a real point: neither swapped nor in another order.
    pixels[bad, 2] = pixels[bad, 0] + 0.1
    finding = looked_at(pixels)
    kept = np.mean(~bad)
    if finding.proposal:
        assert kept > 0.4
    if kept > 0.8 and bad.any():
        assert finding.proposal == {"data.repair.disparity": True}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda pixels: pixels[:, [2, 3, 0, 1]],
        lambda pixels: pixels + np.array([0, 15.0, 0, 0]),
        lambda pixels: np.column_stack([pixels[:, 0], pixels[:, 1], pixels[:, 0] - 0.4, pixels[:, 3]]),
    ],
)
def test_the_whole_inspection_proposes_nothing_that_leaves_nearly_nothing(spoil):
    spoilt = replace(SEQUENCE, pixels=spoil(SEQUENCE.pixels))
    result = inspect_sequence(spoilt, Config(name="s", data=DataConfig(file="s.npz", repair=NOTHING)))
    assert not {"data.repair.disparity", "data.repair.consensus"} & set(result.proposal)
    left = result.finding("repairs").counts
    assert left["observations"] > 0.5 * left["of"]


def test_default_repairs_that_leave_nothing_are_a_fault():
    swapped = replace(SEQUENCE, pixels=SEQUENCE.pixels[:, [2, 3, 0, 1]])
    result = inspect_sequence(swapped, Config(name="s", data=DataConfig(file="s.npz")))
    assert result.finding("repairs").verdict == "fault"
    assert "disparity drops" in result.finding("repairs").text
