"""Attempts on grids: which are tried for which goals, in what order, and what is made of what each of them gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planned import task
from test_grid_route import posed

import hplan.planning.find_motion
import hplan.planning.sampled_motion
from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.planning.certified_motion import PlannedMotion
from hplan.planning.find_motion import GROWTH, SLUGGISH, YAW_GRID_ATTEMPTS, find_motion, least_duration
from hplan.planning.refusals import EnclosedError
from hplan.planning.task import GridAttempt, PlanningTask
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box

START = (0.0, 30.0, 20.0, 20.0)
STEP = 1.0

#: What a grid gives for a goal, by its number: a motion of so many seconds, or an error.
Outcome = float | HplanError
Try = tuple[int, float, float, float, bool]

#: A plate that the straight motion to any of the goals passes through.
WALL = [Box(name="wall", center=(1.0, 0.3, 1.0), size=(1.4, 0.02, 2.0))]


def goals(robot: Robot, *yaws: float) -> list[PlanningTask]:
    """Tasks to goals behind the wall."""
    scenes = [task(START, (yaw, 30.0, 20.0, 20.0), WALL) for yaw in yaws]
    return [posed(robot, scene, PlanOptions(step_deg=STEP)) for scene in scenes]


@pytest.fixture
def ladder(monkeypatch: pytest.MonkeyPatch, robot: Robot) -> Callable[..., list[Try]]:
    """Grids that give what they are told to, however large; no roadmaps, no trees. Returns what has been tried."""
    monkeypatch.setattr(hplan.planning.find_motion, "SAMPLED", 0)
    monkeypatch.setattr(hplan.planning.sampled_motion, "promising_paths", lambda *_: [])
    monkeypatch.setattr(hplan.planning.sampled_motion, "tree_path", lambda *_, **__: (None, 0))
    for most in ("MOST_CELLS", "MOST_CELLS_IN_ALL"):
        monkeypatch.setattr(hplan.planning.find_motion, most, 1e12)

    def prepare(tasks: list[PlanningTask], outcome: Callable[[Try], Outcome]) -> list[Try]:
        tried: list[Try] = []
        straight = find_motion([posed(robot, task(START, (60.0, 30.0, 20.0, 20.0)))])[1]

        def on_grid(one: PlanningTask, attempt: GridAttempt) -> PlannedMotion:
            number = next(i for i, each in enumerate(tasks) if each is one)
            tried.append((number, *values(attempt)))
            given = outcome(tried[-1])
            if isinstance(given, HplanError):
                raise given
            time = np.linspace(0.0, given, straight.trajectory.samples)
            return replace(straight, task=one, trajectory=replace(straight.trajectory, time=time))

        monkeypatch.setattr(hplan.planning.find_motion, "_on_grid", on_grid)
        return tried

    return prepare


class Explained:
    """A region that says so when it is asked what bounds it."""

    what = "the start is enclosed"

    def explained(self) -> NoPathError:
        return NoPathError("explained", reached_cells=5)


def enclosed(*, open_ended: bool) -> EnclosedError:
    return EnclosedError(Explained(), 5, open_ended=open_ended)


def values(attempt: GridAttempt) -> tuple[float, float, float, bool]:
    """Step and yaw range [deg], growth [m], whether layers are thick."""
    return STEP * attempt.step_factor, attempt.yaw_range_deg, attempt.growth_m, attempt.thick


def grid_attempts(number: int, steps: tuple[float, ...] = (2.0, 1.0)) -> list[Try]:
    """All grids of these steps for a goal."""
    return [(number, *values(attempt)) for attempt in YAW_GRID_ATTEMPTS if attempt.step_factor in steps]


def test_grids_go_from_coarse_and_near_to_fine_and_wide() -> None:
    """Of either step grids for all yaws, thin ones; of the fine one also thick ones and grown obstacles."""
    steps = [attempt.step_factor for attempt in YAW_GRID_ATTEMPTS]
    assert steps == sorted(steps, reverse=True)
    for step in (2.0, 1.0):
        widths = [
            attempt.yaw_range_deg
            for attempt in YAW_GRID_ATTEMPTS
            if attempt.step_factor == step and not attempt.growth_m and not attempt.thick
        ]
        assert widths == sorted(widths)
        assert widths[-1] == 360.0
    fine = [values(attempt)[1:] for attempt in YAW_GRID_ATTEMPTS if attempt.step_factor == 1.0]
    assert fine == [
        (45.0, 0.0, False), (45.0, 0.0, True), (360.0, 0.0, False), (45.0, 5e-3, True), (45.0, 0.02, False),
    ]  # fmt: skip


def test_every_grid_is_tried_before_it_is_given_up(robot: Robot, ladder: Any) -> None:
    tasks = goals(robot, 60.0)
    tried = ladder(tasks, lambda _: CertificationError(f"number {len(tried)}"))
    with pytest.raises(CertificationError, match=r"number 1$"):  # the first is what is told
        find_motion(tasks)
    assert tried == grid_attempts(0)


@pytest.mark.parametrize("number", range(len(YAW_GRID_ATTEMPTS)))
def test_the_first_grid_that_gives_a_quick_motion_ends_it(robot: Robot, ladder: Any, number: int) -> None:
    tasks = goals(robot, 60.0)
    tried = ladder(tasks, lambda _: 3.0 if len(tried) == number + 1 else TimingError("none", cause="test"))
    assert find_motion(tasks)[1].trajectory.duration == 3.0
    assert tried == grid_attempts(0)[: number + 1]


def test_goals_in_one_pocket_are_tried_once_on_coarse_grids_and_each_on_fine_ones(robot: Robot, ladder: Any) -> None:
    """Goals nearer than two steps of a coarse grid fail together there; no fine grid leaves one out."""
    tasks = goals(robot, 60.0, 60.0 + 3.0 * STEP, 60.0 + 8.0 * STEP)
    tried = ladder(tasks, lambda _: CertificationError("none"))
    with pytest.raises(CertificationError):
        find_motion(tasks)
    for number, coarse in ((0, True), (1, False), (2, True)):
        mine = [each for each in tried if each[0] == number]
        assert mine == grid_attempts(number, (2.0, 1.0) if coarse else (1.0,))


def test_a_pocket_that_opens_on_a_fine_grid(robot: Robot, ladder: Any) -> None:
    tasks = goals(robot, 60.0, 60.5)
    ladder(tasks, lambda one: 3.0 if one[:2] == (1, STEP) else CertificationError("none"))
    assert find_motion(tasks)[0] == 1


def test_sluggish_motions_are_taken_where_there_is_no_other(robot: Robot, ladder: Any) -> None:
    """The quickest of them, after everything was tried."""
    tasks = goals(robot, 60.0)
    bound = SLUGGISH * least_duration(tasks[0])
    seconds = {3: bound + 2.0, 5: bound + 1.0, 8: bound + 3.0}
    tried = ladder(tasks, lambda _: seconds.get(len(tried), CertificationError("none")))
    number, motion = find_motion(tasks)
    assert (number, motion.trajectory.duration) == (0, bound + 1.0)
    assert len(tried) == len(YAW_GRID_ATTEMPTS)


def test_a_quick_motion_beats_a_sluggish_one_found_before(robot: Robot, ladder: Any) -> None:
    tasks = goals(robot, 60.0)
    bound = SLUGGISH * least_duration(tasks[0])
    tried = ladder(tasks, lambda _: bound + 1.0 if len(tried) == 1 else 0.9 * bound)
    assert find_motion(tasks)[1].trajectory.duration == 0.9 * bound
    assert len(tried) == 2


def test_closed_on_the_fine_grid_is_no_path(robot: Robot, ladder: Any) -> None:
    """An end enclosed in the yaws of a grid, and not open to more of them, is not looked at again on its step."""
    tasks = goals(robot, 60.0)
    tried = ladder(tasks, lambda _: enclosed(open_ended=False))
    with pytest.raises(NoPathError, match="explained"):
        find_motion(tasks)
    assert tried == [grid_attempts(0)[0], next(one for one in grid_attempts(0) if one[1] == STEP)]


def test_open_ended_is_tried_with_more_yaws(robot: Robot, ladder: Any) -> None:
    """What is open to yaws beyond the grid is not closed, however often it is looked at."""
    tasks = goals(robot, 60.0)
    tried = ladder(tasks, lambda _: enclosed(open_ended=True))
    with pytest.raises(NotFoundError, match="no motion was found"):
        find_motion(tasks)
    # Thick grids close narrow ways, so they show nothing; of the others each wider one is tried.
    assert [one[1:3] for one in tried if not one[4] and not one[3]] == [
        (2.0, 4.0), (2.0, 45.0), (2.0, 360.0), (1.0, 45.0), (1.0, 360.0),
    ]  # fmt: skip


def test_closed_on_a_thick_grid_shows_nothing(robot: Robot, ladder: Any) -> None:
    tasks = goals(robot, 60.0)
    tried = ladder(tasks, lambda one: enclosed(open_ended=False) if one[4] or one[3] else CertificationError("thin"))
    with pytest.raises(CertificationError, match="thin"):
        find_motion(tasks)
    assert tried == grid_attempts(0)


def test_closed_for_one_goal_is_not_closed_for_another(robot: Robot, ladder: Any) -> None:
    tasks = goals(robot, 60.0, 80.0)

    def outcome(one: Try) -> Outcome:
        if one[0] == 0:
            return enclosed(open_ended=False)
        return 3.0 if one[1] == STEP else TimingError("none", cause="test")

    ladder(tasks, outcome)
    assert find_motion(tasks)[0] == 1


# With the base locked


def test_planar_ladder(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Grown obstacles first, then twice as fine; a way that is closed by growing them ends a step, but says nothing."""
    scene = task((0.0, 10.0, 10.0, 10.0), (0.0, 40.0, 10.0, 10.0), locked_joints=("base_yaw",))
    tried: list[tuple[float, float]] = []
    closed_at: dict[tuple[float, float], HplanError] = {}

    def on_grid(_: PlanningTask, attempt: GridAttempt) -> PlannedMotion:
        tried.append((STEP * attempt.step_factor, attempt.growth_m))
        raise closed_at.get(tried[-1], CertificationError(f"number {len(tried)}"))

    monkeypatch.setattr(hplan.planning.find_motion, "_on_grid", on_grid)
    monkeypatch.setattr(hplan.planning.sampled_motion, "promising_paths", lambda *_: [])
    monkeypatch.setattr(hplan.planning.sampled_motion, "tree_path", lambda *_, **__: (None, 0))
    with pytest.raises(CertificationError, match=r"number 1$"):
        find_motion([posed(robot, scene, PlanOptions(step_deg=STEP))])
    assert tried == [(step, growth) for step in (STEP, 0.5 * STEP) for growth in GROWTH]
    tried.clear()
    closed_at[STEP, GROWTH[2]] = NoPathError("closed", reached_cells=0)
    with pytest.raises(CertificationError, match=r"number 1$"):
        find_motion([posed(robot, scene, PlanOptions(step_deg=STEP))])
    assert tried == [*((STEP, growth) for growth in GROWTH[:3]), *((0.5 * STEP, growth) for growth in GROWTH)]
    tried.clear()
    closed_at[STEP, 0.0] = NoPathError("closed", reached_cells=0)
    with pytest.raises(NoPathError, match="closed"):
        find_motion([posed(robot, scene, PlanOptions(step_deg=STEP))])
    assert tried == [(STEP, 0.0)]


def test_a_grid_that_is_too_large_gets_a_larger_step(robot: Robot) -> None:
    (one,) = goals(robot, 60.0)
    widest = GridAttempt(1.0, 360.0)
    nodes = one.cells(widest)
    assert one.fitting(widest, 1.01 * nodes) == widest
    coarser = one.fitting(widest, 0.5 * nodes)
    assert coarser == replace(widest, step_factor=1.5)
    assert one.cells(coarser) <= 0.5 * nodes
    assert one.fitting(widest, 10.0) is None


@pytest.mark.parametrize(("step_deg", "largest_deg"), [(0.2, 6.4), (1.0, 8.0), (20.0, 20.0)])
def test_a_fine_step_gives_way_to_as_coarse_a_one_as_others(robot: Robot, step_deg: float, largest_deg: float) -> None:
    """However small the step asked for: up to `COARSEST_DEG`, and never a grid that is finer than what fits."""
    (one,) = (posed(robot, each.scene, PlanOptions(step_deg=step_deg)) for each in goals(robot, 60.0))
    widest = GridAttempt(1.0, 360.0)
    most = one.cells(replace(widest, step_factor=largest_deg / step_deg))
    fitting = one.fitting(widest, most)
    assert fitting is not None
    assert one.step_deg(fitting) == pytest.approx(largest_deg)
    assert one.fitting(widest, 0.9 * most) is None


def test_a_row_of_few_yaws_counts_as_a_longer_one(robot: Robot) -> None:
    """It takes whole words, and its coordinates: a grid of three yaws is no tenth of one of 30."""
    (one,) = goals(robot, 2.0)
    assert one.cells(GridAttempt(1.0)) == one.cells(GridAttempt(1.0, 10.0))
    assert one.cells(GridAttempt(1.0)) < one.cells(GridAttempt(1.0, 20.0))


@pytest.mark.parametrize("attempt", [GridAttempt(2.0, 4.0), GridAttempt(4.0, 45.0), GridAttempt(4.0, 360.0)])
def test_cells_are_those_of_the_grid(robot: Robot, attempt: GridAttempt) -> None:
    (one,) = goals(robot, 60.0)
    assert one.cells(attempt) == pytest.approx(one.occupancy(attempt).grid.size, rel=0.15)


def test_closed_on_the_finest_grid_that_fits_names_its_step(
    robot: Robot, ladder: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = goals(robot, 60.0)
    ladder(tasks, lambda one: enclosed(open_ended=one[2] < 360.0))
    monkeypatch.setattr(hplan.planning.find_motion, "MOST_CELLS", 0.5 * tasks[0].cells(GridAttempt(1.0, 360.0)))
    with pytest.raises(NoPathError, match=r"explained; the grid's step is 1.5 deg") as caught:
        find_motion(tasks)
    assert caught.value.data["step_deg"] == 1.5


def test_a_planar_grid_that_gave_way_to_a_coarser_one_names_its_step_and_is_tried_once(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = task((0.0, 10.0, 10.0, 10.0), (0.0, 40.0, 10.0, 10.0), locked_joints=("base_yaw",))
    one = posed(robot, scene, PlanOptions(step_deg=STEP))
    tried: list[GridAttempt] = []
    found: list[HplanError] = [enclosed(open_ended=False)]

    def on_grid(_: PlanningTask, attempt: GridAttempt) -> PlannedMotion:
        tried.append(attempt)
        raise found[0]

    monkeypatch.setattr(hplan.planning.find_motion, "_on_grid", on_grid)
    monkeypatch.setattr(hplan.planning.sampled_motion, "promising_paths", lambda *_: [])
    monkeypatch.setattr(hplan.planning.sampled_motion, "tree_path", lambda *_, **__: (None, 0))
    monkeypatch.setattr(hplan.planning.find_motion, "MOST_CELLS", 0.5 * one.cells(GridAttempt()))
    with pytest.raises(NoPathError, match=r"explained; the grid's step is 1.5 deg"):
        find_motion([one])
    tried.clear()
    found[0] = CertificationError("not clear")
    with pytest.raises(CertificationError, match="not clear"):
        find_motion([one])
    assert [attempt.growth_m for attempt in tried] == list(GROWTH)
    assert {attempt.step_factor for attempt in tried} == {1.5}


def test_nothing_found_and_nothing_shown(robot: Robot, ladder: Any) -> None:
    """Closed up to some yaws only, and trees found nothing: it is said what was tried."""
    tasks = goals(robot, 60.0)
    ladder(tasks, lambda _: enclosed(open_ended=True))
    with pytest.raises(NotFoundError, match=r"trees with 80000 evaluations .*; grids down to 1 deg") as caught:
        find_motion(tasks)
    assert caught.value.exit_status == 6
    assert caught.value.data["tried"][0] == "straight motion"


def test_trees_go_before_grids(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """No quick path in the roadmap: the trees' motion is taken."""
    monkeypatch.setattr(hplan.planning.sampled_motion, "quick_path", lambda *_, **__: None)
    tasks = goals(robot, 60.0)
    number, motion = find_motion(tasks)
    assert (number, motion.origin) == (0, "trees")
    assert motion.certificate.verified
