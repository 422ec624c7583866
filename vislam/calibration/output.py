"""The config that a calibration writes: the best so far after each round, and the calibrated one."""

from pathlib import Path

from vislam.base.files import check_writable, write_text
from vislam.base.legible import one_line
from vislam.comparison import config as configuration
from vislam.comparison.config import Config


class Output:
    """A config file, written whole or not at all.

    Attributes
    ----------
    path : Path
    kept : str
        The round after which the best config so far was written last; empty before the first.
    """

    def __init__(self, path: Path) -> None:
        check_writable(path)
        self.path, self.kept = path, ""

    def keep(self, config: Config, where: str) -> None:
        """Write the best config so far, marked as unfinished."""
        self._write(f"# calibration unfinished: {where}\n{configuration.dump(config)}")
        self.kept = where

    def finish(self, config: Config, *, rejected: str = "") -> None:
        """Write the calibrated config, or the one from before with the reason why it is that."""
        reason = f"# as before the calibration: {one_line(rejected)}\n" if rejected else ""
        self._write(f"{reason}{configuration.dump(config)}")

    def _write(self, text: str) -> None:
        write_text(self.path, text)
