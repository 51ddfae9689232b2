"""Plans that push limbs with less force, or not at all.

The quickest motion may push limbs that it need not, and slows down for the impacts. So it is compared with one that
touches no limb, and, with the option `gentle`, with motions within fractions of the limits of force and stress.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from hplan.errors import HplanError
from hplan.planning.motion import Plan, Solver, best_of
from hplan.planning.problem import Problem
from hplan.planning.world import World

#: Maximum duration of a gentle motion, as a multiple of the quickest one.
LONGER = 1.05

#: Fractions of the limits that are tried with the option `gentle`. Without it, the first one is.
_SHARES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7)


def with_less_force(solve: Solver) -> Solver:
    """A solver that prefers motions that do not push limbs.

    Without the option `gentle` a motion that pushes none is the last plan if it is faster. With it the last plan is the
    motion within the smallest fraction of the limits that takes at most `LONGER` times as long as the fastest.

    Args:
        solve: A solver; its last plan is the fastest.
    """

    def plans(problem: Problem, found: Iterator[Plan]) -> Iterator[Plan]:
        best: Plan | None = None
        try:
            for best in found:
                yield best
        except HplanError:
            less = _within_limits(problem, 0.0, solve)
            if less is None:
                raise
            yield less
            return
        gentle = problem.options.gentle
        if best is None or not any(push.force_n for push in best.join_phases[2].pushes or ()):
            return
        for share in _SHARES if gentle else _SHARES[:1]:
            less = _within_limits(problem, share, solve)
            if less is not None and less.duration < best.duration * (LONGER if gentle else 1.0):
                yield less
                return

    def solver(problem: Problem) -> Iterator[Plan]:
        found = solve(problem)
        return found if problem.scene.wood is None or problem.scene.moves else plans(problem, found)

    return solver


def _within_limits(problem: Problem, share: float, solve: Solver) -> Plan | None:
    """The fastest plan within a fraction of the limits of force and stress, or None."""
    wood = problem.scene.wood
    if wood is None:
        return None
    scene = problem.scene.with_values(wood=wood.scale(share) if share > 0.0 else wood.as_rigid)
    world = World.of_scene(problem.robot, scene, problem.options)
    with suppress(HplanError):
        return best_of(solve(problem.in_world(world)))
    return None
