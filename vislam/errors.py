"""The errors that the command line turns into exit codes."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names the dotted path of the key."""


class DataError(ValueError):
    """A recording or reference that cannot be used; the message names the file and the remedy."""


class DivergedError(RuntimeError):
    """An estimator that lost its covariance or its solution; the message names the frame."""
