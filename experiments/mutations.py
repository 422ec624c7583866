"""Plants faults in a copy of the sources, one at a time, and says which of them the fast tests do not catch.

``python experiments/mutations.py [NAME ...]``, from the checkout. A fault that survives asks for a test.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COPIED = ("vislam", "baselines", "configs", "tests", "docs", "experiments", "pyproject.toml")


@dataclass(frozen=True)
class Mutation:
    """One text in the place of another, and the tests that should see it."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


FILTER = "vislam/estimators/ekf/filter.py"
ODOMETRY = "vislam/models/odometry.py"
STEREO = "vislam/models/stereo.py"
EKF, SMOOTHER, SCORES = ("tests/ekf",), ("tests/smoother",), ("tests/evaluation",)
INERTIAL = (
    "tests/ekf/test_inertial.py",
    "tests/smoother/test_inertial.py",
    "tests/sensors/test_preintegration.py",
)
WINDOW = ("tests/smoother/test_window.py",)
MODELS = ("tests/sensors", "tests/ekf", "tests/geometry")
MUTATIONS = (
    Mutation(
        "a velocity that does not turn with the world",
        "vislam/estimators/ekf/layout.py",
        "= -so3.hat(nav[self[VELOCITY]])",
        "= so3.hat(nav[self[VELOCITY]])",
        INERTIAL,
    ),
    Mutation(
        "bias walk and motion of a step uncorrelated",
        "vislam/models/preintegration.py",
        'out[MOTION, BIASES] = -np.einsum("nij,nj->ij", later, walk)',
        "out[MOTION, BIASES] = 0.0",
        INERTIAL,
    ),
    Mutation(
        "gravity that pulls up",
        "vislam/models/imu.py",
        "np.array([0.0, 0.0, -self.gravity])",
        "np.array([0.0, 0.0, self.gravity])",
        INERTIAL,
    ),
    Mutation(
        "covariance of a gap with the gyro's bias in front of the accelerometer's",
        "vislam/estimators/smoother/inertial.py",
        "turn[9:, 9:][:, _GTSAM_ORDER] = np.eye(6)",
        "turn[9:, 9:] = np.eye(6)",
        INERTIAL,
    ),
    Mutation(
        "gates_from ignored",
        "vislam/comparison/running.py",
        "if common_set is None and gates_from is not None and gates_from in before:",
        "if False:",
        ("tests/test_gates.py",),
    ),
    Mutation(
        "what the gate has let pass is not usable, not what it has gated",
        "vislam/comparison/running.py",
        "return ~runs[gates_from].gated",
        "return ~runs[gates_from].used",
        ("tests/test_gates.py",),
    ),
    Mutation(
        "gate with two degrees of freedom for three",
        FILTER,
        "chi2_quantile(problem.gate_probability, 3)",
        "chi2_quantile(problem.gate_probability, 2)",
        EKF,
    ),
    Mutation(
        "gate decisions ignored by the filter",
        FILTER,
        "allowed=usable[rows], slots=slots",
        "allowed=np.ones(len(rows), bool), slots=slots",
        ("tests/test_testing.py",),
    ),
    Mutation(
        "gate decisions ignored by the smoother",
        "vislam/estimators/smoother/tracks.py",
        "np.flatnonzero(frame.stereo.usable)",
        "np.arange(len(frame.stereo))",
        ("tests/test_testing.py",),
    ),
    Mutation(
        "Student weight without the dimension",
        "vislam/models/kernel.py",
        "return (nu + DIMENSION) / (nu + squared)",
        "return nu / (nu + squared)",
        ("tests/smoother/test_kernel.py", *EKF),
    ),
    Mutation(
        "vertical velocity with the wrong sign",
        "vislam/estimators/ekf/motion.py",
        'by_nav[0, layout["height"]] = -1.0',
        'by_nav[0, layout["height"]] = 1.0',
        EKF,
    ),
    Mutation(
        "stereo-matching bias left out of a new landmark",
        FILTER,
        "variance = np.column_stack([variance, match**2])",
        "variance = np.column_stack([variance, 1e-6 * match**2])",
        EKF,
    ),
    Mutation(
        "process noise by the square of the step",
        ODOMETRY,
        "cov=dt * (jacobian * noise.twist**2)",
        "cov=dt**2 * (jacobian * noise.twist**2)",
        MODELS,
    ),
    Mutation(
        "walk of the bias without the step",
        ODOMETRY,
        "bias_cov=dt * np.diag",
        "bias_cov=np.diag",
        MODELS,
    ),
    Mutation(
        "bias added, not taken off", ODOMETRY, "xi = dt * (twist - bias)", "xi = dt * (twist + bias)", MODELS
    ),
    Mutation(
        "left for right perturbation",
        ODOMETRY,
        "se3.adjoint(se3.inverse(step.prev_T_next))",
        "np.eye(6)",
        MODELS,
    ),
    Mutation(
        "bias does not move the pose's error",
        ODOMETRY,
        "by_bias=-dt * jacobian",
        "by_bias=dt * jacobian",
        MODELS,
    ),
    Mutation(
        "right column as the left one's derivative",
        STEREO,
        "out[..., 1, 2] = -self.fx * (x - self.baseline) / z**2",
        "out[..., 1, 2] = -self.fx * x / z**2",
        MODELS,
    ),
    Mutation(
        "row back-projected by the column's focal length",
        STEREO,
        "(z[..., 2] - self.cy) * depth / self.fy",
        "(z[..., 2] - self.cy) * depth / self.fx",
        MODELS,
    ),
    Mutation(
        "cross-covariance of navigation and landmarks dropped",
        "vislam/estimators/ekf/linear.py",
        "cov[:nav, nav:] = moved[:, nav:]",
        "cov[:nav, nav:] = 0.0 * moved[:, nav:]",
        EKF,
    ),
    Mutation(
        "a reset of the error without the product of both of its parts",
        "vislam/estimators/ekf/linear.py",
        "half = cov[:, POSE] + 0.5 * (by_pose @ cov[POSE, POSE])",
        "half = cov[:, POSE]",
        EKF,
    ),
    Mutation(
        "a distance of the gate without the last covariance",
        "vislam/estimators/ekf/linear.py",
        "zy = cov[:, 2, 1] - of_z * yx",
        "zy = cov[:, 2, 1]",
        EKF,
    ),
    Mutation(
        "one block of a symmetric product too few",
        "vislam/estimators/ekf/linear.py",
        "out[:start, own] = out[own, :start].T",
        "out[:start, own] = 0.0",
        EKF,
    ),
    Mutation(
        "the coupling of a single left Jacobian with the wrong sign",
        "vislam/geometry/se3.py",
        "by_v, by_omega = 0.5 - third * square, s * (2.0 * third - second)",
        "by_v, by_omega = 0.5 - third * square, s * (second - 2.0 * third)",
        MODELS,
    ),
    Mutation(
        "rotation of the alignment transposed",
        "vislam/evaluation/alignment.py",
        "self.scale * points @ self.rotation.T",
        "self.scale * points @ self.rotation",
        SCORES,
    ),
    Mutation(
        "association off by one",
        "vislam/evaluation/association.py",
        "estimate=world_T_imu[own] @ reference.imu_T_point",
        "estimate=world_T_imu[np.maximum(own - 1, 0)] @ reference.imu_T_point",
        SCORES,
    ),
    Mutation(
        "lever arm of the reference on the wrong side",
        "vislam/evaluation/association.py",
        "world_T_imu[own] @ reference.imu_T_point",
        "reference.imu_T_point @ world_T_imu[own]",
        SCORES,
    ),
    Mutation(
        "Bonferroni dropped from the divergence",
        "vislam/evaluation/agreement.py",
        "chi2_upper_quantile(alarm / len(self.squared), 6)",
        "chi2_upper_quantile(alarm, 6)",
        SCORES,
    ),
    Mutation(
        "agreement with three degrees of freedom",
        "vislam/evaluation/agreement.py",
        "float(self.squared.mean()) / 6.0",
        "float(self.squared.mean()) / 3.0",
        SCORES,
    ),
    Mutation(
        "position covariance not turned to the world",
        "vislam/evaluation/normalised.py",
        "turn @ cov[:, 3:, 3:] @ turn.transpose(0, 2, 1)",
        "turn.transpose(0, 2, 1) @ cov[:, 3:, 3:] @ turn",
        SCORES,
    ),
    Mutation(
        "NEES by the wrong block of the tangent",
        "vislam/evaluation/normalised.py",
        "(turn @ cov[:, 3:, 3:] @ turn",
        "(turn @ cov[:, :3, :3] @ turn",
        SCORES,
    ),
    Mutation(
        "lower tail of the interval for the upper",
        "vislam/evaluation/statistics.py",
        "float(chi2_upper_quantile(tail, high)) / high",
        "float(chi2_upper_quantile(tail, low)) / low",
        SCORES,
    ),
    Mutation(
        "KITTI segments from every frame",
        "vislam/evaluation/kitti.py",
        "% _STRIDE == 0",
        "% 1 == 0",
        SCORES,
    ),
    Mutation(
        "motion factor without the step",
        "vislam/estimators/smoother/motion.py",
        "3.0 * (density / frame.dt) ** 2",
        "3.0 * density**2",
        SMOOTHER,
    ),
    Mutation(
        "landmark seen from the frame before",
        "vislam/estimators/smoother/factors.py",
        "GenericStereoFactor3D(point, noise, X(k), key,",
        "GenericStereoFactor3D(point, noise, X(max(k - 1, 0)), key,",
        SMOOTHER,
    ),
    Mutation(
        "walk of the height without the root",
        "vislam/estimators/smoother/motion.py",
        "np.sqrt(frame.dt) * self._noise.walk",
        "frame.dt * self._noise.walk",
        SMOOTHER,
    ),
    Mutation(
        "a variable tied by a marginal is relinearised",
        "vislam/estimators/smoother/window.py",
        "self.fixed.update(self.factors[number].keys())",
        "self.fixed.update(leaving)",
        WINDOW,
    ),
    Mutation(
        "factors of what has left can be taken out",
        "vislam/estimators/smoother/window.py",
        "number in self._slots and not self._leaves(number)",
        "number in self._slots",
        WINDOW,
    ),
    Mutation(
        "what has left is eliminated and stays as well",
        "vislam/estimators/smoother/window.py",
        "self._emptied + parameters.removeFactorIndices",
        "parameters.removeFactorIndices",
        WINDOW,
    ),
    Mutation(
        "a lag without its anchor",
        "vislam/estimators/smoother/tree.py",
        'self._anchored = parameters.getFactorization() == "CHOLESKY"',
        "self._anchored = False",
        ("tests/smoother/test_rescue.py",),
    ),
    Mutation(
        "the end begins where the factors were linearised",
        "vislam/estimators/smoother/ending.py",
        "estimate = gauss_newton(objective, estimate)",
        "gauss_newton(objective, estimate)",
        ("tests/smoother/test_ending.py",),
    ),
    Mutation(
        "an end that cannot be solved goes unsaid",
        "vislam/estimators/smoother/ending.py",
        "undone=at.stuck",
        "undone=False",
        ("tests/smoother/test_ending.py",),
    ),
    Mutation(
        "what is needed all along leaves the tree",
        "vislam/estimators/smoother/engine.py",
        "self._at_rest.intersection(newest)",
        "set()",
        ("tests/smoother/test_segments.py",),
    ),
    Mutation(
        "energy score without the opposite of each draw",
        "vislam/evaluation/proper_scores.py",
        "for sign in (-1.0, 1.0)",
        "for sign in (1.0, 1.0)",
        ("tests/evaluation/test_from_elsewhere.py",),
    ),
    Mutation(
        "filled-in poses of a reference file are scored",
        "vislam/core/filled.py",
        "return (rows if kept is None else rows.take(kept)), remark",
        "return rows, remark",
        ("tests/cli/test_evaluate_files.py",),
    ),
)


def caught(mutation: Mutation, folder: Path) -> bool:
    """Whether a test fails with the fault in the copy."""
    path = folder / mutation.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.name}: its text is {text.count(mutation.old)} times in {mutation.file}")
    path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    try:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not slow"]
        environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [*command, *mutation.tests], cwd=folder, env=environment, capture_output=True, check=False
        )
        return done.returncode == 1
    finally:
        path.write_text(text, encoding="utf-8")


def main() -> int:
    """Plant all faults, or those named, and return 1 if one survives."""
    wanted = [one for one in MUTATIONS if not sys.argv[1:] or one.name in sys.argv[1:]]
    survived = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in COPIED:
            source = ROOT / part
            if source.is_dir():
                shutil.copytree(source, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder / part)
        (folder / "vislam_baselines").symlink_to("baselines")
        for one in wanted:
            started = time.perf_counter()
            found = caught(one, folder)
            survived += [] if found else [one.name]
            print(
                f"{'caught  ' if found else 'SURVIVED'} {one.name} ({time.perf_counter() - started:.0f} s)",
                flush=True,
            )
    print(f"{len(wanted) - len(survived)} of {len(wanted)} caught")
    return 1 if survived else 0


if __name__ == "__main__":
    sys.exit(main())
