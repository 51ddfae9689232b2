"""Limbs and fruit that move on a page: their recorded motions, objects and animation."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from hplan.apps.view import three_js as three
from hplan.apps.view.commands import ROOT, clip, rotation_track, set_object, set_transform, translation_track
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray, IntArray, Record

#: Keyframes are left out where the position between two others differs by less than this [m].
_TOLERANCE_M = 3e-4

#: Distance at which a rotation counts as a displacement, when keyframes are left out [m].
_LEVER_M = 0.1


@dataclass(frozen=True, eq=False)
class BodyMotion(Record):
    """Motion of a rigid body of capsules.

    Attributes:
        names: Limb or fruit that each capsule belongs to.
        start: (m, 3) first ends of the capsules, relative to the body [m].
        end: (m, 3) last ends [m]; equal to the first ones for balls.
        radius: (m,) radii [m].
        position: (k, 3) positions over time [m]; (1, 3) for a body at rest.
        turn: (k, 4) quaternions x, y, z, w over time; (1, 4) for a body at rest.
    """

    names: tuple[str, ...]
    start: FloatArray
    end: FloatArray
    radius: FloatArray
    position: FloatArray
    turn: FloatArray

    @property
    def moves(self) -> bool:
        """True unless the body is at rest."""
        return len(self.position) > 1

    def only(self, names: Collection[str]) -> BodyMotion:
        """Return the body with the capsules of some limbs only."""
        kept = [row for row, name in enumerate(self.names) if name in names]
        return replace(
            self, names=tuple(self.names[row] for row in kept), start=self.start[kept], end=self.end[kept],
            radius=self.radius[kept],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class BodyMotions(Record):
    """Recorded motions of limbs and fruit.

    Attributes:
        time: (k,) times of the poses [s].
        limbs: Bodies of the limbs that moved, with all of their capsules.
        fruits: Fruit that moved.
    """

    time: FloatArray
    limbs: tuple[BodyMotion, ...]
    fruits: tuple[BodyMotion, ...]

    @property
    def limb_names(self) -> frozenset[str]:
        """Names of the limbs that moved."""
        return frozenset(name for body in self.limbs for name in body.names)


def moving_limbs(motions: BodyMotions, surface: Json) -> list[Json]:
    """Commands that draw the limbs that move, at rest.

    Args:
        motions: The motions.
        surface: Material of the limbs.
    """
    commands = []
    for number, motion in enumerate(motions.limbs):
        body, path = Body(), _limb_path(number)
        three.add_capsules(body, motion.start, motion.end, motion.radius, surface, name="limb")
        commands += [
            set_object(path, body),
            set_transform(path, three.transform(_rotation(motion.turn[0]), motion.position[0])),
        ]
    return commands


def limb_clips(motions: BodyMotions, duration: float, end: float) -> list[Json]:
    """Animation of the limbs.

    Args:
        motions: The motions.
        duration: Duration of the arm's motion, from which on limbs are at rest [s].
        end: End of the animation [s].
    """
    clips = []
    for number, motion in enumerate(motions.limbs):
        if motion.moves:
            times, rows = _keyframes(motions.time, motion, duration)
            last = np.append(rows, rows[-1])
            tracks = (
                rotation_track([*times, end], motion.turn[last]),
                translation_track([*times, end], motion.position[last]),
            )
            clips.append(clip(_limb_path(number), *tracks))
    return clips


def fruit_tracks(motions: BodyMotions, duration: float, end: float) -> dict[str, Json]:
    """Translation track of each fruit that moves, by name (`limb_clips`)."""
    found = {}
    for motion in motions.fruits:
        times, rows = _keyframes(motions.time, motion, duration)
        found[motion.names[0]] = translation_track([*times, end], motion.position[np.append(rows, rows[-1])])
    return found


def _limb_path(number: int) -> str:
    return f"{ROOT}/limbs/{number}"


def _rotation(turn: FloatArray) -> FloatArray:
    """(3, 3) rotation of a unit quaternion x, y, z, w."""
    x, y, z, w = turn.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _keyframes(time: FloatArray, motion: BodyMotion, duration: float) -> tuple[FloatArray, IntArray]:
    """Times up to the duration, and rows of the poses, between which linear interpolation is close."""
    last = max(int(np.searchsorted(time, duration, side="right")) - 1, 0)
    values = np.column_stack([motion.position, 2.0 * _LEVER_M * motion.turn])[: last + 1]
    kept, spans = {0, last}, [(0, last)]
    while spans:  # Ramer, Douglas and Peucker, over time
        first, final = spans.pop()
        if final - first < 2:
            continue
        share = ((time[first : final + 1] - time[first]) / (time[final] - time[first]))[:, None]
        error = np.linalg.norm(
            values[first : final + 1] - (1.0 - share) * values[first] - share * values[final], axis=1
        )
        worst = first + int(error.argmax())
        if error.max() > _TOLERANCE_M:
            kept.add(worst)
            spans += [(first, worst), (worst, final)]
    rows = np.array(sorted(kept), dtype=np.int64)
    return np.minimum(time[rows], duration), rows
