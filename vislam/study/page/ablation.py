"""What an ablation shows: two tables and a figure of what each defect costs."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from vislam.evaluation.metric import METRICS
from vislam.report.canvas import SMALL, legend, logarithmic, new_figure
from vislam.report.colours import colours
from vislam.report.figures import Drawing
from vislam.report.table import Table
from vislam.study.ablation import CASE, Ablation
from vislam.study.page.labels import ERRORS, errors, metric_label
from vislam.study.trials import Trials

DETAILS = {key: METRICS[key].label for key in ("path_length", "nis_per_dof", "nees_pose", "total_time_s")}
"""Metrics that are told beside the error."""
_MISSING = "failed"


def short_table(trials: Trials, ablation: Ablation) -> Table:
    """Defects corrected one after the other: the error of every estimator."""
    key = errors(trials)[0]
    header = [
        "corrected, one after the other",
        *(f"{_name(trials, run)}, {metric_label(key)}" for run in trials.complete),
    ]
    rows = [[label, *_errors(trials, key, case)] for label, case in _steps(ablation)]
    return Table(header, rows)


def mending_table(trials: Trials, ablation: Ablation) -> Table:
    """Defects corrected one after the other: the error of every estimator, and what else is known of it."""
    key = errors(trials)[0]
    details = [name for name in DETAILS if any(_known(trials, run, name) for run in trials.complete)]
    header = ["corrected", "estimator", metric_label(key), *(DETAILS[name] for name in details)]
    rows = []
    for label, case in _steps(ablation):
        for run in trials.complete:
            found = [_value(trials, run, name, case) for name in (key, *details)]
            rows.append(
                [label, _name(trials, run), _number(found[0], missing=_MISSING), *map(_number, found[1:])]
            )
    return Table(header, rows)


def defects_table(trials: Trials, ablation: Ablation) -> Table:
    """Each defect alone: the error where it alone is present or corrected, and what it adds."""
    key = errors(trials)[0]
    title, unit = ERRORS[key].short_title, ERRORS[key].unit
    header = ["defect"]
    header += [f"{_name(trials, run)}: {title} if it alone is there [{unit}]" for run in trials.complete]
    header += [f"{_name(trials, run)}: cost [{unit}]" for run in trials.complete]
    header += [f"{_name(trials, run)}: {title} if it alone is corrected [{unit}]" for run in trials.complete]
    rows = [["none", *_errors(trials, key, ablation.label(()))]]
    rows[0] += ["-"] * (2 * len(trials.complete))
    for alone, mended in zip(ablation.alone(), ablation.mended_alone(), strict=True):
        costs = [cost(trials, run, ablation, alone[0]) for run in trials.complete]
        rows.append(
            [
                alone[0],
                *_errors(trials, key, ablation.label(alone)),
                *(_number(value, signed=True) for value in costs),
                *_errors(trials, key, ablation.label(mended)),
            ]
        )
    return Table(header, rows)


def ablation_figures(trials: Trials, ablation: Ablation) -> dict[str, Drawing]:
    """The figure, by file name."""
    key = errors(trials)[0]
    title = "What each defect costs"
    caption = (
        f"Above: {metric_label(key)} as the defects are corrected from top to bottom. Below: what each adds "
        "where it alone is there. A run that failed has no point."
    )
    figure = new_figure(1.8 + 0.66 * len(ablation.defects))
    above, below = figure.subplots(2, 1)
    labels, steps = zip(*_steps(ablation), strict=True)
    _draw(
        above,
        {run: [_value(trials, run, key, case) for case in steps] for run in trials.complete},
        labels,
        joined=True,
    )
    _draw(
        below,
        {run: [cost(trials, run, ablation, name) for name in ablation.defects] for run in trials.complete},
        ablation.defects,
        joined=False,
    )
    above.set_xlabel(metric_label(key))
    logarithmic(above, "x")
    below.axvline(0.0, color="k", lw=0.6)
    below.set_xscale("symlog", linthresh=1.0)
    below.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    below.set_xlabel(f"added {metric_label(key)}")
    below.margins(x=0.1)
    below.tick_params(axis="x", labelsize=SMALL)
    legend(figure, above)
    return {"ablation": Drawing(title, caption, figure)}


def verdict(trials: Trials, ablation: Ablation) -> list[str]:
    """Sentences: where each estimator begins and ends, and what costs it most."""
    key = errors(trials)[0]
    title, unit = ERRORS[key].short_title, ERRORS[key].unit
    told = []
    for run in trials.complete:
        ends = [_value(trials, run, key, ablation.label(present)) for present in (ablation.defects, ())]
        costs = {name: cost(trials, run, ablation, name) for name in ablation.defects}
        failed = [
            name for name in costs if not trials.complete[run][_rows(trials, ablation.label((name,)))].all()
        ]
        worst = sorted((name for name in costs if costs[name] > 0.0), key=lambda name: -costs[name])[:3]
        listed = ", ".join(f"{name} (+{_number(costs[name])} {unit})" for name in worst)
        begin, end = (_told(value, unit) for value in ends)
        sentence = f"{_name(trials, run)}: {title} {begin} with all defects, {end} with none."
        sentence += f" On their own cost most: {listed}." if listed else ""
        sentence += f" It fails with {', '.join(failed)}." if failed else ""
        told.append(sentence)
    return told


def _name(trials: Trials, run: str) -> str:
    """A run with the estimate that is shown of it, where those of the runs differ."""
    return run if len(trials.estimates) == 1 else f"{run} ({trials.final(run)})"


def _steps(ablation: Ablation) -> list[tuple[str, str]]:
    """What was corrected last and the name of the case, from none corrected to all."""
    named = ["0. nothing", *(f"{step}. {name}" for step, name in enumerate(ablation.defects, start=1))]
    cases = [ablation.label(present) for present in ablation.one_after_the_other()]
    return list(zip(named, cases, strict=True))


def cost(trials: Trials, run: str, ablation: Ablation, defect: str) -> float:
    """What a defect on its own adds to the headline error; NaN where a run failed."""
    key = errors(trials)[0]
    with_it, without = (_value(trials, run, key, ablation.label(present)) for present in ((defect,), ()))
    return with_it - without


def _draw(axes: Axes, series: dict[str, list[float]], names: Sequence[str], *, joined: bool) -> None:
    place = np.arange(len(names))
    for run, colour in colours(series).items():
        axes.plot(series[run], place, "o-" if joined else "o", ms=4, lw=1.0, color=colour, label=run)
    axes.set_yticks(place, names, fontsize=SMALL)
    axes.invert_yaxis()
    axes.grid(axis="x", lw=0.3)


def _rows(trials: Trials, label: str) -> np.ndarray:
    return trials.at({CASE: label})


def _known(trials: Trials, run: str, key: str) -> bool:
    return bool(np.isfinite(trials.value(run, key)).any())


def _value(trials: Trials, run: str, key: str, label: str) -> float:
    """Mean over the seeds of a case, all of which have to be complete."""
    values = trials.value(run, key)[_rows(trials, label)]
    return float(values.mean()) if len(values) else float("nan")


def _errors(trials: Trials, key: str, label: str) -> Iterator[str]:
    for run in trials.complete:
        yield _number(_value(trials, run, key, label), missing=_MISSING)


def _told(value: float, unit: str) -> str:
    return f"{_number(value)} {unit}" if np.isfinite(value) else _MISSING


def _number(value: float, *, missing: str = "-", signed: bool = False) -> str:
    """Three digits, but no fewer than the metres have."""
    if not np.isfinite(value):
        return missing
    digits = 0 if abs(value) >= 1e3 else 1 if abs(value) >= 1e2 else 2
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
