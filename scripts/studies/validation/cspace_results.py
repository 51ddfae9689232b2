"""Results of the comparison of a C-space with coal (`studies.validation.cspace`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hplan.collision.coal_scene import Contact
from hplan.collision.coal_shapes import LinkShapes
from hplan.cspace.sections import SECTION_ERROR, LinkModel
from hplan.planning.report import versions

#: Keys of the result file that have other names here.
_KEYS: Final = {"links": "judge", "coal_occupied": "judge_occupied"}

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

    def speed_ratio(self, comparison: Comparison) -> float:
        """Time of coal over that of the analytic side; NaN where it was not timed."""
        return comparison.coal_s / self.analytic_s

    def as_dict(self) -> dict[str, Any]:
        """The numbers, as `hplan.planning.report.write_report` writes them (what is not finite becomes null)."""
        return {
            "ok": self.ok,
            "scene": self.scene,
            "robot": self.robot,
            "joint_names": list(self.joint_names),
            "yaw_deg": float(np.degrees(self.yaw_rad)),
            "clearance_m": self.clearance_m,
            "step_deg": [float(np.degrees(step)) for step in self.step_rad],
            "shape": list(self.shape),
            "nodes": self.nodes,
            "faults": self.faults,
            "contact_tolerance_m": CONTACT_TOLERANCE,
            "section_error_m": SECTION_ERROR,
            "time_ms": {"analytic": round(1e3 * self.analytic_s, 4), "total": round(1e3 * self.total_s, 4)},
            "comparisons": [
                {
                    **{
                        _KEYS.get(key, key): value
                        for key, value in vars(c).items()
                        if not key.endswith(("_s", "_examples"))
                    },
                    "judge_ms": round(1e3 * c.coal_s, 4),
                    "speed_ratio": round(self.speed_ratio(c), 2),
                    "fault_examples": [_plain(example) for example in c.fault_examples],
                    "conservative_examples": [_plain(example) for example in c.conservative_examples],
                }
                for c in self.comparisons
            ],
            "base_contacts": [dict(vars(contact)) for contact in self.base_contacts],
            "versions": versions(),
        }


def _plain(example: Difference) -> dict[str, Any]:
    return {
        "node": list(example.node),
        "joints_deg": [round(float(angle), 9) for angle in np.degrees(example.joints_rad)],
        "link": example.link,
        "obstacle": example.obstacle,
        "distance_m": example.distance_m,
    }
