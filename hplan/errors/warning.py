"""Warnings: the call continues, but its result covers less than expected."""

from __future__ import annotations


class HplanWarning(UserWarning):
    """Root of the hplan warnings, for filters.

    Examples:
        >>> import warnings
        >>> from hplan.errors import HplanWarning
        >>> warnings.simplefilter("ignore", HplanWarning)
    """


class FarObstacleWarning(HplanWarning):
    """Obstacles are far from the arm; their unit is probably millimetres.

    Examples:
        >>> from hplan.errors import FarObstacleWarning, HplanWarning
        >>> issubclass(FarObstacleWarning, HplanWarning)
        True
    """


class UncoveredLinkWarning(HplanWarning):
    """A link has visuals that its collision shapes do not cover.

    Plans and certificates say nothing about that link.

    Examples:
        >>> from hplan.errors import UncoveredLinkWarning
        >>> issubclass(UncoveredLinkWarning, UserWarning)
        True
    """


class RobotFileWarning(HplanWarning):
    """A robot file has faults that no motion depends on; it was read without them.

    Examples:
        >>> from hplan.errors import HplanWarning, RobotFileWarning
        >>> issubclass(RobotFileWarning, HplanWarning)
        True
    """


class MissingVisualWarning(HplanWarning):
    """A visual's mesh file is missing, so the link is not drawn.

    Plans do not change.

    Examples:
        >>> import warnings
        >>> from hplan.errors import MissingVisualWarning
        >>> warnings.filterwarnings("error", category=MissingVisualWarning)
    """
