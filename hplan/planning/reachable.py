"""Which fruits of a scene can be picked from its start, with a way to take each, and why the others cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

from hplan.base.arguments import truth
from hplan.base.arrays import Record
from hplan.base.deadline import Cancel, TimeIsUpError, check_deadline, time_limit
from hplan.collision.coal_scene import Contact
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    SceneError,
    TimingError,
    UnreachableError,
)
from hplan.planning.approach import Approach
from hplan.planning.effort import effort_named
from hplan.planning.failures import NO_MOTION
from hplan.planning.grasps import Blocked, Grasp, Target, grasps_or_blocked
from hplan.planning.motion import Motion
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task
from hplan.planning.plans import plans_to_grasps
from hplan.planning.problem import Problem
from hplan.planning.stages import Progress, no_progress, stage_clock
from hplan.robot.model import Robot
from hplan.scene.model import Fruit, Scene

#: Why a fruit cannot be picked: no configuration reaches it, or none was found; something is in the way of all that do;
#: no approach to any of those that are clear is certified; no motion from the start to any of them was found.
Reason = Literal["out_of_reach", "blocked", "no_approach", "no_motion"]


@dataclass(frozen=True, eq=False)
class FruitReach(Record):
    """Whether a fruit can be picked, and how, or why not.

    Attributes:
        fruit: Its name.
        reason: Why it cannot be picked; None where it can.
        detail: The reason as a sentence; empty where there is none.
        grasp: How it can be taken: its arrays are read-only; None where it cannot be.
        motions: The certified approach and retreat, after the transit where motions are asked for. None at all where
            it cannot be picked, and no approach where no straight one is clear: then the grasp is certified
            clear, and the last link may touch the fruit on the whole motion.
        contact: Where it is blocked: what is in the way at the configuration that comes nearest to being clear, and
            their distance, where negative how deep they are in one another [m].
        best_clearance_m: Where it is blocked the clearance of that configuration beyond the one to keep [m]; what gives
            way counts from where it is pushed as deep as it may be.
    """

    fruit: str
    reason: Reason | None = None
    detail: str = ""
    grasp: Grasp | None = None
    motions: tuple[Motion, ...] = ()
    contact: Contact | None = None
    best_clearance_m: float | None = None

    @property
    def can_be_picked(self) -> bool:
        """True if nothing that was looked at is in the way."""
        return self.reason is None


def reachable(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    motions: bool = False,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> Mapping[str, FruitReach]:
    """Which fruits of a scene can be picked, each among all the others; of the scene's goal only `approach_deg` counts.

    That a fruit can be picked means: of the grasps that `plan` would try, one has a straight approach and retreat that
    are certified, or where no straight approach is clear, is certified clear itself. Whether a motion leads there
    from the start is **not** looked at unless `motions` asks for it; then one was found, and is certified.
    Where a fruit cannot be picked `plan` refuses it too; only `no_motion` is no proof, as `plan` may search longer.

    Args:
        robot: The arm.
        scene: Obstacles and fruits, which all are obstacles to one another.
        options: As for `plan`. With a deadline all fruits have to be looked at before it.
        motions: True also looks for motions from the start, with the effort `quick`, which takes ten times as long.
        progress: Called with what is being done.
        cancel: As for `hplan.plan`.

    Returns:
        For each fruit, by its name and in the order of the scene, whether it can be picked.

    Raises:
        InputError: The scene does not fit the robot, or the start cannot be taken.
        OptionError: An option that the robot has no use for.
        NotInTimeError: The deadline came before all fruits were looked at.
        PlanCancelledError: It was cancelled.
    """
    check_task(robot, scene, options, progress)
    truth("motions", motions)
    if motions and scene.start.is_moving:
        raise SceneError("motions begin at rest here; the start has a velocity or an acceleration", where="start")
    asked = PlanOptions() if options is None else options
    with stage_clock(progress), time_limit(asked.deadline_s, cancel) as limit:
        try:
            whole = replace(asked, deadline_s=None)
            problem = Problem.of(robot, scene, whole)
            problem.world.check_base(robot.yaw_of(problem.start))
            problem.between(problem.start, problem.start)
            found: dict[str, FruitReach] = {}
            for number, fruit in enumerate(scene.fruits):
                check_deadline()
                progress(f"fruit {number + 1} of {len(scene.fruits)}")
                found[fruit.name] = _reach(problem, fruit, motions=motions)
        except TimeIsUpError:
            raise limit.error([f"{len(scene.fruits)} fruits"]) from None
    return MappingProxyType(found)


def _reach(problem: Problem, fruit: Fruit, *, motions: bool) -> FruitReach:
    target = Target.of_fruit(problem.world, fruit, problem.scene, problem.options)
    try:
        found = grasps_or_blocked(
            target, problem.start, standoff=problem.options.standoff_m, locked=problem.scene.locked_joints
        )
    except UnreachableError as error:
        return FruitReach(fruit.name, "out_of_reach", error.message)
    if isinstance(found, Blocked):
        return _blocked(fruit.name, found)
    if motions:
        quick = replace(problem, effort=effort_named(problem.robot, "quick"))
        try:
            approach, plan = next(plans_to_grasps(quick, target, found))
        except NO_MOTION as error:
            return FruitReach(fruit.name, "no_motion", error.message)
        return FruitReach(fruit.name, grasp=approach.grasp, motions=plan.motions)
    failure: HplanError | None = None
    for grasp in found:
        try:
            taken = Approach(problem, target, grasp).motions
            if not taken:
                target.world_touching.check_clear(grasp.goal, "goal")
            return FruitReach(fruit.name, grasp=grasp, motions=taken)
        except (CertificationError, ConfigurationInCollisionError, TimingError) as error:
            failure = failure or error.with_traceback(None)
    return FruitReach(fruit.name, "no_approach", "" if failure is None else failure.message)


def _blocked(name: str, found: Blocked) -> FruitReach:
    contact = found.contact_at(found.best)
    what = "" if contact is None else f": {contact.obstacle!r} against {contact.link!r}"
    detail = f"the best of {found.tried} configurations has a clearance of {1e3 * found.best_m:.3g} mm{what}"
    return FruitReach(name, "blocked", detail, contact=contact, best_clearance_m=found.best_m)
