"""The commands from Python: nothing is printed, and nothing is written unless asked.

The heavy imports follow the calls, so that ``import vislam`` is quick.
"""

import sys
from collections.abc import Mapping
from collections.abc import Sequence as Several
from dataclasses import dataclass, replace
from html import escape
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, overload

from vislam.base.errors import ConfigError
from vislam.base.former import metric_key, note
from vislam.base.shipped import find_config

if TYPE_CHECKING:
    from vislam.base.progress import Progress
    from vislam.comparison.config import Config, HeldOutConfig
    from vislam.comparison.open import Dataset
    from vislam.comparison.results import Results
    from vislam.core.estimator import Estimator
    from vislam.core.run import Estimate, Run
    from vislam.core.sequence import Sequence
    from vislam.datasets.settings import TrajectoryConfig
    from vislam.evaluation import Evaluation
    from vislam.inspection import Inspection
    from vislam.report.table import Table

File = str | Path | Mapping[str, Any]
"""A trajectory file, or what can be set of one."""


class CallableModule(ModuleType):
    """A module of a command that can be called as the function of its name, which its import would hide."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the function of this module."""
        return globals()[self.__name__.rpartition(".")[2]](*arguments, **options)


def make_callable(name: str) -> None:
    """Let a module that is being imported be called, and explained, as the function of its name."""
    # The main module of a process that this one starts has another name.
    if name not in ("__main__", "__mp_main__"):
        module, function = sys.modules[name], globals()[name.rpartition(".")[2]]
        module.__class__ = CallableModule
        module.__doc__ = function.__doc__
        vars(module)["__signature__"] = signature(function)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a comparison.

    Attributes
    ----------
    results : Results
        The sequence and its runs.
    evaluation : Evaluation
        Their metrics.
    """

    results: "Results"
    evaluation: "Evaluation"

    @property
    def runs(self) -> "dict[str, Run]":
        """Runs by their names."""
        return self.results.runs

    def metric(self, key: str, estimator: str, *, estimate: "Estimate | None" = None) -> float:
        """Value of a metric, by its key in ``metrics.json``.

        Parameters
        ----------
        key, estimator : str
        estimate : "filtered" or "smoothed", optional
            By default the final one: smoothed if the run has it, else filtered.

        Raises
        ------
        ConfigError
            If there is no such run, or it has no such metric.
        """
        if estimator not in self.runs:
            raise ConfigError(f"no run {estimator!r}; there are {', '.join(self.runs)}")
        value = self.evaluation.value(estimator, metric_key(key), estimate)
        if value is None:
            keys = ", ".join(self.evaluation.keys(estimator, estimate))
            of = "" if estimate is None else f" of its {estimate} poses"
            raise ConfigError(f"{estimator} has no metric {key!r}{of}; it has {keys}")
        return value

    def table(self, *, every: bool = False) -> str:
        """Markdown tables, filtered and smoothed: the metrics that the terminal shows, or ``every`` one."""
        told = []
        for title, table in self._tables(every=every).items():
            lines = [table.header, ["---", *("---:" for _ in table.header[1:])], *table.rows]
            told += [f"**{title}**", "", *(f"| {' | '.join(line)} |" for line in lines), ""]
        return "\n".join(told[:-1])

    def save(self, out: Path | str = "results", *, report: bool = False) -> Path:
        """Write the results folder that ``vislam compare`` writes below ``out``; with its page, or without.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        DataError
            If it cannot be written.
        """
        from vislam.comparison.compare import keep  # noqa: PLC0415

        return keep(self.results, Path(out), report=report)

    def report(self, out: Path | str = "results") -> Path:
        """Write the same with its page, and return the page."""
        return self.save(out, report=True) / "report.html"

    def _tables(self, *, every: bool) -> "dict[str, Table]":
        from vislam.evaluation.metric import ESTIMATE_TITLES  # noqa: PLC0415
        from vislam.report.table import SHORT, comparison_tables  # noqa: PLC0415

        found = comparison_tables(self.runs, self.evaluation, keys=None if every else SHORT)
        return {ESTIMATE_TITLES[estimate]: table for estimate, table in found.items()}

    def __repr__(self) -> str:
        return f"{self.results.title}\n{self.table()}"

    def _repr_html_(self) -> str:
        """Tables and top view, as a notebook shows them."""
        from vislam.comparison.results import top_view_svg  # noqa: PLC0415

        drawn = ""
        for title, table in self._tables(every=False).items():
            rows = [table.header, *table.rows]
            cells = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
            drawn += f"<table><caption>{escape(f'{self.results.title}, {title}')}</caption>{cells}</table>"
        return drawn + top_view_svg(self.results, self.evaluation)


def load_config(config: "Config | str | Path", **overrides: Any) -> "Config":
    """Load a config by the name of a shipped one, or by its file.

    Parameters
    ----------
    config : Config, str or Path
    **overrides
        Values by dotted path with ``__`` for its dots, as ``noise__pixel_sigma_px=0.5``.

    Raises
    ------
    ConfigError
        If there is none, or it is wrong.

    Examples
    --------
    >>> import vislam
    >>> vislam.load_config("tiny", noise__pixel_sigma_px=0.75).noise.pixel_sigma_px
    0.75
    """
    from vislam.comparison import config as configuration  # noqa: PLC0415

    values = {key.replace("__", "."): value for key, value in overrides.items()}
    if isinstance(config, configuration.Config):
        if values:
            raise ConfigError(
                "overrides are for a config that is loaded; use dataclasses.replace for this one"
            )
        return config
    path = find_config(config)
    return configuration.load(Path(config) if path is None else path, overrides=values)


def compare(
    config: "Config | str | Path",
    *,
    estimators: Several[str] | None = None,
    data_dir: Path | str | None = None,
    allow_substitute: bool = True,
    progress: "Progress | None" = None,
    **overrides: Any,
) -> Outcome:
    """Run estimators on identical information and score them; print and write nothing.

    Parameters
    ----------
    config : Config, str or Path
        The name of a shipped config, a file, or a config.
    estimators : sequence of str, optional
        In place of the config's.
    data_dir : Path or str, optional
        First folder to look for data.
    allow_substitute : bool
        Whether a missing recording is simulated, which the results then say.
    progress : Progress, optional
        Takes notes and how far it is; ``vislam.cli.console.Terminal()`` prints them.
    **overrides
        As in :func:`load_config`.

    Raises
    ------
    ConfigError, DataError
        If config or data cannot be used.
    DivergedError
        If an estimator that the list of observations is to come from is incomplete.

    Examples
    --------
    >>> import vislam
    >>> outcome = vislam.compare("tiny", estimators=["dead_reckoning", "ekf"])
    >>> outcome.metric("ate_rmse", "ekf") < outcome.metric("ate_rmse", "dead_reckoning")
    True
    """
    from vislam.base.progress import Silent  # noqa: PLC0415
    from vislam.comparison import config as configuration  # noqa: PLC0415
    from vislam.comparison.compare import run_comparison  # noqa: PLC0415

    if "allow_stand_in" in overrides:
        note({"allow_stand_in": "allow_substitute"}, "compare")
        allow_substitute = bool(overrides.pop("allow_stand_in"))
    loaded = load_config(config, **overrides)
    if estimators is not None:
        chosen = {name: loaded.estimators.get(name, {}) for name in estimators}
        loaded = configuration.with_estimators(loaded, chosen)
    dataset = _opened(
        loaded, config, data_dir=data_dir, allow_substitute=allow_substitute, held_out=loaded.held_out
    )
    results = run_comparison(loaded, dataset, Silent() if progress is None else progress)
    return Outcome(results, evaluate(results))


def run(
    estimator: "str | Estimator",
    data: "Config | str | Path | Dataset",
    *,
    config: "Config | str | Path | None" = None,
    options: Mapping[str, Any] | None = None,
) -> "Run":
    """Run one estimator on all observations of a sequence.

    Parameters
    ----------
    estimator : str or Estimator
        The name of one, or one that is built.
    data : Config, str, Path or Dataset
        A config, whose data it is, or a dataset.
    config : Config, str or Path, optional
        Noise and prior, if ``data`` is a dataset.
    options : mapping, optional
        Of an estimator that is named.

    Returns
    -------
    Run
        Marked incomplete, with the reason, if the estimator fails.

    Examples
    --------
    >>> import vislam
    >>> vislam.run("ekf", "tiny").complete
    True
    """
    from vislam.comparison.compare import make_problem, pixel_sigma  # noqa: PLC0415
    from vislam.comparison.open import Dataset  # noqa: PLC0415
    from vislam.core.estimator import find  # noqa: PLC0415
    from vislam.estimators.loop import run as feed  # noqa: PLC0415

    if isinstance(data, Dataset):
        if config is None:
            raise ConfigError("run: a dataset has no noise; name a config, too")
        loaded, dataset = load_config(config), data
    else:
        loaded = load_config(data)
        dataset = _opened(loaded, data, data_dir=None, allow_substitute=True)
    name = estimator if isinstance(estimator, str) else type(estimator).__name__
    if isinstance(estimator, str):
        estimator = find(estimator)(make_problem(loaded, dataset), dict(options or {}))
    return feed(estimator, dataset.sequence, pixel_sigma(loaded, dataset), name=name)


@overload
def evaluate(
    results: "Results | Path | str",
    *,
    reference: None = None,
    trajectories: Mapping[str, File] | None = None,
    **matching: Any,
) -> "Evaluation": ...
@overload
def evaluate(
    results: None = None, *, reference: File, trajectories: Mapping[str, File], **matching: Any
) -> Outcome: ...
def evaluate(
    results: "Results | Path | str | None" = None,
    *,
    reference: File | None = None,
    trajectories: Mapping[str, File] | None = None,
    **matching: Any,
) -> "Evaluation | Outcome":
    """Metrics of runs or a results folder, maybe beside trajectory files; or of files against a reference.

    Parameters
    ----------
    results : Results, Path or str, optional
        Runs, or the folder of a comparison.
    reference : Path, str or mapping, optional
        In place of results: the file that trajectories are scored against, or what can be set of it
        (:class:`vislam.datasets.settings.TrajectoryConfig`), as ``{"file": "gt.csv", "sigma_m": 0.1}``.
    trajectories : mapping of str to the same, optional
        Files by the names that they are to have.
    **matching
        ``association``, ``max_time_difference``, ``start`` and ``end``, as
        :class:`vislam.datasets.settings.MatchingConfig` has them.

    Returns
    -------
    Evaluation
        Of results.
    Outcome
        Of files, with tables (``outcome.table()``), ``outcome.metric(key, name)`` and the page
        (``outcome.report()``).

    Raises
    ------
    ConfigError
        If it is not said, or said twice, what is to be scored.
    DataError
        If the folder is none, a file cannot be used, or what is in them does not belong together.

    Examples
    --------
    >>> import vislam
    >>> outcome = vislam.compare("tiny", estimators=["dead_reckoning"])
    >>> vislam.evaluate(outcome.results).value("dead_reckoning", "path_length") > 40
    True
    """
    from vislam.base.settings import parse  # noqa: PLC0415
    from vislam.comparison.imported import with_trajectories  # noqa: PLC0415
    from vislam.comparison.results import Results  # noqa: PLC0415
    from vislam.comparison.scoring import ScoringConfig, matching_of, score_files  # noqa: PLC0415
    from vislam.datasets.settings import MatchingConfig  # noqa: PLC0415
    from vislam.evaluation import evaluate as score  # noqa: PLC0415

    if (results is None) == (reference is None):
        raise ConfigError("evaluate: give results, or a reference with trajectories")
    how = parse(MatchingConfig, matching, at="evaluate")
    given = [_trajectory(name, file) for name, file in (trajectories or {}).items()]
    if reference is not None:
        name = "reference" if isinstance(reference, Mapping) else Path(reference).stem
        config = ScoringConfig(
            name=name, reference=_trajectory(name, reference), trajectories=tuple(given), matching=how
        )
        scored = score_files(config)
        return Outcome(scored, score(scored.runs, scored.record, scored.own))
    if not isinstance(results, Results):
        assert results is not None
        results = Results.load(Path(results))
    results = with_trajectories(results, given, matching_of(how))
    return score(results.runs, results.record, results.own)


def _trajectory(name: str, file: File) -> "TrajectoryConfig":
    from vislam.base.settings import parse  # noqa: PLC0415
    from vislam.datasets.settings import TrajectoryConfig  # noqa: PLC0415

    tree = dict(file) if isinstance(file, Mapping) else {"file": str(file)}
    return parse(TrajectoryConfig, {"name": name, **tree}, at=f"trajectories.{name}")


def inspect(data: "Sequence | Config | str | Path") -> "Inspection":
    """Faults of a recording, found from the data alone.

    Parameters
    ----------
    data : Sequence, Config, str or Path
        A sequence as its file has it, a recording (``.npz``, ``.npy``, ``.mat``), or a config.

    Examples
    --------
    >>> import vislam
    >>> [item.check for item in vislam.inspect("tiny").findings if item.verdict == "fault"]
    ['inertial noise']
    """
    from vislam.comparison.config import Config, parse  # noqa: PLC0415
    from vislam.core.sequence import Sequence  # noqa: PLC0415
    from vislam.datasets import open as open_sequence  # noqa: PLC0415
    from vislam.inspection import inspect_sequence  # noqa: PLC0415
    from vislam.inspection.checks import bare_tree, unrepaired  # noqa: PLC0415

    if not isinstance(data, Sequence | Config) and Path(data).suffix in (".npz", ".npy", ".mat"):
        data = open_sequence(data)
    if isinstance(data, Sequence):
        return inspect_sequence(data, parse(Config, bare_tree("inspection", f"{data.name}.npz")))
    loaded = load_config(data)
    raw = replace(loaded, data=unrepaired(loaded).data)
    return inspect_sequence(_opened(raw, data, data_dir=None, allow_substitute=True).sequence, loaded)


def _opened(
    loaded: "Config",
    given: Any,
    *,
    data_dir: Path | str | None,
    allow_substitute: bool,
    held_out: "HeldOutConfig | None" = None,
) -> "Dataset":
    from vislam.comparison.open import open_dataset  # noqa: PLC0415

    path = find_config(given) if isinstance(given, str | Path) else None
    return open_dataset(
        loaded.data,
        seed=loaded.seed,
        data_dir=None if data_dir is None else Path(data_dir),
        config_dir=None if path is None else path.parent,
        allow_substitute=allow_substitute,
        held_out=held_out,
    )
