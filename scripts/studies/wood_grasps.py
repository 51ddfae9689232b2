"""Grasps of fruit that pushes displace, executed among trees that bend, against the bound of the displacement.

Planned motions rarely push anything that displaces their goal. So motions are drawn here that do: to the stand-off of a
grasp by way of a configuration in which a link pushes the limb of the fruit, or anything that is pressed against it,
and then along the straight approach. Each is timed and certified as a plan is; certified ones whose fruit may be
displaced are executed until the grasp.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.wood import PICK_TRACKING_RAD, TreePush, drawn_scene, run_pick, tree_pushes

from hplan.apps.execution.bending_wood import BendingTrees
from hplan.apps.execution.simulation import Pick
from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.planning.approach import Approach
from hplan.planning.grasps import Blocked, Grasp, Target, grasps_or_blocked
from hplan.planning.motion import Motion, Plan, certified_trajectory, require_whole
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import Wood
from hplan.trajectory.spline import SplinePath

#: Fruit of one tree that are grasped, grasps of each fruit, and motions to each grasp that are executed.
FRUITS, GRASPS, MOTIONS = 8, 3, 2

#: Displacement that a certificate allows [m]: grippers take fruit in within less, but larger bounds are tested, too.
CAPTURE_M = 0.1

#: Motions that are drawn for each grasp at most.
ATTEMPTS = 150

#: Range of the standard deviations of joints about the stand-off, for starts and for pushes [rad, or m if prismatic].
SPREADS = (0.03, 0.5)

#: Range of the deepest push, as a share of the permitted depth.
DEPTHS = (0.1, 1.0)

#: Distance of control points from that of the push, as a share of the ways to the start and to the stand-off.
BESIDE = 0.3

#: Starts that are drawn for each push.
STARTS = 8

#: Solids farther than this from the arm at a stand-off are not pushed on the way there [m].
NEAR_M = 0.2

#: Newton steps towards a push, and differences of joints for its gradients [rad, or m if prismatic].
STEPS, DIFFERENCE = 8, 1e-5


def _grasps(config: StudyConfig, problem: TreePush) -> list[Row]:
    """Rows of the certified motions to grasps of one tree whose fruit may be displaced."""
    random, robot = problem.random, config.arm("orchard_harvester")
    scene = drawn_scene(config, robot, problem, random)
    if scene is None:
        return []
    wood = (scene.wood or Wood()).with_values(capture_range=CAPTURE_M)
    scene = scene.with_values(wood=wood)
    options, rows = PlanOptions(effort=config.effort, tracking_error=PICK_TRACKING_RAD), list[Row]()
    grasped = 0
    for name in _within_reach(random, robot, scene, options):
        goal = scene.with_values(goal=Goal(fruit=name))
        motions = itertools.islice(_motions_to(random, robot, goal, options), GRASPS * MOTIONS)
        found = list[Row]()
        for kind, plan in motions:
            phases, motion, certificate = plan.join_phases
            picked_s = phases[-2].end_s
            until = motion.cut_after(int(np.searchsorted(motion.time, picked_s - 1e-9)))
            pick = Pick(name, phases[-2].start_s, until.duration)
            modulus_gpa = float(random.uniform(*wood.youngs_modulus_gpa))
            row = run_pick(robot, goal, until, certificate, pick, BendingTrees(youngs_modulus_gpa=modulus_gpa))
            row |= {"name": f"{problem.name}, {name}, {len(found)}", "tree": problem.tree.stem}
            found.append(row | {"kind": kind, "modulus_gpa": modulus_gpa})
        rows += found
        grasped += bool(found)
        if grasped == FRUITS:
            break
    return rows


def _within_reach(random: np.random.Generator, robot: Robot, scene: Scene, options: PlanOptions) -> Iterator[str]:
    """Names of fruit with a grasp, in random order; that they are goals later leaves other fruit as they are."""
    problem = Problem.from_scene(robot, scene.without_goal_fruit, options)
    for fruit in (scene.fruits[number] for number in random.permutation(len(scene.fruits)).tolist()):
        with suppress(HplanError):
            target = Target.of_fruit(problem.world, fruit, scene, options)
            if _displacing(target) and not isinstance(
                grasps_or_blocked(target, problem.start, standoff=options.standoff_m), Blocked
            ):
                yield fruit.name


def _motions_to(
    random: np.random.Generator, robot: Robot, scene: Scene, options: PlanOptions
) -> Iterator[tuple[str, Plan]]:
    """Certified motions to a fruit that they may displace, and whether the approach alone may do it."""
    problem, fruit = Problem.from_scene(robot, scene, options), scene.goal_fruit
    assert fruit is not None
    with suppress(HplanError):  # it cannot be reached, or the arm has no room
        target = Target.of_fruit(problem.world, fruit, scene, options)
        every = grasps_or_blocked(target, problem.start, standoff=options.standoff_m)
        pushed = [
            (CoalScene(robot, [solid], yield_links=scene.yield_links), depth) for solid, depth in _displacing(target)
        ]
        if isinstance(every, Blocked) or not pushed:
            return
        for number in random.permutation(len(every)).tolist()[: 3 * GRASPS]:
            grasp, count = every[number], 0
            near = [each for each in pushed if each[0].distances(grasp.standoff).min() < NEAR_M]
            if not grasp.distance or not near:
                continue
            with suppress(HplanError):
                approaches = Approach(problem, target, grasp).motions
                for _ in range(ATTEMPTS):
                    plan = _draw(random, problem, target, grasp, approaches, near)
                    if plan is not None and (plan.join_phases[2].goal_displacement_m or 0.0) > 0.0:
                        alone = approaches[0].certificate.goal_displacement_m or 0.0
                        yield "approach" if alone > 0.0 else "transit", plan
                        count += 1
                        if count == MOTIONS:
                            break


def _displacing(target: Target) -> list[tuple[Solid, float]]:
    """Parts of the limb of the fruit, and fruit on it, with their permitted depths [m].

    What is pressed against that limb counts in the bound as well. The simulation has no contacts among limbs and fruit.
    """
    ((name, _, own),) = target.world_touching.checker.fruit_limits or ((None, None, None),)
    limits = [(solid, solid.contact_limit) for solid in target.world.solids if solid.name != name]
    return [
        (solid, limit.depth)
        for solid, limit in limits
        if own is not None and limit is not None and limit.depth > 0.0 and limit.root == own.root >= 0
    ]


def _draw(
    random: np.random.Generator, problem: Problem, target: Target, grasp: Grasp, approaches: tuple[Motion, ...],
    pushed: Sequence[tuple[CoalScene, float]],
) -> Plan | None:  # fmt: skip
    """A random motion by way of a push to a grasp, if it is certified; None otherwise."""
    robot, standoff, world = problem.robot, grasp.standoff, target.transit_world(grasp)
    checker, depth = pushed[int(random.integers(len(pushed)))]
    middle = _push(robot, checker, _spread(random, robot, standoff), float(random.uniform(*DEPTHS)) * depth)
    if middle is None or world.field.spare_clearances(middle[None]).min() < 0.0:
        return None
    for _ in range(STARTS):
        start = _spread(random, robot, middle)
        before, after = middle + BESIDE * (start - middle), middle + BESIDE * (standoff - middle)
        path = _through(middle, [start, before, after, standoff])
        if world.field.spare_clearances(path.evaluate(np.linspace(0.0, path.end, 40))).min() < 0.0:
            continue
        if world.checker.distances(start).min() < 0.0:  # limbs are at rest at the start
            continue
        with suppress(HplanError):
            between = problem.in_world(world).from_configurations(start, standoff)
            transit = Motion("transit", *certified_trajectory(between, path), between)
            return require_whole(problem, Plan(transit, approaches, grasp))
    return None


def _through(point: FloatArray, ends: Sequence[FloatArray]) -> SplinePath:
    """A spline through a configuration, between two control points before and two after it."""
    first, before, after, last = ends
    corner = point
    for _ in range(4):
        path = SplinePath.from_control_points([first, before, corner, after, last])
        curve = path.evaluate(np.linspace(0.0, path.end, 65))
        corner = corner + 1.5 * (point - curve[np.argmin(np.linalg.norm(curve - point, axis=1))])
    return path


def _spread(random: np.random.Generator, robot: Robot, about: FloatArray) -> FloatArray:
    """(dof,) random configuration about another one."""
    size = math.exp(float(random.uniform(*np.log(SPREADS))))
    found: FloatArray = np.clip(about + size * random.normal(size=robot.dof), robot.lower, robot.upper)
    return found


def _push(robot: Robot, checker: CoalScene, q: FloatArray, depth: float) -> FloatArray | None:
    """(dof,) configuration near another one, with a push of a solid of a depth [m]; None if none was found."""
    for _ in range(STEPS):
        distance = float(checker.distances(q).min())
        if not math.isfinite(distance) or abs(distance + depth) < 0.1 * depth:
            break
        moved = q + DIFFERENCE * np.eye(robot.dof)
        gradient = np.array([float(checker.distances(row).min()) - distance for row in moved]) / DIFFERENCE
        square = float(gradient @ gradient)
        if square < 1e-6:
            return None
        q = np.clip(q - (distance + depth) / square * gradient, robot.lower, robot.upper)
    return q if -2.0 * depth <= float(checker.distances(q).min()) < 0.0 else None


WOOD_GRASPS = Study(
    "wood_grasps",
    "certified grasps of fruit that pushes displace, among trees that bend (--trees); count of scenes for each tree",
    _grasps,
    (
        *("kind", "pushes", "goal_mm", "goal_bound_mm", "goal_ratio", "force_ratio", "stress_ratio", "force_n"),
        *("stress_mpa", "rigid_contacts", "within_limits", "broken", "knocked_off"),
    ),
    problems=tree_pushes,
    by="tree",
    count=(6, 1),
    needs=("trees",),
    peers=(),
    warm=0,
)
