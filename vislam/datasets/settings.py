"""What can be set of a recording's source, of a reference, and of a trajectory from elsewhere."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive
from vislam.base.settings import Remark, Title
from vislam.datasets.trajectory_formats.options import QuaternionOrder, ReadOptions, Unit
from vislam.geometry.pose_covariance import Frame, Order

Format = Literal[
    "planar_xy",
    "kitti",
    "kitti360",
    "tum",
    "euroc",
    "positions",
    "openvins",
    "smfeval",
    "tum_cov",
    "matrices",
    "npz",
    "rosbag",
]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Seven = tuple[Finite, Finite, Finite, Finite, Finite, Finite, Finite]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class CourseNpz:
    """A recording of the course, in the form that it had up to 2024."""

    format: Literal["course_npz"] = "course_npz"
    """Name of the format."""
    file: str
    """The ``.npz`` file, searched for where all data is."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class CourseNpy:
    """A recording of the course, in the form that it has had since 2025."""

    format: Literal["course_npy"] = "course_npy"
    """Name of the format."""
    file: str
    """The ``.npy`` file, searched for where all data is."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ClementMat:
    """A set of Clement et al. (2015), with its reference poses and, where there are some, landmarks."""

    format: Literal["clement_mat"] = "clement_mat"
    """Name of the format."""
    file: str
    """The ``.mat`` file, searched for where all data is."""
    steps: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    """First and last step that are read, counted from 1 as in the paper; null: all."""

    def __post_init__(self) -> None:
        """Reject a stretch of less than two steps."""
        if self.steps is not None and self.steps[1] <= self.steps[0]:
            raise ValueError(f"steps must be first and last, the last one later, got {list(self.steps)}")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class TracksNpz:
    """Tracks of any front end in the open track format (``docs/reference/track_format.md``)."""

    format: Literal["tracks_npz"] = "tracks_npz"
    """Name of the format."""
    file: str
    """The ``.npz`` file, searched for where all data is."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Kitti00:
    """The beginning of KITTI odometry 00, real tracks from GTSAM's examples; odometry is made for them."""

    format: Literal["kitti00"] = "kitti00"
    """Name of the format."""
    gyro_sigma: NonNegative = 0.05
    """White noise of the made angular velocity, one value a frame [rad/s]."""
    velocity_sigma: NonNegative = 0.5
    """White noise of the made velocity, one value a frame [m/s]."""
    imu: bool = False
    """Whether to have accelerometer and gyro of the same drive, also from GTSAM's examples, with the frames
    from the 14th on, which they cover; the body is then the inertial sensor."""


RecordedFile = CourseNpz | CourseNpy | ClementMat | TracksNpz
"""Sources that are one file."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReferenceConfig:
    """What a recorded run is scored against."""

    file: str
    """File name, searched for where the recording is."""
    format: Format
    """``planar_xy``: lines of frame, x, y. ``kitti``: 12 numbers a line (3 x 4, row by row), or 16, one a
    frame. ``kitti360``: the frame before them. ``tum``: stamp, x, y, z, qx, qy, qz, qw. ``euroc``: EuRoC's
    ground truth: stamp [ns], x, y, z, qw, qx, qy, qz, then anything. ``positions``: stamp, x, y, z.
    ``vislam evaluate`` has them all in its documentation (docs/reference/trajectory_formats.md)."""
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
    sigma_deg: NonNegative = 0.0
    """Standard deviation of its own attitudes [deg]."""
    max_time_difference: Positive = 0.02
    """Farthest that a stamp may be from the camera stamp it is taken for [s]."""
    association: Literal["nearest", "interpolate"] = "nearest"
    """Whether a frame has the row of the nearest stamp, or what lies between the rows around it."""
    strict: bool = False
    """Whether a file that is out of order, or has lost or double rows, is rejected, not mended."""

    def __post_init__(self) -> None:
        """Reject a plane whose normal is not up."""
        if self.format == "planar_xy" and self.up != "z":
            raise ValueError("a planar_xy reference lies in the plane across z: up must be z")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class TrajectoryConfig:
    """A trajectory file from elsewhere, or the reference that such are scored against."""

    name: Title
    """Its name, as tables and page print it."""
    file: str
    """Path of the file."""
    format: Literal[Format, "auto"] = "auto"
    """One of the formats that are read; ``auto``: by the content."""
    limits: Remark = "from elsewhere"
    """What it does not tell, as the report prints it of a reference."""
    pose_of: Literal["imu", "left_camera"] = "imu"
    """What its poses are those of; ``left_camera`` needs a recording that knows where that sits."""
    up: Literal["z", "-y"] = "z"
    """Axis of its world that points up; "-y" where the world has a camera's axes, as in KITTI odometry."""
    unit: Unit = "auto"
    """Of its stamps: s, ms, us or ns; ``auto``: by their size."""
    quaternion: QuaternionOrder = "auto"
    """xyzw or wxyz; ``auto``: by the names of the columns, else as the format has it."""
    conjugated: bool = False
    """Whether its attitudes take the world to the body, so that they are turned round."""
    inverted: bool = False
    """Whether its poses as a whole take the world to the body, so that they are inverted."""
    body_T_point: Seven | None = None
    """Where the body of the others sits on its body: x y z [m], qx qy qz qw. Its poses are moved there."""
    clock_offset: Finite | Literal["estimate"] = 0.0
    """What is added to its stamps [s]; ``estimate``: what fits best, with its interval."""
    alignment: Literal["se3", "sim3"] = "se3"
    """``sim3``: its positions are scaled to fit first, as of a monocular system."""
    times: str | None = None
    """File of stamps, one a row, for a format that has none."""
    frames: str | None = None
    """File of frame numbers, one a row, for a format that has none."""
    cov: str | None = None
    """File of covariances beside it: a stamp, then 21 numbers (lower triangle by rows) or 36."""
    cov_order: Literal[Order, "auto"] = "auto"
    """Order of rows and columns of its covariances; ``auto``: as the format has it, else what fits."""
    cov_frame: Literal[Frame, "auto"] = "auto"
    """Where their error stands (``right``, ``left``, ``split``, ``world``); ``auto`` alike."""
    map: str | None = None
    """File of the points of its map: PLY, or npz with ``points_world``."""
    topic: str | None = None
    """Topic of a bag."""
    sigma_m: NonNegative = 0.0
    """Standard deviation of a reference's own positions [m]."""
    sigma_deg: NonNegative = 0.0
    """Standard deviation of a reference's own attitudes [deg]."""
    strict: bool = False
    """Whether a file that is out of order, or has lost or double rows, is rejected, not mended."""

    @field_validator("name")
    @classmethod
    def _usable(cls, name: str) -> str:
        if "|" in name or name == "saved" or not name.isprintable():
            raise ValueError("a name must be printable, without |, and not 'saved'")
        return name

    def __post_init__(self) -> None:
        """Reject what says two things."""
        if self.times is not None and self.frames is not None:
            raise ValueError("one of times and frames, not both")

    @property
    def options(self) -> ReadOptions:
        """How its file is to be read."""
        return ReadOptions(self.unit, self.quaternion, self.topic, self.strict)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MatchingConfig:
    """How the rows of trajectories are matched with those of the reference."""

    association: Literal["auto", "nearest", "interpolate"] = "auto"
    """``nearest``: stamps within ``max_time_difference``. ``interpolate``: the denser side at the stamps of
    the sparser. ``auto``: nearest, unless that leaves out more than half of what interpolation finds."""
    max_time_difference: Positive = 0.01
    """Farthest that two stamps may be apart [s]."""
    start: NonNegative = 0.0
    """Time of the reference before which nothing is scored [s], from its first row on."""
    end: Positive | None = None
    """Time of the reference after which nothing is scored [s], from its first row on; null: its end."""

    def __post_init__(self) -> None:
        """Reject a span that is empty."""
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"end must be after start, got {self.end:g} and {self.start:g}")


def fields_of(kind: Any) -> tuple[str, ...]:
    """Names of what can be set of a section."""
    return tuple(kind.__dataclass_fields__)
