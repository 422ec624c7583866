"""Figure of :mod:`benchmarks.held_out_ranking`: data in, Figure out."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import spearmanr


def dots(score: Mapping[str, float], errors: Mapping[str, Sequence[float]], *, title: str) -> Figure:
    """One panel for each kind of error, one numbered dot for each run.

    Parameters
    ----------
    score : mapping of name to float
        Of each run, its score [px].
    errors : mapping of title to sequence
        Of each kind, the error of each run in the same order.
    title : str
    """
    figure = Figure(figsize=(4.0 * len(errors), 5.6), layout="constrained")
    runs = [f"{number}  {name}" for number, name in enumerate(score, start=1)]
    panels: Sequence[Axes] = figure.subplots(1, len(errors), sharey=True, squeeze=False)[0]
    pixels = list(score.values())
    for axes, (label, wrong) in zip(panels, errors.items(), strict=True):
        for number, (x, y, name) in enumerate(zip(wrong, pixels, runs, strict=True), start=1):
            axes.plot(x, y, "o", ms=13, mfc="#9ecae1", mec="0.3", mew=0.5, alpha=0.8, label=name)
            axes.annotate(str(number), (x, y), ha="center", va="center", fontsize=7)
        axes.set(xlabel=label, xscale="log", yscale="log")
        axes.set_title(f"Spearman {spearmanr(wrong, pixels).statistic:.2f}", fontsize=10)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        axes.grid(which="both", color="0.9", lw=0.5)
    panels[0].set_ylabel("held-out tracks, median RMS [px]")
    # The numbers are in the dots and in the names: the key needs no dots of its own.
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        fontsize=8,
        ncols=5,
        handlelength=0.0,
        handletextpad=0.0,
        markerscale=0.0,
    )
    figure.suptitle(title, fontsize=11)
    return figure
