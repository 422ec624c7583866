"""Quantiles and tails against ``scipy.stats``."""

import numpy as np
import pytest
from scipy.stats import chi2, norm, t

from vislam.base import distributions

SHARES = np.array([1e-9, 0.01, 0.025, 0.5, 0.9, 0.975, 0.9999])
VALUES = np.array([0.0, 1e-6, 0.3, 1.0, 12.0, 800.0])


@pytest.mark.parametrize("freedom", [0.7, 1.0, 3.0, 6.0, 2000.0])
def test_chi_square_is_that_of_scipy_stats(freedom):
    law = chi2(freedom)
    for own, theirs, at in (
        (distributions.chi2_quantile, law.ppf, SHARES),
        (distributions.chi2_upper_quantile, law.isf, SHARES),
        (distributions.chi2_below, law.cdf, VALUES),
        (distributions.chi2_above, law.sf, VALUES),
    ):
        np.testing.assert_allclose(own(at, freedom), theirs(at), rtol=1e-12)


@pytest.mark.parametrize("freedom", [1.0, 4.0, 31.0])
def test_normal_and_t_are_those_of_scipy_stats(freedom):
    shares = SHARES[SHARES != 0.5]
    np.testing.assert_allclose(distributions.normal_quantile(shares), norm.ppf(shares), rtol=1e-12)
    np.testing.assert_allclose(distributions.t_quantile(shares, freedom), t.ppf(shares, freedom), rtol=1e-9)
