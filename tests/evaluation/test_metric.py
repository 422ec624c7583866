"""The registry of metrics says what the metrics themselves say, and of nothing that there is not."""

import pytest

import vislam
from vislam.core.run import BESIDE
from vislam.evaluation.metric import METRICS, is_error

UNITS = {"1": "", "1/rad^2": "1/rad²"}


@pytest.fixture(scope="module")
def computed():
    outcome = vislam.compare("ci", estimators=["ekf", "isam2"], data__simulation__frames=60)
    return {item.key: item.unit for item in outcome.evaluation.metrics}


def test_units_are_those_that_are_computed(computed):
    shared = METRICS.keys() & computed.keys()
    assert len(shared) > 15
    for key in shared:
        assert METRICS[key].unit == UNITS.get(computed[key], computed[key])


def test_no_metric_is_made_up(computed):
    # Of a reference without attitudes, of a drive of more than 100 m, of a filter that measures it, of a
    # bound that was asked for.
    assert METRICS.keys() - computed.keys() <= {
        "nees_position_planar",
        "nees_position_aligned",
        "scale_gap_position_planar",
        "scale_gap_position_aligned",
        "coverage_90_position_planar",
        "coverage_90_position_aligned",
        "kitti_t_rel",
        "kitti_r_rel",
        "spurious_yaw_information",
        *(key for key in METRICS if key.startswith("bound_")),
        # Of other covariances than the estimator's own.
        *(key for key in METRICS if key.endswith(BESIDE)),
        # Of trajectories from elsewhere.
        *("rows_matched", "share_matched", "completion", "scale", "clock_offset", "map_points_complete"),
    }


def test_every_error_that_is_named_is_one_of_which_less_is_better(computed):
    for key, spec in METRICS.items():
        assert is_error(key) == (spec.better == "less" and not key.endswith(("_ms", "_s", "_mb"))), key
    assert is_error("rpe_100m_rmse")
    assert not is_error("nees_pose")


def test_labels_carry_the_unit_once():
    for spec in METRICS.values():
        for label in (spec.label, spec.short_label):
            assert label.count("[") == bool(spec.unit)


@pytest.mark.parametrize(
    ("values", "places"),
    [
        ([0.0052, 0.0040], 4),
        ([0.052, None], 3),
        ([0.52, 0.004], 2),
        ([12.0, float("nan")], 2),
        ([0.0], 2),
        ([], 2),
    ],
)
def test_lengths_are_shown_to_two_digits_that_count(values, places):
    assert METRICS["ate_rmse"].places(values) == places
    assert METRICS["held_out_median"].places(values) == METRICS["held_out_median"].digits
