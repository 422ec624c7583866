"""What crosses rooms: sequence, reference, estimator, run, record."""
