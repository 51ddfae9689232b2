r"""The analytic C-space compared with coal, node by node.

Two programs that share no formula say of every grid node whether the arm touches an obstacle there: the closed-form
intervals of `hplan.grid.occupancy`, and coal by way of Pinocchio. Where they differ, two directions are told apart:

- *fault*: free for us, a collision for coal. The planner could go there. One is too many;
- *conservatism*: forbidden for us, free for coal. It costs room, not safety. Where a section is drawn around an
  obstacle instead of computed in closed form, it may stand `SECTION_ERROR` outside; nodes beyond that are counted.

Nodes where coal's signed distance is within `CONTACT_TOLERANCE` of the clearance are in contact up to rounding.
They may be decided either way, and are counted apart.

Coal is asked with several shapes of the links:

- `capsule`: what the analytic model claims to be. Nothing may differ but by the section error;
- `urdf`: the URDF's own collision geometry, which the capsules must hold: no fault, perhaps conservatism;
- `box`: square beams from joint to joint, in the arm plane the paper's rectangles. The capsule holds the rectangle, but
  **not the beam's edges**, which stand :math:`\sqrt 2 w` from the axis, out of the plane; nor does the beam hold the
  capsule's round ends. Differences both ways are right, then, and say how much the choice of model matters;
- where all obstacles are balls also the `rectangle` model against the same beams, which must agree.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.collision.coal_scene import CoalScene, Contact, base_contacts
from hplan.collision.coal_shapes import LINK_SHAPES, LinkShapes
from hplan.errors import InputError, OptionError
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.occupancy import occupancy
from hplan.grid.sections import SECTION_ERROR, LinkModel
from hplan.planning.report import versions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere

#: Nodes given to coal in one call.
CHUNK = 65_536

#: Differing nodes of each direction whose distances are looked at, spread evenly over all that differ.
LOOKED_AT = 1_000

#: Differing nodes of each direction that are told in full, the worst first.
EXAMPLES = 5

#: Repetitions of the analytic computation, of which the fastest counts.
_REPETITIONS = 3

#: A node whose distance is this close to the clearance is in contact, which may be decided either way [m].
CONTACT_TOLERANCE: Final = 1e-9


@dataclass(frozen=True)
class Difference:
    """A node that the two sides decide differently.

    Attributes:
        node: Index of the node along each axis of the grid.
        joints_rad: Configuration of all joints.
        link: Coal's nearest link.
        obstacle: Its nearest obstacle.
        distance_m: Signed distance between them beyond the clearance, by coal [m]; negative is too near.
    """

    node: tuple[int, ...]
    joints_rad: tuple[float, ...]
    link: str
    obstacle: str
    distance_m: float


@dataclass(frozen=True)
class Comparison:
    """One analytic model and coal with one shape of links, over all nodes.

    Attributes:
        link_model: The analytic model.
        links: Shape of coal's links.
        decisive: Whether a fault here is a fault of the C-space; False for capsules against boxes.
        occupied: Nodes that the analytic side forbids.
        coal_occupied: Nodes at which coal finds a collision.
        faults: Nodes that only coal forbids.
        conservative: Nodes that only the analytic side forbids.
        unexplained: Those of them with a distance of more than `SECTION_ERROR` by coal; none may be where coal's links
            are the model's, elsewhere they are narrower links.
        in_contact: Nodes decided differently that are in contact up to rounding; not among the others.
        deepest_fault_m: Largest depth at the faults looked at [m]; 0 without any.
        widest_gap_m: Largest distance beyond the clearance at the conservative nodes looked at [m]; 0 without any.
        coal_s: Time of coal over all nodes [s].
        fault_examples: Some faults, the deepest first.
        conservative_examples: Some conservative nodes, the widest first.
    """

    link_model: LinkModel
    links: LinkShapes
    decisive: bool
    occupied: int
    coal_occupied: int
    faults: int
    conservative: int
    unexplained: int
    in_contact: int
    deepest_fault_m: float
    widest_gap_m: float
    coal_s: float
    fault_examples: tuple[Difference, ...]
    conservative_examples: tuple[Difference, ...]


@dataclass(frozen=True)
class Validation:
    """The result of comparing a scene's C-space with coal.

    Attributes:
        scene: Name of the scene.
        robot: Name of the robot.
        joint_names: All joints of the robot.
        yaw_rad: Yaw of the arm plane.
        clearance_m: Distance kept from obstacles, on both sides [m].
        step_rad: Spacing of the grid along each planar joint.
        shape: Nodes along each axis.
        analytic_s: Time of the analytic side over all nodes, sections included, kernels loaded [s]; NaN where the
            occupancy was handed in.
        total_s: Time of the whole validation [s].
        comparisons: One for each model and shape of links.
        base_contacts: Obstacles that touch pedestal or turret, which the C-space does not cover.
    """

    scene: str
    robot: str
    joint_names: tuple[str, ...]
    yaw_rad: float
    clearance_m: float
    step_rad: tuple[float, ...]
    shape: tuple[int, ...]
    analytic_s: float
    total_s: float
    comparisons: tuple[Comparison, ...]
    base_contacts: tuple[Contact, ...]

    @property
    def nodes(self) -> int:
        """Number of nodes that were compared."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def faults(self) -> int:
        """Number of faults in all decisive comparisons."""
        return sum(comparison.faults for comparison in self.comparisons if comparison.decisive)

    @property
    def ok(self) -> bool:
        """True if no fault was found."""
        return self.faults == 0

    def as_dict(self) -> dict[str, Any]:
        """The numbers, as `hplan.planning.report.write_report` writes them (what is not finite becomes null)."""
        return {"ok": self.ok, "nodes": self.nodes, "faults": self.faults, **asdict(self), "versions": versions()}


def validate_cspace(
    robot: Robot,
    scene: Scene,
    *,
    step: float = float(np.radians(1.0)),
    yaw: float | None = None,
    links: Sequence[LinkShapes] = LINK_SHAPES,
    space: Occupancy | None = None,
) -> Validation:
    """Compare the C-space of a scene with coal on every node of the joint grid.

    The grid spans the limits of all planar joints, those that the scene locks as well. Memory does not grow with it
    but for one bit a node, and one number for each node that differs.

    Args:
        robot: The arm.
        scene: Obstacles, and the clearance to keep from them.
        step: Largest spacing of the grid [rad].
        yaw: Yaw of the arm plane; None for that of the scene's start.
        links: Shapes of coal's links.
        space: An occupancy to validate, whoever computed it, over the arm's joints in the capsule model; None to
            compute it here (then `step` is that of the grid).

    Raises:
        OptionError: Unknown link shape, a step that is not positive or too small, a yaw outside the limits.
        InputError: The occupancy is not one of this arm; the scene's start is not one of this robot (asked for its
            yaw only).
    """
    begin = time.perf_counter()
    unknown = [shapes for shapes in links if shapes not in LINK_SHAPES]
    if unknown or not links:
        raise OptionError("links", unknown[0] if unknown else (), f"some of {', '.join(LINK_SHAPES)}")
    yaw = _checked_yaw(robot, scene, yaw)
    analytic_s = float("nan")
    if space is None:
        space, analytic_s = _timed_occupancy(robot, scene, joint_grid(robot.arm, step), yaw, "capsule")
    elif len(space.grid.shape) != robot.arm.link_count:
        raise InputError(
            f"the occupancy has {len(space.grid.shape)} axes, the arm {robot.arm.link_count} planar joints"
        )
    comparisons: list[Comparison] = []
    for shapes in links:
        models: list[tuple[LinkModel, Occupancy]] = [("capsule", space)]
        if shapes == "box" and all(isinstance(obstacle, Sphere) for obstacle in scene.solids):
            models.append(("rectangle", _occupancy(robot, scene, space.grid, yaw, "rectangle")))
        comparisons += _compare(robot, scene, yaw, shapes, models)
    return Validation(
        scene=scene.name,
        robot=robot.name,
        joint_names=robot.joint_names,
        yaw_rad=yaw,
        clearance_m=scene.clearance,
        step_rad=tuple(space.grid.step.tolist()),
        shape=space.grid.shape,
        analytic_s=analytic_s,
        total_s=time.perf_counter() - begin,
        comparisons=tuple(comparisons),
        base_contacts=base_contacts(robot, scene.solids, yaw, margin=scene.clearance),
    )


def _checked_yaw(robot: Robot, scene: Scene, yaw: float | None) -> float:
    if yaw is None:
        joints = scene.start.joints() if robot.has_yaw else None
        return 0.0 if joints is None else robot.yaw_of(robot.check_configuration(joints, "start"))
    low, high = (robot.lower[0], robot.upper[0]) if robot.has_yaw else (0.0, 0.0)
    if not low - 1e-9 <= yaw <= high + 1e-9:
        expected = f"between {low:.6g} and {high:.6g} rad" if robot.has_yaw else "0, as the robot has no yaw"
        raise OptionError("yaw", yaw, expected)
    return float(np.clip(yaw, low, high))


def _occupancy(robot: Robot, scene: Scene, grid: Grid, yaw: float, model: LinkModel) -> Occupancy:
    sections = arm_sections(robot, scene.solids, yaw=yaw, clearance=scene.clearance, link_model=model)
    return occupancy(robot.arm, sections, grid)


def _timed_occupancy(robot: Robot, scene: Scene, grid: Grid, yaw: float, model: LinkModel) -> tuple[Occupancy, float]:
    """The occupancy, and the time that the fastest of some repetitions took [s]; the first loads the kernels."""
    space = _occupancy(robot, scene, grid, yaw, model)
    fastest = float("inf")
    for _ in range(_REPETITIONS):
        begin = time.perf_counter()
        space = _occupancy(robot, scene, grid, yaw, model)
        fastest = min(fastest, time.perf_counter() - begin)
    return space, fastest


def _compare(
    robot: Robot,
    scene: Scene,
    yaw: float,
    shapes: LinkShapes,
    models: Sequence[tuple[LinkModel, Occupancy]],
) -> Iterator[Comparison]:
    """Ask coal with one shape of links at every node, and compare each model with its answers."""
    clearance = scene.clearance
    checker = CoalScene(robot, scene.solids, links=shapes, clearance=clearance, single_joint_pairs=False)
    grid = models[0][1].grid
    tallies = [_DifferingNodes() for _ in models]
    coal_occupied, coal_s = 0, 0.0
    rows = max(1, CHUNK // grid.shape[-1])
    row_count = grid.size // grid.shape[-1]
    for first in range(0, row_count, rows):
        last = min(first + rows, row_count)
        indices = np.arange(first * grid.shape[-1], last * grid.shape[-1])
        q = _configurations(robot, grid, indices, yaw)
        begin = time.perf_counter()
        theirs = checker.in_collision(q, margin=clearance)
        coal_s += time.perf_counter() - begin
        coal_occupied += int(theirs.sum())
        for tally, (_, space) in zip(tallies, models, strict=True):
            tally.add(checker, indices, q, _occupied_rows(space, first, last), theirs, clearance)
    for tally, (model, space) in zip(tallies, models, strict=True):
        faults, gaps = np.concatenate([*tally.faults, _NONE]), np.concatenate([*tally.conservative, _NONE])
        fault_examples = _look(checker, grid, faults, yaw, clearance)
        gap_examples = _look(checker, grid, gaps, yaw, clearance)[::-1]
        yield Comparison(
            link_model=model,
            links=shapes,
            decisive=not (model == "capsule" and shapes == "box"),
            occupied=space.occupied_count,
            coal_occupied=coal_occupied,
            faults=len(faults),
            conservative=len(gaps),
            unexplained=tally.unexplained,
            in_contact=tally.in_contact,
            deepest_fault_m=max(0.0, -fault_examples[0].distance_m) if fault_examples else 0.0,
            widest_gap_m=max(0.0, gap_examples[0].distance_m) if gap_examples else 0.0,
            coal_s=coal_s,
            fault_examples=tuple(fault_examples[:EXAMPLES]),
            conservative_examples=tuple(gap_examples[:EXAMPLES]),
        )


_NONE: IntArray = np.zeros(0, dtype=np.int64)


class _DifferingNodes:
    """The differing nodes of one comparison, as chunks come in."""

    def __init__(self) -> None:
        self.faults: list[IntArray] = []
        self.conservative: list[IntArray] = []
        self.unexplained = 0
        self.in_contact = 0

    def add(
        self, checker: CoalScene, indices: IntArray, q: FloatArray, ours: BoolArray, theirs: BoolArray, clearance: float
    ) -> None:
        """Sort the differing nodes of a chunk; coal is asked again with the contact tolerance."""
        missed = np.flatnonzero(theirs & ~ours)
        if len(missed):
            sure = checker.in_collision(q[missed], margin=clearance - CONTACT_TOLERANCE)
            self.faults.append(indices[missed[sure]])
            self.in_contact += int((~sure).sum())
        extra = np.flatnonzero(ours & ~theirs)
        if len(extra):
            sure = ~checker.in_collision(q[extra], margin=clearance + CONTACT_TOLERANCE)
            beyond = ~checker.in_collision(q[extra], margin=clearance + SECTION_ERROR)
            self.conservative.append(indices[extra[sure]])
            self.in_contact += int((~sure).sum())
            self.unexplained += int(beyond.sum())


def _configurations(robot: Robot, grid: Grid, indices: IntArray, yaw: float) -> FloatArray:
    """(n, dof) configurations of nodes given by flat index."""
    nodes = grid.coordinates(np.stack(np.unravel_index(indices, grid.shape), axis=-1))
    return np.column_stack([np.full(len(nodes), yaw), nodes]) if robot.has_yaw else nodes


def sampled_occupancy(checker: CoalScene, grid: Grid, yaw: float = 0.0) -> BoolArray:
    """Mask of a grid over the planar joints: True where coal finds some link in contact with an obstacle."""
    q = _configurations(checker.robot, grid, np.arange(grid.size), yaw)
    return checker.in_collision(q).reshape(grid.shape)


def _occupied_rows(space: Occupancy, first: int, last: int) -> BoolArray:
    """Flat mask of some rows of an occupancy, unpacked from its bits."""
    bits = np.unpackbits(space.free_words[first:last].view(np.uint8), axis=1, bitorder="little")
    occupied: BoolArray = (bits[:, : space.grid.shape[-1]] == 0).reshape(-1)
    return occupied


def _look(checker: CoalScene, grid: Grid, indices: IntArray, yaw: float, clearance: float) -> list[Difference]:
    """Distances at some of the nodes, spread evenly over them; smallest distance first."""
    if len(indices) > LOOKED_AT:
        indices = indices[np.linspace(0, len(indices) - 1, LOOKED_AT).astype(np.int64)]
    found = []
    for index, q in zip(indices, _configurations(checker.robot, grid, indices, yaw), strict=True):
        nearest = checker.nearest(q)
        if nearest is None:  # no obstacles: the occupancy that was handed in forbids nodes all the same
            nearest = Contact("", "", float("inf"))
        node = tuple(int(i) for i in np.unravel_index(index, grid.shape))
        found.append(
            Difference(node, tuple(q.tolist()), nearest.link, nearest.obstacle, nearest.distance_m - clearance)
        )
    return sorted(found, key=lambda difference: (difference.distance_m, difference.node))
