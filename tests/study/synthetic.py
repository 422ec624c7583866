"""Trials made up for tests: the errors, claims and failures are known."""

import itertools

import numpy as np


def record(seed, point, values, *, failed=()):
    """Plain data of one trial; ``values`` is {estimator: {key: value}}."""
    runs = {
        name: {"complete": name not in failed, "error": "diverged" if name in failed else ""}
        for name in values
    }
    metrics = [
        {"estimator": name, "key": key, "value": value}
        for name, found in values.items()
        for key, value in found.items()
    ]
    return {"seed": seed, "point": point, "status": "done", "reason": "", "runs": runs, "metrics": metrics}


def lost(seed, point, reason="worker was killed"):
    """Plain data of a trial that failed as a whole."""
    return {"seed": seed, "point": point, "status": "failed", "reason": reason}


def study(sweep, *, seeds=12, overconfident=lambda point: 1.0, rng=None):
    """Trials of two estimators, of which the second errs by 0.2 m less and is consistent.

    ``overconfident`` gives the expected NEES of the first at a point.
    """
    rng = np.random.default_rng(5) if rng is None else rng
    records = []
    for values in itertools.product(*sweep.values()):
        point = dict(zip(sweep, values, strict=True))
        for seed in range(seeds):
            drive = 1.0 + rng.gamma(4.0, 0.1)
            nees = rng.chisquare(30, 2) / 30 * [overconfident(point), 1.0]
            ekf = {"ate_rmse": drive + 0.2 + rng.normal(0.0, 0.05), "nees_pose": nees[0]}
            isam2 = {"ate_rmse": drive + rng.normal(0.0, 0.05), "nees_pose": nees[1]}
            for found, milliseconds in ((ekf, 5.0), (isam2, 20.0)):
                found["coverage_pose_3sigma"] = 1.0 - 0.005 * rng.uniform()
                found["step_time_p50_ms"] = milliseconds * rng.uniform(0.9, 1.1)
            records.append(record(seed, point, {"ekf": ekf, "isam2": isam2}))
    return records
