"""Trajectory optimisation: the timed motion itself, not a path and then its timing, by linear programs in sequence.

May use the rooms up to `smoothing`.
"""
