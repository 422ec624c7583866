"""What a check says, when it holds, and how seldom a test of consistency fails sound results."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import chi2

from vislam.base.errors import ConfigError, DataError
from vislam.checks.judge import Checklist, rerun_noise, summary
from vislam.checks.junit import write_junit
from vislam.checks.saved import Saved
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.core.run import Log
from vislam.evaluation import Evaluation, Metric

VALUES = {
    ("ekf", "ate_rmse"): (2.0, "m"),
    ("isam2", "ate_rmse"): (1.5, "m"),
    ("isam2", "kitti_t_rel"): (0.8, "%"),
    ("isam2", "total_time_s"): (9.0, "s"),
    ("ekf", "nis_per_dof"): (1.1, "1"),
    ("ekf", "height_end"): (float("nan"), "m"),
    ("ekf|isam2", "trajectory_distance_rmse"): (0.4, "m"),
}
EVALUATION = Evaluation([Metric(*key, *value) for key, value in VALUES.items()])
BOTH = Evaluation(
    [
        Metric("ekf", "ate_rmse", 2.0, "m", estimate="filtered"),
        Metric("isam2", "ate_rmse", 2.5, "m", estimate="filtered"),
        Metric("isam2", "ate_rmse", 1.5, "m", estimate="smoothed"),
        Metric("isam2", "peak_rss_mb", 90.0, "MB"),
    ]
)
"""A filter, and a smoother that is worse at each frame and better in the end."""


@cache
def interval(probability: float, total: float) -> tuple[float, float]:
    tail = 0.5 * (1.0 - probability)
    return float(chi2.ppf(tail, total)) / total, float(chi2.isf(tail, total)) / total


@dataclass(frozen=True)
class Fake:
    """A mean of squared errors, chi-square distributed if the run is consistent."""

    value: float
    freedom: int = 6
    samples: int = 300
    effective: float = 50.0
    name: str = "nees_pose"
    convention: str = "1 is expected"

    @property
    def _total(self) -> float:
        return self.freedom * self.effective

    def interval(self, probability: float) -> tuple[float, float]:
        return interval(probability, self._total)

    def p_value(self) -> float:
        below = float(chi2.cdf(self.value * self._total, self._total))
        return 2.0 * min(below, 1.0 - below)


def config_of(*checks, **more) -> Config:
    tree = {
        "name": "c",
        "data": {"simulation": {}},
        "estimators": {"ekf": {}, "isam2": {}},
        "checks": list(checks),
    }
    return configuration.parse(Config, {**tree, **more})


def runs(**errors):
    found = {name: errors.get(name, "") for name in ("ekf", "isam2")}
    return {name: SimpleNamespace(complete=not error, log=Log(error)) for name, error in found.items()}


def saved(values=None, *, complete=True) -> Saved:
    values = {("isam2", "ate_rmse"): 1.45, ("isam2", "total_time_s"): 1.0} if values is None else values
    done = {name: complete for name, _ in values}
    entries = {(name, key, None): value for (name, key), value in values.items()}
    return Saved(Path("old/metrics.json"), "drive", "d" * 64, "truth", done, entries)


def judged(*checks, old=None, evaluation=EVALUATION, **errors):
    return Checklist.of(config_of(*checks), saved=old).judge(runs(**errors), evaluation)


def bound(estimator="isam2", metric="ate_rmse", **more):
    return {"estimator": estimator, "metric": metric, **more}


HOLDS = {
    "isam2 ate_rmse at most 1.5 m: 1.5 m": bound(at_most=1.5),
    "isam2 ate_rmse at least 1.5 m: 1.5 m": bound(at_least=1.5),
    "ekf nis_per_dof at least 0.8 and at most 1.2: 1.1": bound(
        "ekf", "nis_per_dof", at_least=0.8, at_most=1.2
    ),
    "isam2 ate_rmse at most 0.75 times that of ekf: 1.5 m, ekf 2 m": bound(at_most=0.75, times="ekf"),
    "isam2 ate_rmse at most 1.04 times the saved: 1.5 m, saved 1.45 m": bound(at_most=1.04, times="saved"),
    "ekf|isam2 trajectory_distance_rmse at most 0.5 m: 0.4 m": bound(
        "ekf|isam2", "trajectory_distance_rmse", at_most=0.5
    ),
}


@pytest.mark.parametrize("text", HOLDS)
def test_a_bound_that_is_kept_holds_and_says_what_was_measured(text):
    check = HOLDS[text]
    (verdict,) = judged(check, old=saved() if check.get("times") == "saved" else None)
    assert verdict.holds
    assert verdict.line() == f"holds  {text}"


FAILS = {
    "isam2 ate_rmse at most 1.49 m: 1.5 m": bound(at_most=1.49),
    "isam2 ate_rmse at least 1.51 m: 1.5 m": bound(at_least=1.51),
    "ekf nis_per_dof at least 0.8 and at most 1: 1.1": bound("ekf", "nis_per_dof", at_least=0.8, at_most=1),
    "isam2 ate_rmse at most 0.74 times that of ekf: 1.5 m, ekf 2 m": bound(at_most=0.74, times="ekf"),
    "isam2 ate_rmse at least 0.76 times that of ekf: 1.5 m, ekf 2 m": bound(at_least=0.76, times="ekf"),
    "isam2 ate_rmse at most 1.03 times the saved: 1.5 m, saved 1.45 m": bound(at_most=1.03, times="saved"),
    "ekf height_end at most 9 m: nan m": bound("ekf", "height_end", at_most=9),
    "ekf height_end at least -9 m: nan m": bound("ekf", "height_end", at_least=-9),
    "isam2 ate_rms at most 1: isam2 has no such metric; it has ate_rmse, kitti_t_rel, total_time_s": bound(
        metric="ate_rms", at_most=1
    ),
    "isam2 kitti_t_rel at most 1 times that of ekf: ekf has no kitti_t_rel": bound(
        metric="kitti_t_rel", at_most=1, times="ekf"
    ),
    "isam2 kitti_t_rel at most 1 times the saved: no kitti_t_rel in old/metrics.json": bound(
        metric="kitti_t_rel", at_most=1, times="saved"
    ),
    "ekf ate_rmse at most 1 times the saved: no complete run of ekf in old/metrics.json": bound(
        "ekf", at_most=1, times="saved"
    ),
}


@pytest.mark.parametrize("text", FAILS)
def test_a_bound_that_is_not_kept_or_cannot_be_judged_does_not_hold_and_says_why(text):
    check = FAILS[text]
    (verdict,) = judged(check, old=saved() if check.get("times") == "saved" else None)
    assert verdict.line() == f"FAILS  {text}"


OF_AN_ESTIMATE = {
    "holds  isam2 ate_rmse at most 1.5 m: 1.5 m": bound(at_most=1.5),
    "holds  isam2 smoothed ate_rmse at most 1.5 m: 1.5 m": bound(at_most=1.5, estimate="smoothed"),
    "FAILS  isam2 filtered ate_rmse at most 1.5 m: 2.5 m": bound(at_most=1.5, estimate="filtered"),
    "holds  isam2 filtered peak_rss_mb at most 90 MB: 90 MB": bound(
        metric="peak_rss_mb", at_most=90, estimate="filtered"
    ),
    "FAILS  ekf smoothed ate_rmse at most 2: ekf has no such metric of its smoothed poses; it has none": (
        bound("ekf", at_most=2, estimate="smoothed")
    ),
    # Of two runs the last estimate that both have: the smoothed one is not held against a filtered one.
    "FAILS  isam2 ate_rmse at most 1 times that of ekf: 2.5 m, ekf 2 m": bound(at_most=1, times="ekf"),
}


@pytest.mark.parametrize("line", OF_AN_ESTIMATE)
def test_a_check_is_of_the_estimate_that_it_names_or_else_of_the_final_one(line):
    (verdict,) = judged(OF_AN_ESTIMATE[line], evaluation=BOTH)
    assert verdict.line() == line


def test_a_verdict_says_of_which_estimate_it_is():
    checks = [bound(at_most=9), bound(at_most=9, estimate="filtered"), bound(metric="peak_rss_mb", at_most=9)]
    found = judged(*checks, evaluation=BOTH)
    assert [verdict.record()["estimate"] for verdict in found] == ["smoothed", "filtered", None]


def test_an_incomplete_run_holds_nothing_even_if_its_part_is_accurate():
    verdicts = judged(bound(at_most=9), bound("ekf", at_most=9, times="isam2"), isam2="frame 9: lost")
    assert [verdict.measured for verdict in verdicts] == ["isam2 is incomplete: frame 9: lost"] * 2
    assert not any(verdict.holds for verdict in verdicts)
    (verdict,) = judged(bound(at_most=2, times="saved"), old=saved(complete=False))
    assert not verdict.holds


def test_nan_is_no_saved_value_to_keep_to():
    (verdict,) = judged(bound(at_most=9, times="saved"), old=saved({("isam2", "ate_rmse"): float("nan")}))
    assert not verdict.holds


MISTAKES = {
    "checks.0: one of metric and test must be given": {"estimator": "ekf"},
    "checks.0: one of metric and test": bound(test="nis", at_most=1),
    "checks.0: at_most or at_least must be given": bound(),
    "checks.0: at_least must not be above at_most, got 2 and 1": bound(at_least=2, at_most=1),
    "checks.0: test has its bounds from false_alarm_rate": {"estimator": "ekf", "test": "nis", "at_most": 1},
    "checks.0: times must name another run": bound(at_most=1, times="isam2"),
    "checks.0.atmost: unknown key; known are at_least, at_most, estimate, estimator": bound(atmost=1),
    "checks.0.at_most: Input should be a finite number": bound(at_most=float("inf")),
    "checks.0.estimator: ": {"metric": "ate_rmse", "at_most": 1},
    "checks.0.estimator: expected one of ekf, isam2, got ukf": bound("ukf", at_most=1),
    "checks.0.estimator: expected one of ekf, isam2 (two in this order), got isam2|ekf": bound(
        "isam2|ekf", at_most=1
    ),
    "checks.0.times: expected one of ekf, isam2, saved, got ukf": bound(at_most=1, times="ukf"),
    "checks.0.times: no saved results are given; name them with --against": bound(at_most=1, times="saved"),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_a_mistake_gets_one_line(message):
    with pytest.raises(ConfigError) as raised:
        Checklist.of(config_of(MISTAKES[message]))
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("rate", [0, 1, -0.1])
def test_a_false_alarm_rate_is_a_chance(rate):
    with pytest.raises(ConfigError, match="false_alarm_rate"):
        config_of(false_alarm_rate=rate)


def test_an_estimator_named_saved_is_refused_where_it_could_be_meant():
    check = bound("ekf", at_most=1, times="saved")
    with pytest.raises(ConfigError, match=r"estimators\.saved"):
        Checklist.of(config_of(check, estimators={"ekf": {}, "saved": {"estimator": "isam2"}}), saved=saved())


def test_checks_of_estimators_that_are_not_chosen_are_left_out():
    whole = config_of(bound(at_most=1), bound("ekf", at_most=1), bound("ekf", at_most=1, times="isam2"))
    chosen = configuration.with_estimators(whole, {"ekf": {}})
    assert chosen.checks == whole.checks[1:2]


def test_without_a_word_of_saved_results_no_error_may_be_larger_than_them():
    checklist = Checklist.of(config_of(bound("ekf", at_most=9)), saved=saved(), tolerance=0.05)
    verdicts = checklist.judge(runs(), EVALUATION)
    assert [verdict.check for verdict in verdicts] == [
        "ekf ate_rmse at most 9 m",
        "isam2 ate_rmse at most 1.05 times the saved",
    ]
    assert all(verdict.holds for verdict in verdicts)
    strict = Checklist.of(config_of(), saved=saved(), tolerance=0.0).judge(runs(), EVALUATION)
    assert [verdict.holds for verdict in strict] == [False]


def test_a_difference_below_the_noise_of_a_rerun_is_none():
    """1.5 m against a saved 1.49995 m at no tolerance: less than another processor's rounding may do."""
    old = saved({("isam2", "ate_rmse"): 1.5 - 0.5 * rerun_noise("m")})
    (near,) = Checklist.of(config_of(), saved=old, tolerance=0.0).judge(runs(), EVALUATION)
    assert near.holds
    old = saved({("isam2", "ate_rmse"): 1.5 - 2.0 * rerun_noise("m")})
    (far,) = Checklist.of(config_of(), saved=old, tolerance=0.0).judge(runs(), EVALUATION)
    assert not far.holds
    # A bound that somebody has set is kept to the letter, and a unit without a known noise has none.
    assert not judged(bound(at_most=1.5 - 0.5 * rerun_noise("m")))[0].holds
    assert rerun_noise("parsec") == 0.0


def test_the_summary_counts_what_does_not_hold():
    verdicts = judged(bound(at_most=1.0), bound(at_most=9.0), bound(at_most=9.0))
    assert summary(verdicts) == "1 of 3 checks do not hold"
    assert summary(verdicts[1:]) == "all 2 checks hold"


def test_saved_results_without_an_error_to_compare_are_refused():
    with pytest.raises(DataError, match=r"old/metrics\.json: no error of ekf, isam2"):
        Checklist.of(config_of(), saved=saved({("isam2", "total_time_s"): 1.0}))


def consistency_tests(count):
    return [{"test": f"nees_{index}", "estimator": "ekf"} for index in range(count)]


def statistics(values):
    return Evaluation([], {("ekf", f"nees_{index}", None): Fake(value) for index, value in enumerate(values)})


def test_a_test_says_value_interval_samples_rate_and_convention():
    (verdict,) = judged(*consistency_tests(1), evaluation=statistics([1.02]))
    assert verdict.holds
    assert verdict.check == "ekf nees_0 is that of a consistent estimator"
    # Chi-square of 300 degrees of freedom over 300; its normal approximation has 1 +- 2.58 sqrt(2 / 300).
    assert verdict.measured.startswith("1.02, expected 0.8022 to 1.223 (p 0.79, ")
    assert "50 effective of 300 samples, 6 degrees of freedom each" in verdict.measured
    assert verdict.measured.endswith("false-alarm rate 0.01)")
    assert verdict.convention == "1 is expected"


def test_the_rate_is_shared_out_evenly_among_the_tests():
    # A value between the 99 % and the 99.8 % interval: alone it fails, as one of five it holds.
    between = Fake(0.0).interval(0.995)[1]
    assert not judged(*consistency_tests(1), evaluation=statistics([between]))[0].holds
    five = judged(*consistency_tests(5), evaluation=statistics([between] * 5))
    assert all(verdict.holds for verdict in five)
    low, high = Fake(0.0).interval(1.0 - 0.01 / 5)
    assert f"expected {low:.4g} to {high:.4g}" in five[0].measured
    assert "false-alarm rate 0.01 for 5 tests together, Bonferroni" in five[0].measured


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.5, 1.6])
def test_a_statistic_out_of_its_interval_does_not_hold(value):
    assert not judged(*consistency_tests(2), evaluation=statistics([value, 1.0]))[0].holds


def test_a_statistic_that_is_missing_does_not_hold():
    (verdict,) = judged(*consistency_tests(1))
    assert verdict.line() == (
        "FAILS  ekf nees_0 is that of a consistent estimator: ekf has no such statistic"
    )


@pytest.mark.statistical
def test_sound_results_fail_a_test_as_seldom_as_the_rate_says(rng):
    rate, tests, trials = 0.1, 8, 1000
    config = config_of(*consistency_tests(tests), false_alarm_rate=rate)
    total = 6 * 50.0
    checklist = Checklist.of(config)

    def alarms(scale):
        drawn = scale * rng.chisquare(total, (trials, tests)) / total
        return sum(
            not all(verdict.holds for verdict in checklist.judge(runs(), statistics(values)))
            for values in drawn
        )

    # Of independent tests at rate / tests each, some 1 - (1 - 0.1 / 8)^8 = 9.6 % of the trials fail; four
    # standard deviations of their count are 37.
    expected = trials * (1.0 - (1.0 - rate / tests) ** tests)
    assert abs(alarms(1.0) - expected) < 4.0 * np.sqrt(expected)
    # Errors 20 % too large are caught nearly always, by one of eight.
    assert alarms(1.44) > 0.99 * trials


CHECK = {"name": "a", "convention": ""}
DOCUMENT = {
    "name": "ci",
    "dataset": {"name": "simulation", "digest": "abc", "synthetic": True, "reference": None},
    "provenance": {"code": "123", "cpu": "some & any"},
    "runs": {"ekf": {"complete": True, "error": ""}, "isam2": {"complete": False, "error": "f \x1b[1m<9>"}},
    "metrics": [{"estimator": "ekf", "key": "total_time_s", "value": 1.25}],
    "checks": [
        {**CHECK, "check": "a < b", "holds": True, "measured": "1", "estimator": "ekf"},
        {**CHECK, "check": "c", "holds": False, "measured": "isam2 & so on", "estimator": "isam2"},
    ],
}


def test_junit_counts_failures_and_errors_and_can_be_read_back(tmp_path):
    write_junit(tmp_path / "deep" / "out.xml", DOCUMENT)
    root = ElementTree.parse(tmp_path / "deep" / "out.xml").getroot()
    assert (root.tag, [child.tag for child in root]) == ("testsuites", ["testsuite"])
    suite = root[0]
    counted = {"tests": "4", "failures": "1", "errors": "1", "time": "1.250"}
    assert {key: root.get(key) for key in counted} == counted
    assert {key: suite.get(key) for key in counted} == counted
    cases = {(case.get("classname"), case.get("name")): case for case in suite.iter("testcase")}
    assert list(cases) == [
        ("ci.ekf", "completes"),
        ("ci.isam2", "completes"),
        ("ci.ekf", "a < b"),
        ("ci.isam2", "c"),
    ]
    assert all(float(case.get("time")) >= 0.0 for case in cases.values())
    # The escape character has no place in XML.
    assert cases["ci.isam2", "completes"].find("error").get("message") == "f ?[1m<9>"
    assert cases["ci.isam2", "c"].find("failure").text == "isam2 & so on"
    assert cases["ci.ekf", "a < b"].find("failure") is None
    properties = {item.get("name"): item.get("value") for item in suite.find("properties")}
    assert properties["dataset.digest"] == "abc"
    assert properties["provenance.cpu"] == "some & any"


def test_junit_is_written_whole_or_not_at_all(tmp_path):
    (tmp_path / "out.xml").write_text("before", encoding="utf-8")
    with pytest.raises(KeyError):
        write_junit(tmp_path / "out.xml", {key: DOCUMENT[key] for key in DOCUMENT if key != "checks"})
    assert (tmp_path / "out.xml").read_text(encoding="utf-8") == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["out.xml"]
