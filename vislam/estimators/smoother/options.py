"""Options of the smoothers."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SmootherOptions:
    """Options of a smoother; its variants are settings of them."""

    motion: Literal["bias", "between"] = "bias"
    """How the recorded twist enters: with its bias as a random-walk variable, or as one
    ``BetweenFactorPose3`` a step with the bias held at its prior mean."""
    lag_s: Positive | None = None
    """Marginalise what was last observed longer ago than this [s]; null: keep all in the graph."""
    relinearize_every: Annotated[int, Field(ge=0)] = 5
    """Frames between two relinearisations of what was observed last; 0: none, not after the last frame."""
    relinearize_beyond: Positive | Literal["far"] | None = 1.0
    """Relinearise at once where the linearisation of a newest observation neglects more than this many of its
    standard deviations, or one step corrects much of the trajectory; ``far``: only there; null: never."""
    window: Annotated[int, Field(ge=1)] = 5
    """Frames after its last observation for which a variable may be relinearised, until the last frame."""
    pose_threshold_rad: Positive = 0.003
    """Relinearise a pose that turned by more than this [rad]."""
    pose_threshold_m: Positive | None = None
    """Relinearise a pose that moved by more than this [m]; null: by a twentieth of the baseline."""
    landmark_threshold: Positive = 0.005
    """Relinearise a landmark that moved by more than this share of its depth."""
    wildfire_threshold: NonNegative | None = None
    """Old variables whose solution changes by less than this are not updated until the end [rad, m]; null: by
    1.7 times the baseline."""
    factorization: Literal["qr", "cholesky", "auto"] = "auto"
    """How cliques are eliminated. GTSAM's Cholesky takes a half to an eighth of the time, and fails for a
    clique with a pivot below 1e-7 of its diagonal; ``auto`` is Cholesky, and solves a step for which it
    fails, and no other, with QR."""
    initialisation_snr: Positive = 5.0
    """A landmark is initialised when its disparity is this many standard deviations away from zero."""
    min_disparity_px: Positive = 1.3
    """A landmark whose estimated disparity falls below this is degenerate and is rejected [px]."""
    max_pending_observations: Annotated[int, Field(ge=2)] = 30
    """Observations that a track keeps before it is initialised; older ones are dropped and counted."""
    final: Literal["as_is", "relinearised", "batch", "gnc"] = "relinearised"
    """What is done after the last frame: nothing, updates that relinearise everything, Levenberg-Marquardt
    with the landmarks re-triangulated until convergence, or that without the outliers of graduated
    non-convexity."""
    final_iterations: Annotated[int, Field(ge=1)] = 1
    """Updates of ``relinearised``; else rounds of triangulation and optimisation, at most."""
    max_iterations: Annotated[int, Field(ge=1)] = 300
    """Iterations of the final optimisation, at most: updates of ``relinearised``, else Levenberg-Marquardt
    steps over all rounds, with Cholesky and QR together. The best estimate so far is then the result."""
    budget_s: Positive | None = None
    """Wall time of the final optimisation, at most [s]; null: unbounded. It makes the result depend on the
    machine."""
    optimiser: Literal["gtsam", "schur"] = "gtsam"
    """Levenberg-Marquardt of ``batch``, and of ``gnc`` without the outliers: GTSAM's, or ours on normal
    equations with the landmarks eliminated. Both find the same optimum."""
    factors: Literal["stereo", "smart"] = "stereo"
    """Factors of ``batch``: one an observation, or one smart factor a track, which eliminates the landmark.
    GTSAM's smart factors have one isotropic noise: that of rows is taken to be that of columns."""
    pose_cov_every: Annotated[int, Field(ge=0)] = 0
    """Frames between two marginal covariances of the newest pose; 0: none."""
    marginals: Literal["none", "poses", "all"] = "none"
    """Marginal covariances computed after the last frame: none, of all poses, or of the landmarks as well."""
    max_recoveries: Annotated[int, Field(ge=0)] = 50
    """Solver recoveries after which a run has failed."""

    def relinearises(self, k: int) -> bool:
        """Whether the update with a frame relinearises in any case."""
        return self.relinearize_every > 0 and (k + 1) % self.relinearize_every == 0

    @property
    def plain(self) -> bool:
        """Whether all stereo factors have the noise that is stated, and none is taken out."""
        return self.final != "gnc" and self.factors == "stereo"

    def __post_init__(self) -> None:
        """Reject options that contradict each other."""
        if self.lag_s is not None and self.final in ("batch", "gnc"):
            raise ValueError(
                f"final: {self.final} needs the whole sequence, lag_s marginalises it; set one to null"
            )
        if self.factors == "smart" and self.final != "batch":
            raise ValueError("factors: smart ones are for final: batch alone")
        if self.optimiser == "schur" and self.final not in ("batch", "gnc"):
            raise ValueError(f"optimiser: schur is for final: batch or gnc, not {self.final}")
        if self.optimiser == "schur" and self.factors == "smart":
            raise ValueError("optimiser: schur eliminates the landmarks itself; set factors to stereo")
