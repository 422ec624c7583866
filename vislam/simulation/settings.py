"""What can be set of a simulated sequence."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive, Probability, Vector3
from vislam.geometry.axes import axes_rotation

SigmaVector = tuple[NonNegative, NonNegative, NonNegative]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class RigConfig:
    """The simulated stereo pair; the left camera looks along the body's x axis."""

    fx: Positive = 552.554261
    """Focal length, horizontal [px]."""
    fy: Positive = 552.554261
    """Focal length, vertical [px]."""
    cx: Positive = 682.049453
    """Principal point, column [px]."""
    cy: Positive = 238.769549
    """Principal point, row [px]."""
    width: Positive = 1408.0
    """Image width [px]."""
    height: Positive = 376.0
    """Image height [px]."""
    baseline: Positive = 0.59418
    """Distance between the cameras [m]."""
    position_imu: Vector3 = (1.575, 0.004, 0.65)
    """Left camera in the body frame [m]."""
    pitch_deg: float = -5.6
    """Turn of the camera about the body's y axis [deg]; negative looks up."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class RecordedPathConfig:
    """Recorded poses that a simulated sequence follows."""

    file: str
    """File of poses, searched for where recordings are."""
    format: Literal["kitti", "tum"]
    """``kitti``: 12 numbers a line (3 x 4, row by row), one pose a period. ``tum``: stamp, x, y, z, qx, qy,
    qz, qw; the first stamp is the start."""
    pose_of: Literal["imu", "left_camera"] = "imu"
    """What its poses are those of; a left camera is taken to sit in the body as that of ``rig``."""
    up: Literal["z", "-y"] = "z"
    """Axis of its world that points up; "-y" where the world has a camera's axes, as in KITTI odometry."""
    knot_spacing: Positive = 0.4
    """Time between the knots of the splines through the poses: what is quicker is taken for jitter [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ImuSimulation:
    """Raw inertia of a simulated sequence; the defaults are those of EuRoC's sensor, by its data sheet."""

    rate: Annotated[float, Field(ge=20, le=2000)] = 200.0
    """Samples a second [Hz]."""
    gyro_density: NonNegative = 1.7e-4
    """White noise of the angular velocity [rad/s/sqrt(Hz)]."""
    accel_density: NonNegative = 2e-3
    """White noise of the specific force [m/s^2/sqrt(Hz)]."""
    gyro_walk: NonNegative = 2e-5
    """Random walk of the gyro's bias [rad/s/sqrt(s)]."""
    accel_walk: NonNegative = 3e-3
    """Random walk of the accelerometer's bias [m/s^2/sqrt(s)]."""
    gyro_bias_sigma: Positive = 0.01
    """Standard deviation of the gyro's first bias, about 0 [rad/s]."""
    accel_bias_sigma: Positive = 0.1
    """The same of the accelerometer's [m/s^2]."""
    gravity: Positive = 9.81
    """Magnitude of gravity [m/s^2]."""
    vibration_gyro: NonNegative = 0.0
    """Root mean square of a shaking of the angular velocity [rad/s]."""
    vibration_accel: NonNegative = 0.0
    """The same of the specific force [m/s^2]."""
    vibration_hz: Positive = 31.0
    """Its frequency [Hz]; the phase wanders by one radian in a second."""
    tilt_sigma: Positive = 0.01
    """How far the attitude that is known at the first frame is off the vertical, about either axis [rad]."""
    velocity_sigma: Positive = 0.1
    """How far the velocity that is known at the first frame is off, along each axis [m/s]."""
    gauge_sigma: Positive = 1e-4
    """Prior standard deviation of heading and position at the first frame, which are free to be chosen
    [rad, m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SimulationConfig:
    """A simulated sequence: path, inertial data, stereo tracks and the faults of a recording."""

    frames: Annotated[int, Field(ge=2, le=1_000_000)] = 1010
    """Number of frames."""
    period: Positive = 0.1046
    """Time between frames [s]."""
    path: Literal[
        "town",
        "straight",
        "loop",
        "circuit",
        "urban",
        "figure_eight",
        "highway",
        "helix",
        "room",
        "recorded",
    ] = "town"
    """Shape of the path. ``town``: turns and changes of speed. ``straight``: a straight line. ``loop``: a
    circle. ``circuit``: a circle driven ``laps`` times at constant speed. ``urban``: blocks with right-angle
    turns, and a stop before every other. ``figure_eight``: closed, at constant speed. ``highway``: gentle
    curves, for some 33 m/s. ``helix``: three turns up a 6 % grade. ``room``: hovering through a room of some
    metres, turning about all axes; ``speed`` is that along its sides. ``recorded``: along the poses of
    ``recorded``, with their speed and their hills."""
    laps: Annotated[int, Field(ge=1)] = 2
    """How often the circle of ``path: circuit`` is driven."""
    recorded: RecordedPathConfig | None = None
    """The poses of ``path: recorded``, and of no other."""
    speed: Positive = 12.7
    """Mean speed [m/s]."""
    hills_m: NonNegative = 4.0
    """Amplitude of the hills [m]."""
    rig: RigConfig = RigConfig()
    """The stereo pair."""
    tracks_in_view: Positive = 66.0
    """Mean number of stereo tracks in view to which new ones are born."""
    tracks_spread: NonNegative = 0.08
    """Standard deviation of that number from frame to frame, as a share of it."""
    redetect_below: Positive | None = None
    """Number of tracks in view below which the front end re-detects in the next frame, but never twice on
    end: that frame is duplicated, no track is lost in it, and tracks are born in it and in no other. Null:
    tracks are born in every frame."""
    shortest_track: Annotated[int, Field(ge=1)] = 1
    """Tracks with fewer observations than this are not written."""
    loss_probability: Probability = 0.04
    """Chance that a track in view is lost in a frame."""
    loss_flow_px: Positive | None = None
    """Flow in a frame at which a track is kept with a chance of 1/e, besides; the chance falls exponentially
    with the flow, so that fast tracks are lost sooner. Null: the flow does not matter [px]."""
    landmarks: Literal["births", "field", "recognised"] = "births"
    """What new tracks follow. ``births``: points of their own, anywhere in the image. ``field``: points of a
    fixed field of facades and ground along the way, which can be found again, so that one landmark can have
    several tracks; after a duplicated frame a track follows a point of its own there too. ``recognised``: the
    same field, and what is found again is recognised, so that the ids of tracks are those of landmarks."""
    field_per_metre: Positive = 10.0
    """Points of the field, in each metre of the way."""
    depth_min: Positive = 5.0
    """Nearest depth at which a track is born [m]."""
    depth_max: Positive = 120.0
    """Farthest depth at which a track is born [m]."""
    pixel_sigma_px: NonNegative = 0.5
    """White noise of uL, vL, uR and vR [px]."""
    matching_bias_px: NonNegative = 0.0
    """Stereo-matching bias: error of a track's first disparity that persists in proportion to it [px]."""
    matching_bias_share: NonNegative = 0.0
    """More of that error, as a share of the disparity; Student-distributed with two degrees of freedom."""
    outlier_probability: Probability = 0.0
    """Chance that an observation is off by up to 50 px."""
    duplication_probability: Probability = 0.0
    """Chance that a frame is duplicated: tracks repeat their pixels and follow other points afterwards."""
    dropped_probability: Probability = 0.0
    """Chance that a frame after the first comes without observations; tracks go on behind it."""
    gyro_bias: Vector3 = (0.0, 0.0, 0.0)
    """Constant bias of the angular velocity [rad/s]."""
    velocity_bias: Vector3 = (0.0, 0.0, 0.0)
    """Constant bias of the velocity [m/s]."""
    gyro_bias_sigma: SigmaVector = (0.0, 0.0, 0.0)
    """Standard deviation of what each seed adds to the bias of the angular velocity [rad/s]."""
    velocity_bias_sigma: SigmaVector = (0.0, 0.0, 0.0)
    """The same of the velocity's [m/s]."""
    gyro_bias_walk: NonNegative = 0.0
    """Random walk of the bias of the angular velocity, which then begins at the constant [rad/s/sqrt(s)]."""
    velocity_bias_walk: NonNegative = 0.0
    """The same of the velocity's [m/s/sqrt(s)]."""
    gyro_sigma: NonNegative = 0.002
    """White noise of an angular velocity sample [rad/s]."""
    velocity_sigma: NonNegative = 0.02
    """White noise of a velocity sample [m/s]."""
    inertial_noise: Literal["sample", "step"] = "sample"
    """``sample``: one sample a frame, with this noise. ``step``: the mean twist of each step with this noise,
    kept all through the step, so that the noise of steps is independent, as the estimators take it to be;
    samples that are joined by straight lines share theirs with both neighbours."""
    clock_offset: float = 0.0
    """How late the inertial stamps are against the camera's [s]."""
    extrinsic_axes: tuple[str, str, str] = ("x", "y", "z")
    """Body axes of the velocities in those of the stored extrinsic; other than x, y, z they do not fit."""
    extrinsic_rotation: Literal["stored", "inverse"] = "stored"
    """``inverse``: the stored extrinsic has the rotation of the other direction."""
    extrinsic_translation: Literal["stored", "inverse"] = "stored"
    """``inverse``: the stored extrinsic has the translation of the other direction."""
    stated_baseline: Positive | None = None
    """Baseline that the file states in place of the true one [m]."""
    disparity_offset_px: float = 0.0
    """Constant error of all disparities [px]."""
    camera_rotation: Vector3 = (0.0, 0.0, 0.0)
    """Rotation of the cameras against the body that the stated mounting does not know of [rad]."""
    principal_point_px: tuple[float, float] = (0.0, 0.0)
    """What the stated principal point is off by: all columns and all rows are larger by it [px]."""
    focal_scale: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0
    """Share by which both focal lengths are longer than stated."""
    velocity_direction: tuple[float, float] = (0.0, 0.0)
    """Direction of the recorded velocity in the body, to the left and up [rad]."""
    camera_rotation_sigma: NonNegative = 0.0
    """Standard deviation of what each seed adds to each of these [rad]."""
    disparity_offset_sigma_px: NonNegative = 0.0
    """The same of the error of all disparities [px]."""
    principal_point_sigma_px: NonNegative = 0.0
    """The same of the principal point [px]."""
    focal_scale_sigma: NonNegative = 0.0
    """The same of the scale of the focal lengths."""
    clock_sigma: NonNegative = 0.0
    """The same of the clock offset [s]."""
    velocity_direction_sigma: NonNegative = 0.0
    """The same of the direction of the velocity [rad]."""
    moving_share: Probability = 0.0
    """Share of the tracks that are born on vehicles driving along at another speed."""
    drift_px: NonNegative = 0.0
    """Tracker drift: random walk of a track's column and row, a frame [px]."""
    imu: ImuSimulation | None = None
    """Raw inertia beside the twist; null: there is none."""
    navigation_frame_velocity: bool = False
    """Write the vertical velocity as the third velocity component, as KITTI's recordings have it."""
    navigation_frame_rates: bool = False
    """Write rates about level axes that turn with the heading only."""

    def __post_init__(self) -> None:
        """Reject swapped depths, axes that are none, ids without a point, a recorded path without poses."""
        if self.depth_min > self.depth_max:
            raise ValueError(
                f"depth_min must not be above depth_max, got {self.depth_min:g} and {self.depth_max:g}"
            )
        try:
            axes_rotation(self.extrinsic_axes)
        except ValueError as error:
            raise ValueError(f"extrinsic_axes: {error}") from None
        changing = {
            "duplication_probability": self.duplication_probability > 0.0,
            "redetect_below": self.redetect_below is not None,
            "moving_share": self.moving_share > 0.0,
        }
        found = [name for name, given in changing.items() if given]
        if self.landmarks == "recognised" and found:
            raise ValueError(
                f"landmarks: recognised has one static point for each id, which {' and '.join(found)} would "
                "change: leave that out, or take landmarks: field"
            )
        if (self.path == "recorded") != (self.recorded is not None):
            raise ValueError("path: recorded and the section recorded, with its file, go together: give both")
