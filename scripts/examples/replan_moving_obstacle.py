"""Replan repeatedly while an obstacle moves, next to a controller.

python scripts/examples/replan_moving_obstacle.py
"""

from __future__ import annotations

import time

import numpy as np

import hplan
from hplan.scene import Sphere


def main(steps: int = 8) -> list[hplan.PlanResult]:
    """Move a ball through the arm's path; the motion after each step."""
    planner = hplan.Planner(hplan.load_robot(), hplan.load_scene("trellis"))
    planner.plan()
    planner.add(Sphere(name="ball", center=(0.8, -0.6, 1.4), radius=0.08))
    motions = []
    for y in np.linspace(-0.6, 0.6, steps).tolist():
        planner.move("ball", center=(0.8, y, 1.4))
        began = time.perf_counter()
        result = planner.replan()
        took_ms = 1e3 * (time.perf_counter() - began)
        motions.append(result)
        print(f"ball at y = {y:+.2f} m: {result.trajectory.duration:.3f} s of motion, planned in {took_ms:.0f} ms")
    return motions


if __name__ == "__main__":
    main()
