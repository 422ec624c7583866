"""The least error of an unbiased estimator of a simulated sequence, as it is saved with the sequence."""

from dataclasses import dataclass

from vislam.base.types import Array


@dataclass(frozen=True)
class Bound:
    """Bound of the poses relative to the first, from the data up to each frame and from all data.

    Errors (omega, v) are on the right of the true poses [rad, m].

    Attributes
    ----------
    filtered, smoothed : (T, 6, 6)
        Least covariances; 0 at the first frame.
    filtered_error, smoothed_error : (T, 6)
        What an estimator that attains them errs by on the noise of this sequence.
    """

    filtered: Array
    smoothed: Array
    filtered_error: Array
    smoothed_error: Array
