"""What every room may use: arrays, errors, files, text, plain data."""
