"""Objects that are picked up and put down between motions, judged by coal with the object where it is."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

from hplan import PlanOptions, load_robot, load_scene
from hplan.errors import InputError, SceneError, TiltedError
from hplan.geometry.shape_outline import coal_distance
from hplan.planning.steps import StepsResult, certify_steps, plan_steps
from hplan.robot.model import Robot
from hplan.scene import Box, Fruit, Goal, Scene, Sphere, Start, Step, Track, Upright

QUICK = PlanOptions(effort="quick")
TABLE = Box(name="table", center=(0.55, 0.0, -0.15), size=(0.5, 1.2, 0.1))
CRATE = Box(name="crate", center=(0.5, -0.3, -0.05), size=(0.12, 0.12, 0.1))
WALL = Box(name="wall", center=(0.5, 0.0, 0.0), size=(0.3, 0.04, 0.2))
HOME = (-0.729, -1.079, 1.864, -2.356, -1.571, -2.3)


def above(y: float, height: float) -> Goal:
    """The tool over the table, pointing down."""
    return Goal(position=(0.5, y, height), quaternion_xyzw=(1.0, 0.0, 0.0, 0.0))


#: The tool touches the top of the crate, which stands on the table.
STEPS = (
    Step(goal=above(-0.3, 0.1)),
    Step(goal=above(-0.3, 0.0), pick="crate", mass=1.0),
    Step(goal=above(-0.3, 0.1)),
    Step(goal=above(0.3, 0.1)),
    Step(goal=above(0.3, 0.0), put="crate"),
    Step(goal=above(0.3, 0.2)),
)


@pytest.fixture(scope="module")
def ur5(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("ur5", tmp_path_factory)


@pytest.fixture(scope="module")
def scene() -> Scene:
    start = Start(joints_rad=HOME)
    return Scene(
        name="pick and place", start=start, goal=Goal(joints_rad=HOME), obstacles=(TABLE, CRATE, WALL), clearance=0.005
    )


@pytest.fixture(scope="module")
def moved(ur5: Robot, scene: Scene) -> StepsResult:
    return plan_steps(ur5, scene, STEPS, QUICK)


def test_crate_goes_around_the_wall_and_touches_what_it_stands_on(ur5: Robot, moved: StepsResult) -> None:
    """Coal's distances of the crate, which moves with the tool between pick and put."""
    assert moved.certificate.verified
    (picked_s,), (put_s,) = moved.picked.values(), moved.put.values()
    assert 0.0 < picked_s < put_s < moved.trajectory.duration
    clock = np.linspace(0.0, moved.trajectory.duration, 400)
    q = moved.trajectory.positions(clock)
    tools = [pin.SE3(pose) for pose in ur5.forward_kinematics(q)]
    lies = pin.SE3(np.eye(3), np.array(CRATE.center))
    at_pick = pin.SE3(ur5.forward_kinematics(moved.trajectory.positions(np.array([picked_s]))[0]))
    local = at_pick.inverse() * lies
    put = pin.SE3(ur5.forward_kinematics(moved.trajectory.positions(np.array([put_s]))[0])) * local
    box = coal.Box(*CRATE.size)
    for time_s, tool in zip(clock.tolist(), tools, strict=True):
        place = lies if time_s <= picked_s else put if time_s >= put_s else tool * local
        for other in (TABLE, WALL):
            there = pin.SE3(np.eye(3), np.array(other.center))
            # It stands on the table, up to the accuracy of inverse kinematics and the tolerance of contacts.
            least = 0.005 - 1e-6 if other is WALL else -1.2e-4
            assert coal_distance(box, place, coal.Box(*other.size), there) > least
    np.testing.assert_allclose(put.translation, [0.5, 0.3, -0.05], atol=1e-5)
    crate = next(item for item in moved.scene.obstacles if item.name == "crate")
    np.testing.assert_allclose(crate.center, put.translation, atol=1e-9)
    assert moved.scene.attached == ()
    assert [motion.arrives for motion in moved.motions] == [False, True, False, False, True, False]


def test_torques_include_the_crate_while_it_is_held(ur5: Robot, moved: StepsResult) -> None:
    masses = [sum(item.mass for item in motion.scene.attached) for motion in moved.motions]
    assert masses == [0.0, 0.0, 1.0, 1.0, 1.0, 0.0]
    lifted = moved.motions[2].trajectory
    empty = ur5.dynamics.torques(lifted.position, lifted.velocity, lifted.acceleration)
    assert np.abs(lifted.torque - empty).max() > 1.0


def test_whole_motion_is_certified_again(ur5: Robot, scene: Scene, moved: StepsResult) -> None:
    ends = [phase.end_s for phase in moved.phases]
    assert certify_steps(ur5, scene, STEPS, moved.trajectory, ends).verified
    higher = Box(name="wall", center=(0.5, 0.0, 0.1), size=(0.3, 0.04, 0.4))
    found = certify_steps(ur5, scene.with_obstacles([TABLE, CRATE, higher]), STEPS, moved.trajectory, ends)
    assert any("wall" in words for words in found.violations)
    heavy = (*STEPS[:1], STEPS[1].with_values(mass=100.0), *STEPS[2:])
    assert any("torque" in words for words in certify_steps(ur5, scene, heavy, moved.trajectory, ends).violations)
    with pytest.raises(InputError, match="increasing times of samples"):
        certify_steps(ur5, scene, STEPS, moved.trajectory, [*ends[:-1], ends[-1] + 1.0])


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([], "no step"),
        ([Step(goal=above(-0.3, 0.1), pick="crat")], "no obstacle or fruit 'crat'.*step 1 of 1"),
        ([Step(goal=above(-0.3, 0.1), put="crate")], "no held object 'crate'"),
        ([*STEPS[:2], STEPS[4]], "lift the object in a step between"),
    ],
)
def test_steps_that_do_not_fit_are_refused(ur5: Robot, scene: Scene, steps: list[Step], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan_steps(ur5, scene, steps, QUICK)


def test_fruit_can_be_held_and_moving_obstacles_cannot() -> None:
    rest = Start(joints_deg=(0.0, 90.0, 90.0, 90.0))
    track = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    cart = Sphere(name="cart", center=(2.0, 0.0, 0.0), radius=0.3, track=track)
    pear = Fruit(name="pear", center=(1.0, 0.0, 1.0), radius=0.04, hangs_from=("branch",))
    branch = Sphere(name="branch", center=(1.0, 0.0, 1.1), radius=0.05)
    goal = Goal(joints_deg=(30.0, 45.0, 0.0, 0.0))
    scene = Scene(name="pear", start=rest, goal=goal, obstacles=(branch, cart), fruits=(pear,))
    pose = np.eye(4)
    pose[:3, 3] = 0.9, 0.0, 1.0
    held = scene.pick_up("pear", pose, mass=0.2)
    np.testing.assert_allclose(held.attached[0].object.core, [[0.1, 0.0, 0.0]], atol=1e-12)
    assert held.fruits == ()
    assert [item.name for item in held.put_down("pear", pose).obstacles] == ["branch", "cart", "pear"]
    with pytest.raises(SceneError, match="has a track"):
        scene.pick_up("cart", pose)


def test_object_in_another_frame_is_put_where_it_is(ur5: Robot, scene: Scene) -> None:
    """It is fixed to the forearm, far from everything, and let go elsewhere."""
    q = np.array(HOME)
    at = ur5.forward_kinematics(q, "forearm_link")
    box = Sphere(name="box", center=tuple((at @ np.array([0.2, 0.0, 0.2, 1.0]))[:3].tolist()), radius=0.03)
    begin = scene.with_values(obstacles=(box,), clearance=0.0)
    turned = Goal(joints_rad=(HOME[0] + 1.0, *HOME[1:]))
    steps = [
        Step(goal=Goal(joints_rad=HOME), pick="box", frame="forearm_link", mass=0.1),
        Step(goal=turned, put="box"),
    ]
    found = plan_steps(ur5, begin, steps, QUICK)
    where = ur5.forward_kinematics([HOME[0] + 1.0, *HOME[1:]], "forearm_link") @ np.array([0.2, 0.0, 0.2, 1.0])
    np.testing.assert_allclose(found.scene.obstacles[0].core[0], where[:3], atol=1e-6)


def test_all_steps_keep_upright_the_axis_of_the_first_start() -> None:
    robot, start = load_robot(), Start(joints_deg=(0.0, 20.0, 40.0, 30.0))
    free = load_scene().with_values(start=start, obstacles=(), locked_joints=())
    kept = free.with_values(upright=Upright(max_tilt_deg=8.0))
    near, far = (Step(goal=Goal(joints_deg=(yaw, 30.0, 40.0, 26.0 + more))) for yaw, more in ((20.0, 0.0), (40.0, 6.0)))
    assert plan_steps(robot, kept, [near], QUICK).certificate.verified
    with pytest.raises(TiltedError, match="step 2 of 2"):
        plan_steps(robot, kept, [near, far], QUICK)
    found = plan_steps(robot, free, [near, far], QUICK)
    ends_s = [phase.end_s for phase in found.phases]
    assert certify_steps(robot, free, [near, far], found.trajectory, ends_s).verified
    assert not certify_steps(robot, kept, [near, far], found.trajectory, ends_s).verified
