"""A proof of infeasibility is the error, with a deadline too, and ends the search."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hplan
from hplan.base.deadline import TimeIsUpError, current
from hplan.errors import NoPathError
from hplan.planar import no_path_proof
from hplan.planning import path_finder
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere


@pytest.fixture(scope="module")
def closed() -> Scene:
    """Balls that close the arm's plane, its base locked: the grid shows within 11 ms that no path exists."""
    random = np.random.default_rng(2)
    centers = [random.uniform((0.6, -0.8, 0.8), (1.6, 0.8, 2.2)).tolist() for _ in range(6)]
    return hplan.load_scene().with_obstacles(
        [Sphere(name=f"b{number}", center=tuple(center), radius=0.08) for number, center in enumerate(centers)]
    )


def no_search(*_: object, **__: object) -> Any:
    raise AssertionError("a search after a proof")


OPTIONS = {
    "none": PlanOptions(),
    "quick": PlanOptions(effort="quick"),
    "best": PlanOptions(effort="best"),
    "deadline": PlanOptions(deadline_s=1e4),
    "deadline, best": PlanOptions(deadline_s=1e4, effort="best"),
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_proof_of_no_path_comes_before_any_tree(
    options: PlanOptions, robot: Robot, closed: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(path_finder, "tree_path", no_search)
    with pytest.raises(NoPathError) as caught:
        hplan.plan(robot, closed, options)
    assert caught.value.reached_cells == 40677
    assert (caught.value.blockers[0]["obstacle"], caught.value.blockers[0]["link"]) == ("b3", "forearm")


def time_is_up(*_: object) -> Any:
    limit = current()
    assert limit is not None
    limit.keep(2e4)
    raise TimeIsUpError


def test_deadline_while_the_blockers_are_found_keeps_the_proof(
    robot: Robot, closed: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(no_path_proof, "blockers", time_is_up)
    with pytest.raises(NoPathError, match="40677 of 753571 nodes") as caught:
        hplan.plan(robot, closed, PlanOptions(deadline_s=1e4))
    assert caught.value.blockers == ()
