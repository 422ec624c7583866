"""Figure of :mod:`benchmarks.held_out_ranking`: data in, Figure out."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from scipy.stats import spearmanr


def dots(
    score: Mapping[str, float],
    errors: Mapping[str, Sequence[float]],
    *,
    reference: tuple[str, float],
    title: str,
) -> Figure:
    """One panel for each kind of error, one numbered dot for each run.

    Parameters
    ----------
    score : mapping of name to float
        Of each run, its score [px].
    errors : mapping of title to sequence
        Of each kind, the error of each run in the same order.
    reference : str, float
        Its name, and what it scores itself [px].
    title : str
    """
    figure = Figure(figsize=(3.4 * len(errors), 5.6), layout="constrained")
    runs = [f"{number}  {name}" for number, name in enumerate(score, start=1)]
    panels: Sequence[Axes] = figure.subplots(1, len(errors), sharey=True, squeeze=False)[0]
    pixels = list(score.values())
    for axes, (label, wrong) in zip(panels, errors.items(), strict=True):
        for number, (x, y, name) in enumerate(zip(wrong, pixels, runs, strict=True), start=1):
            axes.plot(x, y, "o", ms=5, color="#0072B2", alpha=0.7, label=name)
            axes.annotate(str(number), (x, y), xytext=(4, 3), textcoords="offset points", fontsize=8)
        axes.axhline(reference[1], color="0.4", lw=1.0, ls="--")
        axes.set(xlabel=label, xscale="log", yscale="log")
        axes.set_title(f"Spearman {spearmanr(wrong, pixels).statistic:.2f}", fontsize=10)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        axes.grid(which="both", color="0.9", lw=0.5)
    panels[0].set_ylabel("held-out tracks, median RMS [px]")
    panels[0].annotate(
        reference[0],
        (1.0, reference[1]),
        xycoords=("axes fraction", "data"),
        ha="right",
        va="bottom",
        fontsize=8,
    )
    # The numbers stand beside the dots and before the names: the key needs no dots of its own.
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        fontsize=8,
        ncols=6,
        handlelength=0.0,
        handletextpad=0.0,
        markerscale=0.0,
    )
    figure.suptitle(title, fontsize=11)
    return figure
