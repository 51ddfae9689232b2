"""A certified motion to one of several grasps: the promising ones first, all of them before any is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias, TypeVar

from hplan.base.arrays import FloatArray
from hplan.errors import CertificationError, ConfigurationInCollisionError, HplanError, TimingError
from hplan.planning.certified_motion import Part, PlannedMotion, certified_trajectory
from hplan.planning.find_motion import first_motion, without_path
from hplan.planning.grasps import SPARE, Grasp, Target, promising
from hplan.planning.refusals import Refusals
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import Stretch, stretches
from hplan.verification.goal_contact import contact_window
from hplan.verification.limit_use import cubic_pieces

_Last = TypeVar("_Last")

#: Finds a motion to one of several goals, or says why there is none to each.
FindMotion: TypeAlias = Callable[[Sequence[PlanningTask]], tuple[int, PlannedMotion] | Refusals]


def motion_to_grasp(
    target: Target,
    found: Sequence[Grasp],
    start: FloatArray,
    task_to: Callable[[Grasp], PlanningTask],
    last_of: Callable[[Grasp], _Last],
    find: FindMotion | None = None,
) -> tuple[Grasp, PlannedMotion, _Last]:
    """A grasp, the motion to where its approach begins, and what is made of the approach.

    The promising grasps are tried as if there were no others. Where none of them can be reached, one flood shows to
    which of the others no path exists, and those that are left are tried in their order. Grasps without an approach
    come after all those with one.

    Args:
        target: What is grasped.
        found: Its grasps, those that promise the shortest motions first.
        start: (dof,) configuration from which the arm comes.
        task_to: The motion to plan to a grasp; raises `ConfigurationInCollisionError` where it cannot be taken.
        last_of: What follows the motion to a grasp; raises `CertificationError` or `TimingError` where nothing can.
        find: Finds a motion to one of several grasps; `first_motion` where this is None.

    Raises:
        NoPathError: No path to any of the grasps exists on the grid.
        TimingError: No path can be timed.
        CertificationError: Not all grasps were shown to have no path, and no motion could be certified.
        ConfigurationInCollisionError: The start is in collision.
    """
    ordered: list[Grasp] = []
    refused: dict[int, HplanError] = {}
    for is_likely, batch in _batches(target, found, start):
        begin = len(ordered)
        ordered += batch
        tasks = _tasks(ordered, range(begin, len(ordered)), task_to, refused)
        if not is_likely:
            for number, error in zip(list(tasks), without_path(list(tasks.values())), strict=True):
                if error is not None:
                    refused[number] = error
                    del tasks[number]
        while tasks:
            numbers = list(tasks)
            result = (find or first_motion)(list(tasks.values()))
            if isinstance(result, Refusals):
                refused |= zip(numbers, result.errors, strict=True)
                break
            number, motion = numbers[result[0]], result[1]
            try:
                return ordered[number], motion, last_of(ordered[number])
            except (CertificationError, TimingError) as error:
                refused[number] = error.with_traceback(None)
                del tasks[number]
    raise _refusal(target, ordered, [refused[number] for number in range(len(ordered))])


def _refusal(target: Target, ordered: Sequence[Grasp], errors: Sequence[HplanError]) -> HplanError:
    """The one error for all grasps; where they have little room it says how little."""
    refusal = Refusals(tuple(errors)).error(f"grasps of {target.what}")
    room = max(grasp.room for grasp in ordered)
    if room < SPARE:
        remark = (
            f"spare clearance {1e3 * room:.2g} mm at the grasp; with {1e3 * SPARE:g} mm there would be room to move"
        )
        refusal.add(remark, spare_clearance_m=room, needed_clearance_m=SPARE)
    return refusal


def _batches(target: Target, found: Sequence[Grasp], start: FloatArray) -> Iterator[tuple[bool, list[Grasp]]]:
    """Grasps to try together, those with an approach before those without; and whether they are the promising ones."""
    for batch in ([grasp for grasp in found if grasp.distance > 0.0], [grasp for grasp in found if not grasp.distance]):
        likely = promising(batch, target, start)
        first = {id(grasp) for grasp in likely}
        yield True, likely
        yield False, [grasp for grasp in batch if id(grasp) not in first]


def _tasks(
    ordered: Sequence[Grasp], batch: range, task_to: Callable[[Grasp], PlanningTask], refused: dict[int, HplanError]
) -> dict[int, PlanningTask]:
    """The motions to plan, by the numbers of their grasps; grasps that cannot be taken are noted as refused."""
    tasks = {}
    for number in batch:
        try:
            tasks[number] = task_to(ordered[number])
        except ConfigurationInCollisionError as error:
            if error.which == "start":
                raise
            refused[number] = error.with_traceback(None)
    return tasks


def approach_and_retreat(context: PlanningContext, target: Target, grasp: Grasp) -> list[Part]:
    """The approach to a grasp and, from a fruit, the retreat, timed and certified; nothing without an approach.

    The last link may touch the fruit (`hplan.verification.goal_contact`).

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    path, fruit = grasp.path(context.robot, context.scene.locked_joints), target.fruit
    if path is None:
        return []

    def among(there: Trajectory) -> list[Stretch]:
        bezier, _ = cubic_pieces(there)
        contact = None if fruit is None else contact_window(context.robot, bezier, fruit.center)
        return stretches(target.world.checker, len(bezier), contact, None if fruit is None else fruit.name)

    there, shown = certified_trajectory(context.among(target.world_touching), path, among)
    approach = Part("approach", there, shown)
    # The same motion backwards: accelerations and torques stay as they are, and so do all the distances.
    return [approach] if fruit is None else [approach, Part("retreat", there.reversed, shown)]
