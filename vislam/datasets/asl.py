"""Stereo images and inertial samples in the ASL layout: EuRoC, TUM-VI and whatever is exported like them.

A folder ``mav0`` has ``cam0``, ``cam1`` and ``imu0``, each with ``data.csv`` (stamp in nanoseconds, then a
file name or numbers) and ``sensor.yaml`` (Burri et al., *The EuRoC micro aerial vehicle datasets*, IJRR
2016). Where there is no ``sensor.yaml`` for a camera, as in TUM-VI, a Kalibr ``camchain*.yaml`` in, beside or
below the folder takes its place.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.core.images import ImageRecording, Inertia, ReferenceFile
from vislam.datasets.calibration_yaml import Camchain, imu_in_body, imu_noise, read_camchain, read_sensor
from vislam.datasets.image_lists import NANOSECONDS, ImageFiles, Listed, paired
from vislam.datasets.inertial_table import inertia_of
from vislam.datasets.text import read_lines, read_table
from vislam.models.imu import ImuNoise

_REFERENCES = (
    ("state_groundtruth_estimate0/data.csv", "euroc"),
    ("mocap0/data.csv", "euroc"),
    ("../groundtruth.tum", "tum"),
)
_EUROC = b"Asctec Firefly MAV"
"""What ``body.yaml`` of the EuRoC recordings calls the vehicle."""
_EUROC_M = 0.001
"""Its positions are millimetre accurate (Burri et al. 2016, abstract), of attitudes nobody says it [m]."""
_EUROC_LIMITS = "beside the images; positions to 1 mm by its authors (Burri et al. 2016)"


def is_asl(folder: Path) -> bool:
    """Whether a folder, or its ``mav0``, is of this layout."""
    return (mav0_of(folder) / "cam0").is_dir()


def mav0_of(folder: Path) -> Path:
    """The folder ``mav0`` in one, or that itself."""
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def load_asl(folder: Path) -> ImageRecording:
    """List a recording; no image is read.

    Parameters
    ----------
    folder : Path
        ``mav0``, or the one that holds it.

    Raises
    ------
    DataError
        If a camera, its calibration or its list is missing or cannot be right, or no pair is left.
    """
    mav0 = mav0_of(folder)
    left, right, counts = paired(_listed(mav0 / "cam0"), _listed(mav0 / "cam1"), where=mav0)
    chain = cameras_of(mav0)
    pair = chain.rectified(mav0)
    inertia, dropped = _inertia(mav0 / "imu0", chain) if (mav0 / "imu0").is_dir() else (None, {})
    return ImageRecording(
        name=mav0.absolute().parent.name if mav0.name == "mav0" else mav0.absolute().name,
        stamp=np.asarray(left.stamp_ns * NANOSECONDS, dtype=np.float64),
        left=left.images,
        right=right.images,
        pair=pair,
        inertia=inertia,
        reference=_reference(mav0),
        counts={**counts, **dropped},
    )


def _listed(folder: Path) -> Listed:
    """Stamps and files that ``data.csv`` lists."""
    path = folder / "data.csv"
    if not path.is_file():
        raise DataError(
            f"{path}: no such file; it must list stamp [ns] and file name of each image of {folder.name}"
        )
    stamps, paths = [], []
    for number, line in read_lines(path):
        stamp, comma, name = (part.strip() for part in line.partition(b","))
        plain = name.decode(errors="replace")
        if not (comma and stamp.isdigit() and len(stamp) < 20 and plain and "\0" not in plain):
            shown = line[:40].decode(errors="replace")
            raise DataError(f"{path}:{number}: must be a stamp [ns], a comma and a file name, got {shown!r}")
        stamps.append(int(stamp))
        paths.append(folder / "data" / plain)
    return Listed(np.array(stamps, dtype=np.int64), ImageFiles(tuple(paths)))


def cameras_of(mav0: Path) -> Camchain:
    """Calibration of ``cam0`` and ``cam1`` of a folder; DataError if there is none, or it cannot be right."""
    paths = [mav0 / name / "sensor.yaml" for name in ("cam0", "cam1")]
    if all(path.is_file() for path in paths):
        body = mav0 / "imu0" / "sensor.yaml"
        body_T_imu = imu_in_body(body) if body.is_file() else np.eye(4)
        left, right = (read_sensor(path, body_T_imu=body_T_imu) for path in paths)
        return Camchain(left, right, mounted=True, shift=0.0, topics=None)
    places = [
        (folder, name) for folder in (mav0, mav0.parent) for name in ("camchain*.yaml", "*/camchain*.yaml")
    ]
    chains = [found for folder, name in places for found in sorted(folder.glob(name))]
    if not chains:
        missing = next(path for path in paths if not path.is_file())
        raise DataError(f"{missing}: no such file, nor a camchain*.yaml of Kalibr; put the calibration there")
    return read_camchain(chains[0])


def _inertia(folder: Path, chain: Camchain) -> tuple[Inertia | None, dict[str, int]]:
    """Gyro and accelerometer, sorted, one sample a stamp; None if their mounting is not known."""
    table, _ = read_table(folder / "data.csv", columns=7, more=True, comma=True)
    inertia, counts = inertia_of(table, chain, where=folder / "data.csv")
    noise = None if inertia is None else _noise(folder)
    return inertia if inertia is None else replace(inertia, noise=noise), counts


def _noise(folder: Path) -> ImuNoise | None:
    """As ``sensor.yaml`` has it; without one, a Kalibr ``imu*.yaml`` where a ``camchain*.yaml`` could be."""
    mav0 = folder.parent
    places = [(place, name) for place in (mav0, mav0.parent) for name in ("imu*.yaml", "*/imu*.yaml")]
    found = [folder / "sensor.yaml", *(one for place, name in places for one in sorted(place.glob(name)))]
    return next((noise for path in found if path.is_file() and (noise := imu_noise(path))), None)


def _reference(mav0: Path) -> ReferenceFile | None:
    found = ((mav0 / name, form) for name, form in _REFERENCES)
    reference = next((ReferenceFile(path.resolve(), form) for path, form in found if path.is_file()), None)
    if reference is None or not _is_euroc(mav0):
        return reference
    return replace(reference, sigma_m=_EUROC_M, limits=_EUROC_LIMITS)


def _is_euroc(mav0: Path) -> bool:
    """Whether a recording says that it is one of EuRoC's."""
    body = mav0 / "body.yaml"
    return body.is_file() and any(_EUROC in line for _, line in read_lines(body))
