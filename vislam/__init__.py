"""Filter or smoother, on my data? EKF and factor-graph stereo visual-inertial SLAM, compared.

``python -m vislam.compare --config configs/ds3.yaml`` is the main job; ``vislam.geometry`` states the
conventions; ``vislam.core.estimator`` is the interface of all estimators.
"""
