"""Warnings: the call goes on, but its result does not cover everything that the user may expect."""

from __future__ import annotations


class HplanWarning(UserWarning):
    """Root of the warnings that users of hplan may want to filter."""


class FarObstacleWarning(HplanWarning):
    """Obstacles are so far from the arm that their lengths are probably in millimetres."""
