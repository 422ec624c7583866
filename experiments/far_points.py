"""Where far points move to against the reference's motion.

``python -m experiments.far_points battle/kitti_0036`` prints a table. Each observation is triangulated and
carried over one frame by the motion of the reference; the residual is what the next observation of its track
differs by. Rows are of depths, values the mean over the drive of the median of each frame, with the standard
error by ten blocks of time.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from vislam.base.shipped import find_config
from vislam.base.types import Array
from vislam.comparison import config as configuration
from vislam.comparison.open import Dataset, open_dataset
from vislam.geometry import se3

DEPTHS = (20.0, 40.0, 80.0, np.inf)
BLOCKS = 10
_FEWEST = 50
"""Residuals without which a depth is left out."""
_SLOWEST = 2.0
"""Speed below which a frame is left out [m/s]: at standstill nothing moves."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table for each config."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("config", nargs="+")
    print("| recording | depth [m] | column [px] | row [px] |\n|---|---|---:|---:|")
    for name in parser.parse_args(arguments).config:
        path = find_config(name) or Path(name)
        config = configuration.load(path)
        dataset = open_dataset(config.data, seed=config.seed, config_dir=path.parent, allow_substitute=False)
        for line in lines(dataset):
            print(f"| {config.name} | {line}", flush=True)
    return 0


def lines(dataset: Dataset) -> Iterator[str]:
    """Cells of the rows of a recording with reference poses."""
    frame, depth, residual = residuals(dataset)
    for low, high in pairwise(DEPTHS):
        here = (depth > low) & (depth < high)
        if here.sum() < _FEWEST:
            continue
        groups = np.split(residual[here], np.flatnonzero(np.diff(frame[here])) + 1)
        medians = np.array([np.median(group, axis=0) for group in groups])
        blocks = np.array([block.mean(axis=0) for block in np.array_split(medians, BLOCKS)])
        error = blocks.std(axis=0) / np.sqrt(BLOCKS - 1)
        cells = [f"{m:+.3f} ± {s:.3f}" for m, s in zip(medians.mean(axis=0), error, strict=True)]
        yield f"{low:g} to {high:g} | {cells[0]} | {cells[1]} |"


def residuals(dataset: Dataset) -> tuple[Array, Array, Array]:
    """Frame ``(n,)``, depth ``(n,)`` [m] and residual of column and row ``(n, 2)`` [px], frame by frame."""
    sequence, reference = dataset.sequence, dataset.reference
    assert reference is not None
    assert reference.pose is not None
    rig, z, frame_of = sequence.rig, sequence.z, sequence.frame_of
    motion = np.full((len(sequence), 4, 4), np.nan)
    motion[reference.frame] = reference.pose @ se3.inverse(reference.imu_T_point)
    motion[1:] = np.linalg.inv(motion[:-1]) @ motion[1:]
    speed = np.linalg.norm(sequence.step_means()[0][:, 3:], axis=1)
    order = np.lexsort((frame_of, sequence.track))
    one, two = order[:-1], order[1:]
    next_to = (sequence.track[one] == sequence.track[two]) & (frame_of[two] - frame_of[one] == 1)
    known = np.isfinite(motion[frame_of[two], 0, 0]) & (speed[frame_of[two]] > _SLOWEST)
    kept = next_to & known & (sequence.disparity[one] > 1.0)
    one, two = one[kept], two[kept]
    one, two = (rows[np.argsort(frame_of[two], kind="stable")] for rows in (one, two))
    points = rig.back_project(z[one])
    carry = rig.cam_T_imu @ se3.inverse(motion[frame_of[two]]) @ rig.imu_T_cam
    moved = np.einsum("nij,nj->ni", carry[:, :3, :3], points) + carry[:, :3, 3]
    return frame_of[two], points[:, 2], (z[two] - rig.project(moved))[:, [0, 2]]


if __name__ == "__main__":
    sys.exit(main())
