"""Which arm, and how far from the row? Arms of two lengths and heights before a measured tree, from both sides.

python scripts/examples/arm_study.py [TREE.csv] [ROWS.csv]
"""

from __future__ import annotations

import sys
from pathlib import Path

import hplan
from hplan.study.definition import Arm, Yields

TREE = Path(__file__).parent / "trees" / "apple_1_tallspindle.csv"


def main(tree: str | None = None, rows: str | None = None, workers: int | None = None) -> hplan.StudyResult:
    """Run or continue a study (ROWS.csv), and print its Pareto front."""
    study = hplan.Study(
        name="spindle",
        arms=(
            "orchard_harvester",
            Arm(name="shorter", vary={"link_lengths": ((0.8, 0.7, 0.4),), "shoulder_height": (0.6, 0.9)}),
        ),
        trees=(TREE if tree is None else tree,),
        distances=(1.2, 1.7),
        turns_deg=(0.0, 180.0),
        yields=(Yields(wood=0.02, fruit=0.02),),
    )
    result = hplan.run_study(study, rows, workers=workers)
    for choice in sorted(result.choices, key=lambda choice: choice.reach_m):
        mark = "*" if choice.is_best else " "
        print(f"{mark} {choice.arm} at {choice.distance_m:g} m: {100.0 * choice.share:.0f} % of the fruit")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:3])
