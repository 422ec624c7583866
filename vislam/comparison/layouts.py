"""All trajectories of results in the layouts of other tools."""

from dataclasses import replace
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.base.files import folder_name
from vislam.comparison.results import Results
from vislam.core.run import Run
from vislam.core.stamped import Stamped
from vislam.datasets.layouts import write_layouts


def export_layouts(results: Results, folder: Path) -> list[Path]:
    """Write each run and the reference for evo, rpg, OpenVINS, smfeval and KITTI; return the files.

    Raises
    ------
    ConfigError
        If there is no reference.
    DataError
        If a file cannot be written.
    """
    reference = results.record.reference
    if reference is None:
        raise ConfigError("--export: there is no reference, without which none of these layouts is whole")
    source = reference.source
    if source is None:
        source = Stamped(results.record.stamp[reference.frame], reference.position, reference.pose)
    written = []
    for name, run in results.runs.items():
        own = results.own.get(name)
        scored = run if own is None else own.run
        if len(scored.frame):
            written += write_layouts(folder, folder_name(name), _rows(scored), source)
    return written


def _rows(run: Run) -> Stamped:
    pose = run.final.world_T_imu
    return replace(Stamped(run.stamp, pose[:, :3, 3], pose), cov=run.final.cov)
