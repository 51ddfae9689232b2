"""Reachable fruits: agreement with `plan`, and messages for both outcomes."""

from __future__ import annotations

import numpy as np
import pytest
from planned import at, frame_about_upper_arm, fruit, task

import hplan
from hplan.certificate.certificate import certify
from hplan.errors import (
    BlockedError,
    CertificationError,
    HplanError,
    NoPathError,
    NotFoundError,
    NotInTimeError,
    OptionError,
    PlanCancelledError,
    TimingError,
    UnreachableError,
)
from hplan.planar.family_reader import family_of
from hplan.planning.approach import Approach
from hplan.planning.failures import FailuresError, mark_approach, obstacle_of, reason_of
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.reachable import fruit_names
from hplan.robot.model import Robot, load_robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere

QUICK = PlanOptions(effort="quick")
TUCKED = (0.0, 90.0, 90.0, 90.0)


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("orchard_harvester")


def canopy(seed: int) -> Scene:
    """Random fruits, near and far, each with a few twigs, half of them compliant."""
    rng = np.random.default_rng(seed)
    fruits, twigs = [], []
    for number in range(8):
        place = at(rng.uniform(-60.0, 60.0), rng.uniform(0.9, 2.4), rng.uniform(0.6, 2.2))
        fruits.append({"name": f"apple {number}", "center": place, "radius": 0.035, "yields": 0.02 * (number % 2)})
        for twig in range(3):
            middle, along = place + rng.normal(0.0, 0.04, 3), rng.normal(0.0, 0.15, 3)
            ends = {"from": tuple((middle - along).tolist()), "to": tuple((middle + along).tolist())}
            name, yields = f"twig {number} {twig}", float(rng.choice([0.0, 0.02]))
            twigs.append(Capsule.model_validate({"name": name, "radius": 0.004, "yields": yields, **ends}))
    return task(TUCKED, Goal(fruit="apple 0", approach_deg=(-90.0, 100.0)), twigs, fruits=tuple(fruits))


def test_reachable_agrees_with_plan(arm: Robot) -> None:
    seen = []
    for seed in range(3):
        scene = canopy(seed)
        said, asked = hplan.reachable(arm, scene, QUICK), hplan.reachable(arm, scene, QUICK, motions=True)
        assert list(said) == [apple.name for apple in scene.fruits] == list(asked)
        for name, one in said.items():
            goal, reason, failure = scene.goal.model_copy(update={"fruit": name}), None, None
            try:
                found = plan(arm, scene.model_copy(update={"goal": goal}), QUICK)
                assert found.certificate.verified
            except HplanError as error:
                failure = error
                reason = reason_of(error)
            assert asked[name].reason == reason
            assert one.reason == (None if reason == "no_motion" else reason)
            assert one.can_be_picked is (one.reason is None)
            if isinstance(failure, BlockedError):
                assert one.best_clearance_m == failure.best_clearance_m
                assert one.contact is not None
                assert one.obstacle == one.contact.obstacle
                assert one.obstacle in one.detail
            seen.append(reason)
    assert set(seen) == {None, "out_of_reach", "blocked"}


def test_some_fruits_are_checked_alone(arm: Robot) -> None:
    scene = canopy(0)
    every, some = hplan.reachable(arm, scene), hplan.reachable(arm, scene, fruits=["apple 5", "apple 2"])
    assert [(name, found.reason) for name, found in some.items()] == [
        (name, every[name].reason) for name in ("apple 2", "apple 5")
    ]
    for wrong in (["pear"], ["apple 1", "apple 1"], []):
        with pytest.raises(OptionError, match="fruits"):
            hplan.reachable(arm, scene, fruits=wrong)


def test_unknown_fruit_is_answered_with_the_nearest_names() -> None:
    fruits = tuple(Fruit(name=f"apple {n}", center=(0.3, 0.1 * n, 0.5), radius=0.03) for n in range(136))
    scene = Scene(name="many", start=Start(joints_deg=TUCKED), goal=Goal(fruit="apple 1"), fruits=fruits)
    with pytest.raises(OptionError, match="did you mean 'apple 12'"):
        fruit_names(scene, ["aple 12"])
    with pytest.raises(OptionError, match=r"there are apple 0, .*, apple 9 and 126 more"):
        fruit_names(scene, ["17"])
    with pytest.raises(OptionError, match="there are none"):
        fruit_names(scene.with_values(fruits=(), goal=Goal(joints_deg=(0.0,))), ["apple 1"])


def test_motions_are_planned_only_on_request(robot: Robot) -> None:
    apple = {"name": "apple", "center": (-0.6, 0.6, 1.6), "radius": 0.04}
    frame = frame_about_upper_arm(0.0, 70.0)
    scene = task((0.0, 70.0, 20.0, 20.0), Goal(fruit="apple"), frame, fruits=(apple,))
    coarse = PlanOptions(step_deg=3.0)
    assert hplan.reachable(robot, scene, coarse)["apple"].can_be_picked
    shut = hplan.reachable(robot, scene, coarse, motions=True)["apple"]
    assert shut.reason == "no_motion"
    assert "no path exists" in shut.detail


def test_pickable_fruit_has_motions_that_certify(arm: Robot) -> None:
    for with_transit in (False, True):
        scene = canopy(1)
        found = [one for one in hplan.reachable(arm, scene, motions=with_transit).values() if one.can_be_picked]
        assert found
        for one in found:
            assert one.grasp is not None
            center = next(apple.center for apple in scene.fruits if apple.name == one.fruit)
            np.testing.assert_allclose(arm.tool_positions(one.grasp.goal), center, atol=1e-6)
            with pytest.raises(ValueError, match="read-only"):
                one.grasp.goal[0] = 0.0
            assert [motion.name for motion in one.motions] == ["transit"] * with_transit + ["approach", "retreat"]
            there = one.motions[-2].trajectory
            np.testing.assert_allclose(there.position[[0, -1]], [one.grasp.standoff, one.grasp.goal], atol=1e-9)
            goal = scene.goal.model_copy(update={"fruit": one.fruit})
            assert certify(arm, scene.model_copy(update={"goal": goal}), there, check_ends=False).verified


@pytest.mark.parametrize("gap", [-0.03, -0.005, 0.02])
def test_blocking_obstacle_and_depth_are_reported(arm: Robot, gap: float) -> None:
    """A ball so near to the fruit's center that the end of the hand is in it, from wherever it comes."""
    half_width, radius, z = float(family_of(arm).arm.half_widths[-1]), 0.05, 1.4
    beyond = 1.5 + radius + half_width + gap
    ball = Sphere(name="ball", center=at(10.0, beyond, z), radius=radius)
    apple = fruit("apple", 10.0, 1.5, z, 0.03)
    far = fruit("far", 10.0, 9.0, z)
    found = hplan.reachable(arm, task(TUCKED, Goal(fruit="apple"), [ball], fruits=(apple, far)))
    assert found["far"].reason == "out_of_reach"
    assert "beyond the maximum distance" in found["far"].detail
    one = found["apple"]
    assert one.can_be_picked is (gap > 0.0)
    if gap < 0.0:
        assert one.reason == "blocked"
        assert one.contact is not None
        assert (one.contact.obstacle, one.contact.link) == ("ball", arm.tool_frame)  # the gripper
        assert one.contact.distance_m == pytest.approx(gap, abs=1e-5)
        assert one.best_clearance_m == pytest.approx(gap, abs=1e-9)


def test_without_a_certified_approach(arm: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: Approach) -> None:
        raise CertificationError("not shown clear")

    monkeypatch.setattr(Approach, "from_rest", property(none))
    found = hplan.reachable(arm, task(TUCKED, Goal(fruit="apple"), fruits=(fruit("apple", 10.0, 1.5, 1.4),)))
    assert (found["apple"].reason, found["apple"].detail) == ("no_approach", "not shown clear")


def _uncertified(obstacle: str | None = None) -> HplanError:
    return CertificationError(f"not certified near {obstacle}", obstacle=obstacle)


@pytest.mark.parametrize(
    ("error", "reason", "obstacle"),
    [
        (UnreachableError((3.0, 0.0, 1.0), "too_far", "too short"), "out_of_reach", None),
        (BlockedError("fruit 'a'", 3, [{"obstacle": "wire", "link": "hand", "configurations": 3}]), "blocked", "wire"),
        (NoPathError("none", reached_cells=1, blockers=[{"obstacle": "post"}]), "no_motion", "post"),
        (NotFoundError(["trees"]), "no_motion", None),
        (mark_approach(_uncertified("twig")), "no_approach", "twig"),
        (FailuresError((mark_approach(_uncertified("twig")), mark_approach(TimingError("slow")))).as_one(),
         "no_approach", "twig"),
        (FailuresError((mark_approach(_uncertified("twig")), _uncertified("post"), _uncertified("post"))).as_one(),
         "no_motion", "post"),
    ],
)  # fmt: skip
def test_reason_and_obstacle_of_errors(error: HplanError, reason: str, obstacle: str | None) -> None:
    assert (reason_of(error), obstacle_of(error)) == (reason, obstacle)


def test_deadline_and_a_cancelled_question(arm: Robot) -> None:
    scene = canopy(0)
    with pytest.raises(NotInTimeError, match="8 fruits"):
        hplan.reachable(arm, scene, PlanOptions(deadline_s=1e-4))
    with pytest.raises(PlanCancelledError):
        hplan.reachable(arm, scene, cancel=lambda: True)
