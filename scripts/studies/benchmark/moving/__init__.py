"""Scenes in which one obstacle moves while the arm does: random scenes, baselines, and the measurement."""
