"""Moving obstacles of a collision checker: their poses in compiled code and in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.collision.coal_moving_solids import MovingSolids
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Drift, Movement, Track


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


@pytest.mark.parametrize("base_moves", [False, True])
def test_swept_balls_hold_the_obstacles(base_moves):
    rng = np.random.default_rng(2)
    base = random_track(rng, 4, turns=True) if base_moves else None
    boxes = [Box(name=str(number), center=rng.normal(size=3), size=rng.uniform(0.1, 0.5, 3)) for number in range(6)]
    tracks = [random_track(rng, 2 + number, turns=number % 2 == 0) for number in range(6)]
    drift = Drift(radius_m=0.02, speed_m_s=0.3, acceleration_m_s2=1.0)
    tracks = [
        track.copy_unchecked({"drift": drift}) if number % 3 == 0 else track for number, track in enumerate(tracks)
    ]
    movements = [Movement.relative_to(track, base) for track in tracks]
    still = Sphere(name="still", center=(0.0, 0.0, 9.0), radius=0.1)
    moving = MovingSolids.combine([still.solids[0], *(box.solids[0] for box in boxes)], [None, *movements])
    tightest = np.inf
    for _ in range(40):
        begin_s, end_s = np.sort(rng.uniform(-1.0, 5.0, 2))
        centres, radii = moving.swept_balls(begin_s, end_s)
        times = np.linspace(begin_s, end_s, 50)
        for box, movement, centre, radius in zip(boxes, movements, centres, radii, strict=True):
            rotations, shifts = movement.displacement_at(times)
            corners = np.einsum("kij,nj->kni", rotations, box.solids[0].core) + shifts[:, None]
            reached = np.linalg.norm(corners - centre, axis=2).max(axis=1) + box.solids[0].rounding
            spare = radius - (reached + movement.spread_at(times)).max()
            assert spare >= -1e-9
            tightest = min(tightest, spare)
    assert tightest < 1e-3
