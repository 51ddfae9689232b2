"""MotionBenchMaker's problems for the Panda: what is solved, in which time, and whether coal finds it clear every 1 ms.

Where a peer is asked for, the same problems are solved by OMPL's RRTConnect, its paths simplified and timed by toppra
(`studies.benchmark.peer_motions`), and these motions are looked at in the same manner.

The problems are read as VAMP distributes them, one JSON list for each set. The robot is example-robot-data's Panda. Its
fingers stand where the problems have them, which is farther apart than its URDF lets them go, and some goals have joint
4 up to 0.07 rad beyond it: both limits are widened.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from studies.benchmark.measure import median
from studies.benchmark.motions import TimedMotion
from studies.benchmark.outside_check import OutsideCheck
from studies.benchmark.peer_motions import PeerMotion, peer_motion

from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Cylinder

SETS = ("bookshelf_small", "bookshelf_tall", "bookshelf_thin", "box", "cage", "table_pick", "table_under_pick")

#: Where the fingers stand [m], and limits of the URDF that give way.
FINGERS = 0.065
WIDENED = (('lower="0.0" upper="0.04"', 'lower="0.0" upper="0.08"'), ('upper="-0.0698"', 'upper="0.0873"'))


@dataclass(frozen=True)
class Solved:
    """One problem.

    Attributes:
        set_name: Its set.
        number: Its number there.
        origin: Where the motion's path comes from, or the kind of refusal.
        seconds: Time from the scene to the certified motion, or to the refusal [s].
        duration_s: Duration of the motion; None without one [s].
        verified: Whether the motion is certified.
        contacts: Configurations at which coal finds an obstacle touched, and the robot itself.
        peer: The motion of RRTConnect and toppra; None where it was not asked for.
    """

    set_name: str
    number: int
    origin: str
    seconds: float
    duration_s: float | None
    verified: bool
    contacts: tuple[int, int]
    peer: PeerMotion | None = None

    @property
    def row(self) -> dict[str, Any]:
        """What is kept of it."""
        return asdict(self)


def panda(urdf: Path, limits: Path, package_dirs: tuple[Path, ...]) -> Robot:
    """The Panda of a URDF with the limits widened and the fingers held.

    Args:
        urdf: `panda.urdf` of example-robot-data.
        limits: Its limits file.
        package_dirs: Folders of its meshes.
    """
    text = urdf.read_text(encoding="utf-8")
    for before, after in WIDENED:
        text = text.replace(before, after)
    hold = {"panda_finger_joint1": FINGERS}
    return load_robot(text, limits=limits, tool_frame="panda_hand", hold=hold, package_dirs=package_dirs)


def problems(folder: Path, set_name: str) -> list[dict[str, Any]]:
    """The problems of a set."""
    found: list[dict[str, Any]] = json.loads((folder / f"panda_{set_name}.json").read_text(encoding="utf-8"))
    return found


def scene_of(robot: Robot, problem: dict[str, Any], name: str) -> Scene:
    """A problem as a scene; obstacles of one name are numbered."""
    ends = {key: {"joints_rad": tuple(problem[key][joint] for joint in robot.joint_names)} for key in ("start", "goal")}
    obstacles: list[Box | Cylinder] = []
    for number, part in enumerate(problem["obstacles"]):
        x, y, z, w = part["quaternion_xyzw"]
        turn = pin.rpy.matrixToRpy(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())
        keys = {
            "name": f"{part['name']} {number}",
            "center": tuple(part["position"]),
            "rpy_deg": tuple(np.degrees(turn).tolist()),
        }
        if part["kind"] == "box":
            obstacles.append(Box(size=tuple(part["size"]), **keys))
        else:
            obstacles.append(Cylinder(length=part["length"], radius=part["radius"], **keys))
    return Scene.model_validate({"format": "hplan-scene/1", "name": name, "obstacles": tuple(obstacles), **ends})


def outside_check(robot: Robot, problem: dict[str, Any]) -> OutsideCheck:
    """The robot among the obstacles of a problem, as its file has them."""
    obstacles = []
    for part in problem["obstacles"]:
        x, y, z, w = part["quaternion_xyzw"]
        place = pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(part["position"]))
        box = part["kind"] == "box"
        obstacles.append((coal.Box(*part["size"]) if box else coal.Cylinder(part["radius"], part["length"]), place))
    return OutsideCheck(robot, obstacles)


def solved(
    robot: Robot, folder: Path, options: PlanOptions, *, every: int = 1, cpu: bool = False, peer: bool = False
) -> Iterator[Solved]:
    """Each problem planned, or every so many of each set, and looked at from outside; kernels are loaded before.

    Args:
        robot: The Panda.
        folder: Where the sets are.
        options: How to plan.
        every: 1 for all problems, 2 for every other one of each set, and so on.
        cpu: True for CPU time, on a machine that others use.
        peer: True for the motion of RRTConnect and toppra too; OMPL is seeded before.
    """
    now = time.process_time if cpu else time.perf_counter
    for set_name in SETS:
        with suppress(HplanError):
            plan(robot, scene_of(robot, problems(folder, set_name)[-1], set_name), options)
    for set_name in SETS:
        for problem in problems(folder, set_name)[::every]:
            scene, number = scene_of(robot, problem, f"{set_name} {problem['number']}"), int(problem["number"])
            check, began, found = outside_check(robot, problem), now(), None
            try:
                found = plan(robot, scene, options)
                origin: str = found.motion.origin
            except HplanError as error:
                origin = type(error).__name__
            seconds = now() - began
            theirs = peer_motion(robot, scene, check) if peer else None
            if found is None:
                yield Solved(set_name, number, origin, seconds, None, False, (0, 0), theirs)
                continue
            motion = TimedMotion(found.trajectory.duration, found.trajectory.positions)
            touched, verified = check.contacts(motion), found.certificate.verified
            yield Solved(set_name, number, origin, seconds, motion.duration, verified, touched, theirs)


def table(rows: list[Solved]) -> list[str]:
    """Lines: for each set, and for all, how many are solved, times [ms] and contacts."""
    lines = [
        "| set | solved and certified | median ms | 95 % ms | max ms | median duration s | contacts | own contacts |"
    ]
    lines.append("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in (*dict.fromkeys(row.set_name for row in rows), "all"):
        some = [row for row in rows if name in (row.set_name, "all")]
        times = 1e3 * np.array([row.seconds for row in some])
        durations = [row.duration_s for row in some if row.duration_s is not None]
        touched = np.array([row.contacts for row in some]).sum(axis=0)
        lines.append(
            f"| {name} | {sum(row.verified for row in some)} of {len(some)} | {np.median(times):.0f} "
            f"| {np.quantile(times, 0.95):.0f} | {times.max():.0f} | {np.median(durations or [np.nan]):.2f} "
            f"| {touched[0]} | {touched[1]} |"
        )
    return lines


def peer_table(rows: list[Solved]) -> list[str]:
    """Lines: for each set, and for all, what RRTConnect and toppra made of it, and the ratios of durations."""
    heads = (
        *("problems", "paths", "path and timing: median ms", "95 % ms", "motions in contact", "with an obstacle"),
        *("with the robot", "hplan's duration / theirs: median", "95 %", "max", "of those clear: median"),
    )
    lines = [f"| set | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
    for name in (*dict.fromkeys(row.set_name for row in rows), "all"):
        some = [(row, row.peer) for row in rows if name in (row.set_name, "all") and row.peer is not None]
        timed = [peer for _, peer in some if peer.duration_s is not None]
        ms = [1e3 * (peer.path_s + peer.timing_s) for _, peer in some]
        both = [
            (row.duration_s / peer.duration_s, any(peer.contacts))
            for row, peer in some
            if row.duration_s is not None and peer.duration_s is not None
        ]
        ratios = [ratio for ratio, _ in both] or [np.nan]
        cells = (
            *(len(some), len(timed), f"{median(ms):.0f}", f"{np.quantile(ms or [np.nan], 0.95):.0f}"),
            *(sum(any(peer.contacts) for peer in timed), sum(peer.contacts[0] > 0 for peer in timed)),
            *(sum(peer.contacts[1] > 0 for peer in timed), f"{np.median(ratios):.2f}"),
            *(f"{np.quantile(ratios, 0.95):.2f}", f"{max(ratios):.2f}"),
            f"{median([ratio for ratio, touches in both if not touches]):.2f}",
        )
        lines.append(f"| {name} | {' | '.join(map(str, cells))} |")
    return lines
