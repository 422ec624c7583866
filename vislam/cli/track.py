"""``vislam track``: make stereo tracks of a recording of images, in the open track format.

It is a folder that holds ``mav0`` (EuRoC, TUM-VI), a KITTI raw drive, synced or "extract", or a bag of ROS
1 or 2. Beside FILE.npz come
FILE_quality.npz (forward-backward distances and lives) and FILE_front_end.json (settings, counts, figures).
Tracks that were made of the same images with the same settings before are taken from the cache. Exit codes: 0
written, 2 wrong input, 130 interrupted.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vislam.cli.command import Parser, answer, overrides
from vislam.cli.recording import add_choice_options, add_front_end_option, choice_of, located


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _track(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="vislam track", description=__doc__)
    add = parser.add_argument
    add("recording", type=Path, metavar="PATH", help="folder of the images, or bag")
    add_choice_options(parser)
    add_front_end_option(parser)
    add("-o", "--out", type=Path, required=True, metavar="FILE", help="the .npz file to write")
    add("--seed", type=int, default=None, help="seed of the consensus (default: 0)")
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting of the front end, as features=300 (docs/reference/front_end.md lists them)",
    )
    add("--fresh", action="store_true", help="make the tracks even if they are in the cache")
    add("--verbose", action="store_true", help="log what is read")
    return parser


def _track(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.base.errors import ConfigError  # noqa: PLC0415
    from vislam.base.files import check_writable  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.datasets.images import open_images  # noqa: PLC0415
    from vislam.frontend.cache import copy_tracks, require_opencv, tracks_of  # noqa: PLC0415
    from vislam.frontend.registry import choose_front_end  # noqa: PLC0415

    if options.out.suffix != ".npz":
        raise ConfigError(f"--out must name a .npz file, got {options.out}")
    require_opencv()
    chosen = choose_front_end(options.front_end, overrides(options))
    check_writable(options.out)
    recording, terminal = open_images(located(options.recording), choice_of(options)), Terminal()
    path, made = tracks_of(recording, chosen, progress=terminal, fresh=options.fresh)
    copy_tracks(path, options.out)
    summary = json.loads(
        options.out.with_name(f"{options.out.stem}_front_end.json").read_text(encoding="utf-8")
    )
    for line in told(summary, made=made):
        terminal.note(line)
    terminal.note(f"{options.out}: written")
    return 0


def told(summary: dict[str, Any], *, made: bool) -> list[str]:
    """Lines about the tracks for the terminal."""
    counts, figures = summary["counts"], summary["figures"]
    speed = f"{figures['frames_per_second']:.1f} frames/s" if made else "from the cache"
    lines = [
        f"{summary['recording']}: {counts['frames']} frames, {counts['tracks']} tracks, "
        f"{counts['observations']} "
        f"observations, {speed}",
        f"in view {figures['in_view_median']:.0f}, life {figures['life_median']:.0f} frames (medians; "
        "half of the "
        f"observations are of tracks of {figures['life_median_of_observations']:.0f} or more)",
        _rows(figures),
    ]
    left_out = [f"{name.replace('_', ' ')} {counts[name]}" for name in LEFT_OUT if counts.get(name)]
    if left_out:
        lines.append(f"left out: {', '.join(left_out)}")
    without = counts.get("inertial_samples_without_mounting")
    if without:
        lines.append(
            f"{without} inertial samples are left out: nothing says how the sensor sits on the cameras"
        )
    if not summary["velocity"]:
        lacking = "VELOCITY" if summary["gyro"] else "INERTIAL SAMPLE"
        lines.append(
            f"NO {lacking} was recorded: what the file has is 0, "
            "and its noise must be set so wide that it says nothing (docs/guides/your_own_images.md)"
        )
    return lines


LEFT_OUT = (
    "images_missing_left",
    "images_missing_right",
    "images_unpaired",
    "images_duplicate",
    "images_corrupt",
    "images_truncated",
    "images_of_wrong_size",
    "images_of_unknown_encoding",
    "images_late",
    "frames_held",
)
"""Counts of images and pairs that went into no track."""


def _rows(figures: dict[str, float]) -> str:
    line = (
        f"rows of left and right differ by {figures['row_error_px']:+.2f} px "
        f"(spread {figures['row_spread_px']:.2f})"
    )
    if "right_camera_turned_x_mrad" not in figures:
        return line
    return (
        f"{line}; with the right camera turned by {figures['right_camera_turned_x_mrad']:+.2f} mrad "
        "about x and "
        f"{figures['right_camera_turned_z_mrad']:+.2f} about z by "
        f"{figures['row_error_corrected_px']:+.2f} px "
        f"(spread {figures['row_spread_corrected_px']:.2f})"
    )


if __name__ == "__main__":
    sys.exit(main())
