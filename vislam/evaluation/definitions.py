"""Definitions of the metrics in a sentence each, for the reference and for the page of a comparison."""

from vislam.core.run import Beside
from vislam.evaluation.metric import METRICS

_OWN = {
    "ate_rmse": (
        "Absolute trajectory error: root mean square distance of the estimated positions from the "
        "reference, after the rigid (SE(3)) alignment of all positions by least squares (Umeyama 1991, no "
        "scale)."
    ),
    "ate_planar_rmse": (
        "The same in the horizontal plane: alignment by a turn about the vertical and a shift in the "
        "plane, distances without the height."
    ),
    "ate_rotation_rmse": (
        "Root mean square angle between estimated and reference attitude, after the same alignment."
    ),
    "ate_sim3_rmse": (
        "The absolute trajectory error after a similarity alignment (Umeyama 1991), with the scale fitted."
    ),
    "rows_matched": "Rows of a trajectory file that belong to a row of the reference, or to a moment of it.",
    "share_matched": "The same, as a share of the rows of the sparser of the two.",
    "completion": "Time from the first matched row to the last, as a share of that of the reference.",
    "scale": "Factor by which the positions of a trajectory were multiplied to fit (alignment: sim3).",
    "clock_offset": "What was added to the stamps of a trajectory to fit (clock_offset: estimate).",
    "log_score_pose": (
        "Negative log-density of the pose errors under the estimated covariances, mean over the frames: a "
        "proper score, less is better."
    ),
    "energy_score_position": (
        "Energy score of the position errors under the estimated covariances (Gneiting and Raftery 2007), "
        "mean over the frames: a proper score in metres, less is better."
    ),
    "map_points_complete": (
        "Share of the points of the other map that have a point of this one within 5 % of their depth."
    ),
    "held_out_median": (
        "Tracks withheld from every estimator are triangulated from half of their observations at the "
        "estimated poses and predicted in the other half: median over the tracks of the RMS pixel error."
    ),
    "path_length_inertial": (
        "Path length of the recorded inertial data alone, integrated without the camera."
    ),
    "path_length": "Sum of the distances between successive estimated positions.",
    "height_end": "z of the last position, in the world frame of the first pose.",
    "kitti_t_rel": (
        "Relative translation error as the KITTI odometry kit computes it: mean over all segments of 100 "
        "to 800 m, as a share of their length."
    ),
    "kitti_r_rel": "Relative rotation error of the same segments, per 100 m.",
    "map_error_median": (
        "Median distance of the estimated landmarks from the true ones (simulation only), worlds joined "
        "at the first pose."
    ),
    "drift_end": (
        "Position error at the last frame as a share of the distance travelled, worlds joined at the "
        "first pose."
    ),
    "nees_pose": (
        "Normalised estimation error squared of the pose, e' P^-1 e / 6 averaged over the frames, with e "
        "= log(estimate^-1 truth) and P the estimated covariance, both on the right. 1 is expected; above "
        "it the estimator is overconfident, below it conservative."
    ),
    "nees_position_planar": (
        "The same for the planar position against a reference without attitudes. The reference is aligned "
        "to minimise it, so the test is one-sided: only values above 1 count against the estimator."
    ),
    "nees_position_aligned": "The same for the position in space.",
    "scale_gap_pose": (
        "Square root of the median NEES of the pose over the median of chi-square with as many degrees of "
        "freedom: how many times too small the estimated sigmas are. 1 is expected."
    ),
    "scale_gap_position": "The same for the position, three degrees of freedom.",
    "scale_gap_position_planar": "The same for the horizontal position, two degrees of freedom.",
    "scale_gap_position_aligned": "The same for the position in space after the alignment.",
    "coverage_90_pose": (
        "Share of the frames whose 90 % confidence region of the pose holds the reference. 0.9 is expected."
    ),
    "coverage_90_position": "The same for the position.",
    "coverage_90_position_planar": "The same for the horizontal position.",
    "coverage_90_position_aligned": "The same for the position in space after the alignment.",
    "nis_per_dof": (
        "Normalised innovation squared, nu' S^-1 nu divided by its degrees of freedom, over the accepted "
        "observations of the whole run. 1 is expected; below it the stated noise is too large."
    ),
    "fit_per_dof": (
        "Squared residuals of a smoother's final estimate, each by its noise, per degree of freedom "
        "(residuals less unknowns). 1 is expected, without a robust kernel: what the NIS is to a filter."
    ),
    "spurious_yaw_information": (
        "Spurious information: what the filter's own Jacobians claim to observe of the rotation of the "
        "world about the vertical, which no measurement holds, summed over the run. 0 is right."
    ),
    "bound_ratio_rotation": (
        "Squared error of the rotations since the first frame over the posterior Cramer-Rao bound, both "
        "summed over the sequence (simulation with known noise). 1 is expected of an efficient estimator."
    ),
    "bound_ratio_position": "The same of the positions.",
    "bound_excess_rotation": (
        "Squared error of the rotations less that of the linear estimator that attains the bound on the "
        "same noise, in percent of the bound: 0 is expected of an efficient estimator, with far less "
        "scatter than the ratio."
    ),
    "bound_excess_position": "The same of the positions.",
    "nis_autocorrelation": (
        "Autocorrelation of the NIS at a lag of one frame. The innovations of a consistent filter are "
        "white, so 0 is expected."
    ),
    "smoothing_per_dof": (
        "Difference of filtered and smoothed poses, normalised by the difference of their covariances, "
        "per degree of freedom. 1 is expected, without any reference."
    ),
    "smoothing_indefinite": ("Share of the frames whose smoothed covariance is not below the filtered one."),
    "landmarks": "Landmarks of the final map.",
    "observations_used": "Stereo observations that the final estimate rests on.",
    "observations_gated": "Stereo observations that the estimator itself rejected.",
    "step_time_p50_ms": "Median wall time of a frame, in the estimator alone.",
    "step_time_p95_ms": "95th percentile of the wall time of a frame.",
    "total_time_s": (
        "Wall time of all frames and, for the smoothed estimate, of the backward pass or the final "
        "optimisation and covariances."
    ),
    "peak_rss_mb": (
        "Largest resident memory of the process while the estimator ran; runs one after the other share a "
        "process, so it does not fall from one to the next."
    ),
}
_BESIDE: dict[Beside, str] = {
    "considered": (
        "The same by the consider covariance: the estimator's own and what the errors add that all "
        "observations share (Schmidt 1966)."
    ),
    "sandwich": "The same by the covariance from the scores of blocks of time (Huber 1967, White 1982).",
}


def _definition(key: str) -> str:
    """Definition of a metric of the registry."""
    for kind, told in _BESIDE.items():
        if key.endswith(kind):
            return told
    return _OWN[key]


DEFINITIONS = {key: _definition(key) for key in METRICS}
"""What each metric of the registry is, by its key."""
