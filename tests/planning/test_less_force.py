"""Motions among limbs: which are preferred."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hplan
from hplan import PlanOptions, Trajectory
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate, all_of
from hplan.errors import CertificationError, HplanError
from hplan.planning import motion
from hplan.planning.less_force import LONGER, with_less_force
from hplan.planning.motion import best_of
from hplan.planning.problem import Problem
from hplan.planning.result import PlanResult
from hplan.scene import Goal, Scene, Wood, load_scene, with_limbs

#: Fruits whose quickest motion pushes limbs.
PUSHING = ("fruit 36",)


@cache
def robot() -> hplan.Robot:
    return hplan.load_robot("harvester")


@cache
def scene_of(name: str, *, bends: bool) -> Scene:
    scene = with_limbs(load_scene(name))
    assert scene.wood is not None
    return scene if bends else scene.with_values(wood=scene.wood.as_rigid)


@cache
def motion_to(fruit: str, name: str = "dense-canopy", *, bends: bool = True) -> PlanResult:
    scene = scene_of(name, bends=bends).with_values(goal=Goal(fruit=fruit))
    return hplan.plan(robot(), scene)


def largest_force(result: PlanResult) -> float:
    return max((push.force_n or 0.0 for push in result.certificate.pushes or ()), default=0.0)


@pytest.mark.parametrize("fruit", ["fruit 01", "fruit 03", "fruit 07", "fruit 10"])
def test_a_motion_that_touches_nothing_is_taken_if_it_is_as_fast(fruit: str) -> None:
    stiff, bending = (motion_to(fruit, "orchard-row", bends=bends) for bends in (False, True))
    assert bending.certificate.verified
    assert largest_force(bending) == 0.0
    assert bending.trajectory.duration <= stiff.trajectory.duration


def test_limbs_are_pushed_where_no_other_motion_is_as_fast() -> None:
    for fruit in PUSHING:
        bending, stiff_s = motion_to(fruit), math.inf
        with suppress(HplanError):
            stiff_s = motion_to(fruit, bends=False).trajectory.duration
        assert bending.trajectory.duration < stiff_s
        assert 0.0 < largest_force(bending) <= 10.0


@pytest.mark.parametrize(("first_s", "expected_s", "searched"), [(3.0, 2.0, [3.0]), (2.9, 1.0, [2.9, 1.0])])
def test_motions_that_push_are_searched_no_further_if_the_first_one_is_not_faster(
    first_s: float, expected_s: float, searched: list[float]
) -> None:
    problem, pushing = Problem.from_scene(robot(), scene_of("orchard-row", bends=True), PlanOptions()), list[float]()

    def solve(asked: Problem) -> Iterator[Any]:
        is_rigid = asked.world is not problem.world
        for duration_s in (3.0, 2.0) if is_rigid else (first_s, 1.0):
            if not is_rigid:
                pushing.append(duration_s)
            yield SimpleNamespace(duration=duration_s, grasp=SimpleNamespace(least_duration=0.5))

    assert best_of(with_less_force(solve)(problem)).duration == expected_s
    assert pushing == searched


def test_gentle_motions_take_little_longer_and_push_less() -> None:
    """Where limits are high, quick motions push with much force."""
    strong = with_limbs(load_scene("dense-canopy"), Wood(contact_force=60.0, wood_stress_mpa=100.0, fruit_force=40.0))
    scene = strong.with_values(goal=Goal(fruit="fruit 36"))
    quick, gentle = (hplan.plan(robot(), scene, PlanOptions(effort="quick", gentle=choice)) for choice in (False, True))
    assert gentle.certificate.verified
    assert gentle.trajectory.duration <= LONGER * quick.trajectory.duration
    assert 0.0 < largest_force(gentle) < largest_force(quick)


@pytest.mark.parametrize(("fraction", "slowed"), [(0.5, 2), (0.25, 1), (0.1, 0)])
def test_motions_are_not_slowed_down_without_end(fraction: float, slowed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of("dense-canopy", bends=True).with_values(goal=Goal(fruit=PUSHING[0]))
    problem, plan = Problem.from_scene(robot(), scene, PlanOptions()), motion_to(PUSHING[0])
    refused, tried = replace(plan.certificate, verified=False), list[float]()

    def refuse(_: Problem, trajectory: Trajectory, *among: Any, **options: Any) -> Certificate:
        tried.append(trajectory.duration)
        assert trajectory.takes_over_s is None
        return refused

    def slow_down(_: Any, duration_s: float, *others: Any) -> FloatArray:
        return np.array([[0.0, 1.0], [0.2, 1.0], [0.4, fraction], [duration_s, fraction]])

    monkeypatch.setattr(motion, "certificate_of", refuse)
    monkeypatch.setattr(motion, "gentle_speeds", slow_down)
    assert motion.certify_gently(problem, plan.trajectory) == (plan.trajectory, refused)
    assert len(tried) == 1 + slowed


@pytest.mark.parametrize("refused", [1, 1000])
def test_a_plan_is_certified_as_a_whole(refused: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions that are each certified may together displace the fruit: the next grasp is taken, or none."""
    asked = list[Certificate]()

    def joined(parts: list[Certificate]) -> Certificate:
        found = all_of(parts)
        asked.append(found)
        return found if len(asked) > refused else replace(found, verified=False, violations=("the fruit is displaced",))

    monkeypatch.setattr(motion, "all_of", joined)
    scene = scene_of("orchard-row", bends=True)
    with pytest.raises(CertificationError, match="displaced") if refused > 1 else nullcontext():
        assert hplan.plan(robot(), scene, PlanOptions(effort="quick")).certificate.verified
    assert len(asked) > 1
    unasked = hplan.plan(robot(), scene, PlanOptions(effort="quick", certify=False)) if refused > 1 else None
    assert unasked is None or not unasked.certificate.verified
