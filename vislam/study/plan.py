"""What a study consists of: its points, its trials, and the data that they are of."""

import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from vislam.base.errors import ConfigError, DataError, Interrupted, first_line
from vislam.base.files import folder_name
from vislam.comparison.compare import build_estimators
from vislam.comparison.config import Config, parse
from vislam.comparison.identity import code_digest, combine
from vislam.comparison.members import members
from vislam.comparison.open import open_dataset
from vislam.datasets.find import find_file, search_path
from vislam.datasets.settings import Kitti00
from vislam.study.ablation import Ablation
from vislam.study.points import Point, Trial, all_points, all_trials
from vislam.study.settings import StudyConfig

_log = logging.getLogger("vislam.study")
_MOST = 1 << 63
"""Bound of the seeds, which a table holds as 64-bit integers."""


@dataclass(frozen=True)
class Plan:
    """What a study consists of.

    Attributes
    ----------
    config : Config
    study : StudyConfig
    points : sequence of Point
    data : str
        Hash of the recording; empty for sequences that each trial simulates with its seed.
    about : str
        What the trials are of.
    """

    config: Config
    study: StudyConfig
    points: Sequence[Point]
    data: str
    about: str

    @classmethod
    def of(cls, config: Config) -> "Plan":
        """Plan the study of a config; ConfigError if there is none, or what it sweeps cannot be."""
        if config.study is None:
            raise ConfigError("study: the config has no such section; see configs/monte_carlo.yaml for one")
        study = parse(StudyConfig, config.study, at="study")
        if config.seed + study.seeds > _MOST:
            raise ConfigError(f"seed: must be below {_MOST} with all that follow it, got {config.seed}")
        config, data, about = _settle_data(config, seeds=study.seeds)
        return cls(config, study, all_points(config, study), data, about)

    def trials(self) -> Iterator[Trial]:
        """Every seed at every point."""
        first = self.config.seed
        seeds = range(first, first + self.study.seeds)
        return all_trials(self.points, seeds=seeds, code=code_digest(), data=self.data)

    def longest_first(self) -> "Plan":
        """The same study with its longest sequences first: so that no worker is idle for long at the end."""
        points = sorted(self.points, key=_frames, reverse=True)
        return replace(self, points=points)

    @property
    def ablation(self) -> Ablation | None:
        """Whose cases the points are; None if they are something else."""
        return Ablation(tuple(self.study.defects)) if self.study.defects else None

    @property
    def simulated(self) -> bool:
        """Whether no recorded data is used."""
        return self.config.data.simulated

    @property
    def upright(self) -> bool:
        """Whether roll and pitch are observable at every point: by gravity, that raw inertia measures."""
        return all(point.tree["motion"] == "imu" for point in self.points)

    @property
    def id(self) -> str:
        """Hash of config, code and all files.

        With more seeds a study goes on, and so it does with other things shown: they do not count.
        """
        study = replace(self.study, seeds=1, metrics=(), ranking=None)
        lasting = replace(self.config, seed=0, study=asdict(study))
        inputs = sorted({point.inputs for point in self.points})
        digest = combine(json.dumps(asdict(lasting)), code_digest(), self.data, *inputs)
        return f"{folder_name(self.config.name)}-{digest}"

    def refuse_bad_options(self) -> None:
        """Raise ConfigError or DataError for what would make every trial of a point fail."""
        dataset = open_dataset(parse(Config, self.points[0].tree).data, seed=self.config.seed)
        for point in self.points:
            try:
                config = parse(Config, point.tree)
                build_estimators(config, dataset, members(config))
            except (ConfigError, DataError, Interrupted):
                raise
            except BaseException as error:
                # Whatever somebody's estimator raises is for its trials to tell and to count.
                _log.info("%s: %s", point.label, first_line(error))


def _settle_data(config: Config, *, seeds: int) -> tuple[Config, str, str]:
    """Config whose data every trial finds, the hash of its recording if it has one, and what it is."""
    data, file = config.data, config.data.recorded_file
    if data.packaged is not None or isinstance(data.source, Kitti00):
        told = "MADE ODOMETRY: real stereo tracks of kitti00, odometry of each trial's seed"
        return config, "", told
    if data.simulated:
        return config, "", "SIMULATED: every trial is a simulated drive"
    dataset = open_dataset(data, seed=config.seed)
    if file is not None and find_file(file, search_path(None)) is None:
        # Each worker would decide for itself what it stands in for.
        made = replace(data, source=None, file=None, inertial=None, reference=None)
        return replace(config, data=made), "", dataset.notes[0]
    if data.redraw_inertial is not None:
        return config, "", dataset.notes[0]
    named = file or getattr(data.source, "format", "")
    if seeds > 1:
        raise ConfigError(
            f"study.seeds: {named} is the same with every seed; set it to 1, or data.file to null, "
            f"got {seeds}"
        )
    reference = dataset.reference
    known = "no reference" if reference is None else f"reference {reference.name}: {reference.limits}"
    return config, dataset.sequence.digest, f"RECORDED: every trial is of {named}; {known}"


def _frames(point: Point) -> int:
    """Length of a point's simulated drive; 0 for recorded data, of which all points have the same."""
    data = point.tree["data"]
    settings = data["simulation"] or data.get("source") or {}
    return int(settings.get("frames", 0))
