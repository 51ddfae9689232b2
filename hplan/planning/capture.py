"""How likely it is that a fruit which is not where it was seen is within the gripper's capture range.

The gripper takes a fruit whose middle is off by no more than a length along where the tool points at the grasp, which
is along a straight approach, and no more than another across it. The fruit's error is normal, with the covariance that
the scene gives, that of all places together in it. What is counted is a share of 4,096 draws that are spread evenly,
the same for all approaches: good to about 0.2 %, so that approaches which differ by less count as equally good. Errors
of the arm are not in it.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray

#: Draws, and by how much less than the best an approach is as good.
_DRAWS, SAME = 4096, 0.005


def caught(approaches: FloatArray, covariance: FloatArray, capture_m: tuple[float, float]) -> FloatArray:
    """(k,) probabilities that a fruit is within capture range.

    Args:
        approaches: (k, 3) where the tool points, of any length.
        covariance: (3, 3) of the fruit's place [m^2].
        capture_m: How far its middle may be off across the approach, and along it [m].
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
