"""Probability that an uncertain fruit is within the gripper's capture range.

The gripper takes a fruit whose center is off by at most one length along the tool axis at the grasp (the direction of a
straight approach) and by at most another length across it. The position error is normal with the covariance of the
scene: the fruit's own and the shared one. The probability is the fraction of 4,096 evenly distributed draws, the same
for all approaches. It is accurate to about 0.2 %, so approaches that differ by less count as equal. Errors of the arm
are not included.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray

#: Number of draws, and the maximum difference in probability from the best approach to count as equally good.
_DRAWS, SAME = 4096, 0.005


def caught(approaches: FloatArray, covariance: FloatArray, capture_m: tuple[float, float]) -> FloatArray:
    """(k,) probabilities that a fruit is within capture range.

    Args:
        approaches: (k, 3) directions of the tool, of any length.
        covariance: (3, 3) covariance of the fruit's position [m^2].
        capture_m: Maximum offset of its center across the approach, and along it [m].
    """
    from scipy.special import ndtri

    # Multiples of the inverse powers of the root of x^4 = x + 1, modulo 1, fill a cube evenly.
    root = 1.2207440846057596
    even = (0.5 + np.arange(1, _DRAWS + 1)[:, None] * root ** -np.arange(1.0, 4.0)) % 1.0
    values, vectors = np.linalg.eigh(covariance)
    errors = (ndtri(even) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    ahead = approaches / np.linalg.norm(approaches, axis=1, keepdims=True)
    along = errors @ ahead.T
    across = np.maximum((errors**2).sum(axis=1)[:, None] - along**2, 0.0)
    within: FloatArray = ((np.abs(along) <= capture_m[1]) & (across <= capture_m[0] ** 2)).mean(axis=0)
    return within
