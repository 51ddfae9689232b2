"""One motion: choice of goal and attempt, and reuse of an earlier motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planned import ABOVE, BAR, BELOW, at, between_rows, posed, post, task

from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import CoalScene
from hplan.errors import CertificationError, NoPathError
from hplan.planning.motion import Motion, best_of, certificate_of, require_certificate
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.plans import plans_from_rest
from hplan.planning.problem import Problem, merge_problems
from hplan.planning.solver import best_motion, reuse_motion
from hplan.robot.model import Robot
from hplan.scene.model import Scene, Start
from hplan.scene.obstacles import Sphere

START = (0.0, 30.0, 20.0, 20.0)
NEAR = (30.0, 30.0, 20.0, 20.0)
OPTIONS = PlanOptions(step_deg=2.0)


def assert_motion(robot: Robot, scene: Scene, motion: Motion) -> None:
    assert motion.certificate.verified
    assert certify(robot, scene, motion.trajectory).verified
    checker = CoalScene(robot, scene.solids)
    q = between_rows(motion.trajectory, np.arange(motion.trajectory.samples))
    assert not checker.obstacle_names or min(checker.distances(each).min() for each in q) > 0.0
    np.testing.assert_array_equal(motion.waypoints[[0, -1]], [motion.problem.start, motion.problem.goal])


def test_nearer_goal_around_something_beats_a_far_straight_one(robot: Robot) -> None:
    """A low post before the near goal costs little; the far goal takes more than twice as long."""
    low = [post("low", 15.0, 1.7, 0.0, 1.65, 0.03)]
    near = task(START, NEAR, low)
    far = task(START, (-150.0, 30.0, 20.0, 20.0), low)
    number, motion = best_motion(merge_problems([posed(robot, near, OPTIONS), posed(robot, far, OPTIONS)]))
    assert number == 0
    assert_motion(robot, near, motion)
    assert motion.trajectory.duration < best_motion(posed(robot, far, OPTIONS))[1].trajectory.duration


def test_locked_base_tries_the_goals_in_turn(robot: Robot) -> None:
    closed = task(BELOW, ABOVE, BAR, locked_joints=("base_yaw",))
    free = task(BELOW, (0.0, 12.0, 40.0, 30.0), BAR, locked_joints=("base_yaw",))
    tasks = [posed(robot, closed, OPTIONS), posed(robot, free, OPTIONS)]
    number, motion = best_motion(merge_problems(tasks))
    assert number == 1
    assert_motion(robot, free, motion)
    with pytest.raises(NoPathError):
        best_motion(tasks[0])


def test_uncertified_plan_is_refused_by_default(robot: Robot) -> None:
    """A motion timed without the ball, certified with it."""
    motion = best_motion(posed(robot, task(BELOW, ABOVE)))[1]
    with_ball = posed(robot, task(BELOW, ABOVE, BAR))
    shown = certificate_of(with_ball, motion.trajectory)
    assert not shown.verified
    with pytest.raises(CertificationError, match="'ball'") as caught:
        require_certificate(with_ball, shown)
    assert caught.value.data["violations"]
    lax = replace(with_ball, options=PlanOptions(certify=False))
    assert require_certificate(lax, certificate_of(lax, motion.trajectory)) == shown


# Earlier motions


def after(robot: Robot, before: Motion, scene: Scene) -> Motion | None:
    return reuse_motion(posed(robot, scene, OPTIONS), before)


def test_path_is_kept_or_repaired(robot: Robot) -> None:
    obstacles: list[Any] = [post("post", 30.0, 1.2, 0.0, 2.0, 0.05)]
    scene = task(START, (60.0, 30.0, 20.0, 20.0), obstacles)
    before = best_motion(posed(robot, scene, OPTIONS))[1]
    more = scene.with_obstacles([*obstacles, Sphere(name="far", center=at(-120.0, 1.5, 1.0), radius=0.2)])
    kept = after(robot, before, more)
    assert kept.origin == "kept"
    assert kept.trajectory is before.trajectory
    assert kept.problem.scene is more
    assert_motion(robot, more, kept)
    again = after(robot, kept, scene)
    assert again.origin == "kept"
    tip = robot.tool_positions(before.trajectory.position[before.trajectory.samples // 2])
    bead = Sphere(name="bead", center=tuple(np.add(tip, (0.0, 0.0, 0.035)).tolist()), radius=0.01)
    grazed = scene.with_obstacles([*obstacles, bead])
    repaired = after(robot, before, grazed)
    assert repaired.origin == "mended"
    assert_motion(robot, grazed, repaired)


@pytest.mark.parametrize("joint", ["base_yaw", "shoulder", "elbow", "wrist"])
def test_another_range_of_a_joint_is_another_task(robot: Robot, joint: str) -> None:
    """Start and goal are the same, but the earlier motion went around something with a joint that is now locked."""
    scene = task((0.0, 30.0, 20.0, 20.0), (60.0, 30.0, 20.0, 20.0), [post("post", 30.0, 1.2, 0.0, 2.0, 0.05)])
    before = best_motion(posed(robot, scene, OPTIONS))[1]
    assert after(robot, before, scene).origin == "kept"
    changed = posed(robot, scene, OPTIONS)
    place = robot.joint_names.index(joint)
    for name, value in (("lower", -0.01), ("upper", 0.01)):
        limits = np.array(getattr(changed, name))
        limits[0, place] = limits[0, place] - value  # narrower by a little
        assert reuse_motion(replace(changed, **{name: limits}), before) is None


def test_draft_is_timed_but_not_verified(robot, scene):
    problem = replace(Problem.from_scene(robot, scene, PlanOptions(effort="quick")), is_draft=True)
    draft = best_of(plans_from_rest(problem.in_world(problem.world)))
    assert draft.duration > 0.0
    assert not draft.transit.certificate.verified
    assert draft.transit.certificate.violations == ("the motion is a draft",)


def test_draft_hands_on_what_is_near_it_and_its_blended_motion_does_not(robot, scene):
    around = task((0.0, 30.0, 20.0, 20.0), (60.0, 30.0, 20.0, 20.0), [post("post", 30.0, 1.2, 0.0, 2.0, 0.05)])
    problem = Problem.from_scene(robot, around, PlanOptions(effort="quick"))
    problem = problem.in_world(problem.world)
    certified, draft = (best_of(plans_from_rest(replace(problem, is_draft=each))).transit for each in (False, True))
    assert certified.near is None
    assert draft.near is not None
    middle, bodies = draft.trajectory.position[draft.trajectory.samples // 2], len(problem.field.arm.bodies)
    distances = [field.link_clearances(middle)[:bodies] for field in (problem.field, draft.near)]
    np.testing.assert_array_equal(*distances)
    start = Start(joints_rad=around.start.configuration, velocity_rad_s=(0.2, 0.0, 0.0, 0.0))
    moving = around.with_values(start=start)
    assert plan(robot, moving, PlanOptions(effort="quick")).motion.near is None
