"""A certified motion to one of several grasps: the promising ones first, all of them before any is refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from hplan.errors import CertificationError, ConfigurationInCollisionError, HplanError, TimingError
from hplan.planning.find_motion import PlannedMotion, first_motion, without_path
from hplan.planning.grasps import Grasp
from hplan.planning.grid_route import PlanningTask
from hplan.planning.refusals import Refusals

_Last = TypeVar("_Last")


def motion_to_grasp(
    ways: Sequence[Grasp],
    likely: Sequence[Grasp],
    task_of: Callable[[Grasp], PlanningTask],
    last_of: Callable[[Grasp, PlannedMotion], _Last],
    what: str,
) -> tuple[Grasp, PlannedMotion, _Last]:
    """A grasp, the motion to where its approach begins, and what is made of the approach.

    The likely grasps are tried as if there were no others. Where none of them can be reached, one flood shows to which
    of the others no path exists, and those that are left are tried in their order.

    Args:
        ways: The grasps, those that promise the shortest motions first.
        likely: Those of them to try first.
        task_of: The motion to plan to a grasp; raises `ConfigurationInCollisionError` where it cannot be taken.
        last_of: What follows the motion to a grasp; raises `CertificationError` or `TimingError` where nothing can.
        what: What is grasped, for errors.

    Raises:
        NoPathError: No path to any of the grasps exists on the grid.
        TimingError: No path can be timed.
        CertificationError: Not all grasps were shown to have no path, and no motion could be certified.
        ConfigurationInCollisionError: The start is in collision.
    """
    first = {id(grasp) for grasp in likely}
    ordered = [*likely, *(grasp for grasp in ways if id(grasp) not in first)]
    refused: dict[int, HplanError] = {}
    for batch in (range(len(likely)), range(len(likely), len(ordered))):
        tasks = _tasks(ordered, batch, task_of, refused)
        if batch.start > 0:
            for number, error in zip(list(tasks), without_path(list(tasks.values())), strict=True):
                if error is not None:
                    refused[number] = error
                    del tasks[number]
        while tasks:
            numbers = list(tasks)
            found = first_motion(list(tasks.values()))
            if isinstance(found, Refusals):
                refused |= zip(numbers, found.errors, strict=True)
                break
            number, motion = numbers[found[0]], found[1]
            try:
                return ordered[number], motion, last_of(ordered[number], motion)
            except (CertificationError, TimingError) as error:
                refused[number] = error.with_traceback(None)
                del tasks[number]
    raise Refusals(tuple(refused[number] for number in range(len(ordered)))).error(f"grasps of {what}")


def _tasks(
    grasps: Sequence[Grasp], batch: range, task_of: Callable[[Grasp], PlanningTask], refused: dict[int, HplanError]
) -> dict[int, PlanningTask]:
    """The motions to plan, by the numbers of their grasps; grasps that cannot be taken are noted as refused."""
    tasks = {}
    for number in batch:
        try:
            tasks[number] = task_of(grasps[number])
        except ConfigurationInCollisionError as error:
            if error.which == "start":
                raise
            refused[number] = error.with_traceback(None)
    return tasks
