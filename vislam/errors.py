"""The errors that the command line turns into exit codes."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names the dotted path of the key."""


class DataError(ValueError):
    """A recording or reference that cannot be used; the message names the file and the remedy."""


class DivergedError(RuntimeError):
    """An estimator that lost its covariance or its solution; the message names the frame."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM, as the commands raise it; a bare KeyboardInterrupt comes from somebody's code."""


def first_line(error: BaseException) -> str:
    """First line of what an error says, without the path that an OSError repeats."""
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return next((line for line in said.splitlines() if line.strip()), type(error).__name__)
