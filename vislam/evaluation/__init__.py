"""Scores saved runs. Knows nothing of estimators: a number can be had again without running one."""

from vislam.evaluation.evaluate import Evaluation, evaluate
from vislam.evaluation.metrics import Metric

__all__ = ["Evaluation", "Metric", "evaluate"]
