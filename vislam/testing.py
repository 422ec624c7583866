"""Checks of the protocols, for the tests of an estimator or a front end of your own."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from vislam.base.errors import ContractError
from vislam.base.progress import Silent
from vislam.base.types import Array, BoolArray, IntArray
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.estimator import Build, find
from vislam.core.images import ImageRecording, Inertia, RawImage
from vislam.core.run import Run
from vislam.estimators.loop import run
from vislam.geometry import se3
from vislam.models import CAMERA_AXES
from vislam.models.camera import Camera, Lens
from vislam.models.stereo_pair import rectified
from vislam.simulation.pictures import Studio, street
from vislam.simulation.settings import SimulationConfig

if TYPE_CHECKING:
    from vislam.frontend.track import Tracked

_SAME = 1e-9
_FAR_OFF_PX = 2.0
"""Median error of an observation [px] beyond which a track does not follow a point."""


def check_estimator(
    build: Build | str, options: Mapping[str, Any] | None = None, *, frames: int = 16, seed: int = 0
) -> Run:
    """Run an estimator over a short simulated sequence in several ways, and compare the results.

    Shapes, rotations and covariances are checked at each step, as in every comparison. Beyond that:

    * two runs give the same results;
    * it is causal: its step at a frame does not change when later frames are left out;
    * it does not fuse rejected observations.

    Parameters
    ----------
    build : callable or str
        As a config names it, or the function itself.
    options : mapping, optional
        Of the config's section.
    frames : int
        Length of the sequence.
    seed : int
        Seed of the sequence.

    Returns
    -------
    Run
        The run over the whole sequence.

    Raises
    ------
    ContractError
        States the violation in one line.

    Examples
    --------
    >>> from vislam.testing import check_estimator
    >>> check_estimator("dead_reckoning").complete
    True
    """
    simulation = SimulationConfig(frames=frames, tracks_in_view=20)
    config = Config(
        name="check",
        data=DataConfig(simulation=simulation),
        noise=NoiseConfig(pixel_sigma_px=simulation.pixel_sigma_px),
        seed=seed,
    )
    dataset = open_dataset(config.data, seed=seed, data_dir=None, allow_substitute=True)
    whole = _run(build, options, config, dataset)
    again = _run(build, options, config, dataset)
    _refuse_other("two runs over the same drive differ", whole, again, frames=frames)
    half = frames // 2
    shortened = replace(dataset, sequence=dataset.sequence.first(half))
    shorter = _run(build, options, config, shortened)
    _refuse_other("later frames change what it says at a frame", whole, shorter, frames=half)
    usable = np.ones(dataset.sequence.observations, bool)
    usable[::3] = False
    count = int(np.count_nonzero(_run(build, options, config, dataset, usable=usable).used & ~usable))
    if count:
        raise ContractError(f"fused {count} observations that are not usable (frame.stereo.usable)")
    return whole


def _run(
    build: Build | str,
    options: Mapping[str, Any] | None,
    config: Config,
    dataset: Dataset,
    *,
    usable: BoolArray | None = None,
) -> Run:
    builder = find(build) if isinstance(build, str) else build
    estimator = builder(make_problem(config, dataset), dict(options or {}))
    sigma = pixel_sigma(config, dataset)
    found = run(estimator, dataset.sequence, sigma, name="checked", usable=usable)
    if not found.complete:
        raise ContractError(found.log.error)
    return found


def _refuse_other(what: str, one: Run, other: Run, *, frames: int) -> None:
    theirs = _reported(other)
    for name, mine in _reported(one).items():
        same = _same(mine[:frames], theirs.get(name, np.full_like(mine, np.nan))[:frames])
        if not same.all():
            raise ContractError(f"frame {int(np.argmin(same))}: {what} ({name})")


def _same(first: Array, second: Array) -> BoolArray:
    """At which frames ``(T,)`` two reports ``(T, ...)`` are the same, but for rounding."""
    if first.shape != second.shape:
        return np.zeros(len(first), bool)
    close = np.isclose(first, second, rtol=_SAME, atol=_SAME, equal_nan=True)
    return np.asarray(close.reshape(len(first), -1).all(axis=1))


def _reported(run: Run) -> dict[str, Array]:
    """What a run reported at each frame, by name."""
    states = {f"states.{name}": state.value for name, state in run.states.items()}
    poses = {"pose": run.filtered.world_T_imu, "pose_cov": run.filtered.covariances}
    return {**poses, "nis": run.innovations.nis, **states}


def check_front_end(name: str, settings: Mapping[str, Any] | None = None, *, frames: int = 4) -> "Tracked":
    """Run a front end over a short rendered recording in several ways, and hold its tracks to the true ones.

    Ids, shapes and numbers are checked at each pair, as in every use. Beyond that:

    * two runs give the same tracks;
    * it is causal: the tracks of a pair do not change when later pairs are left out;
    * its tracks follow points of the world: where the point that the first observation of a track shows is
      seen later is where the track is, within 2 px in the median, in both images.

    Parameters
    ----------
    name : str
        As ``--front-end`` names it.
    settings : mapping, optional
        As ``--set`` gives them.
    frames : int
        Length of the recording.

    Returns
    -------
    Tracked
        What it made of the whole recording.

    Raises
    ------
    ContractError
        States the violation in one line.
    ConfigError
        If OpenCV is not installed, or there is no such front end or setting.
    """
    from vislam.frontend.cache import require_opencv  # noqa: PLC0415

    require_opencv()
    from vislam.frontend.registry import choose_front_end  # noqa: PLC0415
    from vislam.frontend.track import track  # noqa: PLC0415

    given = {"fewest_observations": 1, "row_correction": False, **dict(settings or {})}
    chosen = choose_front_end(name, given)
    studio, pose, recording = _rendered(frames)
    shorter = replace(recording, stamp=recording.stamp[:-1], left=recording.left.of(np.arange(frames - 1)))
    shorter = replace(shorter, right=recording.right.of(np.arange(frames - 1)))
    whole, again, part = (
        track(one, chosen.reading, progress=Silent(), build=chosen.build)
        for one in (recording, recording, shorter)
    )
    count = part.sequence.observations
    for what, other in (("two runs differ", again), ("later pairs change tracks of earlier ones", part)):
        if not np.array_equal(whole.sequence.pixels[: other.sequence.observations], other.sequence.pixels):
            raise ContractError(f"{name}: {what}")
    if count == whole.sequence.observations:
        raise ContractError(f"{name}: no track was found in the last pair")
    error = _errors_px(whole, studio, pose)
    if not float(np.median(error)) <= _FAR_OFF_PX:
        raise ContractError(
            f"{name}: tracks must follow points of the world within {_FAR_OFF_PX:g} px (median), "
            f"got {np.median(error):.2f}"
        )
    return whole


@dataclass(frozen=True)
class _Pictures:
    """Images in memory, as a recording has them."""

    pictures: tuple[Any, ...]
    place: str = "rendered"

    def __len__(self) -> int:
        return len(self.pictures)

    def __iter__(self) -> Iterator[RawImage]:
        for picture in self.pictures:
            height, width = picture.shape
            yield RawImage("mono8", height, width, width, picture.ravel())

    def of(self, rows: "IntArray | BoolArray") -> "_Pictures":
        return _Pictures(tuple(self.pictures[row] for row in np.arange(len(self))[rows]))

    def present(self) -> BoolArray:
        return np.ones(len(self), bool)


@lru_cache(maxsize=2)
def _rendered(frames: int) -> tuple[Studio, Array, ImageRecording]:
    """A drive along a street with two unlike cameras that have lenses: planes, poses and recording."""
    left = Camera(320, 200, 200.0, 199.0, 158.0, 103.0, Lens.RADTAN, (-0.28, 0.07, 2e-4, 2e-5))
    right = Camera(320, 200, 201.0, 200.0, 163.0, 98.0, Lens.RADTAN, (-0.28, 0.07, 2e-4, 2e-5))
    imu_T_left = se3.from_rotation_translation(CAMERA_AXES, np.zeros(3))
    imu_T_right = imu_T_left @ se3.exp(np.array([0.004, -0.012, 0.008, 0.3, 0.004, -0.003]))
    pair = rectified(left, right, imu_T_left=imu_T_left, imu_T_right=imu_T_right)
    studio = Studio(street(half_width=4.0, camera_height=1.5, length=30.0, seed=1), pair)
    step = np.array([0.0, 0.0, 0.008, 0.2, 0.0, 0.0])
    pose = np.array([se3.exp(k * step) for k in range(frames)])
    pictures = [studio.pictures(one) for one in pose]
    stamp: Array = 0.1 * np.arange(frames, dtype=np.float64)
    gyro: Array = np.tile(np.array([0.0, 0.0, 0.08]), (frames, 1))
    recording = ImageRecording(
        name="rendered",
        stamp=stamp,
        left=_Pictures(tuple(one for one, _ in pictures)),
        right=_Pictures(tuple(other for _, other in pictures)),
        pair=pair,
        inertia=Inertia(stamp.copy(), gyro),
    )
    return studio, pose, recording


def _errors_px(tracked: "Tracked", studio: Studio, pose: Array) -> Array:
    """How far each observation is from where the point that its track began with is seen [px]."""
    sequence, pair = tracked.sequence, studio.pair
    first = sequence.first_rows()[sequence.track]
    frame = sequence.frame_of
    left, right = pair.raw_left(sequence.pixels[:, :2]), pair.raw_right(sequence.pixels[:, 2:])
    error = np.empty(len(left))
    for row, (began, at) in enumerate(zip(first, frame, strict=True)):
        point = studio.points(pose[frame[began]], left[began : began + 1])
        in_left, in_right = studio.pixels(pose[at], point)
        error[row] = max(np.linalg.norm(in_left - left[row]), np.linalg.norm(in_right - right[row]))
    return error
