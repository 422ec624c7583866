"""The configuration: a frozen tree of dataclasses, loaded from YAML once, every default a value."""

import re
from collections.abc import Mapping
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import yaml
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError, first_line
from vislam.base.fields import STRICT, NonNegative, Positive, Seed
from vislam.base.files import open_regular
from vislam.base.legible import one_line, quoted
from vislam.base.yaml_text import DEEPEST, parse_yaml, unwritable
from vislam.checks.settings import Check
from vislam.repair import RepairConfig
from vislam.simulation.settings import SimulationConfig
from vislam.study.settings import StudyConfig

Parsed = TypeVar("Parsed")

STAMPED = ("tum", "euroc")
"""Formats of a reference that name stamps, not frames."""
LONGEST_NAME = 128
"""Letters of the name of a comparison."""
_WHOLE = ("estimators", "ladder")
"""Sections in which the order matters: a config that extends another replaces them."""
_MOST_BYTES = 1 << 18
_MOST_FILES = 16
"""Files that build on each other."""

Title = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Remark = Annotated[str, Field(max_length=1000)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReferenceConfig:
    """What a recorded run is scored against."""

    file: str
    """File name, searched for where the recording is."""
    format: Literal["planar_xy", "kitti", "kitti360", "tum", "euroc"]
    """``planar_xy``: lines of frame, x, y. ``kitti``: 12 numbers a line (3 x 4, row by row), one a frame.
    ``kitti360``: the frame before the 12 numbers. ``tum``: stamp, x, y, z, qx, qy, qz, qw. ``euroc``: EuRoC's
    ground truth, with commas: stamp [ns], x, y, z, qw, qx, qy, qz, then anything."""
    name: Title
    """Its name, as the report prints it."""
    limits: Remark
    """What it does not tell."""
    pose_of: Literal["imu", "left_camera"] = "imu"
    """What its positions and poses are those of."""
    up: Literal["z", "-y"] = "z"
    """Axis of its world that points up; "-y" where the world has a camera's axes, as in KITTI odometry."""
    sigma_m: NonNegative = 0.0
    """Standard deviation of its own positions [m]; the first poses of a run are surer than any survey."""
    max_time_difference: Positive = 0.02
    """Farthest that a stamp may be from the camera stamp it is taken for (``tum``, ``euroc``) [s]."""

    def __post_init__(self) -> None:
        """Refuse a plane whose normal is not up."""
        if self.format == "planar_xy" and self.up != "z":
            raise ValueError("a planar_xy reference lies in the plane across z: up must be z")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class InertialConfig:
    """Inertial samples from elsewhere than the recording's own file."""

    format: Literal["oxts"]
    """``oxts``: folder of a KITTI raw drive, synced or not."""
    folder: str
    """Folder that holds ``data`` and ``timestamps.txt``, searched for where the recording is."""
    camera_timestamps: str | None = None
    """The drive's ``image_00/timestamps.txt``, searched for alike; null: sample k is at frame k."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PackagedConfig:
    """Real stereo tracks that an installed package brings; odometry is made for them."""

    name: Literal["kitti00"]
    """``kitti00``: the beginning of KITTI odometry 00, from GTSAM's examples."""
    gyro_sigma: NonNegative = 0.05
    """White noise of the made angular velocity, one value a frame [rad/s]."""
    velocity_sigma: NonNegative = 0.5
    """White noise of the made velocity, one value a frame [m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DataConfig:
    """Where the data comes from and how it is to be read and repaired."""

    file: str | None = None
    """Recorded course file (.npz); null for a simulation or packaged data."""
    packaged: PackagedConfig | None = None
    """Data from an installed package, with its own reference, in place of all other sources."""
    simulation: SimulationConfig | None = None
    """The simulated drive: the data where ``file`` is null, the stand-in where the file is missing."""
    inertial: InertialConfig | None = None
    """What replaces the inertial samples of ``file``, or null."""
    repair: RepairConfig = RepairConfig()
    """The repairs, each by its name; they hold for a recording and for its stand-in."""
    reference: ReferenceConfig | None = None
    """Reference trajectory of the recording, or null."""

    def __post_init__(self) -> None:
        """Refuse a section without any data, and keys that would go unheard."""
        if self.packaged is not None:
            if any((self.file, self.simulation, self.inertial, self.reference)):
                raise ValueError(
                    "packaged stands in place of file, simulation, inertial and reference: give it alone"
                )
            return
        if self.file is None and self.simulation is None:
            raise ValueError("one of file, simulation and packaged must be given")
        if self.inertial is not None and self.file is None:
            raise ValueError("inertial replaces the samples of a recording: file must be given")


Six = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ClimbConfig:
    """The climb rate as a measurement against gravity."""

    walk: Positive = 0.02
    """Random walk of the error of its integral [m/sqrt(s)]."""
    tilt_sigma: Positive = 0.05
    """Prior standard deviation of the turn of the first pose's z axis against the vertical [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class NoiseConfig:
    """Noise and prior, the same for every estimator. Six numbers are (omega, v), body axes."""

    pixel_sigma_px: Positive = 1.0
    """White noise of uL and uR [px]; that of the mean row is smaller by sqrt(2)."""
    drift_px: NonNegative = 0.0
    """Drift of a track: its column and its row walk randomly, by this much a frame [px]."""
    match_px: NonNegative = 0.0
    """Error of a track's first disparity that stays with it, in proportion to the disparity [px]."""
    twist_density: Six = (1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02)
    """White noise of the inertial twist [rad/sqrt(s), m/sqrt(s)]."""
    bias_sigma: Six = (0.02, 0.02, 0.02, 0.1, 0.05, 0.02)
    """Prior standard deviation of its bias [rad/s, m/s]."""
    bias_mean: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Prior mean of its bias [rad/s, m/s]."""
    bias_walk: Six = (5e-5, 5e-5, 5e-5, 5e-4, 5e-4, 5e-4)
    """Random walk of its bias [rad/s/sqrt(s), m/s/sqrt(s)]."""
    first_pose_sigma: Six = (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)
    """Prior standard deviation of the first pose [rad, m]; it fixes the gauge."""
    clock_sigma: NonNegative = 0.0
    """Prior standard deviation of what is left of the clock offset after ``repair.clock`` [s]; 0: nothing is,
    and it is not estimated."""
    disparity_offset_sigma_px: NonNegative = 0.0
    """The same of a constant error of all disparities after ``repair.disparity_offset`` [px]."""
    climb: ClimbConfig | None = None
    """How the climb rate is used; null: it is not."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class HeldOutConfig:
    """Tracks that are kept from every estimator; afterwards they say how well each predicts them."""

    share: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Chance of each track to be held out; 0: none is, and nothing is scored by them."""
    seed: Seed = 0
    """Seed of the choice."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Config:
    """One comparison."""

    name: Title
    """Name of the comparison, as it stands in titles; its folder has the same name, with ``_`` and a hash for
    what is no letter, digit, ``_``, ``.`` or ``-``."""
    data: DataConfig
    """The data."""
    noise: NoiseConfig = NoiseConfig()
    """Noise and prior of every estimator."""
    held_out: HeldOutConfig = HeldOutConfig()
    """What is kept from every estimator, to score them by without a reference."""
    gate_probability: Annotated[float, Field(gt=0, lt=1)] = 0.9973
    """Share of good observations that the chi-square gate lets pass."""
    gates_from: str | None = "ekf"
    """Estimator whose gate decisions hold for all that run after it; null: each for itself. Without a meaning
    where there is ``frozen_by``."""
    frozen_by: tuple[str, ...] = ()
    """Runs that make a frozen list of observations: they go first, one after the other, each refused what
    those before it left out. Then all run afresh on what each of these fused, and none gates for itself."""
    estimators: dict[str, dict[str, Any]] = field(
        default_factory=lambda: {"dead_reckoning": {}, "ekf": {}, "isam2": {}}
    )
    """The runs in order, each with the options of its estimator. A run is of the estimator it is named for or
    of the one that its section names: ``{mine: {estimator: ekf, gate: false}}``."""
    ladder: dict[str, Remark] = field(default_factory=dict)
    """What each run adds to the one before it here, by the name of the run; the report then says what that
    does to the error. Order them so that each differs from the one before by one thing."""
    checks: tuple[Check, ...] = ()
    """What is demanded of the results; the exit code says whether it holds."""
    false_alarm_rate: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Chance that results of consistent estimators fail one of the tests among the checks, whichever; shared
    out evenly among the tests (Bonferroni)."""
    study: StudyConfig | None = None
    """How ``vislam.study`` repeats the comparison with other seeds and values; nothing else looks at it."""
    blas_threads: Annotated[int, Field(ge=1)] = 1
    """Threads of the linear algebra; the matrices are small."""
    seed: Seed = 0
    """Seed of whatever is simulated."""


def load(path: Path, *, overrides: Mapping[str, Any] | None = None) -> Config:
    """Load a configuration file.

    A file may build on another, named by ``extends`` relative to itself: its own values go over those of the
    other, key by key in sections; ``estimators`` and ``ladder`` are replaced as a whole.

    Parameters
    ----------
    path : Path
    overrides : mapping of str to Any
        Values by dotted path, as ``{"noise.pixel_sigma_px": 2}``.

    Raises
    ------
    ConfigError
        If the file cannot be read, a key is unknown or a value is out of range.
    """
    tree = read(path)
    for dotted, value in (overrides or {}).items():
        put(tree, dotted, value)
    return parse(Config, tree)


def read(path: Path, *, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a configuration file, laid over those it builds on, as plain data.

    ``above`` are files that build on it. A ConfigError says what is wrong with it.
    """
    tree = _read_one(path)
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str):
        raise ConfigError(f"{path}: extends: expected a file name, got {quoted(base)}")
    if path.resolve() in above:
        raise ConfigError(f"{path}: extends: the files build on each other in a circle")
    if len(above) >= _MOST_FILES:
        raise ConfigError(f"{path}: extends: more than {_MOST_FILES} files build on each other")
    return _over(read(path.parent / base, above=(*above, path.resolve())), tree)


def _over(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Lay one tree over another."""
    merged = dict(base)
    for key, value in own.items():
        inside = isinstance(value, dict) and isinstance(merged.get(key), dict) and key not in _WHOLE
        merged[key] = _over(merged[key], value) if inside else value
    return merged


def _read_one(path: Path) -> dict[str, Any]:
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise ValueError(f"expected at most {_MOST_BYTES} bytes, got more")
        tree = parse_yaml(content.decode("utf-8"))
    except OSError as error:
        raise ConfigError(one_line(f"{path}: cannot be read ({first_line(error)})")) from None
    except ValueError as error:
        raise ConfigError(one_line(f"{path}: not a YAML file ({first_line(error)})")) from None
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of keys, got {type(tree).__name__}")
    return tree


def parse(kind: type[Parsed], tree: Any, *, at: str = "") -> Parsed:
    """Turn plain data into a dataclass; a ConfigError names the dotted path, what is wrong and what came."""
    if (wrong := unwritable(tree)) is not None:
        where = one_line(".".join([*([at] if at else []), *wrong[0]]) or "config", limit=200)
        raise ConfigError(f"{where}: {wrong[1]}")
    try:
        return TypeAdapter(kind).validate_python(tree)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join([*([at] if at else []), *(str(part) for part in first["loc"])])
        where = one_line(where or "config", limit=200)
        if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
            raise ConfigError(f"{where}: unknown key; {_known(kind, first['loc'])}") from None
        message = one_line(re.sub(r"^Value error, ", "", first["msg"]), limit=500)
        got = "" if isinstance(first["input"], dict) else f", got {quoted(first['input'])}"
        raise ConfigError(f"{where}: {message}{got}") from None


def with_estimators(config: Config, estimators: dict[str, dict[str, Any]]) -> Config:
    """Return the configuration with other estimators.

    A ladder that lacks one of its rungs is left out, and so is a check that needs one that is not there.
    """
    ladder = config.ladder if config.ladder.keys() <= estimators.keys() else {}
    checks = tuple(check for check in config.checks if estimators.keys() >= set(check.runs))
    return replace(config, estimators=estimators, ladder=ladder, checks=checks)


def dump(config: Config) -> str:
    """YAML of the effective configuration, defaults filled in."""
    return yaml.safe_dump(_plain(asdict(config)), sort_keys=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _known(kind: Any, location: tuple[int | str, ...]) -> str:
    """Say which keys the section of an unknown key has."""
    for part in location[:-1]:
        if isinstance(part, int):
            # An item of a list, whose section the list has already named.
            continue
        inside = _section(kind.__dataclass_fields__[part].type)
        kind = kind if inside is None else inside
    return "known are " + ", ".join(sorted(kind.__dataclass_fields__))


def _section(annotation: Any) -> Any:
    """Find the config section that an annotation holds, or None."""
    if hasattr(annotation, "__dataclass_fields__"):
        return annotation
    return next((found for part in get_args(annotation) if (found := _section(part)) is not None), None)


def inline(value: Any) -> str:
    """One line of YAML."""
    return yaml.safe_dump(_plain(value), default_flow_style=True).splitlines()[0]


def put(tree: dict[str, Any], dotted: str, value: Any) -> None:
    """Set a value of a tree of plain data by its dotted path; ConfigError if that leads nowhere."""
    *parents, last = dotted.split(".")
    if not all((*parents, last)) or len(parents) >= DEEPEST:
        raise ConfigError(f"{quoted(dotted)}: expected a key, or keys joined by single dots")
    for part in parents:
        if tree.get(part) is None or tree[part] is True:
            # A section that is left empty, or a step that is switched on with its defaults.
            tree[part] = {}
        tree = tree[part]
        if not isinstance(tree, dict):
            where = one_line(dotted, limit=200)
            raise ConfigError(f"{where}: {quoted(part)} is a value and has no keys below it")
    tree[last] = value
