"""Quantiles and tails of chi-square, normal and t distributions.

By ``scipy.special``, whose functions ``scipy.stats`` calls as well; importing that package takes a fifth of
the start of a command.
"""

from typing import Any

from scipy import special

from vislam.base.types import Array


def chi2_quantile(probability: Any, freedom: Any) -> Array:
    """Value below which a chi-square variable lies with a probability."""
    return 2.0 * special.gammaincinv(0.5 * freedom, probability)


def chi2_upper_quantile(probability: Any, freedom: Any) -> Array:
    """Value above which a chi-square variable lies with a probability."""
    return special.chdtri(freedom, probability)


def chi2_below(value: Any, freedom: Any) -> Array:
    """Probability that a chi-square variable is below a value."""
    return special.chdtr(freedom, value)


def chi2_above(value: Any, freedom: Any) -> Array:
    """Probability that a chi-square variable is above a value."""
    return special.chdtrc(freedom, value)


def normal_quantile(probability: Any) -> Array:
    """Value below which a standard normal variable lies with a probability."""
    return special.ndtri(probability)


def t_quantile(probability: Any, freedom: Any) -> Array:
    """Value below which Student's t lies with a probability."""
    return special.stdtrit(freedom, probability)
