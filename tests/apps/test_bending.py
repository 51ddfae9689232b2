"""Trees that bend in MuJoCo: beam theory, fruit on stalks, the command and its page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import animation_of, commands_of, objects
from planned import fruit, straight, task
from script_loader import load_script

from hplan.apps.execution.bending_wood import BendingTrees, WoodBodies
from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, Plant, SimulatedArm, import_mujoco
from hplan.apps.execution.simulation import Execution, execute, find_near
from hplan.apps.execution.tree_response import TreeMonitor
from hplan.apps.execution.wind import Wind
from hplan.apps.view.body_motions import limb_clips
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.base.arrays import FloatArray
from hplan.errors import SceneError
from hplan.robot.model import Robot
from hplan.scene import save_scene, with_limbs
from hplan.scene.fruit import Fruit
from hplan.scene.limbs import Limbs
from hplan.scene.obstacles import Capsule
from hplan.scene.orchard import OrchardOptions, generate
from hplan.scene.wood import Wood
from hplan.trajectory.trajectory import write_csv

pytest.importorskip("mujoco", reason="the extra `execution` is not installed")

TRUNK = Capsule(name="trunk", start=(2.1, 0.0, 0.0), end=(2.1, 0.0, 2.0), radius=0.03)

#: A shoot towards the base, with a twig on it.
SHOOT = Capsule(name="shoot", start=(2.1, 0.0, 1.3), end=(1.3, 0.0, 1.3), radius=0.005, parent="trunk")
TWIG = Capsule(name="twig", start=(1.6, 0.0, 1.3), end=(1.6, 0.0, 1.55), radius=0.004, parent="shoot")

START, GOAL = (-25.0, 20.0, 20.0, 20.0), (25.0, 20.0, 20.0, 20.0)


class Pushed:
    """A limb in MuJoCo that is pushed at a point by a force; steps of a second lead to the equilibrium."""

    def __init__(self, limbs: Limbs, number: int, along: float, trees: BendingTrees) -> None:
        self.mujoco = import_mujoco()
        spec = self.mujoco.MjSpec()
        spec.option.timestep = 1.0
        bodies = WoodBodies(self.mujoco, spec, limbs, Wood(), trees)
        bodies.add_limbs([limbs.names[number]])
        self.model = spec.compile()
        self.data = self.mujoco.MjData(self.model)
        self.monitor = TreeMonitor(self.mujoco, self.model, self.data, bodies)
        carrier = bodies.carrier(number, along)
        self.body = self.model.body(carrier.body.name).id
        self.local = limbs.start[number] + along * limbs.axis[number] - carrier.origin

    @property
    def point(self) -> FloatArray:
        return np.asarray(self.data.xpos[self.body] + self.data.xmat[self.body].reshape(3, 3) @ self.local)

    def displacement(self, force: FloatArray) -> FloatArray:
        before = self.point
        for _ in range(20):
            lever = self.point - self.data.xipos[self.body]
            self.data.xfrc_applied[self.body] = [*force, *np.cross(lever, force)]
            self.mujoco.mj_step(self.model, self.data)
            self.mujoco.mj_forward(self.model, self.data)
        return self.point - before


@pytest.mark.parametrize(("number", "fraction"), [(1, 1.0), (1, 0.4), (1, 0.07), (2, 1.0), (2, 0.5), (2, 0.1)])
def test_limb_has_the_compliance_of_a_beam(number: int, fraction: float) -> None:
    limbs = Limbs.of([TRUNK, SHOOT, TWIG])
    along = fraction * float(limbs.length[number])
    limb = Pushed(limbs, number, along, BendingTrees(youngs_modulus_gpa=3.0))
    compliance = limbs.compliance(number, fraction, 3e9)[:3, :3]
    for direction in np.eye(3):
        expected = compliance @ direction
        size = float(np.linalg.norm(expected))
        if size > 1e-9:
            force = 1e-4 / size * direction
            limb.mujoco.mj_resetData(limb.model, limb.data)
            limb.mujoco.mj_forward(limb.model, limb.data)
            np.testing.assert_allclose(limb.displacement(force), 1e-4 * expected / size, atol=3e-6)


def test_stress_of_a_cantilever_is_that_of_its_clamp() -> None:
    limbs = Limbs.of([TRUNK, SHOOT])
    force = np.array([0.0, 0.0, 0.5])
    limb = Pushed(limbs, 1, 0.8, BendingTrees())
    limb.displacement(force)
    expected = 4.0 * 0.5 * 0.8 / (math.pi * 0.005**3)
    assert limb.monitor.bending_stress()[1] == pytest.approx(expected, rel=0.01)


def test_stalk_bears_the_weight_and_what_pushes_the_fruit() -> None:
    mujoco, apple = import_mujoco(), fruit("apple", 0.0, 1.4, 1.25)
    spec = mujoco.MjSpec()
    bodies = WoodBodies(mujoco, spec, Limbs.of([TRUNK, SHOOT]), Wood(), BendingTrees())
    bodies.add_limbs(["shoot"])
    bodies.add_fruits([apple], ["apple"])
    model = spec.compile()
    data = mujoco.MjData(model)
    monitor = TreeMonitor(mujoco, model, data, bodies)
    weight = 9.81 * Wood().fruit_density * 4.0 / 3.0 * math.pi * apple.radius**3
    assert monitor._weights == pytest.approx([weight], rel=1e-6)
    data.xfrc_applied[model.body("fruit:apple").id, 1] = 0.3
    for _ in range(20_000):
        mujoco.mj_step(model, data)
    assert np.linalg.norm(monitor._stalk_forces()) == pytest.approx(math.hypot(weight, 0.3), rel=1e-3)


def sweep(robot: Robot, *obstacles: Capsule, seconds: float = 2.0, fruits: Any = (), **trees: float) -> Execution:
    """The arm sweeps sideways through what is in front of it."""
    scene = task(START, GOAL, [TRUNK, *obstacles], fruits=fruits, wood=Wood())
    motion = straight(robot, np.radians(START), np.radians(GOAL), seconds, 100.0)
    return execute(robot, scene, motion, trees=BendingTrees(**trees))


@pytest.fixture(scope="module")
def swept(robot: Robot) -> Execution:
    return sweep(robot, SHOOT, TWIG, fruits=(fruit("apple", 0.0, 1.4, 1.25),))


def test_swept_shoot_bends_and_springs_back(swept: Execution) -> None:
    assert swept.trees is not None
    assert {one.limb for one in swept.trees.contacts} >= {"shoot"}
    for one in swept.trees.contacts:
        assert one.force_n > 0.0
        assert one.begin_s <= one.force_s <= one.end_s < swept.duration_s
    shoot = max((one for one in swept.trees.contacts if one.limb == "shoot"), key=lambda one: one.force_n)
    assert 0.02 < shoot.deflection_m < 0.5
    assert 1.0 < shoot.stress_mpa < 400.0
    assert not swept.contacts  # nothing rigid
    assert swept.ended_at_goal


def test_sleep_and_the_dual_solver_change_nothing(
    robot: Robot, swept: Execution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hplan.apps.execution.simulated_arm.set_solver", lambda *_, **__: None)
    awake = sweep(robot, SHOOT, TWIG, fruits=(fruit("apple", 0.0, 1.4, 1.25),)).trees
    assert awake is not None
    assert swept.trees is not None
    for one, other in zip(swept.trees.contacts, awake.contacts, strict=True):
        assert (one.limb, one.link) == (other.limb, other.link)
        for name in ("begin_s", "end_s", "force_n", "stress_mpa", "deflection_m"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-4)
    assert dict(swept.trees.fruit_displacement_m) == pytest.approx(awake.fruit_displacement_m, rel=1e-4)


def test_fruit_is_knocked_off_by_a_fast_arm_and_a_weak_stalk(robot: Robot) -> None:
    apple = fruit("apple", 0.0, 1.4, 1.25)
    strong = sweep(robot, SHOOT, fruits=(apple,), stalk_strength_n=1e4).trees
    weak = sweep(robot, SHOOT, fruits=(apple,), stalk_strength_n=3.0).trees
    assert strong is not None
    assert weak is not None
    assert not strong.knocked_off
    assert strong.fruit_displacement_m["apple"] < 0.5
    (lost,) = weak.knocked_off
    assert lost.name == "apple"
    assert lost.load > 3.0
    assert not weak.fruit_displacement_m
    assert not weak.ok
    (falls,) = weak.motions.fruits
    assert falls.position[-1, 2] == pytest.approx(0.04, abs=1e-6)  # on the ground


def test_stronger_wood_does_not_break(swept: Execution, robot: Robot) -> None:
    assert swept.trees is not None
    broken = sweep(robot, SHOOT, wood_strength_mpa=1.0).trees
    assert broken is not None
    assert [one.name for one in broken.broken] == ["shoot"]
    assert broken.broken[0].load > 1.0


@pytest.mark.parametrize("bending", [("shoot",), ()])
def test_only_named_limbs_bend(robot: Robot, bending: tuple[str, ...]) -> None:
    scene = task(START, GOAL, [TRUNK, SHOOT], wood=Wood())
    motion = straight(robot, np.radians(START), np.radians(GOAL), 2.0, 100.0)
    result = execute(robot, scene, motion, trees=BendingTrees(), bending=bending)
    assert result.trees is not None
    assert {one.limb for one in result.trees.contacts} == set(bending)
    assert {touch.obstacle for touch in result.contacts} == {"shoot"} - set(bending)


def test_limbs_are_found_in_a_scene_without_wood(robot: Robot) -> None:
    bare = [piece.model_copy(update={"parent": None}) for piece in (TRUNK, SHOOT)]
    motion = straight(robot, np.radians(START), np.radians(GOAL), 2.0, 100.0)
    result = execute(robot, task(START, GOAL, bare), motion, trees=BendingTrees())
    assert result.trees is not None
    assert {one.limb for one in result.trees.contacts} == {"shoot"}
    with pytest.raises(SceneError, match=r"parent|limb|touch"):
        execute(robot, task(START, GOAL, bare[:1]), motion, trees=BendingTrees())


def test_steady_wind_bends_a_cantilever_like_a_uniform_load() -> None:
    limbs = Limbs.of([TRUNK, SHOOT])
    wind = Wind(speed_m_s=2.0, intensity=0.0, heading_deg=90.0, leaf_width_m=0.02)
    limb = Pushed(limbs, 1, 0.8, BendingTrees(wind=wind))
    before = limb.point
    for _ in range(20):
        limb.monitor.blow()
        limb.mujoco.mj_step(limb.model, limb.data)
    limb.mujoco.mj_forward(limb.model, limb.data)
    load = 0.5 * 1.2 * 2.0**2 * (2.0 * 0.005 + 0.02)  # newton per metre
    rigidity = 5e9 * 0.25 * math.pi * 0.005**4
    np.testing.assert_allclose(limb.point - before, [0.0, load * 0.8**4 / (8.0 * rigidity), 0.0], atol=5e-4)


def test_gusts_have_the_given_deviation_and_length_scale() -> None:
    wind = Wind(speed_m_s=5.0, intensity=0.2, length_scale_m=10.0, seed=1)
    speeds = wind.speeds(4000.0, 0.1)
    assert np.mean(speeds) == pytest.approx(5.0, rel=0.05)
    assert np.std(speeds) == pytest.approx(1.0, rel=0.1)
    lag = round(10.0 / 5.0 / 0.1)  # correlation falls to 1/e in the time of a length scale
    assert np.corrcoef(speeds[:-lag], speeds[lag:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.1)


# The page.


def test_limbs_move_on_the_page(swept: Execution, robot: Robot) -> None:
    assert swept.trees is not None
    motions = swept.trees.motions
    assert motions.limb_names == {"shoot", "twig"}
    scene = task(START, GOAL, [TRUNK, SHOOT, TWIG], fruits=(fruit("apple", 0.0, 1.4, 1.25),))
    page = render_page(robot, scene, Playback(swept.trajectory, bodies=motions))
    assert len(page) < 3e6
    commands = commands_of(page)
    drawn = [path for path in objects(commands) if path.startswith("/hplan/limbs/")]
    assert len(drawn) == len(motions.limbs)
    clips = {clip["path"]: clip["clip"] for clip in animation_of(commands)["animations"]}
    moving = [clips[path] for path in drawn if path in clips]
    assert len(moving) == sum(body.moves for body in motions.limbs) > 0
    largest = 0.0
    for clip in moving:
        (track,) = [track for track in clip["tracks"] if track["name"] == ".position"]
        places = np.reshape(track["values"], (-1, 3))
        assert len(places) == len(track["times"])
        largest = max(largest, float(np.linalg.norm(places - places[0], axis=1).max()))
    assert largest > 0.02
    assert "/hplan/fruits/fruit apple" in clips


def test_keyframes_are_few_and_close(swept: Execution) -> None:
    assert swept.trees is not None
    motions, duration = swept.trees.motions, swept.trajectory.duration
    bodies = [body for body in motions.limbs if body.moves]
    for body, clip in zip(bodies, limb_clips(motions, duration, duration + 1.0), strict=True):
        (track,) = [track for track in clip["clip"]["tracks"] if track["name"] == ".position"]
        places = np.reshape(track["values"], (-1, 3))
        shown = np.column_stack([np.interp(motions.time, track["times"], axis) for axis in places.T])
        assert np.abs(shown - body.position).max() < 1e-3
        assert len(places) <= len(motions.time) + 1


# The command.


@pytest.fixture
def small_orchard(tmp_path: Path) -> Path:
    """One generated tree with fruit, and limits of force."""
    options = OrchardOptions(trees=1, distance=2.0, branches=16, branch_length=1.0, shoots=1, fruits=4)
    return save_scene(with_limbs(generate(options)), tmp_path / "orchard.yaml")


def test_command(small_orchard: Path, robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion = write_csv(straight(robot, np.radians(START), np.radians(GOAL), 2.0, 100.0), tmp_path / "motion.csv")
    report, page = tmp_path / "report.json", tmp_path / "motion.html"
    command = [str(motion), str(small_orchard), "--bending"]
    status = load_script("execute").main([*command, "--report", str(report), "--page", str(page)])
    text = capsys.readouterr().out
    content = json.loads(report.read_text())
    trees = content["trees"]
    assert status == (0 if content["status"] == "ok" else 5)
    assert trees["contacts"]
    assert all(one["limb"] in text and one["force_n"] > 0.0 for one in trees["contacts"])
    assert {"broken", "knocked_off", "goal", "limits"} <= set(trees)
    shown = page.read_text(encoding="utf-8")
    assert any("/limbs/" in path for path in objects(commands_of(shown)))
    limbs = len({one["limb"] for one in trees["contacts"] if not one["is_fruit"]})
    assert f"Touched {limbs} limb{'' if limbs == 1 else 's'}" in shown
    assert ">simulated<" in shown
    assert "no certificate" not in shown
    softer = load_script("execute").main(
        [*command, "--youngs-modulus", "0.7", "--json", "--wood-strength", "1000", "--wind", "1", "90"]
    )
    soft = json.loads(capsys.readouterr().out)
    assert softer in (0, 5)
    assert not soft["trees"]["broken"]
    stiff, soft_force = (sum(one["force_n"] for one in each["trees"]["contacts"]) for each in (content, soft))
    assert soft_force < stiff


def test_options_of_trees_need_bending(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "motion.csv"
    path.write_text("time_s,a_pos_rad\n0,0\n")
    assert load_script("execute").main([str(path), "--friction", "0.3"]) == 2
    assert "--friction" in capsys.readouterr().err


#: A breeze across the shoot.
BREEZE = Wind(speed_m_s=2.0, intensity=0.0, heading_deg=90.0, leaf_width_m=0.02)


def in_breeze(robot: Robot, *fruits: Fruit) -> SimulatedArm:
    scene = task(START, GOAL, [TRUNK, SHOOT], fruits=fruits, wood=Wood())
    return SimulatedArm(robot, scene, Plant(bandwidth=200.0, decoupled=True), trees=BendingTrees(wind=BREEZE))


def sideways(arm: SimulatedArm) -> float:
    """Displacement of the end of the shoot along the wind."""
    last = max(geom for geom, name in arm._obstacle_of.items() if name == "shoot")
    return float(arm._data.geom_xpos[last, 1])


def hold(arm: SimulatedArm, q: FloatArray, seconds: float) -> None:
    for _ in range(round(seconds / CONTROL_PERIOD)):
        arm.follow(q, np.zeros_like(q), np.zeros_like(q))


def test_limbs_sway_when_the_motion_begins(robot: Robot) -> None:
    arm, q = in_breeze(robot, fruit("apple", 0.0, 1.4, 1.25)), np.radians(START)
    arm.settle(q)
    assert arm.time_s == 0.0
    np.testing.assert_array_equal(arm.position, q)
    bent = sideways(arm)
    assert bent > 0.001
    hold(arm, q, 0.5)
    assert sideways(arm) == pytest.approx(bent, rel=0.1)  # no jump


def test_trees_settle_in_long_steps_as_in_short_ones(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for step_s in (4e-3, 5e-4):
        monkeypatch.setattr("hplan.apps.execution.simulated_arm._COARSE_STEP_S", step_s)
        arm = in_breeze(robot, fruit("apple", 0.0, 1.4, 1.25))
        arm.settle(np.radians(START))
        ends.append(sideways(arm))
    assert ends[0] == pytest.approx(ends[1], rel=0.01)


def test_limbs_move_only_while_the_arm_is_near(robot: Robot) -> None:
    arm, q = in_breeze(robot), np.radians(START)
    assert arm.trees is not None
    arm.trees._lead_s[:] = 0.3
    arm.trees.move_only({"shoot": [(1.0, 1.2)]})
    arm.settle(q)
    hold(arm, q, 0.6)
    assert sideways(arm) == 0.0
    assert arm._data.ntree_awake == 1
    hold(arm, q, 1.0)
    assert sideways(arm) > 0.001
    hold(arm, q, 1.0)
    assert sideways(arm) == 0.0
    assert arm._data.ntree_awake == 1
    assert not arm.trees.touched_still


def test_soft_limbs_move_all_the_time(robot: Robot) -> None:
    soft = Capsule(name="soft", start=(2.1, 0.0, 1.3), end=(1.3, 0.0, 1.3), radius=0.002, parent="trunk")
    for shoot, settle_s in ((SHOOT, 0.0), (soft, 10.0)):
        scene = task(START, GOAL, [TRUNK, shoot], wood=Wood())
        arm = SimulatedArm(robot, scene, trees=BendingTrees(wind=BREEZE, youngs_modulus_gpa=0.1))
        assert arm.trees is not None
        arm.trees.move_only({shoot.name: [(30.0, 31.0)]})
        assert arm.trees.settle_s == settle_s


def test_touch_of_a_limb_held_still_is_counted(robot: Robot) -> None:
    arm = in_breeze(robot)
    assert arm.trees is not None
    arm.trees.move_only({})
    clock = CONTROL_PERIOD * np.arange(2001)[:, None] / 2.0
    ways = np.radians(START) + clock * (np.radians(GOAL) - np.radians(START))
    arm.settle(ways[0])
    for q in ways:
        arm.follow(q, np.gradient(ways, CONTROL_PERIOD, axis=0)[1], np.zeros_like(q))
    assert "shoot" in arm.trees.touched_still
    assert max(one.force_n for one in arm.trees.response({}).contacts) > 0.0  # it bends


def test_stalks_at_rest_do_not_depend_on_the_arm_before_it_is_placed(robot: Robot) -> None:
    tip = robot.tool_positions(np.zeros(robot.dof))
    x, apple = float(tip[0]), fruit("apple", 0.0, float(tip[0]), float(tip[2]))
    trunk = Capsule(name="trunk", start=(x, 0.4, 0.0), end=(x, 0.4, 2.0), radius=0.02)
    above = (x, 0.03, float(tip[2]) + 0.05)
    shoot = Capsule(name="shoot", start=(x, 0.4, above[2]), end=above, radius=0.005, parent="trunk")
    arm = SimulatedArm(robot, task(START, GOAL, [trunk, shoot], fruits=(apple,), wood=Wood()), trees=BendingTrees())
    assert arm.trees is not None
    weight = 9.81 * Wood().fruit_density * 4.0 / 3.0 * math.pi * apple.radius**3
    assert arm.trees._weights == pytest.approx([weight], rel=1e-6)


def test_what_is_near_the_arm_is_found_with_its_rows(robot: Robot) -> None:
    far = Capsule(name="far", start=(-3.0, 0.0, 0.0), end=(-3.0, 0.0, 1.0), radius=0.01)
    scene = task(START, GOAL, [TRUNK, SHOOT, far], wood=Wood())
    ways = np.linspace(np.radians(START), np.radians(GOAL), 101)
    near = find_near(robot, scene, ways)
    ((first, last),) = near["shoot"]
    assert 0 < first < 50 < last < 100
    assert "far" not in near
    ((wider, _),) = find_near(robot, scene, ways, {"shoot": 0.2})["shoot"]
    assert wider < first
