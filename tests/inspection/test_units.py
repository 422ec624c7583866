"""Units that are off by a factor, though by no order of magnitude, are a fault of the inspection."""

import pytest

from tests.data.test_plausibility import RIGS, drive, with_baseline, with_stamps, with_twist
from vislam.inspection.units import check_units

FACTORS = {
    "km/h": (lambda item: with_twist(item, velocity=3.6), "linear_velocity looks like km/h"),
    "mph": (lambda item: with_twist(item, velocity=2.237), "linear_velocity looks like mph"),
    "twice the baseline": (lambda item: with_baseline(item, 2.0), "of b is wrong"),
    "frame numbers": (lambda item: with_stamps(item, 1 / 0.1046), "time_stamps are no seconds"),
    "deg/s": (lambda item: with_twist(item, turn=57.3), "angular_velocity looks like deg/s"),
    "baseline in mm": (lambda item: with_baseline(item, 1e3), "b looks like millimetres"),
}


@pytest.mark.parametrize("factor", FACTORS)
def test_a_factor_is_a_fault_with_its_likely_reason(factor):
    spoil, said = FACTORS[factor]
    spoilt = spoil(drive(path="loop"))
    finding = check_units(spoilt, spoilt)
    assert finding.verdict == "fault"
    assert said in finding.text


@pytest.mark.parametrize("rig", RIGS)
def test_good_units_are_no_fault(rig):
    for seed in range(2):
        sequence = drive(rig, seed=seed, gyro_sigma=0.01, velocity_sigma=0.05 * RIGS[rig]["speed"])
        assert check_units(sequence, sequence).verdict in ("ok", "unclear")


def test_a_baseline_in_millimetres_is_mended_by_a_step():
    spoilt = with_baseline(drive(), 1e3)
    proposal = check_units(spoilt, spoilt).proposal
    assert proposal["data.repair.baseline"]["metres"] == pytest.approx(0.59418)
