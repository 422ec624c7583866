"""From a path to a config: tracks of images, inspected, with what was measured of them."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base import settings
from vislam.base.errors import DataError
from vislam.base.files import check_writable, write_text
from vislam.base.settings import LONGEST_NAME
from vislam.cli.console import Terminal
from vislam.cli.raw_inertia import with_raw_inertia, with_repairs
from vislam.cli.track import told
from vislam.comparison import config as configuration
from vislam.comparison.open import open_dataset
from vislam.core.images import ImageRecording, ReferenceFile
from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.core.sequence import Sequence
from vislam.datasets.bag_topics import Choice
from vislam.datasets.images import is_images, open_images
from vislam.frontend.cache import copy_tracks, require_opencv, tracks_of
from vislam.frontend.registry import choose_front_end
from vislam.geometry import se3
from vislam.inspection import inspect_sequence
from vislam.inspection.checks import bare_tree, unrepaired
from vislam.inspection.finding import Inspection
from vislam.inspection.written import proposed_config
from vislam.models.imu import ImuNoise

_ESTIMATORS: dict[str, dict[str, Any]] = {
    "dead_reckoning": {},
    "stereo_vo": {},
    "ekf_invariant": {},
    "eks": {},
    "isam2": {},
}
_UNKNOWING = 10.0
"""Standard deviation of a step by a velocity that nobody measured, in fast steps as the camera sees them."""
_FAST = 95.0
"""Percentile of the steps that is a fast one."""
_KNOWN = 1e-3
"""Prior standard deviation of the bias of such a velocity [m/s]: it is beyond its noise already."""
_GYRO = 3
_WIDER = 2.0
"""The intervals come from the recording's own blocks; a prior is held so many times wider."""


@dataclass(frozen=True)
class _Recorded:
    """What came with the images: velocity, parallel to the earth's surface, angular rates, stated noise."""

    levelled: bool = False
    velocity: bool = True
    gyro: bool = True
    imu_noise: ImuNoise | None = None


def config_of(data: Path, *, out: Path, choice: Choice, front_end: str) -> Path:
    """Make a config for a recording, print it and save it in the folder of the results.

    Parameters
    ----------
    data : Path
        A recording of stereo images, of which tracks are made first, or a file of tracks.
    out : Path
        Folder of the results; the tracks are copied into it, too.
    choice : Choice
        Topics and calibration of a bag, where they are not to be guessed.
    front_end : str
        Name of what makes the tracks.

    Returns
    -------
    Path
        The saved config.
    """
    terminal = Terminal()
    if not data.exists():
        raise DataError(f"{data}: not found; name a folder of stereo images, a bag, or a file of tracks")
    of_images = data.is_dir() or is_images(data)
    tree, recorded = bare_tree(data.stem, str(data.resolve())), _Recorded()
    if of_images:
        tree, recorded = _tracked(open_images(data, choice), front_end, out, terminal)
    path = out / f"{tree['name']}.yaml"
    check_writable(path)
    config = settings.parse(configuration.Config, tree)
    dataset = open_dataset(unrepaired(config).data, seed=config.seed, config_dir=out)
    result = inspect_sequence(dataset.sequence, config)
    for finding in result.findings:
        terminal.note(f"{finding.verdict.upper():8}{finding.check}: {finding.text}")
    if not recorded.velocity:
        tree = _without_velocity(tree, result, dataset.sequence, gyro=recorded.gyro)
        if dataset.sequence.imu is not None:
            mended = with_repairs(tree, dataset.sequence, result)
            for line in with_raw_inertia(tree, mended, recorded.imu_noise):
                terminal.note(line)
        text = configuration.dump(settings.parse(configuration.Config, tree))
    else:
        if recorded.levelled:
            settings.put(tree, "data.repair.navigation_frame_velocity", True)
        text = proposed_config(tree, result, folders=[out, Path()], written_to=path)
    write_text(path, text)
    terminal.note(f"config, saved as {path}:")
    for line in text.splitlines():
        terminal.note(f"  {line}")
    return path


def tracked_tree(data: Path, *, out: Path, choice: Choice, front_end: str) -> dict[str, Any]:
    """Config, as plain data, that reads the tracks of a recording of images, which are made first.

    Parameters
    ----------
    data : Path
        A recording of stereo images.
    out : Path
        Folder that the tracks are copied into.
    choice : Choice
        Topics and calibration of a bag, where they are not to be guessed.
    front_end : str
        Name of what makes the tracks.
    """
    if not data.exists():
        raise DataError(f"{data}: not found; name a folder of stereo images or a bag")
    if not (data.is_dir() or is_images(data)):
        raise DataError(
            f"{data}: expected a folder or bag of stereo images, got another; use --file for tracks"
        )
    return _tracked(open_images(data, choice), front_end, out, Terminal())[0]


def _tracked(
    recording: ImageRecording, front_end: str, out: Path, terminal: Terminal
) -> tuple[dict[str, Any], _Recorded]:
    """Tracks of images in the folder of the results, and the config that reads them."""
    require_opencv()
    made_path, made = tracks_of(recording, choose_front_end(front_end), progress=terminal)
    path = out / f"{recording.name}_tracks.npz"
    check_writable(path)
    copy_tracks(made_path, path)
    summary = json.loads(path.with_name(f"{path.stem}_front_end.json").read_text(encoding="utf-8"))
    for line in told(summary, made=made):
        terminal.note(line)
    tree = bare_tree(recording.name, str(path.resolve()))
    tree["name"] = recording.name[:LONGEST_NAME]
    tree["estimators"] = _ESTIMATORS
    reference = recording.reference
    if isinstance(reference, ReferenceFile):
        tree["data"]["reference"] = {
            "file": str(reference.path),
            "format": reference.format,
            "name": reference.path.name,
            "limits": reference.limits,
            "sigma_m": reference.sigma_m,
        }
    elif reference is not None and len(reference.stamp) > 1:
        tree["data"]["reference"] = {
            "file": str(path.with_name(f"{path.stem}_reference.tum").resolve()),
            "format": "tum",
            "name": reference.name,
            "limits": reference.origin,
        }
    stated = summary["imu_noise"]
    noise = None if stated is None else ImuNoise(**stated)
    for name, value in (stated or {}).items():
        if name != "gravity":
            settings.put(tree, f"noise.imu.{name}", value)
    levelled, velocity, gyro = (bool(summary[name]) for name in ("levelled", "velocity", "gyro"))
    return tree, _Recorded(levelled, velocity, gyro, noise)


def _without_velocity(
    tree: dict[str, Any], result: Inspection, sequence: Sequence, *, gyro: bool
) -> dict[str, Any]:
    """Config for tracks and a gyro: what was measured of these, and a velocity so noisy that it says nothing.

    Without a gyro the angular velocity is as noisy.

    Nothing is taken over that was told by a velocity of 0: axes, clock, scale, and its own noise and bias.
    """
    found = {**result.settings, **result.proposal}
    for dotted in ("noise.pixel_sigma_px", "noise.drift_px", "noise.matching_bias_px"):
        if dotted in found:
            settings.put(tree, dotted, found[dotted])
    settings.put(tree, "data.repair", {"disparity": True, "consensus": True, "duplicated_tracks": False})
    of_gyro = _of_gyro(result)
    turning, moving = _unknowing_densities(sequence)
    if not gyro:
        of_gyro = {
            "twist_density": (turning,) * _GYRO,
            "bias_mean": (0.0,) * _GYRO,
            "bias_sigma": (_KNOWN,) * _GYRO,
        }
    settings.put(tree, "noise.twist_density", [*of_gyro["twist_density"], moving, moving, moving])
    settings.put(tree, "noise.bias_mean", [*of_gyro["bias_mean"], 0.0, 0.0, 0.0])
    settings.put(tree, "noise.bias_sigma", [*of_gyro["bias_sigma"], _KNOWN, _KNOWN, _KNOWN])
    return tree


def _of_gyro(result: Inspection) -> dict[str, Any]:
    """Noise of the angular velocity as it was measured, else as by default: density, bias and its prior."""
    default = configuration.NoiseConfig()
    measured = {one.name: one for finding in result.findings for one in finding.measured}
    density, biases = measured.get("gyro density"), [measured.get(f"gyro bias {axis}") for axis in "xyz"]
    found = {**result.settings, **result.proposal}
    out = {
        name: found.get(f"noise.{name}", getattr(default, name))[:_GYRO]
        for name in ("twist_density", "bias_mean", "bias_sigma")
    }
    if density is not None:
        out["twist_density"] = (float(f"{density.value:.3g}"),) * _GYRO
    told = [one for one in biases if one is not None and np.isfinite(one.sigma)]
    if len(told) == _GYRO:
        out["bias_mean"] = tuple(float(f"{one.value:.3g}") for one in told)
        out["bias_sigma"] = tuple(float(f"{max(_WIDER * one.sigma, _KNOWN):.3g}") for one in told)
    return out


def _unknowing_densities(sequence: Sequence) -> tuple[float, float]:
    """White noise of rates and velocities that were not measured, from the steps that the camera sees.

    Of the angular velocity [rad/sqrt(s)] and of the velocity [m/sqrt(s)].
    """
    possible = sequence.select(sequence.disparity > 0.0)
    fits = rigid_fits(possible, continuations(possible))
    if not fits:
        raise DataError(f"{sequence.name}: must have frames whose tracks agree on a motion, got none")
    steps = se3.log(np.array([fit.next_T_prev for fit in fits.values()]))
    period = float(np.median(np.diff(sequence.stamp)))
    turning, moving = (
        _UNKNOWING * np.percentile(np.linalg.norm(part, axis=1), _FAST) / np.sqrt(period)
        for part in (steps[:, :_GYRO], steps[:, _GYRO:])
    )
    return float(f"{turning:.3g}"), float(f"{moving:.3g}")
