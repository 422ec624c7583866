"""Options of the smoothers, and what can be asked of their end."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SmootherOptions:
    """Options of a smoother. The members of the family are settings of them."""

    motion: Literal["bias", "between"] = "bias"
    """How the recorded twist enters: with its bias as a variable that walks, or as one
    ``BetweenFactorPose3`` a step with the bias taken for known, at its prior's mean."""
    lag_s: Positive | None = None
    """Marginalise what was last seen longer ago than this [s]; null: keep all in the graph."""
    relinearize_every: Annotated[int, Field(ge=0)] = 5
    """Frames between two relinearisations on the way; 0: none, not in the end either."""
    window: Annotated[int, Field(ge=1)] = 5
    """Frames after its last sight for which a variable may still be relinearised, until the end."""
    pose_threshold_rad: Positive = 0.003
    """Relinearise a pose that turned by more than this [rad]."""
    pose_threshold_m: Positive | None = None
    """Relinearise a pose that moved by more than this [m]; null: by a twentieth of the baseline."""
    landmark_threshold: Positive = 0.005
    """Relinearise a landmark that moved by more than this share of its depth."""
    wildfire_threshold: NonNegative = 1.0
    """Old variables whose solution changes by less than this are left alone until the end [rad, m]."""
    factorization: Literal["qr", "cholesky", "auto"] = "auto"
    """How cliques are eliminated. GTSAM's Cholesky takes a half to an eighth of the time, and refuses a
    clique in which a pivot is less than 1e-7 of its diagonal; ``auto`` solves a refused step with QR and then
    goes back to it."""
    start_clearance: Positive = 5.0
    """A landmark starts when its disparity is this many standard deviations away from zero."""
    min_disparity_px: Positive = 1.3
    """A landmark whose disparity, as estimated, falls below this has gone astray [px]."""
    max_waiting_views: Annotated[int, Field(ge=2)] = 30
    """Views that a waiting track keeps; older ones are dropped and counted."""
    final: Literal["as_is", "relinearised", "batch", "gnc"] = "relinearised"
    """What is done after the last frame: nothing, updates that relinearise everything, Levenberg-Marquardt
    with the landmarks triangulated anew until the cost rests, or that without what graduated non-convexity
    takes for outliers."""
    final_iterations: Annotated[int, Field(ge=1)] = 1
    """Updates of ``relinearised``; else rounds of triangulation and optimisation, at most."""
    max_iterations: Annotated[int, Field(ge=1)] = 300
    """Iterations of the final optimisation, at most: updates of ``relinearised``, else Levenberg-Marquardt
    steps over all rounds, with Cholesky and QR together. The best estimate so far is then the result."""
    budget_s: Positive | None = None
    """Wall time of the final optimisation, at most [s]; null: unbounded. It makes the result depend on the
    machine."""
    factors: Literal["stereo", "smart"] = "stereo"
    """Factors of ``batch``: one a sight, or one smart factor a track, which holds no landmark. GTSAM's smart
    factors have one isotropic noise: rows are taken for as noisy as columns."""
    pose_cov_every: Annotated[int, Field(ge=0)] = 0
    """Frames between two marginal covariances of the newest pose; 0: none."""
    marginals: Literal["none", "poses", "all"] = "none"
    """Whose marginal covariances are computed in the end: nobody's, all poses', or the landmarks' as well."""
    max_rescues: Annotated[int, Field(ge=0)] = 50
    """A run with more rescues than this has failed."""

    @property
    def plain(self) -> bool:
        """Whether all stereo factors have the noise that is stated, and none is taken out."""
        return self.final != "gnc" and self.factors == "stereo"

    def __post_init__(self) -> None:
        """Refuse what has no meaning together."""
        if self.lag_s is not None and self.final in ("batch", "gnc"):
            raise ValueError(
                f"final: {self.final} needs the whole drive, lag_s marginalises it; set one to null"
            )
        if self.factors == "smart" and self.final != "batch":
            raise ValueError("factors: smart ones are for final: batch alone")
