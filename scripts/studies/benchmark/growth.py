"""How time and memory grow with the grid, the number of obstacles and the number of links."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, fitted_slope, median, peak_memory_mb, timed, times_ms
from studies.benchmark.scenes import discs_in_plane, task
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.clearance_field import ClearanceField
from hplan.cspace.occupancy import occupancy
from hplan.errors import HplanError, InputError
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.robot_family.members import ArmSpec, write_robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere
from hplan.search import SearchResult, dense_search, two_level_search
from hplan.search.grid import Grid, Occupancy

#: Spacings of the grid [deg], numbers of obstacles, numbers of links.
STEPS_DEG = (2.0, 1.0, 0.5, 0.25)
COUNTS = (1, 3, 10, 30, 100, 300, 1000)
LINKS = (2, 3, 4, 5)

#: Spacing of the grid where the number of links grows [deg].
LINK_STEP_DEG = 6.0

#: On grids of more nodes the dense search is run once only.
_OFTEN = 8_000_000

#: A search that only loads the kernels.
_NODE = np.zeros(3, dtype=np.int64)
_TINY = Occupancy.from_mask(Grid.over([0.0] * 3, [1.0] * 3, 0.5), np.zeros((3, 3, 3), dtype=np.bool_)), _NODE, _NODE + 2

#: Time that the repetitions of one measurement may take together [ms].
_BUDGET_MS = 1500.0

#: What is fitted and drawn.
QUANTITIES = ("cspace_ms", "two_level_ms", "dense_ms", "plan_ms", "two_level_mb", "dense_mb")


def measure(robot: Robot, scene: Scene, *, seed: int, quick: bool, progress: Progress) -> dict[str, Any]:
    """Measure the growth set.

    Args:
        robot: The arm.
        scene: The reference scene.
        seed: Seed of the obstacles.
        quick: Leave the largest cases out.
        progress: Told how far it is.
    """
    steps, counts, links = (STEPS_DEG[:2], COUNTS[:5:2], LINKS[:3]) if quick else (STEPS_DEG, COUNTS, LINKS)
    repetitions = 3 if quick else 15
    total, done = len(steps) + len(counts) + len(links), 0
    table: dict[str, list[dict[str, Any]]] = {"step": [], "obstacles": [], "links": []}

    def case(axis: str, size: float, arm: Robot, where: Scene, step_deg: float) -> None:
        nonlocal done
        progress(f"growth: {axis}", done, total)
        table[axis].append({"size": size, **_case(arm, where, step_deg, repetitions)})
        done += 1

    for step in steps:
        case("step", step, robot, scene, step)
    discs = beside_the_way(robot, scene, max(counts), seed)
    for count in counts:
        case("obstacles", count, robot, scene.with_obstacles(discs[:count]), 1.0)
    with tempfile.TemporaryDirectory() as folder:
        for number in links:
            arm = load_robot(_arm_of(number, Path(folder)))
            case("links", number, arm, _links_scene(arm), LINK_STEP_DEG)
    progress("growth", total, total)
    return {
        "repetitions": repetitions,
        **{axis: {"cases": cases, "slopes": _slopes(axis, cases)} for axis, cases in table.items()},
    }


def _slopes(axis: str, cases: list[dict[str, Any]]) -> dict[str, float]:
    """Exponents against nodes (grid and links) or obstacles."""
    sizes = [case["size"] if axis == "obstacles" else case["nodes"] for case in cases]
    return {name: fitted_slope(sizes, [case[name] for case in cases]) for name in QUANTITIES}


def _case(robot: Robot, scene: Scene, step_deg: float, repetitions: int) -> dict[str, Any]:
    """Time and memory of C-space, searches and the whole plan."""
    grid = joint_grid(robot.arm, np.radians(step_deg))

    def cspace() -> Occupancy:
        return occupancy(robot.arm, arm_sections(robot, scene.solids), grid)

    space = cspace()
    start, goal = (_free_node(space, end.joints(), robot) for end in (scene.start, scene.goal))

    def two_level() -> SearchResult:
        return two_level_search(space, start, goal)

    found = two_level()  # loads the kernels, as does the next line
    dense_search(*_TINY)
    _, memory = peak_memory_mb(lambda: two_level_search(cspace(), start, goal))
    row: dict[str, Any] = {
        "step_deg": step_deg,
        "nodes": grid.size,
        "occupancy_mb": space.free_words.nbytes / 2**20,
        "occupied_share": space.occupied_count / grid.size,
        "cspace_ms": _median_ms(cspace, repetitions),
        "two_level_ms": _median_ms(two_level, repetitions),
        "two_level_mb": memory,
        "expansions": found.expansions.total,
        "fallback": found.fallback,
        **_dense(space, start, goal, repetitions),
    }
    options = PlanOptions(step_deg=step_deg)
    try:
        certificate = plan(robot, scene, options).certificate
        row["plan_ms"] = _median_ms(lambda: plan(robot, scene, options), repetitions)
        row["certified"] = certificate.verified
    except HplanError as error:
        row.update(plan_ms=float("nan"), certified=False, error=f"{error.kind}: {error.message}")
    return row


def _dense(space: Occupancy, start: IntArray, goal: IntArray, repetitions: int) -> dict[str, float]:
    """Time and memory of the dense search."""
    (_, once), memory = peak_memory_mb(lambda: timed(lambda: dense_search(space, start, goal)))
    often = space.grid.size <= _OFTEN
    ms = _median_ms(lambda: dense_search(space, start, goal), repetitions) if often else once
    return {"dense_ms": ms, "dense_mb": memory}


def _free_node(space: Occupancy, q: FloatArray | None, robot: Robot) -> IntArray:
    """The free node nearest to a configuration."""
    position = space.grid.position(np.asarray(q)[robot.arm_slice])
    near = np.stack(np.meshgrid(*[[-1, 0, 1]] * len(position), indexing="ij"), axis=-1).reshape(-1, len(position))
    nodes = np.clip(np.rint(position).astype(np.int64) + near, 0, np.array(space.grid.shape) - 1)
    free = [node for node in nodes if space.is_free(node)]
    nearest: IntArray = min(free, key=lambda node: float(np.linalg.norm(node - position)))
    return nearest


def _median_ms(run: Any, repetitions: int) -> float:
    """Median of repeated calls, fewer of those that take long."""
    once = timed(run)[1]
    affordable = int(_BUDGET_MS / max(once, 1e-3))
    return once if affordable < 2 else median(times_ms(run, min(repetitions, affordable), warm=0))


def beside_the_way(robot: Robot, scene: Scene, count: int, seed: int) -> list[Sphere]:
    """Small discs within reach, none in the way of the reference motion; the scene's own obstacles come first."""
    path = plan(robot, scene).path
    if path is None:
        raise InputError(f"scene {scene.name!r}: its motion is empty")
    along = path.evaluate(np.linspace(0.0, path.end, 60))
    random = np.random.default_rng(seed)
    reach = float(robot.arm.lengths.sum())
    kept: list[Sphere] = [obstacle for obstacle in scene.solids if isinstance(obstacle, Sphere)]
    while len(kept) < count:
        distance, bearing = reach * random.uniform(0.1, 1.0), np.radians(random.uniform(-20.0, 200.0))
        row = np.array([[distance * np.cos(bearing), distance * np.sin(bearing), random.uniform(0.005, 0.02)]])
        (disc,) = discs_in_plane(robot, row)
        field = ClearanceField.of(robot, [disc])
        if min(field.clearance(q) for q in along) > 0.01:
            kept.append(disc.model_copy(update={"name": f"disc {len(kept)}"}))
    return kept


def _arm_of(links: int, folder: Path) -> Path:
    """A member of the robot family of 2.2 m with the given number of links, each of half its predecessor's mass."""
    share = 0.75 ** np.arange(links)
    lengths = 2.2 * share / share.sum()
    spec = ArmSpec(
        name=f"arm-{links}",
        link_lengths=tuple(lengths),
        link_half_widths=tuple(0.05 * 0.85 ** np.arange(links)),
        link_masses=tuple(10.0 * share / share.sum()),
        lower=(-np.pi, *[0.0] * links),
        upper=(np.pi, *[0.5 * np.pi] * links),
        velocity=(1.5,) * (links + 1),
        effort=(400.0,) * (links + 1),
        acceleration=(4.0,) * (links + 1),
    )
    return write_robot(spec, folder / f"arm-{links}.urdf")[0]


def _links_scene(robot: Robot) -> Scene:
    """A disc far out, which an arm of any number of links passes folded."""
    links = robot.arm.link_count
    discs = discs_in_plane(robot, np.array([[1.38, 1.16, 0.1]]))
    goal: FloatArray = np.radians(np.full(links, 54.0 if links < 4 else 42.0))
    goal[0] = np.radians(48.0)
    return task(robot, f"{links} links", discs, np.zeros(links), goal)
