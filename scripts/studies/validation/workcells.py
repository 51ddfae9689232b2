"""Random workcells whose files are certified, each verdict compared with Pinocchio and coal alone.

Two to four arms of any kind stand at random, in one another as well. Each has a CSV: hplan's own, one of another
program with samples at its own times, or either with something changed. A certificate is false if arms are nearer to
each other than the clearance, or than it says, at any tick; if an arm touches an obstacle or itself; or if a file
breaks a limit in its columns, or does not end at rest.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from studies.harness import Asked, Row, Study
from studies.validation.arms import DrawnArm, draw_arm, named_arm
from studies.validation.episodes import COUNTED, Tally, impatient, warm_up
from studies.validation.judge import TICK_S, Motion, Moves, contacts, least_between, read_cubics, things_of
from studies.validation.worlds import World, draw_ends, draw_item, obstacle

from hplan.certificate.certificate import LIMIT_TOLERANCE, REST, certify
from hplan.errors import HplanError
from hplan.planning.cell import Cell, CellCertificate, certify_cell
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.model import Goal, Start
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv

#: Sets of files for arms at the same places.
SETS = 8

#: Arms of a workcell, and how far their bases are from the origin [m].
ARMS, FAR_M = (2, 4), (0.3, 1.5, 3.0)

#: Shares of hplan's own files, of tampered ones, and of workcells whose clearance is about the distance that is kept.
OWN, TAMPERED, TIGHT = 0.1, 0.25, 0.5

#: Distances beyond this are not compared; rounding of coal and of text [m].
WITHIN_M, SAME_M = 0.2, 1e-6


def judged_cells(seed: int, number: int) -> Tally:
    """Arms at some places, and some sets of files for them: their certificates, and what the judge sees."""
    rng, tally = np.random.default_rng([seed, number, 21]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn, places = _drawn_arms(Path(name), rng, tally)
        except HplanError as error:
            tally.refused[f"robot: {error.kind}"] += 1
            return tally
        for turn in range(SETS):
            try:
                _judge(drawn, places, Path(name), rng, tally, f"{number}.{turn}")
            except HplanError as error:
                tally.refused[error.kind] += 1
    return tally


def _judge(
    drawn: list[DrawnArm], places: list[dict[str, Any]], folder: Path, rng: np.random.Generator, tally: Tally, case: str
) -> None:
    """One set of files."""
    found = _drawn_files(drawn, places, folder, rng, tally)
    if found is None:
        return
    cell, paths = found
    files = {each: read_csv(path) for each, path in paths.items()}
    certificate = certify_cell(cell, files, check_ends=False)
    tally.looked["verified" if certificate.verified else "not verified"] += 1
    told = {"case": case, "arms": [each.kind for each in drawn]}
    tally.faults += [told | fault for fault in _faults(cell, drawn, paths, certificate, tally)]
    for arm in cell.arms:
        alone = certify(arm.robot, arm.scene, files[arm.name], check_ends=False)
        if certificate.arms[arm.name].violations != alone.violations:
            tally.faults.append(told | {"kind": "not the certificate that the arm has alone", "arm": arm.name})


def _drawn_arms(folder: Path, rng: np.random.Generator, tally: Tally) -> tuple[list[DrawnArm], list[dict[str, Any]]]:
    """Two to four arms, and the names and bases of them."""
    far = float(rng.choice(FAR_M))
    drawn, places = list[DrawnArm](), list[dict[str, Any]]()
    for k in range(int(rng.integers(ARMS[0], ARMS[1] + 1))):
        own = folder / str(k)
        own.mkdir()
        arm = named_arm("harvester") if rng.random() < 0.1 else draw_arm(own, rng)
        tilt = rng.uniform(-20.0, 20.0, 2) if rng.random() < 0.15 else np.zeros(2)
        place = (*(rng.uniform(-far, far, 2)), float(rng.choice([0.0, rng.uniform(-0.3, 0.3)])))
        drawn.append(arm)
        places.append({"name": f"arm_{k}" if k % 2 else f"arm{'_0' * (k // 2)}", "position": tuple(map(float, place)),
                       "rpy_deg": (*tilt.tolist(), float(rng.uniform(-180.0, 180.0)))})  # fmt: skip
        tally.arms[arm.kind] += 1
    return drawn, places


def _drawn_files(
    drawn: list[DrawnArm], places: list[dict[str, Any]], folder: Path, rng: np.random.Generator, tally: Tally
) -> tuple[Cell, dict[str, Path]] | None:
    """A workcell and the file of each arm; None where an arm touches itself nearly everywhere."""
    ends = [draw_ends(each, rng, 0.0) for each in drawn]
    if any(both is None for both in ends):
        return None
    known = [both for both in ends if both is not None]
    items = [
        draw_item(drawn[0], World(*known[0]), rng, f"o{k}")
        for k in range(int(rng.integers(3)) if rng.random() < 0.4 else 0)
    ]
    arms = tuple(
        CellRobot(**given, start=Start(joints_rad=tuple(q[0].tolist())), goal=Goal(joints_rad=tuple(q[1].tolist())))
        for given, q in zip(places, known, strict=True)
    )
    scene = CellScene(name="drawn", robots=arms, obstacles=tuple(map(obstacle, items)))
    cell = Cell.of(scene, {arm.name: each.robot for arm, each in zip(arms, drawn, strict=True)})
    paths, unreadable = {}, list[Path]()
    for arm, given, both in zip(cell.arms, drawn, known, strict=True):
        motion = _own(cell, arm.name) if rng.random() < OWN else None
        tampered, kind = False, "foreign" if motion is None else "own"
        motion = _foreign(given.robot, *both, rng) if motion is None else motion
        motion = replace(motion, joint_names=arm.robot.joint_names)
        if rng.random() < TAMPERED / len(drawn):
            motion, tampered = _tampered(motion, rng), True
        paths[arm.name] = write_csv(motion, folder / f"trajectory-{arm.name}.csv")
        if tampered and rng.random() < 0.2:
            unreadable.append(paths[arm.name])
        tally.looked_in[f"{kind}{', tampered' if tampered else ''}"] += 1
    cell = _with_clearance(cell, drawn, paths, rng)
    for path in unreadable:
        _tamper_text(path, rng)
    return cell, paths


def _with_clearance(cell: Cell, drawn: list[DrawnArm], paths: dict[str, Path], rng: np.random.Generator) -> Cell:
    """The workcell with a clearance, about the distance that is kept where that is possible, and with declarations."""
    clearance = float(rng.choice([0.0, rng.uniform(0.0, 0.1)]))
    declared = list[Any]()
    if rng.random() < 0.3:  # links that stand still in one another are to be so
        still = [[body for body in each.arm.bodies if body.joint == 0] for each in drawn]
        names = [arm.name for arm in cell.arms]
        for (i, one), (j, other) in itertools.combinations(enumerate(still), 2):
            declared += {((names[i], a.link), (names[j], b.link)) for a in one for b in other}
    cell = _remade(cell, drawn, clearance, tuple(sorted(declared)))
    if rng.random() < TIGHT:
        least, *_ = _least(cell, drawn, paths)
        if SAME_M < least < 0.1:
            clearance = float(np.clip(least * rng.uniform(0.8, 1.1), 0.0, 0.1))
    return _remade(cell, drawn, clearance, tuple(sorted(declared)))


def _remade(cell: Cell, drawn: list[DrawnArm], clearance: float, declared: tuple[Any, ...]) -> Cell:
    scene = cell.scene.model_copy(update={"clearance": clearance, "may_touch": declared})
    return Cell.of(scene, {arm.name: each.robot for arm, each in zip(cell.arms, drawn, strict=True)})


def _own(cell: Cell, name: str) -> Trajectory | None:
    """The motion that hplan plans for an arm; None where it finds none in time."""
    arm = cell.arm(name)
    warm_up()
    try:
        return plan(arm.robot, arm.scene, PlanOptions(effort="quick"), cancel=impatient()).trajectory
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


def _motions(cell: Cell, drawn: list[DrawnArm], paths: dict[str, Path]) -> list[tuple[Any, Motion, pin.SE3]]:
    """Each arm, its file at the ticks and samples of all files, and the pose of its base, for the judge."""
    cubics = [read_cubics(paths[arm.name]) for arm in cell.arms]
    end_s = max(float(times[-1]) for _, times, _ in cubics)
    clock = np.unique(np.concatenate([np.arange(0.0, end_s, TICK_S), *(times for _, times, _ in cubics)]))
    found = []
    for given, each, (_, times, place) in zip(cell.scene.robots, drawn, cubics, strict=True):
        turn = pin.rpy.rpyToMatrix(*np.radians(given.rpy_deg))
        motion = Motion(each.robot.joint_names, clock, place(np.minimum(clock, times[-1])))
        found.append((each.arm, motion, pin.SE3(turn, np.array(given.position))))
    return found


def _least(cell: Cell, drawn: list[DrawnArm], paths: dict[str, Path]) -> tuple[float, str, str]:
    """The distance that arms keep from one another, and between which bodies; of links that may touch none."""
    names = [arm.name for arm in cell.arms]
    declared = {frozenset(pair) for pair in cell.scene.may_touch}

    def skip(first: int, link: str, second: int, other: str) -> bool:
        return frozenset(((names[first], link), (names[second], other))) in declared

    return least_between(_motions(cell, drawn, paths), WITHIN_M, skip)


def _faults(
    cell: Cell, drawn: list[DrawnArm], paths: dict[str, Path], certificate: CellCertificate, tally: Tally
) -> list[Row]:
    """What of a verified certificate is not true."""
    if not certificate.verified:
        return []
    faults, motions = list[Row](), _motions(cell, drawn, paths)
    tally.ticks += sum(len(motion.times) for _, motion, _ in motions)
    least, *bodies = _least(cell, drawn, paths)
    claimed = certificate.between.min_clearance_m
    told: Row = {"least_m": least, "between": bodies, "clearance_m": cell.scene.clearance, "claimed_m": claimed}
    if least < min(cell.scene.clearance, WITHIN_M) - SAME_M:
        faults.append({"kind": "nearer than the clearance"} | told)
    if claimed > least + SAME_M and least < WITHIN_M:
        faults.append({"kind": "nearer than it says"} | told)
    things = things_of(_items(cell))
    for given, each, (arm, motion, base) in zip(cell.scene.robots, drawn, motions, strict=True):
        robot, file = each.robot, read_csv(paths[given.name])
        at = base.translation.tolist()
        stands = Moves({"times_s": [0.0, 1.0], "shifts_m": [at, at], "rpy_deg": [given.rpy_deg] * 2})
        faults += [{"kind": "contact", **vars(each)} for each in contacts(arm, motion, things, base=stands)]
        uses = {
            "velocity": np.abs(file.velocity) / robot.velocity_limit,
            "acceleration": np.abs(file.acceleration) / robot.acceleration_limit,
            "torque": np.abs(file.torque) / robot.torque_limit,
        }
        faults += [{"kind": key, "use": use.max()} for key, use in uses.items() if use.max() > LIMIT_TOLERANCE]
        outside = float(np.maximum(robot.lower - motion.values, motion.values - robot.upper).max())
        if outside > 1e-5 or np.abs(file.velocity[-1]).max() > REST:
            faults.append({"kind": "beyond the limits, or not at rest", "outside_rad": outside})
    return faults


def _items(cell: Cell) -> list[dict[str, Any]]:
    """Obstacles in the cell's frame, as the judge takes them."""
    found = []
    for each in cell.scene.obstacles:
        item = each.model_dump(mode="json", by_alias=True)
        data = getattr(each, "_data", None)
        found.append(item | {key: getattr(data, key, None) for key in ("vertices", "faces", "points")})
    return found


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
