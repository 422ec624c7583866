"""Averages of chi-square samples that follow each other in time, and what a consistent estimator's may be.

The samples of one run are not independent: a pose inherits its error from the pose before it. Taking them for
independent would accuse every sound estimator. So a mean of ``n`` samples is taken for a mean of fewer, their
effective number, which is estimated from how long the errors stay correlated.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from vislam.base.distributions import chi2_above, chi2_below, chi2_quantile, chi2_upper_quantile
from vislam.base.types import Array, IntArray

LAGS = 20
"""Lags [samples] at which a sequence is tested for whiteness."""


@dataclass(frozen=True)
class Statistic:
    """A chi-square statistic averaged over a run, per degree of freedom; 1 is expected.

    For the lower tail the effective number is halved: a sequence that happens to stay small happens to cross
    zero often as well, and looks less correlated than it is.

    Attributes
    ----------
    name : str
        For example ``nees_pose`` or ``nis``.
    value : float
    freedom : float
        Degrees of freedom of one sample, their mean if they differ.
    samples : int
    effective : float
        Number of independent samples that would tell as much, from 1 to ``samples``.
    convention : str
        Error, axes, gauge and covariance in words.
    fitted : bool
        Whether part of the error was fitted away, so that the value is too low if anything. Then no value is
        so low that it accuses, and the interval and the probability are one-sided.
    """

    name: str
    value: float
    freedom: float
    samples: int
    effective: float
    convention: str
    fitted: bool = False

    def interval(self, probability: float = 0.95) -> tuple[float, float]:
        """Interval of a consistent estimator's value."""
        low, high = self._freedoms
        if self.fitted:
            return 0.0, float(chi2_quantile(probability, high)) / high
        tail = 0.5 * (1.0 - probability)
        return float(chi2_quantile(tail, low)) / low, float(chi2_upper_quantile(tail, high)) / high

    def p_value(self) -> float:
        """Probability that a consistent estimator's value is as far out as this one."""
        low, high = self._freedoms
        above = float(chi2_above(self.value * high, high))
        return above if self.fitted else min(1.0, 2.0 * min(above, float(chi2_below(self.value * low, low))))

    @property
    def _freedoms(self) -> tuple[float, float]:
        """Degrees of freedom of the mean, for its lower and its upper tail."""
        return self.freedom * max(1.0, 0.5 * self.effective), self.freedom * self.effective


@dataclass(frozen=True)
class Whiteness:
    """Whether the samples of a sequence are uncorrelated with those before them.

    Attributes
    ----------
    lag, autocorrelation : (LAGS,)
        Sample autocorrelation at each lag [samples].
    band : float
        Half-width of the 95 % band of a white sequence's.
    p_value : float
        Of the test of Ljung and Box (Biometrika 1978) over all these lags.
    effective : float
        Effective number of samples.
    """

    lag: IntArray
    autocorrelation: Array
    band: float
    p_value: float
    effective: float


def of_errors(name: str, whitened: Array, *, convention: str, fitted: bool = False) -> Statistic:
    """Average of normalised squared errors, whose effective number comes from the errors themselves.

    Parameters
    ----------
    name : str
    whitened : (n, d)
        Errors in time order, each brought to unit covariance; in axes that do not turn with the body, for
        a turn would hide that they stay.
    convention : str
    fitted : bool
        Whether part of them was fitted away.
    """
    count, size = whitened.shape
    value, effective = float(np.mean(whitened**2)), effective_errors(whitened)
    return Statistic(name, value, float(size), count, effective, convention, fitted)


def of_squares(name: str, squares: Array, freedom: Array, *, convention: str) -> Statistic:
    """Average of chi-square samples of which no more is known, such as the NIS.

    Parameters
    ----------
    name : str
    squares, freedom : (n,)
        Samples in time order and the degrees of freedom of each, above 0.
    convention : str
    """
    value = float(squares.sum() / freedom.sum())
    effective = effective_squares(squares, freedom)
    return Statistic(name, value, float(freedom.mean()), len(squares), effective, convention)


def effective_errors(whitened: Array) -> float:
    """Effective number of samples of whitened errors ``(n, d)``, of mean zero if the estimator is sound.

    The variance of a mean square is ruled by the sum of the *squared* autocorrelations of the errors, its
    upper tail by the largest eigenvalue of their correlation matrix. The sum of the autocorrelations itself
    bounds the first from above and the second nearly so, and is used: for long correlation this halves the
    number. The autocorrelation is about zero, not about the sample mean, which follows a slow error; and it
    is relative to the sample variance, so that a wrong claim does not change it. Components share one
    number, the harmonic mean of theirs.
    """
    return _effective(_autocorrelation(whitened))


def effective_squares(squares: Array, freedom: Array) -> float:
    """Effective number of chi-square samples ``(n,)`` with ``freedom`` ``(n,)``.

    From their autocorrelation about their mean: correlation over much of the sequence stays unseen.
    """
    value = squares.sum() / freedom.sum()
    return _effective(_autocorrelation(((squares - value * freedom) / np.sqrt(freedom))[:, None]))


def whiteness(squares: Array, freedom: Array) -> Whiteness | None:
    """Test chi-square samples for whiteness; None if there are too few of them.

    Parameters
    ----------
    squares, freedom : (n,)
        Samples in time order and the degrees of freedom of each, above 0.
    """
    count = len(squares)
    if count <= 2 * LAGS:
        return None
    normal = (squares - freedom) / np.sqrt(2.0 * freedom)
    lag = np.arange(1, LAGS + 1)
    # The usual estimate divides every lag by the same number.
    found = _autocorrelation((normal - normal.mean())[:, None])[lag, 0] * (1.0 - lag / count)
    box = count * (count + 2.0) * np.sum(found**2 / (count - lag))
    return Whiteness(
        lag, found, 1.96 / np.sqrt(count), float(chi2_above(box, LAGS)), effective_squares(squares, freedom)
    )


def _autocorrelation(values: Array) -> Array:
    """Autocorrelation ``(n, d)`` about zero at all lags of ``(n, d)``, each lag over the pairs it has."""
    count = len(values)
    size = next_fast_len(2 * count, real=True)
    spectrum = np.abs(rfft(values, size, axis=0)) ** 2
    found = irfft(spectrum, size, axis=0)[:count] / np.arange(count, 0, -1)[:, None]
    still = found[0] <= 0.0
    return np.asarray(np.clip(found / np.where(still, 1.0, found[0]), -1.0, 1.0))


def _effective(correlation: Array) -> float:
    """Effective number of samples from autocorrelations ``(n, d)``.

    They are summed up to the first pair of lags whose sum is not positive: Geyer's initial positive sequence
    (Practical Markov chain Monte Carlo, Statistical Science 1992, section 3.3). One sample is given away for
    the correlation being estimated; calibrated by simulation up to errors that never decorrelate.
    """
    count = len(correlation)
    if count < 2:
        return 1.0
    pairs = correlation[: count - count % 2].reshape(-1, 2, correlation.shape[1]).sum(axis=1)
    negative = pairs <= 0.0
    stop = 2 * np.where(negative.any(axis=0), negative.argmax(axis=0), len(pairs))
    lag = np.arange(count)[:, None]
    summed = np.sum(np.where(lag < stop, (1.0 - lag / count) * correlation, 0.0), axis=0)
    # No sequence counts for more than its samples.
    length = np.clip(2.0 * summed - 1.0, 1.0, count)
    return float(max(1.0, count / length.mean() - 1.0))
