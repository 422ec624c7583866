"""Far points of a simulated drive stay where its true motion carries them."""

import numpy as np

from experiments.far_points import lines, residuals


def test_with_the_true_motion_residuals_are_noise(short):
    frame, depth, residual = residuals(short)
    assert len(frame) == len(depth) == len(residual) > 100
    assert np.all(np.diff(frame) >= 0)
    # Two observations of 0.3 px, and their drift: a median of some hundred is good to a tenth of that.
    far = depth > 20.0
    assert np.abs(np.median(residual[far], axis=0)).max() < 0.15
    assert all(line.count("±") == 2 for line in lines(short))
