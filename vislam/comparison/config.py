"""The configuration: a frozen tree of dataclasses, loaded from YAML once, every default a value."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive, Seed
from vislam.base.settings import OTHER, Remark, Title, dump, inline, parse, put, read
from vislam.checks.settings import Check
from vislam.core.moved_data import PARAMETERS
from vislam.datasets.registry import OWN, formats
from vislam.datasets.settings import ClementMat, CourseNpy, CourseNpz, Kitti00, ReferenceConfig, TracksNpz
from vislam.models import shared_errors
from vislam.repair import RepairConfig
from vislam.simulation.settings import SimulationConfig

__all__ = [
    "Config",
    "ConsiderConfig",
    "DataConfig",
    "HeldOutConfig",
    "InertialConfig",
    "KernelConfig",
    "NoiseConfig",
    "OtherSource",
    "PackagedConfig",
    "RedrawConfig",
    "SandwichConfig",
    "SharedWalkConfig",
    "SimulationSource",
    "Six",
    "Source",
    "VerticalVelocityConfig",
    "dump",
    "inline",
    "load",
    "parse",
    "put",
    "read",
    "with_estimators",
]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class InertialConfig:
    """Inertial samples from elsewhere than the recording's own file."""

    format: Literal["oxts"]
    """``oxts``: folder of a KITTI raw drive, synced or not."""
    folder: str
    """Folder that holds ``data`` and ``timestamps.txt``, searched for where the recording is."""
    camera_timestamps: str | None = None
    """The sequence's ``image_00/timestamps.txt``, searched for alike; null: sample k is at frame k."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PackagedConfig:
    """Real stereo tracks that an installed package brings; odometry is made for them."""

    name: Literal["kitti00"]
    """``kitti00``: the beginning of KITTI odometry 00, from GTSAM's examples."""
    gyro_sigma: NonNegative = 0.05
    """White noise of the made angular velocity, one value a frame [rad/s]."""
    velocity_sigma: NonNegative = 0.5
    """White noise of the made velocity, one value a frame [m/s]."""


Two = tuple[NonNegative, NonNegative]
Three = tuple[NonNegative, NonNegative, NonNegative]
Six = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class RedrawConfig:
    """Inertial data re-sampled from the reference's motion. Six numbers are (omega, v)."""

    twist_density: Six
    """White noise [rad/sqrt(s), m/sqrt(s)]; the last is that of the vertical velocity, where that is used."""
    bias: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Constant bias [rad/s, m/s]."""
    bias_sigma: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Standard deviation of what each seed adds to it [rad/s, m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SimulationSource(SimulationConfig):
    """A simulated drive."""

    format: Literal["simulation"] = "simulation"
    """Name of the format."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class OtherSource:
    """A source whose reader another package brings, by an entry point in the group ``vislam.datasets``."""

    format: str
    """Name of the format."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of that reader."""


def _kind_of_source(value: Any) -> str | None:
    """Tag of the union's member that a source is; None if nobody reads its format."""
    name = value.get("format") if isinstance(value, Mapping) else getattr(value, "format", None)
    if not isinstance(name, str):
        return None
    if name in OWN:
        return name
    return OTHER if name in formats() else None


_ALL = 1_000_000
"""Landmarks that are remembered where all are."""

Source = Annotated[
    Annotated[CourseNpz, Tag("course_npz")]
    | Annotated[CourseNpy, Tag("course_npy")]
    | Annotated[ClementMat, Tag("clement_mat")]
    | Annotated[TracksNpz, Tag("tracks_npz")]
    | Annotated[Kitti00, Tag("kitti00")]
    | Annotated[SimulationSource, Tag("simulation")]
    | Annotated[OtherSource, Tag(OTHER)],
    Discriminator(
        _kind_of_source,
        custom_error_type="source_format",
        custom_error_message="expected a section with a format that there is a reader for: "
        f"{', '.join(OWN)}, or one that an installed package brings",
    ),
]
"""Where a recording comes from, by its format."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LandmarksConfig:
    """Landmarks that are out of view."""

    kept: Annotated[str, Field(pattern=r"^(while_tracked|always|most [1-9][0-9]{0,5})$")] = "while_tracked"
    """``while_tracked``: a track that was interrupted is a new landmark. ``always``: a track id that comes
    back is the landmark that it was; filters keep all landmarks in the state, and a step takes time with the
    square of their number. ``most 100``: the same for the 100 that were seen last."""

    @property
    def most(self) -> int:
        """How many that are out of view are remembered."""
        if self.kept == "while_tracked":
            return 0
        return _ALL if self.kept == "always" else int(self.kept.removeprefix("most "))

    def repairs(self, repair: RepairConfig) -> RepairConfig:
        """Repairs where landmarks come back: they are the same, whatever became of their tracks."""
        if not self.most:
            return repair
        if repair.interruptions is not None:
            repair = replace(repair, interruptions=replace(repair.interruptions, kept=self.most))
        if repair.consensus is not None:
            repair = replace(repair, consensus=replace(repair.consensus, recognised=True))
        return repair


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReferenceAccuracy:
    """How accurate a reference is that comes with the data, by what is known of its instrument."""

    sigma_m: NonNegative = 0.0
    """Standard deviation of its positions [m]."""
    sigma_deg: NonNegative = 0.0
    """Standard deviation of its attitudes [deg]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DataConfig:
    """Source of the data, and how it is read and repaired."""

    source: Source | None = None
    """Format of the data and where it is: course_npz, course_npy, clement_mat, tracks_npz, kitti00,
    simulation, or one that another package reads."""
    file: str | None = None
    """The same for a recording that is one file, whose format is told by its content."""
    packaged: PackagedConfig | None = None
    """The same for ``kitti00``, in the form of earlier versions."""
    simulation: SimulationConfig | None = None
    """The simulated sequence: the data where there is no other source, the synthetic substitute where the
    file of the source is missing."""
    inertial: InertialConfig | None = None
    """What replaces the inertial samples of the source, or null."""
    redraw_inertial: RedrawConfig | None = None
    """Noise with which the motion of the reference replaces the inertial data of the source for each seed, or
    null; the results are then partly synthetic."""
    repair: RepairConfig = RepairConfig()
    """The repairs, each by its name; they hold for a recording and for its synthetic substitute."""
    landmarks: LandmarksConfig = LandmarksConfig()
    """Landmarks seen again: whether a track id that comes back is the landmark that it was."""
    keyframe_every: Annotated[int, Field(ge=1, le=1000)] = 1
    """Every so many frames is a keyframe, from the first on. The observations of the frames between are given
    to no estimator, and their poses are predicted by raw inertia (``motion: imu``); smoothers have variables
    and one inertial factor a keyframe. 1: all frames are keyframes."""
    reference: ReferenceConfig | None = None
    """Reference trajectory of the recording; null: what comes with the source."""
    reference_accuracy: ReferenceAccuracy | None = None
    """Accuracy of the reference that comes with the source, which NEES and coverage then allow for; null:
    what its reader knows of it. That of a file is stated in ``reference``."""

    def __post_init__(self) -> None:
        """Reject a section without any data, and keys that would go unheard."""
        given = [name for name in ("source", "file", "packaged") if getattr(self, name) is not None]
        beside = (
            self.source,
            self.file,
            self.simulation,
            self.inertial,
            self.redraw_inertial,
            self.reference,
        )
        if self.packaged is not None and any(item is not None for item in beside):
            raise ValueError("packaged stands in place of all other sources of data: give it alone")
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} each name the data: give one of them")
        if isinstance(self.source, SimulationSource) and self.simulation is not None:
            raise ValueError("source is a simulation already: give it or simulation alone")
        if not given and self.simulation is None:
            raise ValueError("one of source, file, simulation and packaged must be given")
        if self.reference_accuracy is not None and self.reference is not None:
            raise ValueError("reference_accuracy is of what comes with the source: state it in reference")
        recorded = bool(given) and not isinstance(self.source, SimulationSource)
        if self.inertial is not None and not recorded:
            raise ValueError("inertial replaces the samples of a recording: source or file must be given")
        referenced = self.reference is not None or (self.source is not None and recorded)
        if self.redraw_inertial is not None and not (recorded and referenced):
            raise ValueError("redraw_inertial needs a recording and its reference: give file and reference")

    @property
    def repairs(self) -> RepairConfig:
        """The repairs as they are applied, those of tracks by what becomes of landmarks out of view."""
        return self.landmarks.repairs(self.repair)

    @property
    def recorded_file(self) -> str | None:
        """Name of the file that holds the recording, if it is one."""
        return self.file if self.source is None else getattr(self.source, "file", None)

    @property
    def simulated(self) -> bool:
        """Whether no recorded data is asked for."""
        if isinstance(self.source, SimulationSource):
            return True
        return self.source is None and self.file is None and self.packaged is None


LIST_MAKER = "ekf_invariant"
"""Estimator that decides which observations all are given: a filter that gates by what is uncertain, and is
consistent."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class VerticalVelocityConfig:
    """The vertical velocity as a measurement against gravity."""

    walk: Positive = 0.02
    """Random walk of the error of its integral [m/sqrt(s)]."""
    tilt_sigma: Positive = 0.05
    """Prior standard deviation of the turn of the first pose's z axis against the vertical [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SharedWalkConfig:
    """Random walks of the errors that all tracks share; 0: that one is constant."""

    camera_rotation: NonNegative = 0.0
    """Of the rotation of the cameras [rad/sqrt(s)]."""
    disparity_offset: NonNegative = 0.0
    """Of the error of all disparities [px/sqrt(s)]."""
    principal_point: NonNegative = 0.0
    """Of the principal point [px/sqrt(s)]."""
    focal_scale: NonNegative = 0.0
    """Of the scale of the focal lengths [1/sqrt(s)]."""
    clock: NonNegative = 0.0
    """Of the clock offset [s/sqrt(s)]."""
    velocity_direction: NonNegative = 0.0
    """Of the direction of the velocity [rad/sqrt(s)]."""

    def densities(self) -> dict[str, float]:
        """Those that walk, by name."""
        return {name: value for name, value in asdict(self).items() if value > 0.0}


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ImuNoiseConfig:
    """Noise of accelerometer and gyro, in the units of data sheets."""

    gyro_density: Positive = 1.7e-4
    """White noise of the angular velocity [rad/s/sqrt(Hz)]."""
    accel_density: Positive = 2e-3
    """White noise of the specific force [m/s^2/sqrt(Hz)]."""
    gyro_walk: Positive = 2e-5
    """Random walk of the gyro's bias [rad/s/sqrt(s)], in data sheets also [rad/s^2/sqrt(Hz)]."""
    accel_walk: Positive = 3e-3
    """Random walk of the accelerometer's bias [m/s^2/sqrt(s)], also [m/s^3/sqrt(Hz)]."""
    gravity: Positive = 9.81
    """Magnitude of gravity [m/s^2]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ZeroVelocityConfig:
    """How standing still is used, where the data tell it (``motion: imu``)."""

    sigma: Positive = 0.01
    """Standard deviation of the velocity of a body that stands still, along each axis [m/s]."""
    slowest: Positive = 0.05
    """A motion at this speed must not be taken for standing still: where tracks would not tell the two apart,
    nothing is taken for it [m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class NoiseConfig:
    """Noise and prior, the same for every estimator. Six numbers are (omega, v), body axes."""

    pixel_sigma_px: Positive = 1.0
    """White noise of uL and uR [px]; that of the mean row is smaller by sqrt(2)."""
    drift_px: NonNegative = 0.0
    """Tracker drift: random walk of a track's column and row, a frame [px]."""
    matching_bias_px: NonNegative = 0.0
    """Stereo-matching bias: error of a track's first disparity that persists in proportion to it [px]."""
    twist_density: Six = (1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02)
    """White noise of the inertial twist [rad/sqrt(s), m/sqrt(s)]."""
    bias_sigma: Six = (0.02, 0.02, 0.02, 0.1, 0.05, 0.02)
    """Prior standard deviation of its bias [rad/s, m/s]."""
    bias_mean: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Prior mean of its bias [rad/s, m/s]."""
    bias_walk: Six = (5e-5, 5e-5, 5e-5, 5e-4, 5e-4, 5e-4)
    """Random walk of its bias [rad/s/sqrt(s), m/s/sqrt(s)]."""
    acceleration_density: Six | None = None
    """White noise of the acceleration of the body itself [rad/s/sqrt(s), m/s/sqrt(s)]: how smoothly it moves;
    null: nothing is supposed of it."""
    first_pose_sigma: Six = (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)
    """Prior standard deviation of the first pose [rad, m]; it fixes the gauge."""
    clock_sigma: NonNegative = 0.0
    """Prior standard deviation of what is left of the clock offset after ``repair.clock`` [s]; 0: nothing is,
    and it is not estimated."""
    velocity_direction_sigma: NonNegative = 0.0
    """Prior standard deviation of the direction of the recorded velocity in the body, to the left and up
    [rad]: what the velocity is off by in proportion to its forward component. 0: nothing is. With it, give
    the last two of ``bias_sigma`` and ``bias_walk`` what is left at standstill only."""
    disparity_offset_sigma_px: NonNegative = 0.0
    """The same of a constant error of all disparities after ``repair.disparity_offset`` [px]."""
    camera_rotation_sigma: NonNegative = 0.0
    """The same of a rotation of the cameras against the body, about each of its axes [rad]."""
    principal_point_sigma_px: NonNegative = 0.0
    """The same of the principal point, of its column and of its row, which both images share [px]."""
    focal_scale_sigma: NonNegative = 0.0
    """The same of the share by which both focal lengths are longer than stated."""
    shared_walk: SharedWalkConfig = SharedWalkConfig()
    """How these six walk."""
    vertical_velocity: VerticalVelocityConfig | None = None
    """How the vertical velocity is used; null: it is not."""
    zero_velocity: ZeroVelocityConfig | None = None
    """How standing still is used; null: it is not. For what stops for good, as a car does; a rig in the hand
    that is held still is not at rest."""
    imu: ImuNoiseConfig = ImuNoiseConfig()
    """Raw inertia, where it is the model of motion; the defaults are EuRoC's data sheet."""

    def __post_init__(self) -> None:
        """Reject a walk of what is assumed known."""
        for name in self.shared_walk.densities():
            prior = shared_errors.prior_name(name)
            if getattr(self, prior) == 0.0:
                raise ValueError(f"shared_walk.{name}: {prior} is 0, so that it is known; give it a prior")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KernelConfig:
    """Student's density for the pixel errors: outliers pull less the farther off they are."""

    degrees_of_freedom: Positive = 4.0
    """Of the density: the smaller, the heavier are its tails. An observation with the squared whitened
    residual d² has its variance divided by (nu + 3) / (nu + d²)."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class HeldOutConfig:
    """Tracks that are withheld from every estimator; each is scored by how well it predicts them."""

    share: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Probability of each track to be withheld; 0: none is, and nothing is scored by them."""
    seed: Seed = 0
    """Seed of the choice."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ConsiderConfig:
    """Standard deviations of errors that all observations share and nobody estimates; 0: there is none.

    One number holds for all components of a parameter, or there is one for each.
    """

    camera_rotation: NonNegative | Three = 0.0
    """Turn of the cameras about the axes of the body [rad]."""
    disparity_offset: NonNegative = 0.0
    """Constant error of all disparities [px]."""
    principal_point: NonNegative | Two = 0.0
    """Principal point of both images: column, row [px]."""
    focal_scale: NonNegative = 0.0
    """Share by which both focal lengths are off."""
    clock: NonNegative = 0.0
    """Offset of the inertial stamps from the camera's [s]."""
    velocity_direction: NonNegative | Two = 0.0
    """Direction of the recorded velocity in the body, to the left and up [rad]."""
    rate_direction: NonNegative | Two = 0.0
    """Direction of the recorded turn rate in the body: what roll and pitch rate are off by in proportion to
    the yaw rate [rad]. Rates that an instrument gives about level axes are off by the slope of the road."""
    tracker_bias: NonNegative | Three = 0.0
    """What all tracks move away from their points by in each frame: in column, in row, and about the
    principal point, by what a point at a distance of the focal length moves [px/frame]."""

    def components(self) -> Iterator[tuple[str, int, float]]:
        """Parameter, index and standard deviation of each component that is not 0."""
        for name, parameter in PARAMETERS.items():
            given = getattr(self, name)
            size = len(parameter.components)
            for index, sigma in enumerate(given if isinstance(given, tuple) else (given,) * size):
                if sigma > 0.0:
                    yield name, index, sigma


ORDINARY = ConsiderConfig(
    camera_rotation=0.003,
    disparity_offset=0.3,
    principal_point=2.0,
    clock=0.02,
    velocity_direction=0.01,
    tracker_bias=0.05,
)
"""What a calibration and a tracker with nothing wrong with them may be off by: a mounting to 0.2 deg, stereo
matching to 0.3 px, images to 2 px, stamps to a fifth of a frame, a velocity to 0.6 deg, tracking to a
twentieth of a pixel a frame. One setting for all recordings, fitted to none."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SandwichConfig:
    """Covariances from the scores of blocks of time, as a second opinion."""

    blocks: Annotated[int, Field(ge=2, le=200)] = 10
    """Blocks of as many frames each, one run for each of them."""


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
    motion: Literal["odometry", "imu"] = "odometry"
    """What predicts the motion from frame to frame, for filters and smoothers alike. ``odometry``: the twist.
    ``imu``: accelerometer and gyro, with the velocity and both biases in the state."""
    held_out: HeldOutConfig = HeldOutConfig()
    """Tracks that are withheld from every estimator, to score them without a reference."""
    gate_probability: Annotated[float, Field(gt=0, lt=1)] = 0.9973
    """Probability with which the chi-square gate accepts a valid observation."""
    kernel: KernelConfig | None = None
    """Robust kernel of every estimator, on residuals whitened by the measurement noise; null: pixel errors
    are Gaussian. A run may have another by a ``kernel`` of its own section. Who cannot take it is named as of
    unequal information; with it there is no NIS and no fit, as weighted residuals are no chi-square
    numbers."""
    consider: ConsiderConfig = ConsiderConfig()
    """Errors that all observations share, which no estimator estimates: each run with covariances is repeated
    for each component that is not 0, and has covariances with these errors beside its own."""
    sandwich: SandwichConfig | None = None
    """Covariances from the scores of blocks of time beside the estimators' own; null: none."""
    gates_from: str | None = None
    """Estimator whose gate decisions hold for all that run after it; null: each for itself. Without a meaning
    where there is ``common_set_from``."""
    common_set_from: tuple[str, ...] = (LIST_MAKER,)
    """Runs, or estimators, that determine the common observation set: they run first, one after the other,
    each without what those before it rejected. Then all run on what each of these fused, of the tracks that
    were observed more than once, and none gates for itself. Empty: each is given everything."""
    estimators: dict[str, dict[str, Any]] = field(
        default_factory=lambda: {"dead_reckoning": {}, "ekf": {}, "isam2": {}}
    )
    """The runs in order, each with the options of its estimator. A run is of the estimator it is named for or
    of the one that its section names: ``{mine: {estimator: ekf, gate: false}}``."""
    ablation_chain: dict[str, Remark] = field(default_factory=dict)
    """Ablation chain: what each run adds to the one before it here, by the name of the run; the report then
    has the change of the error. Order them so that each differs from the one before by one thing."""
    checks: tuple[Check, ...] = ()
    """Requirements on the results; the exit code states whether they hold."""
    false_alarm_rate: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Chance that results of consistent estimators fail one of the tests among the checks, whichever; shared
    out evenly among the tests (Bonferroni)."""
    study: dict[str, Any] | None = None
    """How ``vislam.study`` repeats the comparison with other seeds and values, which it reads itself
    (``vislam.study.settings``); nothing else looks at it."""
    lags: Annotated[tuple[Annotated[int, Field(ge=0, le=1000)], ...], Field(max_length=50)] = ()
    """Lags in frames, increasing, at which the pose of a frame is read again and scored, from 0, as filtered;
    what all data say is added. Empty: none is. It takes time at each frame."""
    lag_cov_every: Annotated[int, Field(ge=1)] = 10
    """Frames between two whose covariances are read at each lag, for the NEES."""
    bound: bool = False
    """Compute the posterior Cramer-Rao bound, and compare all with it. Only for a simulated sequence without
    faults whose noise is drawn as ``noise`` states."""
    blas_threads: Annotated[int, Field(ge=1)] = 1
    """Threads of the linear algebra; the matrices are small."""
    seed: Seed = 0
    """Seed of whatever is simulated."""

    def __post_init__(self) -> None:
        """Reject lags that are out of order, and keyframes without what predicts the frames between."""
        if list(self.lags) != sorted(set(self.lags)):
            raise ValueError(f"lags: expected increasing numbers of frames, got {list(self.lags)}")
        if self.data.keyframe_every == 1:
            return
        if self.motion != "imu":
            raise ValueError(
                f"data.keyframe_every: {self.data.keyframe_every} leaves frames whose poses raw inertia "
                f"predicts, and motion is {self.motion}; set it to 1, or motion to imu"
            )
        if self.lags:
            raise ValueError(
                "lags: a smoother has no poses of the frames between keyframes to read again; set "
                "data.keyframe_every to 1, or lags to []"
            )


def load(path: Path, *, overrides: Mapping[str, Any] | None = None) -> Config:
    """Load a configuration file.

    A file may build on another, named by ``extends`` relative to itself: its own values go over those of the
    other, key by key in sections; ``estimators`` and ``ablation_chain`` are replaced as a whole.

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


def with_estimators(config: Config, estimators: dict[str, dict[str, Any]]) -> Config:
    """Return the configuration with other estimators.

    An ablation chain that lacks one of its steps is left out, and so is a check that needs one that is not
    there.
    """
    chain = config.ablation_chain if config.ablation_chain.keys() <= estimators.keys() else {}
    checks = tuple(check for check in config.checks if estimators.keys() >= set(check.runs))
    return replace(config, estimators=estimators, ablation_chain=chain, checks=checks)
