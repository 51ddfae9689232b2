"""libfranka's rules on streams of 1 kHz."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.apps.execution.franka_rules import PANDA, check_stream
from hplan.errors import InputError

Q = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])


def smooth(turn: float, duration_s: float, joint: int = 0) -> np.ndarray:
    """A quintic from rest to rest of one joint."""
    s = np.linspace(0.0, 1.0, round(1000 * duration_s) + 1)
    rows = np.tile(Q, (len(s), 1))
    rows[:, joint] += turn * (10 * s**3 - 15 * s**4 + 6 * s**5)
    return rows


def test_smooth_motion_uses_its_peaks() -> None:
    found = check_stream(smooth(0.5, 1.0))
    assert found.is_accepted
    assert found.velocity == pytest.approx(0.5 * 1.875 / PANDA.velocity[0], rel=1e-3)
    assert found.acceleration == pytest.approx(0.5 * 5.7735 / PANDA.acceleration[0], rel=1e-2)


@pytest.mark.parametrize(
    ("rows", "rule"),
    [
        (smooth(2.5, 1.0), "velocity of joint 1"),
        (smooth(0.2, 0.25, joint=1), "acceleration of joint 2"),
        (smooth(0.5, 1.0)[:600], "acceleration of joint 1"),  # ends in motion
        (smooth(0.5, 1.0)[400:], "acceleration of joint 1"),  # begins in motion
        (smooth(0.5, 1.0) + np.outer(np.arange(1001) > 500, [0, 1e-5, 0, 0, 0, 0, 0]), "jerk of joint 2"),
        (np.tile([0.0, 0.0, 0.0, -0.01, 0.0, 1.5, 0.0], (5, 1)), "position of joint 4"),
    ],
)
def test_violations_are_named(rows: np.ndarray, rule: str) -> None:
    found = check_stream(rows)
    assert not found.is_accepted
    assert any(words.startswith(rule) for words in found.violations), found.violations


def test_wrong_streams() -> None:
    with pytest.raises(InputError, match="finite"):
        check_stream([[float("nan")] * 7])
    with pytest.raises(InputError):
        check_stream([[0.0] * 6])
