"""Verdicts a machine can rely on: bounds on metrics, tests of consistency, comparison with saved results.

``settings`` is what a config demands, ``saved`` are results of an earlier run, ``judge`` decides what holds,
and ``junit`` writes it down for build servers.
"""
