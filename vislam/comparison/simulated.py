"""Simulated sequences with all that they need: the recorded poses that a config may name among them."""

from pathlib import Path

import numpy as np

from vislam.base.errors import ConfigError, DataError
from vislam.comparison.config import SimulationSource
from vislam.core.reference import truth_reference
from vislam.core.sequence import Sequence
from vislam.datasets.find import find_file, not_found
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.trajectories import UPRIGHT, read_poses
from vislam.geometry import se3
from vislam.simulation import SimulationConfig, Truth, simulate
from vislam.simulation.drive import stereo_rig
from vislam.simulation.recorded_path import FEWEST_POSES, RecordedPath

_ROUNDING = 0.01
"""Share of a period by which stamps may fall short of the last frame."""


def read(source: SimulationSource, opening: Opening) -> Recording:
    """Simulate a drive as any other source is read."""
    return simulated(source, opening, name="simulation")


def simulated(config: SimulationConfig, opening: Opening, *, name: str) -> Recording:
    """Simulated drive with its truth.

    Parameters
    ----------
    config : SimulationConfig
    opening : Opening
    name : str
        Of the sequence.
    """
    sequence, truth = simulated_drive(config, seed=opening.seed, name=name, folders=opening.folders)
    nothing = np.empty(0, np.int64), np.empty((0, 3))
    reference = truth_reference(truth.world_T_imu, *nothing, bias=truth.bias)
    return Recording(
        sequence,
        reference,
        truth.points_world,
        (f"SIMULATED: {name}, no recorded data was used",),
    )


def simulated_drive(
    config: SimulationConfig, *, seed: int, name: str, folders: list[Path]
) -> tuple[Sequence, Truth]:
    """Simulate a sequence, along recorded poses if the config says so.

    Parameters
    ----------
    config : SimulationConfig
    seed : int
    name : str
        Name of the sequence.
    folders : list of Path
        Where to look for the file of poses.

    Raises
    ------
    DataError
        If the file of poses is missing or cannot be used.
    ConfigError
        If the sequence is to be longer than the poses.
    """
    path = None
    if config.recorded is not None:
        found = find_file(config.recorded.file, folders)
        if found is None:
            raise DataError(not_found(config.recorded.file, folders))
        path = load_recorded_path(found, config)
    return simulate(config, seed=seed, name=name, path=path)


def load_recorded_path(file: Path, config: SimulationConfig) -> RecordedPath:
    """Read poses and lay a path through them that begins at time 0.

    Poses of a left camera become those of the body by the mounting of the simulated rig, whatever the rig of
    the recording was. A file without stamps (``kitti``) has one pose in each period of the simulation.
    """
    settings = config.recorded
    assert settings is not None
    at, pose = read_poses(file, settings.format)
    if len(pose) < FEWEST_POSES:
        raise DataError(
            f"{file}: must have {FEWEST_POSES} poses or more to lay a path through, got {len(pose)}"
        )
    time = config.period * at if settings.format == "kitti" else at - at[0]
    frames = int(time[-1] / config.period + _ROUNDING) + 1
    if config.frames > frames:
        raise ConfigError(
            f"data.simulation.frames: must be at most {frames}, as {file} covers {time[-1]:.1f} s, "
            f"got {config.frames}"
        )
    if settings.up == "-y":
        pose = UPRIGHT @ pose
    if settings.pose_of == "left_camera":
        pose = pose @ se3.inverse(stereo_rig(config).imu_T_cam)
    return RecordedPath(time, pose, knot_spacing=settings.knot_spacing)
