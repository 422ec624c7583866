"""Noise, biases and clock from the data alone, by maximising the likelihood of the filter's innovations.

A filter whose models fit predicts each measurement with an error of the covariance that it claims. The
density of all innovations under that claim is the likelihood of the models (Mehra 1970), and its maximum sets
noise levels that neither a reference nor a hand has touched.
"""

from vislam.calibration.estimate import Calibration, calibrate
from vislam.calibration.parameters import Parameter, parameters

__all__ = ["Calibration", "Parameter", "calibrate", "parameters"]
