"""Approaches that flow out of the transit, without a stop at the stand-off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hplan.certificate.certificate import certify
from hplan.planning import plans as planning
from hplan.planning.approach import LEADS, Approach, blended
from hplan.planning.motion import seconds
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv

SCENES = ("trellis", "dense-canopy")


class Told:
    """The arguments and the result of the last call of `blended`."""

    asked: tuple[Any, Any]
    approach: Approach
    stopping: float
    blended: Any


@pytest.fixture(scope="module")
def plans(robot: Robot) -> dict[str, tuple[Scene, PlanResult, Told]]:
    """Plans of scenes, with what they would be with a stop."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        for name in SCENES:
            told = Told()

            def keep(task: Any, transit: Any, before: Any, after: Approach, told: Told = told) -> Any:
                told.asked, told.approach = (task, transit), after
                told.stopping = transit.trajectory.duration + 2.0 * after.from_rest.trajectory.duration
                told.blended = blended(task, transit, before, after)
                return told.blended

            patch.setattr(planning, "blended", keep)
            scene = load_scene(name)
            found[name] = scene, plan(robot, scene), told
    return found


def seam_of(result: PlanResult) -> int:
    """The row at which the approach begins."""
    approach = next(phase for phase in result.phases if phase.name == "approach")
    return int(np.argmin(np.abs(result.trajectory.time - approach.start_s)))


def offset_of(robot: Robot, result: PlanResult, motion: Trajectory) -> float:
    """How far the tool is off its straight line at most, from the stand-off to the grasp and back, between rows too."""
    assert result.grasp is not None
    tip, off = robot.tool_positions(result.grasp.goal), robot.tool_positions(result.grasp.standoff)
    line = (off - tip) / np.linalg.norm(off - tip)
    begin = motion.time[seam_of(result)]
    tool = robot.tool_positions(motion.positions(np.linspace(begin, motion.duration, 2001))) - tip
    along = tool @ line
    assert along[0] >= result.grasp.distance - 1e-6
    return float(np.linalg.norm(tool - along[:, None] * line, axis=1).max())


@pytest.mark.parametrize("name", SCENES)
def test_the_approach_begins_in_motion_and_is_straight(robot: Robot, plans: Any, name: str) -> None:
    _, result, told = plans[name]
    assert told.blended is not None
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]
    assert np.abs(result.trajectory.velocity[seam_of(result)]).max() > 0.05
    assert offset_of(robot, result, result.trajectory) < 1e-4
    assert result.trajectory.duration < told.stopping - 1e-3


@pytest.mark.parametrize("name", SCENES)
def test_the_seam_is_as_smooth_as_the_rest(robot: Robot, plans: Any, name: str) -> None:
    _, result, told = plans[name]
    motion, seam = result.trajectory, seam_of(result)
    transit, approach = (motion.trajectory for motion in told.blended[1:])
    for quantity in ("position", "velocity", "acceleration", "torque"):
        end, begin = getattr(transit, quantity)[-1], getattr(approach, quantity)[0]
        np.testing.assert_allclose(end, begin, rtol=0, atol=1e-9)
    near = slice(seam - 10, seam + 10)
    step = np.diff(motion.time)[0]
    jerk = np.diff(motion.acceleration[near], axis=0) / step
    assert (np.abs(jerk) <= robot.jerk_limit * 1.0005).all()
    # The rows' velocities and accelerations are those of their positions.
    mean = 0.5 * (motion.velocity[1:] + motion.velocity[:-1])[near]
    slip = np.diff(motion.position, axis=0)[near] / step - mean
    assert (np.abs(slip) <= robot.jerk_limit * step**2 / 12.0 + 1e-6).all()
    use = result.certificate.limit_use
    assert max(use.velocity, use.acceleration, use.torque) <= 1.0005


@pytest.mark.parametrize("name", SCENES)
def test_anybody_certifies_the_rows(robot: Robot, plans: Any, name: str, tmp_path: Path) -> None:
    scene, result, _ = plans[name]
    read = read_csv(write_csv(result.trajectory, tmp_path / "motion.csv"))
    certificate = certify(robot, scene, read)
    assert certificate.verified, certificate.violations
    assert certificate.contact_s is not None
    assert certificate.contact_s[0] <= result.phases[1].start_s


@pytest.mark.parametrize(("changes", "stops"), [({"effort": "quick"}, True), ({"tracking_delay_s": 1e-3}, False)])
def test_quick_motions_stop_those_that_make_room_for_a_delay_need_not(
    robot: Robot, changes: dict[str, Any], stops: bool
) -> None:
    result = plan(robot, load_scene("trellis"), replace(PlanOptions(), **changes))
    assert result.certificate.verified
    assert stops == (not result.trajectory.velocity[seam_of(result)].any())


def test_where_the_stop_is_as_quick_the_arm_stops(plans: Any) -> None:
    _, _, told = plans["dense-canopy"]
    assert told.blended is not None
    flown = seconds(told.blended[1:])
    task, transit = told.asked
    for sooner_s, is_blended in ((0.004, True), (0.0, False)):
        # As if the approach from rest were as quick as this.
        rest = told.approach.from_rest
        left = flown - transit.trajectory.duration + sooner_s
        time = rest.trajectory.time * (left / rest.trajectory.duration)
        approach = replace(told.approach)
        vars(approach)["from_rest"] = replace(rest, trajectory=replace(rest.trajectory, time=time))
        found = blended(task, transit, None, approach)
        assert (found is not None) is is_blended


def test_at_few_rows_a_second_approaches_in_motion_are_straight_too(robot: Robot, plans: Any) -> None:
    _, _, told = plans["dense-canopy"]
    pick = told.approach
    slow = replace(pick, context=replace(pick.context, options=PlanOptions(rate_hz=25.0)))
    found = [slow.non_stop(lead) for lead in LEADS]
    assert any(part is None for part in found)  # off their line by more, between rows
    for part in found:
        assert part is None or straightness(robot, pick, part) <= 1e-4


def straightness(robot: Robot, pick: Approach, motion: Trajectory) -> float:
    tip = robot.tool_positions(pick.grasp.goal)
    line = robot.tool_positions(pick.grasp.standoff) - tip
    line /= np.linalg.norm(line)
    tool = robot.tool_positions(motion.positions(np.linspace(0.0, motion.duration, 2001))) - tip
    return float(np.linalg.norm(tool - (tool @ line)[:, None] * line, axis=1).max())
