"""Measurements of speed and consistency; run as python -m benchmarks.<name>."""
