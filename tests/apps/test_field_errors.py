"""Errors of base, camera and masses that a planner does not know."""

from __future__ import annotations

import numpy as np

from hplan.apps.execution.field_errors import FieldErrors
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule


def test_a_frame_leaves_a_part_of_the_error_of_the_base() -> None:
    start, goal = Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), Goal(joints_deg=(0.0, 90.0, 90.0, 90.0))
    random = np.random.default_rng(2)
    places = random.uniform((1.0, -0.6, 0.5), (1.8, 0.6, 2.0), (40, 3))
    fruits = tuple(
        Fruit(name=f"fruit {n}", center=tuple(place), radius=0.03) for n, place in enumerate(places.tolist())
    )
    branch = Capsule(name="branch", start=(1.0, -0.8, 1.0), end=(2.0, 0.8, 1.5), radius=0.01)
    scene = Scene(name="tree", start=start, goal=goal, obstacles=(branch,), fruits=fruits)
    off, standard = (np.zeros((2, 20)) for _ in range(2))
    for looks in (0, 1):
        for number in range(20):
            (piece,) = FieldErrors(looks=looks).seen_scene(scene, random).obstacles
            assert isinstance(piece, Capsule)
            off[looks, number] = np.linalg.norm(np.array(piece.core) - np.array(branch.core), axis=1).max()
            standard[looks, number] = piece.sigma
    assert off[1].mean() < 0.25 * off[0].mean()
    assert (off[0] <= 3.0 * standard[0] + 1e-9).all()
    # Of the three coordinates of a look, each has the standard deviation that is stated.
    assert 0.7 < np.sqrt((off[1] ** 2).mean() / 3.0) / standard[1].mean() < 1.5
