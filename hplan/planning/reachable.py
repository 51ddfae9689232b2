"""Determine the fruits that can be picked from a scene's start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from hplan.base.arguments import list_of, nearest_name, truth
from hplan.base.arrays import Record
from hplan.base.deadline import Cancel, TimeIsUpError, check_deadline, time_limit
from hplan.collision.coal_scene import Contact
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    OptionError,
    SceneError,
    TimingError,
    UnreachableError,
)
from hplan.planning.approach import Approach
from hplan.planning.failures import NO_MOTION, Reason, mark_approach, obstacle_of, reason_of
from hplan.planning.grasps import Blocked, Grasp, Target, grasps_or_blocked
from hplan.planning.motion import Motion
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task
from hplan.planning.plans import plans_to_grasps
from hplan.planning.problem import Problem
from hplan.planning.specialist import presets_of
from hplan.planning.stages import Progress, no_progress, stage_clock
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene


@dataclass(frozen=True, eq=False)
class FruitReach(Record):
    """Whether a fruit can be picked, and how, or why not.

    Attributes:
        fruit: Name of the fruit.
        reason: Why it cannot be picked; None if it can.
        detail: The reason as a sentence; empty without a reason.
        obstacle: The obstacle that blocks it, or most often prevents its motions; None if unknown.
        grasp: The grasp, with read-only arrays; None if the fruit cannot be picked.
        motions: The certified approach and retreat, preceded by the transit if motions were requested. Empty if the
            fruit cannot be picked. Without a collision-free straight approach there is no approach: then the grasp is
            certified collision-free, and the last link may touch the fruit during the whole motion.
        contact: For a blocked fruit: the contact at the configuration with the maximum clearance, with its signed
            distance, negative for the penetration depth [m].
        best_clearance_m: For a blocked fruit: the clearance of that configuration beyond the required one [m]; for a
            compliant obstacle it counts from the maximum allowed deflection.
    """

    fruit: str
    reason: Reason | None = None
    detail: str = ""
    obstacle: str | None = None
    grasp: Grasp | None = None
    motions: tuple[Motion, ...] = ()
    contact: Contact | None = None
    best_clearance_m: float | None = None

    @property
    def can_be_picked(self) -> bool:
        """True if no check found an obstacle."""
        return self.reason is None


def reachable(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    fruits: Sequence[str] | None = None,
    motions: bool = False,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> Mapping[str, FruitReach]:
    """Determine the fruits that can be picked from the start.

    A fruit can be picked if one of the grasps that `plan` would try has a certified straight approach and retreat. If
    no straight approach is collision-free, the grasp itself has to be certified collision-free. A motion from the start
    is **not** checked unless `motions` is True; then one was found and certified. If a fruit cannot be picked, `plan`
    refuses it too; `no_motion` alone is not a proof, because `plan` may search longer.

    Args:
        robot: The arm.
        scene: Obstacles and fruits; each fruit is an obstacle to the others. Only `approach_deg` of the goal is used.
        options: As for `plan`. A deadline has to cover all fruits.
        fruits: Names of the fruits to check; None for all.
        motions: True also plans motions from the start, with the effort `quick`, which takes ten times as long.
        progress: Called with the name of each step.
        cancel: As for `hplan.plan`.

    Returns:
        For each fruit, by name and in scene order, whether it can be picked.

    Raises:
        InputError: The scene does not fit the robot, or the start is invalid or in collision.
        OptionError: An option does not apply to the robot; `fruits` names an unknown fruit, names one twice, or is
            empty.
        NotInTimeError: The deadline passed before all fruits were checked.
        PlanCancelledError: The check was cancelled.
    """
    check_task(robot, scene, options, progress)
    truth("motions", motions)
    chosen = set(fruit_names(scene, fruits)) if fruits is not None else {fruit.name for fruit in scene.fruits}
    if motions and scene.start.is_moving:
        raise SceneError("these motions begin at rest, but the start has a velocity or an acceleration", where="start")
    asked = PlanOptions() if options is None else options
    with stage_clock(progress), time_limit(asked.deadline_s, cancel) as limit:
        try:
            whole = replace(asked, deadline_s=None)
            problem = Problem.from_scene(robot, scene.without_goal_fruit, whole)
            problem.world.check_base()
            problem.from_configurations(problem.start, problem.start)
            found: dict[str, FruitReach] = {}
            for number, fruit in enumerate(fruit for fruit in scene.fruits if fruit.name in chosen):
                check_deadline()
                progress(f"fruit {number + 1} of {len(chosen)}")
                found[fruit.name] = _reach(problem, fruit, motions=motions)
        except TimeIsUpError:
            raise limit.error([f"{len(chosen)} fruits"]) from None
    return MappingProxyType(found)


def fruit_names(scene: Scene, fruits: Sequence[str] | None) -> list[str]:
    """Names of some fruits of a scene, validated.

    Args:
        scene: The scene.
        fruits: The names; None for all.

    Raises:
        OptionError: A name is unknown or occurs twice, or there is none.
    """
    known = [fruit.name for fruit in scene.fruits]
    names = known if fruits is None else list(list_of("fruits", fruits, str, "names"))
    if not names:
        raise OptionError("fruits", names, "a fruit to pick" if known else "a scene with fruits")
    for number, name in enumerate(names):
        if name not in known:
            raise OptionError("fruits", name, f"fruits of the scene: {nearest_name(name, known)}")
        if name in names[:number]:
            raise OptionError("fruits", name, "each fruit once")
    return names


def _reach(problem: Problem, fruit: Fruit, *, motions: bool) -> FruitReach:
    target = Target.of_fruit(problem.world, fruit, problem.scene, problem.options)
    try:
        found = grasps_or_blocked(
            target, problem.start, standoff=problem.options.standoff_m, locked=problem.scene.locked_joints
        )
    except UnreachableError as error:
        return _refused(fruit.name, error)
    if isinstance(found, Blocked):
        return _blocked_fruit(fruit.name, found)
    if motions:
        quick = replace(problem, effort=presets_of(problem.robot)["quick"])
        try:
            approach, plan = next(plans_to_grasps(quick, target, found))
        except NO_MOTION as error:
            return _refused(fruit.name, error)
        return FruitReach(fruit.name, grasp=approach.grasp, motions=plan.motions)
    failure: HplanError | None = None
    for grasp in found:
        try:
            taken = Approach(problem, target, grasp).motions
            if not taken:
                target.world_touching.check_clear(grasp.goal, "goal")
            return FruitReach(fruit.name, grasp=grasp, motions=taken)
        except (CertificationError, ConfigurationInCollisionError, TimingError) as error:
            failure = failure or mark_approach(error.with_traceback(None))
    assert failure is not None  # at least one grasp was tried
    return _refused(fruit.name, failure)


def _refused(name: str, error: HplanError) -> FruitReach:
    return FruitReach(name, reason_of(error), error.message, obstacle_of(error))


def _blocked_fruit(name: str, found: Blocked) -> FruitReach:
    contact = found.contact_at(found.best)
    what = "" if contact is None else f": {contact.obstacle!r} against {contact.link!r}"
    detail = f"the best of {found.number_tried} configurations has a clearance of {1e3 * found.best_m:.3g} mm{what}"
    obstacle = None if contact is None else contact.obstacle
    return FruitReach(name, "blocked", detail, obstacle, contact=contact, best_clearance_m=found.best_m)
