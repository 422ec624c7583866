"""One recording, many estimators: config, data, runs, results."""
