"""Properties of every splice: unchanged up to the seam, continuous there."""

from __future__ import annotations

import numpy as np

from hplan.online.splice import SplicedResult
from hplan.planning.result import PlanResult

FIELDS = ("position", "velocity", "acceleration")


def assert_goes_on(before: PlanResult, result: SplicedResult) -> None:
    """Check equal samples up to the seam, and continuous velocity and acceleration there."""
    ran_before, motion = before.trajectory, result.trajectory
    first = int(np.searchsorted(ran_before.time, result.begins_s - before.begins_s - 1e-9))
    seam = int(np.searchsorted(motion.time, result.seam_s - 1e-9))
    for field in FIELDS:
        kept, ran = getattr(motion, field)[: seam + 1], getattr(ran_before, field)[first : first + seam + 1]
        np.testing.assert_array_equal(kept, ran)
    if 0 < seam < motion.samples - 1:
        bezier, duration = motion.segments
        bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
        speed = 3.0 * np.diff(bezier, axis=1) / duration[:, None, None]
        np.testing.assert_allclose(speed[seam, 0], speed[seam - 1, 2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(bent[seam, 0], bent[seam - 1, 1], rtol=0, atol=1e-6)
