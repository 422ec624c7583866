"""The errors that the command line turns into exit codes."""

from pathlib import Path

from vislam.base.legible import one_line

INTERRUPTED = 130
"""Exit code after Ctrl-C or SIGTERM, as a shell gives it."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names the dotted path of the key."""


class DataError(ValueError):
    """A recording or reference that cannot be used; the message names the file and the remedy."""


class NotWrittenError(DataError):
    """A file that cannot be written, before or after the work.

    Attributes
    ----------
    why : str
        What the file system said of it.
    """

    def __init__(self, path: Path, why: str, remedy: str) -> None:
        # All of them, so that it can be sent to another process.
        super().__init__(path, why, remedy)
        self.why = why

    def __str__(self) -> str:
        path, why, remedy = self.args
        return f"{path}: cannot be written ({why}); {remedy}"


class DivergedError(RuntimeError):
    """An estimator that lost its covariance or its solution; the message names the frame."""


class LostError(RuntimeError):
    """Work whose process was lost whenever it ran; the message says so."""


class ContractError(ValueError):
    """What an estimator returned is not what the interface asks for; the message names the field."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM, as the commands raise it; a bare KeyboardInterrupt comes from somebody's code."""

    def __str__(self) -> str:
        return "interrupted"


def interruption(error: BaseException) -> Interrupted | None:
    """Return what an error came of, if that is Ctrl-C or SIGTERM.

    Whoever is interrupted may raise something else: the import of an extension an ImportError, a file that is
    closed on the way a ValueError.
    """
    met: list[BaseException] = []
    here: BaseException | None = error
    while here is not None and not any(here is one for one in met):
        if isinstance(here, Interrupted):
            return here
        met.append(here)
        here = here.__cause__ or here.__context__
    return None


def first_line(error: BaseException) -> str:
    """First line of an error's message, of bounded length, without the path that an OSError repeats."""
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return one_line(next((line for line in said.splitlines() if line.strip()), type(error).__name__))
