"""The first state of raw inertia, found from the data, with an account of how; or of why not."""

from vislam.initialisation.found import Found, NotFoundError
from vislam.initialisation.initialise import initialise
from vislam.initialisation.noise import noise_factor, scaled
from vislam.initialisation.settings import InitialisationSettings

__all__ = ["Found", "InitialisationSettings", "NotFoundError", "initialise", "noise_factor", "scaled"]
