"""Plan one motion to a fruit; write CSV and animated page.

python scripts/examples/plan_and_export.py [FOLDER]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import hplan
from hplan.apps.view.page import write_page
from hplan.apps.view.playback import Playback


def main(folder: str | None = None) -> hplan.PlanResult:
    """Plan the shipped trellis scene and export the motion.

    By default into a temporary folder.
    """
    out = Path(tempfile.mkdtemp(prefix="hplan-") if folder is None else folder)
    out.mkdir(parents=True, exist_ok=True)
    robot, scene = hplan.load_robot(), hplan.load_scene("trellis")
    result = hplan.plan(robot, scene)
    hplan.write_csv(result.trajectory, out / "trajectory.csv")
    playback = Playback.from_result(result)
    write_page(robot, scene, playback, out / "scene.html")
    for phase in result.phases:
        print(f"{phase.name:10} {phase.start_s:6.3f} to {phase.end_s:6.3f} s")
    print(f"clearance at all times: {1e3 * result.certificate.min_clearance_m:.2f} mm or more")
    print(f"written: {out}")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
