"""Moving obstacles of a collision checker: their poses in compiled code and in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.collision.coal_moving_solids import MovingSolids
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Movement, Track


def random_track(rng: np.random.Generator, count: int, *, turns: bool) -> Track:
    """A track with random times, shifts and orientations."""
    turning = {"rpy_deg": rng.uniform(-40.0, 40.0, (count, 3)), "about": rng.normal(size=3)} if turns else {}
    return Track(times_s=rng.uniform(0.1, 1.0, count).cumsum(), shifts_m=rng.normal(size=(count, 3)), **turning)


@pytest.mark.parametrize("base_moves", [False, True])
def test_places_are_those_of_the_movements(base_moves):
    rng = np.random.default_rng(1)
    base = random_track(rng, 4, turns=True) if base_moves else None
    balls = [Sphere(name=str(number), center=rng.normal(size=3), radius=0.1) for number in range(7)]
    tracks = [random_track(rng, 2 + number, turns=number % 2 == 0) for number in range(6)]
    movements = [*(Movement.relative_to(track, base) for track in tracks), None]
    moving = MovingSolids.combine([ball.solids[0] for ball in balls], movements)
    times = np.concatenate([rng.uniform(-1.0, 6.0, 200), *(track.times_s for track in tracks)])
    for time in times.tolist():
        places = moving.places(time)
        assert [number for number, _ in places] == list(range(6))
        for number, place in places:
            rotation, shift = movements[number].displacement_at(np.array([time]))
            at = rotation[0] @ balls[number].center + shift[0]
            np.testing.assert_allclose(place.translation, at, rtol=0, atol=1e-14)
            np.testing.assert_allclose(place.rotation, rotation[0], rtol=0, atol=1e-14)
