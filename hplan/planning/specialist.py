"""Specialists: additions to planning for one family of robots.

A specialist has path finders and an infeasibility proof of its own. Planning does not know any of them;
`hplan.base.lazy_import` describes how they are loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hplan.base.lazy_import import load_extensions
from hplan.errors import NoPathError
from hplan.planning.path_finder import PathFinder
from hplan.planning.problem import Problem
from hplan.robot.model import Robot


@dataclass(frozen=True)
class Specialist:
    """Additions to planning for a family of robots.

    Attributes:
        recognizes: True for the robots of the family.
        path_finders: The finders for a problem, in order of preference; None for the finders of all robots.
        prove_infeasible: For each goal of a problem the error that proves that no path leads there, or None.
        describe_proof: The kind of proof that was attempted, for the error if it did not succeed.
        searches_first: True if a problem is searched on a grid before a straight motion is tried.
    """

    recognizes: Callable[[Robot], bool]
    path_finders: Callable[[Problem], Sequence[PathFinder] | None]
    prove_infeasible: Callable[[Problem], list[NoPathError | None]]
    describe_proof: Callable[[Problem], str]
    searches_first: Callable[[Problem], bool]


_SPECIALISTS: list[Specialist] = []


def register_specialist(specialist: Specialist) -> None:
    """Add a specialist; the first one that recognizes a robot is used."""
    _SPECIALISTS.append(specialist)


def specialist_of(robot: Robot) -> Specialist | None:
    """Return the specialist that recognizes a robot, or None."""
    load_extensions()
    return next((specialist for specialist in _SPECIALISTS if specialist.recognizes(robot)), None)
