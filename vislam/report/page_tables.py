"""The tables of the page that the terminal does not show."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from vislam.core.run import Estimate, Run
from vislam.core.sequence import Repair
from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import AblationStep
from vislam.evaluation.difference import ErrorDifference
from vislam.evaluation.evaluate import mean_step_ms
from vislam.evaluation.metric import LAG_METRICS, METRICS, is_error
from vislam.evaluation.scores import EstimatePair
from vislam.evaluation.shared_errors import estimated_errors
from vislam.evaluation.smoothing import SmoothingDifference
from vislam.evaluation.trajectory import Statistics
from vislam.evaluation.trajectory_scores import WORST_LENGTH, TrajectoryScores
from vislam.report.table import Table
from vislam.report.words import plain

_GROUPS = ("Accuracy and prediction", "Consistency", "Work and cost")
_OF_ACCURACY = ("path_length", "height_end")
_OF_WORK = ("landmarks", "observations_used", "observations_gated")


def grouped(table: Table) -> list[tuple[str, Table]]:
    """The table of a comparison turned, a row an estimator, in parts by what its metrics are about."""
    status = [row for row in table.rows if row[0] == "status"]
    found = []
    for group in _GROUPS:
        rows = [row for row, key in zip(table.rows, table.keys, strict=True) if key and _group(key) == group]
        if rows:
            header, *body = zip(table.header, *status, *rows, strict=True)
            found.append((group, Table(["estimator", *header[1:]], body)))
    return found


def _group(key: str) -> str:
    if is_error(key) or key in _OF_ACCURACY:
        return _GROUPS[0]
    if key in _OF_WORK or key.endswith(("_time_s", "_ms", "_mb")):
        return _GROUPS[2]
    return _GROUPS[1]


def errors_table(evaluation: Evaluation) -> Table:
    """Root mean square, mean, median and largest of the errors of each estimate of each run."""
    rows = []
    for name, one in evaluation.scores.items():
        for estimate, found in one.estimates.items():
            if found.trajectory is not None:
                for what, unit, scale, values in _errors(found.trajectory):
                    told = [
                        f"{scale * value:.3f}"
                        for value in (values.rmse, values.mean, values.median, values.max)
                    ]
                    rows.append([name, estimate, f"{what} [{unit}]", *told])
    return Table(["estimator", "estimate", "error", "rmse", "mean", "median", "max"], rows)


def _errors(scores: TrajectoryScores) -> Iterator[tuple[str, str, float, Statistics]]:
    degrees = float(np.rad2deg(1.0))
    yield "position, aligned", "m", 1.0, scores.headline.position
    if scores.headline.rotation is not None:
        yield "attitude, aligned", "deg", degrees, scores.headline.rotation
    for length, one in scores.by_distance.items():
        if one.translation is not None:
            yield f"over {length:g} m", "m", 1.0, one.translation
        if one.rotation is not None:
            yield f"over {length:g} m", "deg", degrees, one.rotation


def ablation_table(steps: Sequence[AblationStep]) -> Table:
    """A row for each step of the ablation chain, against the one before."""
    title = METRICS[steps[0].key].short_title if steps else ""
    header = ["step", "adds"]
    header += [f"filtered {title} [m]", "change [m]", f"smoothed {title} [m]", "change [m]"]
    header.append("smoothed less filtered [m]")
    rows = [
        [
            step.run,
            step.adds,
            _metres(step.filtered, ".2f"),
            _metres(step.filtered_change, "+.2f"),
            _metres(step.smoothed, ".2f"),
            _metres(step.smoothed_change, "+.2f"),
            _metres(step.smoothing, "+.2f"),
        ]
        for step in steps
    ]
    return Table(header, rows)


def _metres(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def pairs_table(evaluation: Evaluation) -> Table:
    """A row for each two runs and each estimate that both have: how far apart they are, who predicts better.

    The maps are those of the final estimates.
    """
    header = ["estimators", "estimate", "difference of the ATE [m]", "95 % interval [m]", "apart [m]"]
    header += ["aligned [m]", "maps, median [m]", "first predicts better [%]", "p"]
    keys = ("trajectory_distance_rmse", "trajectory_distance_aligned_rmse", "map_distance_median")
    rows = []
    for name, estimate, pair in _pairs(evaluation):
        held = pair.held_out
        apart = [_metres(evaluation.value("|".join(name), key, estimate), ".2f") for key in keys]
        better = ["-", "-"] if held is None else [f"{100.0 * held.better:.0f}", f"{held.p_value:.2g}"]
        rows.append([" and ".join(name), estimate, *_error(pair.error), *apart, *better])
    return Table(header, rows)


def certainty_table(evaluation: Evaluation) -> Table:
    """A row for each two runs and each estimate of which both have covariances: do they agree within them."""
    header = ["estimators", "estimate", "squared distance per degree of freedom", "poses beyond 95 %"]
    header += ["inconsistent from frame", "variance of the first over the second", "least in", "most in"]
    rows = []
    for name, estimate, pair in _pairs(evaluation):
        found = pair.agreement
        if found is not None:
            certainty, frame = found.certainty(), found.divergence()
            told = [f"{found.per_freedom:.2f}", f"{100.0 * found.share_beyond():.0f} %"]
            told += ["never" if frame is None else str(frame), plain(certainty.overall)]
            told += [certainty.smallest_along, certainty.largest_along]
            rows.append([" and ".join(name), estimate, *told])
    return Table(header, rows)


def _pairs(evaluation: Evaluation) -> Iterator[tuple[tuple[str, str], Estimate, EstimatePair]]:
    for name, scores in evaluation.pairs.items():
        for estimate, pair in scores.estimates.items():
            yield name, estimate, pair


def _error(found: ErrorDifference | None) -> list[str]:
    """Difference of two ATEs and its interval."""
    if found is None:
        return ["-", "-"]
    if not found.known:
        return [f"{found.value:+.2f}", "cannot be told"]
    return [f"{found.value:+.2f}", f"{found.low:+.2f} to {found.high:+.2f}"]


def smoothing_table(evaluation: Evaluation) -> Table:
    """Filtered against smoothed poses, on equal information, by both scales."""
    header = ["filtered and smoothed", "by the difference of covariances", "expected", "frames"]
    header += ["more certain filtered than smoothed", "by the sum"]
    rows = [
        [name, *_by_difference(one.smoothing), "-"]
        for name, one in evaluation.scores.items()
        if one.smoothing is not None
    ]
    rows += [
        [" and ".join(pair), *_by_difference(two.smoothing), f"{two.by_sum.per_freedom:.2f}"]
        for pair, two in evaluation.pairs.items()
        if two.smoothing is not None and two.by_sum is not None
    ]
    return Table(header, rows)


def _by_difference(found: SmoothingDifference) -> list[str]:
    """Value, what is expected of it, frames, and frames that are counted and not tested."""
    statistic = found.statistic()
    if statistic is None:
        return ["-", "-", "0", str(found.indefinite)]
    low, high = statistic.interval(0.95)
    told = [f"{statistic.value:.2f}", f"{low:.2f} to {high:.2f}", str(statistic.samples)]
    return [*told, str(found.indefinite)]


def maps_table(evaluation: Evaluation) -> Table:
    """Landmark by landmark between two runs, by depth and by number of views."""
    header = ["estimators", "by", "from", "to", "landmarks", "median distance [m]"]
    header += ["median Mahalanobis distance", "beyond 95 %"]
    rows = []
    for (one, other), scores in evaluation.pairs.items():
        for by, bins in (("depth [baselines]", scores.by_depth()), ("views", scores.by_views())):
            for row in bins:
                if row.count:
                    ends = [f"{row.low:g}", "" if np.isinf(row.high) else f"{row.high:g}"]
                    told = [_number(row.distance, ".2f"), _number(row.mahalanobis, ".2f")]
                    share = _number(100.0 * row.beyond, ".0f")
                    rows.append([f"{one} and {other}", by, *ends, str(row.count), *told, share])
    return Table(header, rows)


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def lags_table(evaluation: Evaluation) -> Table:
    """A row for each run and lag: what the poses are worth that are known so much later."""
    scored = {name: one for name, one in evaluation.scores.items() if one.lags}
    found = {key for one in scored.values() for lag in one.lags for key in lag.values}
    specs = [spec for key, spec in LAG_METRICS.items() if key in found]
    rows = []
    for name, one in scored.items():
        step = mean_step_ms(one.run)
        for lag in one.lags:
            values = [lag.values.get(spec.key) for spec in specs]
            told = [
                "-" if v is None else f"{v:.{spec.digits}f}" for v, spec in zip(values, specs, strict=True)
            ]
            seconds = "all" if lag.seconds is None else f"{lag.seconds:.2f}"
            rows.append([name, lag.label, seconds, *told, "-" if step is None else f"{step:.1f}"])
    header = ["estimator", "lag [frames]", "lag [s]", *(spec.short_label for spec in specs)]
    return Table([*header, "mean step time, all lags read [ms]"], rows)


def shared_errors_table(runs: Mapping[str, Run]) -> Table:
    """A row for each component of an error that all tracks share, as each run has estimated it."""
    rows = []
    for one in estimated_errors(runs):
        for index, (value, sigma) in enumerate(zip(one.value, one.sigma, strict=True)):
            name = one.name.replace("_", " ") + (f" {index + 1}" if len(one.value) > 1 else "")
            rows.append([one.run, name, one.unit, f"{value:.3g}", _number(sigma, ".2g")])
    return Table(["estimator", "error that all tracks share", "unit", "estimate", "sigma"], rows)


def worst_table(evaluation: Evaluation) -> Table:
    """Where each estimate of each run errs most."""
    rows = [
        [name, estimate, str(worst.first), str(worst.last), f"{worst.start:.0f}", f"{worst.error:.2f}"]
        for name, one in evaluation.scores.items()
        for estimate, found in one.estimates.items()
        if found.trajectory is not None
        for worst in found.trajectory.worst
    ]
    header = ["estimator", "estimate", "from frame", "to frame", "begins at [m]"]
    return Table([*header, f"error over {WORST_LENGTH:g} m [m]"], rows)


def counts_table(counts: Mapping[str, int], repairs: Sequence[Repair], runs: Mapping[str, Run]) -> Table:
    """What was read, dropped, held out, gated and rescued."""
    elsewhere = {key for step in repairs for key in step.counts}
    rows = [["data", key.replace("_", " "), str(counts[key])] for key in counts if key not in elsewhere]
    for name, run in runs.items():
        own = {"observations gated": int(run.gated.sum()), **run.log.counts}
        rows += [[name, key.replace("_", " "), str(value)] for key, value in own.items()]
    return Table(["where", "what", "count"], rows)


def repairs_table(repairs: Sequence[Repair]) -> Table:
    """What became of each step; one that is switched off is listed too."""
    rows = []
    for step in repairs:
        options = ", ".join(f"{key.replace('_', ' ')} {_plain(value)}" for key, value in step.options.items())
        done = ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in step.counts.items())
        rows.append([step.name.replace("_", " "), (options or "on") if step.applied else "off", done])
    return Table(["repair", "setting", "counted"], rows)


def _plain(value: object) -> str:
    return " ".join(str(item) for item in value) if isinstance(value, tuple | list) else str(value)
