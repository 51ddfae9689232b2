"""`warm_up`: afterwards nothing is compiled or loaded any more, whatever a controller calls, for any arm."""

from __future__ import annotations

import gc
import subprocess
import sys
import warnings

import pytest
from any_arms import ARMS, loaded_arm

import hplan
from hplan.online.warm_up import NotReadyWarning

COUNTED = """
import sys
import numpy as np
import hplan
from hplan.base import kernels
from hplan.scene import Box, Goal, Scene, Start

found, load = [], kernels._DiskCache.load_overload

def counted(self, types, context):
    found.append(self._compiled.py_func.__qualname__)  # whether it is loaded, or compiled after this
    return load(self, types, context)

kernels._DiskCache.load_overload = counted
"""

HARVESTER = """
robot, scene = hplan.load_robot(), hplan.load_scene()
hplan.warm_up(robot)
print(len(found) > 100)
found.clear()
for name in ("table-1", "trellis", "dense-canopy"):
    motion = hplan.plan(robot, hplan.load_scene(name))
planner = hplan.Planner(robot, scene, hplan.PlanOptions(tracking_error=1e-3))
motion = planner.plan(begins_s=0.0)
points = np.random.default_rng(1).normal((0.9, 0.5, 1.4), 0.03, (5000, 3))
seen = {"joints": scene.start.configuration, "radius": 0.005, "keep_s": 1.0}
for time_s in (0.0, 0.05):
    planner.set_cloud("seen", points, time_s=time_s, **seen)
motion = planner.replan(at=0.3, now=0.1)
planner.stop_at(0.5, now=0.4)
hplan.certify(robot, scene, motion.trajectory)
print(found)
"""

PANDA = """
robot = hplan.load_robot("panda", hold={"panda_finger_joint1": 0.04})
hplan.warm_up(robot)
print(len(found) > 100)
found.clear()
boards = (Box(name="lower", center=(0.7, 0.0, 0.05), size=(0.3, 1.2, 0.02)),
          Box(name="upper", center=(0.75, 0.0, 0.62), size=(0.3, 1.2, 0.02)))
start, goal = (0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.785), (0.5, 0.55, 0.0, -1.75, 0.0, 2.3, 0.785)
scene = Scene(name="shelf", start=Start(joints_rad=start), goal=Goal(joints_rad=goal), obstacles=boards)
motion = hplan.plan(robot, scene)
motion.stop_at(0.3)
print(found)
"""


@pytest.mark.parametrize("program", [HARVESTER, PANDA], ids=["harvester", "panda"])
def test_nothing_is_compiled_or_loaded_afterwards(program: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    if program == PANDA:
        loaded_arm("panda", tmp_path_factory)
    command = [sys.executable, "-c", COUNTED + program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["True", "[]"]


@pytest.mark.parametrize("name", ARMS)
def test_any_arm_has_a_motion_to_make_ready_with(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """But for one whose motors cannot hold it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", NotReadyWarning)
        hplan.warm_up(loaded_arm(name, tmp_path_factory))
    gc.unfreeze()
    assert [str(each.message).split("'")[1] for each in said] == ["lift"] * (name == "lift")
