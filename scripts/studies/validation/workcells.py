"""Random workcells whose files are certified, each verdict compared with Pinocchio and coal alone.

Two to four arms of any kind stand next to one another, or in one another. Each has a CSV: hplan's own, one of another
program with samples at its own times, or either with something changed. Certificates are tested, not plans: arms and
motions are used again at many places. A certificate is false if arms are nearer to each other than the clearance, or
than it says, at any tick; if an arm touches an obstacle or itself; or if a file breaks a limit in its columns, or does
not end at rest.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from studies.harness import Asked, Row, Study
from studies.outside import things_of
from studies.validation.arms import DrawnArm, draw_arm, named_arm
from studies.validation.episodes import COUNTED, Tally, impatient
from studies.validation.judge import (
    TICK_S,
    Arm,
    Contact,
    Motion,
    Moves,
    contacts,
    least_between,
    read_cubics,
)
from studies.validation.worlds import World, draw_ends, draw_item, obstacle

from hplan.certificate.certificate import LIMIT_TOLERANCE, REST, certify
from hplan.errors import HplanError
from hplan.planning.cell import Cell, CellCertificate, certify_cell
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.trajectory import Trajectory, check_joints, read_csv, write_csv

#: Arms drawn for a case, motions of each, places of bases, and sets of files at the same bases.
KINDS, MOTIONS, PLACES, SETS = 3, 2, 6, 5

#: Arms of a workcell.
ARMS = (2, 4)

#: Shares of hplan's own files, of workcells with a tampered file, with bases anywhere within `ANYWHERE_M`, with
#: obstacles, and of certificates that are compared with those of the arms alone.
OWN, TAMPERED, ANYWHERE, CROWDED, COMPARED = 0.25, 0.25, 0.2, 0.2, 0.1

#: Bases are at most so far from the origin if they are anywhere [m]; clearances that arms are tried at by themselves.
ANYWHERE_M, TRIED_M = 0.8, (0.1, 0.03, 0.01, 0.0)

#: Distances beyond this are not compared; rounding of coal and of text [m]; ticks at which clearances are drawn [s].
WITHIN_M, SAME_M, COARSE_S = 0.1, 1e-6, 0.05


@dataclass(frozen=True, eq=False)
class Filed:
    """A motion of an arm in a file.

    Attributes:
        drawn: The arm.
        kind: Who made it.
        path: The file.
        motion: As hplan reads it.
        room_m: The largest of `TRIED_M` at which the arm alone is verified; negative for none [m].
    """

    drawn: DrawnArm
    kind: str
    path: Path
    motion: Trajectory
    room_m: float

    @cached_property
    def cubics(self) -> tuple[list[str], Any, Any]:
        """As the judge reads it."""
        return read_cubics(self.path)

    def at(self, clock: Any) -> Motion:
        """The motion at times, at rest after its end."""
        names, times, place = self.cubics
        return Motion(names, clock, place(np.minimum(clock, times[-1])))

    @cached_property
    def touches_itself(self) -> list[Contact]:
        """Contacts of the arm with itself."""
        return contacts(self.drawn.arm, Motion.read(self.path), ())


def judged_cells(seed: int, number: int) -> Tally:
    """Judge the certificates of a few arms with a few motions each, at many places."""
    rng, tally = np.random.default_rng([seed, number, 21]), Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arms = [each for k in range(KINDS) if (each := _filed_arm(folder / str(k), rng, tally))]
        for place in range(PLACES if arms else 0):
            files = [_any(_any(arms, rng), rng) for _ in range(int(rng.integers(ARMS[0], ARMS[1] + 1)))]
            bases = _placed(files, rng)
            for turn in range(SETS):
                if turn == SETS - 1 and turn:
                    files = [_any([f for own in arms for f in own if f.drawn is each.drawn], rng) for each in files]
                case = f"{number}.{place}.{turn}"
                try:
                    _judge(files, bases, folder / case, np.random.default_rng([seed, number, place, turn]), tally)
                except HplanError as error:
                    tally.refused[error.kind] += 1
    return tally


def _any(values: Sequence[Any], rng: np.random.Generator) -> Any:
    return values[int(rng.integers(len(values)))]


def _filed_arm(folder: Path, rng: np.random.Generator, tally: Tally) -> list[Filed]:
    """Motions of a random arm in files; none if hplan refuses the arm, or it touches itself nearly everywhere."""
    folder.mkdir()
    try:
        drawn = named_arm("harvester") if rng.random() < 0.1 else draw_arm(folder, rng)
    except HplanError as error:
        tally.refused[f"robot: {error.kind}"] += 1
        return []
    tally.arms[drawn.kind] += 1
    found = list[Filed]()
    for count in range(MOTIONS):
        for _ in range(4):  # motions that are verified alone are preferred
            ends = draw_ends(drawn, rng, 0.0)
            if ends is None:
                break
            scene = World(*ends).scene()
            own = _own(drawn.robot, scene) if rng.random() < OWN else None
            motion = _foreign(drawn.robot, *ends, rng) if own is None else own
            path = write_csv(motion, folder / f"{len(list(folder.iterdir()))}-{count}.csv")
            motion = read_csv(path)
            room_m = next((m for m in TRIED_M if _is_verified(drawn.robot, scene, motion, m)), -1.0)
            if room_m >= 0.0:
                break
        else:
            tally.unverified["alone"] += 1
        if ends is not None:
            found.append(Filed(drawn, "foreign" if own is None else "own", path, motion, room_m))
    return found


def _is_verified(robot: Robot, scene: Scene, motion: Trajectory, clearance: float) -> bool:
    return certify(robot, scene.with_(clearance=clearance), motion, check_ends=False).verified


def _placed(files: list[Filed], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Names and bases of arms: each is moved towards another along a line until a small distance is left."""
    clock = np.linspace(0.0, max(each.motion.duration for each in files), 17)
    found, known = list[dict[str, Any]](), list[tuple[Arm, Motion, pin.SE3]]()
    for k, each in enumerate(files):
        tilt = rng.uniform(-20.0, 20.0, 2) if rng.random() < 0.15 else np.zeros(2)
        rpy = (*tilt.tolist(), float(rng.uniform(-180.0, 180.0)))
        turn, bearing = pin.rpy.rpyToMatrix(*np.radians(rpy)), rng.uniform(-np.pi, np.pi)
        along = np.array([np.cos(bearing), np.sin(bearing), 0.0])
        foot = np.array([0.0, 0.0, rng.choice([0.0, rng.uniform(-0.3, 0.3)])])
        if rng.random() < ANYWHERE or not known:
            foot[:2] = rng.uniform(-ANYWHERE_M, ANYWHERE_M, 2)
        else:
            foot += _any(known, rng)[2].translation + 4.0 * along
            target = float(rng.uniform(0.0, 0.1))
            for _ in range(8):
                here = each.drawn.arm, each.at(clock), pin.SE3(turn, foot)
                gap = min(least_between([here, other], 6.0, _never)[0] for other in known)
                foot = foot - (gap - target) * along
                if gap - target < 0.005:
                    break
        known.append((each.drawn.arm, each.at(clock), pin.SE3(turn, foot)))
        name = f"arm_{k}" if k % 2 else f"arm{'_0' * (k // 2)}"
        found.append({"name": name, "position": tuple(foot.tolist()), "rpy_deg": rpy})
    return found


def _never(*_: object) -> bool:
    return False


def _judge(
    files: list[Filed], places: list[dict[str, Any]], folder: Path, rng: np.random.Generator, tally: Tally
) -> None:
    """One set of files."""
    folder.mkdir()
    cell = _drawn_cell(files, places, rng)
    if rng.random() < TAMPERED:
        k = int(rng.integers(len(files)))
        path = write_csv(_tampered(files[k].motion, rng), folder / "tampered.csv")
        if rng.random() < 0.2:
            _tamper_text(path, rng)
        motion = read_csv(path)
        check_joints(motion, files[k].drawn.robot)
        files = [*files[:k], replace(files[k], kind="tampered", path=path, motion=motion), *files[k + 1 :]]
    for each in files:
        tally.looked_in[each.kind] += 1
    # Names of joints of tilted arms have a prefix.
    motions = {
        arm.name: replace(each.motion, joint_names=arm.robot.joint_names)
        for arm, each in zip(cell.arms, files, strict=True)
    }
    about = _least(cell, files, COARSE_S, WITHIN_M)[0]
    clearance = float(rng.choice([0.0, rng.uniform(0.0, 0.1)]))
    if SAME_M < about < 0.12 and rng.random() < 0.7:
        clearance = min(about * float(rng.uniform(0.8, 1.05)), 0.1)
    if rng.random() < 0.85:  # each arm keeps the clearance from itself
        clearance = min(clearance, *(max(each.room_m, 0.0) for each in files))
    cell = Cell.of(cell.scene.with_(clearance=clearance), _robots(cell.scene, files))
    certificate = certify_cell(cell, motions, check_ends=False)
    tally.looked["verified" if certificate.verified else "not verified"] += 1
    known = {"case": folder.name, "arms": [each.drawn.kind for each in files]}
    if certificate.verified:
        tally.looked_in[
            "verified within 20 mm" if about < 0.02 else "verified within 100 mm" if about < 0.1 else "verified, far"
        ] += 1
        tally.faults += [known | fault for fault in _faults(cell, files, certificate, tally)]
    else:
        tally.unverified["between arms" if certificate.between.violations else "alone"] += 1
    if rng.random() < COMPARED:
        for arm in cell.arms:
            alone = certify(arm.robot, arm.scene, motions[arm.name], check_ends=False)
            if certificate.arms[arm.name].violations != alone.violations:
                tally.faults.append(known | {"kind": "not the certificate that the arm has alone", "arm": arm.name})


def _robots(scene: CellScene, files: list[Filed]) -> dict[str, Robot]:
    return {arm.name: each.drawn.robot for arm, each in zip(scene.robots, files, strict=True)}


def _drawn_cell(files: list[Filed], places: list[dict[str, Any]], rng: np.random.Generator) -> Cell:
    """The arms at their places, with a few obstacles and declarations."""
    q = [each.motion.position for each in files]
    items = [
        draw_item(files[0].drawn, World(q[0][0], q[0][-1]), rng, f"o{k}")
        for k in range(int(rng.integers(1, 3)) if rng.random() < CROWDED else 0)
    ]
    declared = list[Any]()
    if rng.random() < 0.15:  # links that stand still in one another are to be so
        still = [[body for body in each.drawn.arm.bodies if body.joint == 0] for each in files]
        for (i, one), (j, other) in itertools.combinations(enumerate(still), 2):
            declared += {((places[i]["name"], a.link), (places[j]["name"], b.link)) for a in one for b in other}
    ends = [(Start(joints_rad=tuple(own[0].tolist())), Goal(joints_rad=tuple(own[-1].tolist()))) for own in q]
    arms = tuple(CellRobot(**given, start=a, goal=b) for given, (a, b) in zip(places, ends, strict=True))
    scene = CellScene(
        name="drawn", robots=arms, obstacles=tuple(map(obstacle, items)), may_touch=tuple(sorted(declared))
    )
    return Cell.of(scene, _robots(scene, files))


def _own(robot: Robot, scene: Scene) -> Trajectory | None:
    """The motion that hplan plans for an arm; None if it finds none in time."""
    try:
        return plan(robot, scene, PlanOptions(effort="quick"), cancel=impatient()).trajectory
    except HplanError:
        return None


def _foreign(robot: Robot, start: Any, goal: Any, rng: np.random.Generator) -> Trajectory:
    """A quintic as another program samples it, within the limits mostly, straight to the goal or nearer."""
    goal = start + (goal - start) * rng.uniform(0.1, 0.5)
    way = np.abs(goal - start)
    fastest = max(1.9 * float((way / robot.velocity_limit).max()), 0.1)
    hardest = float(np.sqrt(5.8 * (way / robot.acceleration_limit).max()))
    duration = 1.3 * max(fastest, hardest) * float(rng.uniform(1.0, 1.5))
    step = float(np.exp(rng.uniform(np.log(2e-3), np.log(0.3)))) * np.pi / 3.0
    times = np.append(np.arange(0.0, duration - 1e-6, step), duration)
    s = times / duration
    f, fd = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    fdd = (60 * s - 180 * s**2 + 120 * s**3) / duration**2
    q, v, a = start + np.outer(f, goal - start), np.outer(fd, goal - start), np.outer(fdd, goal - start)
    torque = robot.dynamics.torques(q, v, a)
    return Trajectory(robot.joint_names, times, q, v, a, torque, robot.slides)


def _tampered(motion: Trajectory, rng: np.random.Generator) -> Trajectory:
    """A motion with something changed."""
    values = {key: getattr(motion, key).copy() for key in ("position", "velocity", "acceleration", "torque")}
    sample, joint = int(rng.integers(motion.samples)), int(rng.integers(len(motion.joint_names)))
    changes: dict[str, Callable[[], Any]] = {
        "moves at its end": lambda: values["velocity"].__setitem__((-1, joint), rng.uniform(-2.0, 2.0)),
        "columns": lambda: values.update(acceleration=1e3 * values["acceleration"] + 1e3),
        "forces": lambda: values.update(torque=1e6 + values["torque"]),
        "a speed": lambda: values["velocity"].__setitem__((sample, joint), rng.uniform(-3.0, 3.0)),
        "a place": lambda: values["position"].__setitem__((sample, joint), rng.uniform(-3.0, 3.0)),
        "far": lambda: values["velocity"].__setitem__((sample, joint), 1e300),
    }
    changes[str(rng.choice(list(changes)))]()
    return replace(motion, **values)


def _tamper_text(path: Path, rng: np.random.Generator) -> None:
    """Change a file so that it can be no motion: a word, a time, a column."""
    lines = path.read_text("utf-8").splitlines()
    which = int(rng.integers(3))
    if which == 0:
        lines[-1] = lines[-1].rsplit(",", 1)[0] + ",nan"
    elif which == 1:
        lines.append(lines[-1])
    else:
        lines = [line.rsplit(",", 4)[0] for line in lines]
    path.write_text("\n".join(lines) + "\n", "utf-8")


def _least(cell: Cell, files: list[Filed], every_s: float, within: float) -> tuple[float, str, str]:
    """The minimum distance of two arms, up to a limit, and the bodies; not of links that may touch."""
    names = [arm.name for arm in cell.arms]
    declared = {frozenset(pair) for pair in cell.scene.may_touch}

    def skip(first: int, link: str, second: int, other: str) -> bool:
        return frozenset(((names[first], link), (names[second], other))) in declared

    rows = [each.cubics[1] for each in files] if every_s <= TICK_S else []
    end_s = max(each.motion.duration for each in files)
    clock = np.unique(np.concatenate([np.arange(0.0, end_s, every_s), [end_s], *rows]))
    arms = []
    for given, each in zip(cell.scene.robots, files, strict=True):
        turn = pin.rpy.rpyToMatrix(*np.radians(given.rpy_deg))
        arms.append((each.drawn.arm, each.at(clock), pin.SE3(turn, np.array(given.position))))
    return least_between(arms, within, skip)


def _faults(cell: Cell, files: list[Filed], certificate: CellCertificate, tally: Tally) -> list[Row]:
    """False statements of a verified certificate."""
    faults, clearance = list[Row](), cell.scene.clearance
    claimed = max(clearance, min(certificate.between.min_clearance_m, WITHIN_M))
    least, *bodies = _least(cell, files, TICK_S, claimed)
    if least < claimed - SAME_M:
        kind = "nearer than the clearance" if least < clearance - SAME_M else "nearer than it says"
        faults.append(
            {"kind": kind, "least_m": least, "between": bodies, "clearance_m": clearance, "claimed_m": claimed}
        )
    things = things_of(cell.scene)
    for given, each in zip(cell.scene.robots, files, strict=True):
        robot, motion, at = each.drawn.robot, each.motion, list(given.position)
        stands = Moves({"times_s": [0.0, 1.0], "shifts_m": [at, at], "rpy_deg": [given.rpy_deg] * 2})
        seen = Motion.read(each.path)
        tally.ticks += len(seen.times)
        touch = contacts(each.drawn.arm, seen, things, base=stands) if things else each.touches_itself
        faults += [{"kind": "contact", **vars(contact)} for contact in touch]
        uses = {
            "velocity": np.abs(motion.velocity) / robot.velocity_limit,
            "acceleration": np.abs(motion.acceleration) / robot.acceleration_limit,
            "torque": np.abs(motion.torque) / robot.torque_limit,
        }
        faults += [{"kind": key, "use": use.max()} for key, use in uses.items() if use.max() > LIMIT_TOLERANCE]
        outside = float(np.maximum(robot.lower - seen.values, seen.values - robot.upper).max())
        if outside > 1e-5 or np.abs(motion.velocity[-1]).max() > REST:
            faults.append({"kind": "beyond the limits, or not at rest", "outside_rad": outside})
    return faults


def _row(asked: Asked, number: int) -> Row:
    return judged_cells(asked.seed, number).row(number)


WORKCELLS = Study(
    "workcells",
    "files of random workcells of two to four arms, certified, and judged by Pinocchio and coal every half millisecond",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
