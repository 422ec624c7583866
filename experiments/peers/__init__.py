"""Other programs of the field and ours on the same data, side by side: ``python -m experiments.peers``.

Of programs that cannot be run here there are published figures and times of another machine, marked as such.
GTSAM's own smoothers take the very factors that ours are given. evo runs as a program of its own on the same
files; nothing of it is imported. It is not installed with vislam: ``pip install evo``.
"""
