"""Warnings: the call goes on, but its result does not cover everything that the user may expect."""

from __future__ import annotations


class HplanWarning(UserWarning):
    """Root of the warnings that users of hplan may want to filter."""


class FarObstacleWarning(HplanWarning):
    """Obstacles are so far from the arm that their lengths are probably in millimetres."""


class UncoveredLinkWarning(HplanWarning):
    """A drawn link of the robot is not covered by its collision shapes.

    Plans and certificates say nothing about that link.
    """


class MissingVisualWarning(HplanWarning):
    """The mesh file of a visual is missing; the link is not drawn, and plans do not change."""
