"""Stereo observations that cannot be: swapped cameras, channels out of order, rows that differ, a wrong K."""

from itertools import permutations

import numpy as np

from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding
from vislam.repair import RepairConfig
from vislam.repair.pixels import Disparity

_ROWS_DIFFER_PX = 2.0
_ROWS_SIGMAS, _FEW_ROWS = 6.0, 0.01
"""Where more than so few rows do, they may differ by so many of the recording's own standard deviations."""
_CHANNELS = ("uL", "vL", "uR", "vR")
_SWAPPED = (2, 3, 0, 1)
_MOST = 0.8
"""Share of the observations that makes a fault one of the whole recording."""
_KEPT = 0.5
"""A step that keeps less than this share is not proposed."""
_NORMALISED_PX = 0.02
"""Share of the principal point: pixels all below it are no pixels."""
_INSIDE = 1.15
"""An image whose outermost pixels lie within so much of the principal point is a quarter of what K is for."""
_OUTERMOST = 0.995
_ENOUGH = 200


def check_observations(sequence: Sequence, repair: RepairConfig) -> Finding:
    """Disparities, rows and columns that cannot be, as the file has them."""
    pixels = sequence.pixels
    disparity = sequence.disparity
    rows = pixels[:, 1] - pixels[:, 3]
    width, height = 2.0 * sequence.rig.cx, 2.0 * sequence.rig.cy
    outside = (pixels[:, [0, 2]] < 0).any(axis=1) | (pixels[:, [0, 2]] > 1.2 * width).any(axis=1)
    outside |= (pixels[:, [1, 3]] < 0).any(axis=1) | (pixels[:, [1, 3]] > 1.6 * height).any(axis=1)
    rows_px = _row_bound(rows)
    counts = {
        "disparity_not_positive": int(np.sum(disparity <= 0)),
        "lowest_disparity_px": float(disparity.min(initial=0.0)),
        "rows_differ": int(np.sum(np.abs(rows) > rows_px)),
        "row_difference_median_px": float(np.median(np.abs(rows))) if len(rows) else 0.0,
        "outside_image": int(outside.sum()),
    }
    text = (
        f"{counts['disparity_not_positive']} of {len(pixels)} observations have a disparity of zero or less "
        f"(lowest {counts['lowest_disparity_px']:.1f} px), {counts['rows_differ']} rows differ by more than "
        f"{rows_px:g} px, {counts['outside_image']} lie outside an image of twice the principal point"
    )
    whole = _whole_recording(sequence, outside=float(np.sum(outside)) / max(len(pixels), 1))
    if whole is not None:
        # None of the steps mends it: the disparity step would drop what is to be mended.
        unknown = {"data.file": f"the tracks of this recording are to be mended first: {whole}"}
        return Finding("observations", "fault", f"{whole}; {text}", counts=counts, unknown=unknown)
    bad = counts["disparity_not_positive"] + counts["rows_differ"]
    if bad == 0:
        return Finding("observations", "ok", text, counts=counts)
    step = Disparity(row_difference_px=rows_px)
    kept = step.apply(sequence).observations if repair.disparity is None else len(pixels)
    if kept < _KEPT * len(pixels):
        text = f"{text}; the disparity step would leave {kept} of {len(pixels)}, so it is not proposed"
        unknown = {"data.repair.disparity": f"it would leave {kept} of {len(pixels)} observations"}
        return Finding("observations", "fault", text, counts=counts, unknown=unknown)
    if repair.disparity is not None:
        text = f"{text}; the configured disparity step drops them ({100.0 * bad / len(pixels):.1f} %)"
        return Finding("observations", "ok", text, counts=counts)
    proposal = {
        "data.repair.disparity": True if rows_px == _ROWS_DIFFER_PX else {"row_difference_px": rows_px}
    }
    return Finding("observations", "fault", text, counts=counts, proposal=proposal)


def _row_bound(rows: Array) -> float:
    """Largest |vL - vR| of an observation [px]: the usual one, or what the front end's spread asks for."""
    if not len(rows) or np.mean(np.abs(rows) > _ROWS_DIFFER_PX) < _FEW_ROWS:
        return _ROWS_DIFFER_PX
    spread = 1.4826 * float(np.median(np.abs(rows - np.median(rows))))
    return max(_ROWS_DIFFER_PX, float(f"{_ROWS_SIGMAS * spread + abs(float(np.median(rows))):.2g}"))


def _whole_recording(sequence: Sequence, *, outside: float) -> str | None:
    """What is wrong with nearly all observations at once, with its likely remedy; None if nothing is."""
    pixels, rig = sequence.pixels, sequence.rig
    if len(pixels) == 0:
        return "no stereo observation is in it"
    centre = np.array([rig.cx, rig.cy, rig.cx, rig.cy])
    if np.all(np.quantile(np.abs(pixels), _OUTERMOST, axis=0) < _NORMALISED_PX * centre):
        return (
            f"all image coordinates lie within {np.abs(pixels).max():.3g} of zero, K has its principal point "
            f"at ({rig.cx:g}, {rig.cy:g}) px: are they normalised? Write pixels"
        )
    order = _channel_order(pixels)
    if order == _SWAPPED:
        return (
            f"{np.sum(sequence.disparity <= 0)} of {len(pixels)} disparities uL - uR are zero or negative: "
            "left and right are swapped; write features as uL, vL, uR, vR"
        )
    if order is not None:
        names = ", ".join(_CHANNELS[np.argsort(order)[place]] for place in range(4))
        return f"features look to be in the order {names}; write them as {', '.join(_CHANNELS)}"
    return _rows(pixels) or _resolution(sequence, outside=outside)


def _sound(pixels: Array) -> float:
    """Share of the observations with a positive disparity and rows that agree."""
    good = (pixels[:, 0] - pixels[:, 2] > 0) & (np.abs(pixels[:, 1] - pixels[:, 3]) <= _ROWS_DIFFER_PX)
    return float(np.mean(good))


def _channel_order(pixels: Array) -> tuple[int, ...] | None:
    """Order in which the channels make sense, if they do not as they are; None otherwise."""
    if _sound(pixels) > 1.0 - _MOST:
        return None
    # Swapped cameras and a swapped uL and uR alone look alike; the first is what happens.
    orders = [_SWAPPED, *permutations(range(4))]
    best = max(orders, key=lambda order: _sound(pixels[:, order]))
    return best if _sound(pixels[:, best]) > _MOST else None


def _rows(pixels: Array) -> str | None:
    """Rows of the two images that differ systematically."""
    difference = pixels[:, 1] - pixels[:, 3]
    if np.mean(np.abs(difference) > _ROWS_DIFFER_PX) < 1.0 - _KEPT:
        return None
    middle = float(np.median(difference))
    spread = 1.4826 * float(np.median(np.abs(difference - middle)))
    told = f"rows differ by {middle:+.1f} px (vL - vR, median; spread {spread:.1f} px)"
    if spread < _ROWS_DIFFER_PX:
        return (
            f"{told}, all alike: not rectified, or one image is shifted or cropped; rectify the pair, or "
            f"take {middle:.1f} px out of vL"
        )
    return (
        f"{told}: the images are not rectified, or left and right are of different features; rectify the pair"
    )


def _resolution(sequence: Sequence, *, outside: float) -> str | None:
    """An intrinsic matrix for another resolution than that of the pixels."""
    pixels, rig = sequence.pixels, sequence.rig
    reach = np.quantile(pixels[:, [0, 1]], _OUTERMOST, axis=0) / np.array([rig.cx, rig.cy])
    if outside > _KEPT:
        share = f"{100 * outside:.0f} %"
        return f"{share} lie outside an image of twice the principal point: is K for a smaller image?"
    if len(pixels) >= _ENOUGH and reach.max() < _INSIDE:
        return (
            f"the outermost pixels lie at {reach[0]:.2f} and {reach[1]:.2f} of the principal point, where "
            "twice is expected: is K for a larger image?"
        )
    return None
