"""Options of a plan: what is kept of them."""

from __future__ import annotations

import numpy as np

from hplan.planning.options import PlanOptions


def test_numbers_are_kept_as_floats() -> None:
    """Whole numbers and those of NumPy too, which the report could not be written with."""
    options = PlanOptions(step_deg=2, sigmas=np.float32(1.5), standoff=np.int64(1))  # type: ignore[arg-type]
    assert [type(value) for value in (options.step_deg, options.sigmas, options.standoff)] == [float] * 3
    assert options == PlanOptions(step_deg=2.0, sigmas=1.5, standoff=1.0)
