"""Where to stop along a row of two measured trees, how much is picked from there, and how long does it take?

python scripts/examples/pick_row.py [TREE.csv] [STEP]
"""

from __future__ import annotations

import sys
from pathlib import Path

import hplan
from hplan.scene.orchard import MeasuredOptions, measured_orchard

TREE = Path(__file__).parent / "trees" / "apple_1_tallspindle.csv"


def main(tree: str | None = None, step: str | float = 0.4) -> hplan.RowResult:
    """Plan the row from both sides and print a grower's numbers."""
    files = [TREE if tree is None else tree] * 2
    trees = MeasuredOptions(distance=1.2, spacing=1.0, wood_yields=0.02, fruit_yields=0.02)
    scene = measured_orchard(files, trees)
    row = hplan.RowOptions(distance=1.2, step=float(step))
    result = hplan.plan_row(hplan.load_robot("orchard_harvester"), scene, hplan.PlanOptions(effort="quick"), row=row)
    for number, stop in enumerate(result.stops, start=1):
        side, along = stop.place.side, stop.place.along
        print(f"stop {number}: side {side}, {along:+.1f} m along the row, {len(stop.tour.order)} fruits, certified")
    report = result.report
    print(f"{len(result.picked)} of {report['fruits']} fruits; {len(result.reachable)} can be picked from any stop")
    print(f"{report['motion_s_per_fruit']:.2f} s of motion for each, {report['total_s_per_fruit']:.2f} s in all")
    print(f"{report['fruit_per_hour']:.0f} fruits an hour")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:3])
