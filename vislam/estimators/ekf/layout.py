"""Where things stand in the filter's joint state: navigation first, then the landmarks.

Pose and bias are those of :mod:`vislam.models.odometry`; behind them stand parameters that are estimated
where their prior is not zero, and cost next to nothing where it is.
"""

CLOCK = 12
"""How much later the inertial stamps are than taken for [s]."""
OFFSET = 13
"""How much too large all disparities are [px]."""
TILT = slice(14, 16)
"""Turn of the true vertical against the world's z axis, about x and y [rad]."""
CLIMB = 16
"""Error of the integrated climb rate [m]."""
NAV = 17
"""Size of the navigation state."""
LANDMARK = 4
"""Size of a landmark: three coordinates, and the error of its match (``vislam.models.track_noise``)."""
