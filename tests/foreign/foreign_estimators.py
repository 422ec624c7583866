"""An estimator that nobody asked for: whoever imports it is told."""

raise RuntimeError("an estimator was loaded that is in no config")
