"""The numbers of the reproduction, the paper's and the measured ones, as frozen records."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from studies.paper.plain import Restoration

from hplan.cspace.sections import LinkModel


@dataclass(frozen=True)
class Paper:
    """What the paper reports (Fig. 16 and text).

    Attributes:
        dense_cost_deg: Cost of the dense A* [deg].
        dense_points: Points of its path.
        dense_expansions: Nodes it expands.
        dense_time_s: Its time [s].
        two_level_cost_deg: Cost of the two-level method [deg].
        two_level_points: Points of its path.
        two_level_expansions: Nodes that its second level expands.
        two_level_time_s: Its time [s].
        first_feasible_deg: First theta3 slice with a path [deg].
    """

    dense_cost_deg: float = 145.214952
    dense_points: int = 107
    dense_expansions: int = 154_647
    dense_time_s: float = 23.5
    two_level_cost_deg: float = 145.800739
    two_level_points: int = 108
    two_level_expansions: int = 6_605
    two_level_time_s: float = 2.56
    first_feasible_deg: int = 45

    @property
    def time_ratio(self) -> float:
        """Time of the dense A* over that of the two-level method."""
        return self.dense_time_s / self.two_level_time_s


PAPER = Paper()


@dataclass(frozen=True)
class Run:
    """One search, measured.

    Attributes:
        cost: Cost of its path ([deg], or the workspace's unit).
        points: Points of its path.
        layer_expansions: Entries taken from the slices' open lists: nodes, or jump points where slices are searched by
            those; 0 for the dense search.
        path_expansions: Entries taken from the open lists by the search that finds the path, dense or on the sparse
            union: nodes, and `settled`.
        settled: Rows among them, settled beforehand for the bound of the search on the union.
        flooded: Nodes reached by bit-parallel flooding; no expansions.
        layer_ms: Time of the slices [ms].
        total_ms: Time of all of it [ms], median of several runs, warm.
    """

    cost: float
    points: int
    layer_expansions: int
    path_expansions: int
    settled: int
    flooded: int
    layer_ms: float
    total_ms: float

    @property
    def total_expansions(self) -> int:
        """All entries taken from open lists."""
        return self.layer_expansions + self.path_expansions


@dataclass(frozen=True)
class ModelRow:
    """One link model.

    Attributes:
        link_model: Its name.
        occupied: Occupied nodes of the grid.
        first_feasible_deg: First theta3 slice with a path [deg].
        last_feasible_deg: Last one [deg].
        dense_cost_deg: Cost of the dense A* [deg].
        dense_points: Points of its path.
        dense_expansions: Nodes it expands.
        cspace_ms: Time of the occupancy [ms], median, warm.
    """

    link_model: str
    occupied: int
    first_feasible_deg: int
    last_feasible_deg: int
    dense_cost_deg: float
    dense_points: int
    dense_expansions: int
    cspace_ms: float


@dataclass(frozen=True)
class Gap:
    """The feasibility gap: the last slice without a path and the first with one.

    Attributes:
        last_without_deg: Last theta3 before the first path [deg].
        first_with_deg: First theta3 with a path [deg].
        reached_without: Nodes the start reaches in the slice without a path.
        reached_with: The same in the slice with one.
        layers_searched: Slices searched, theta3 of the start to theta3 of the goal.
        layers_without: Those of them without a path.
        expansions_without: Nodes that a plain A* expands in those.
    """

    last_without_deg: int
    first_with_deg: int
    reached_without: int
    reached_with: int
    layers_searched: int
    layers_without: int
    expansions_without: int


@dataclass(frozen=True)
class Ties:
    """What the choice among equally short slice paths does to the second level.

    Attributes:
        choices: Sets of slice paths tried: two fixed orders of the moves, the rest drawn from a fixed seed.
        lowest_cost_deg: Lowest cost of the second level [deg].
        highest_cost_deg: Highest cost [deg].
        fewest_points: Fewest points of the path.
        most_points: Most points.
        fewest_expansions: Fewest nodes expanded by the second level.
        most_expansions: Most.
    """

    choices: int
    lowest_cost_deg: float
    highest_cost_deg: float
    fewest_points: int
    most_points: int
    fewest_expansions: int
    most_expansions: int


@dataclass(frozen=True)
class Variant:
    """The method to the letter with one choice of what the paper's text leaves open.

    Attributes:
        link_model: Link model of the C-space.
        last_slice_deg: Last theta3 slice searched, from 0 [deg].
        restoration: What restoration carries back towards the start.
        cost_deg: Cost of the second level [deg].
        points: Points of its path.
        layer_expansions: Nodes expanded in the slices.
        path_expansions: Nodes expanded by the second level.
        sparse_nodes: Nodes of the sparse union.
        ties: What ties between slice paths do to it.
    """

    link_model: LinkModel
    last_slice_deg: int
    restoration: Restoration
    cost_deg: float
    points: int
    layer_expansions: int
    path_expansions: int
    sparse_nodes: int
    ties: Ties


@dataclass(frozen=True)
class Slip:
    """The example with the bearing read as the paper prints it, arctan(x / y).

    Attributes:
        occupied: Occupied nodes.
        goal_is_free: Whether the goal's node is free.
        feasible_slices: theta3 slices with a path.
        cost_deg: Cost of the dense A* [deg]; None where no path exists.
    """

    occupied: int
    goal_is_free: bool
    feasible_slices: int
    cost_deg: float | None


@dataclass(frozen=True)
class Reproduction:
    """All numbers of the report.

    Attributes:
        paper: The paper's.
        nodes: Nodes of the joint grid.
        dense: Dense A*.
        plain: The two levels to the letter.
        straight: `two_level_search` with `octile=False`: plain A* and the paper's straight-line bound.
        hplan: `two_level_search` as it is by default: jump points in the slices, row bounds on the union.
        models: The three link models.
        gap: The feasibility gap (capsule model).
        variants: The method to the letter by link model, slices searched and reading of the restoration.
        sparse_nodes: Nodes of the sparse union (plain).
        demo_dense: Workspace demonstration, dense A*, in the paper's unit.
        demo_two_level: The same, two-level with the straight-line bound.
        demo_layers: Layers of the demonstration.
        slip_link_frame: Bearing read as printed, arctan(x / y), with x and y in the frame of the link before.
        slip_arm_plane: The same with x and y in the arm plane.
        versions: Versions of Python, numpy and numba.
    """

    paper: Paper
    nodes: int
    dense: Run
    plain: Run
    straight: Run
    hplan: Run
    models: tuple[ModelRow, ...]
    gap: Gap
    variants: tuple[Variant, ...]
    sparse_nodes: int
    demo_dense: Run
    demo_two_level: Run
    demo_layers: int
    slip_link_frame: Slip
    slip_arm_plane: Slip
    versions: dict[str, str]

    def variant(
        self, last_slice_deg: int, restoration: Restoration = "path", link_model: LinkModel = "capsule"
    ) -> Variant:
        """The variant of these choices."""
        return next(
            variant
            for variant in self.variants
            if (variant.last_slice_deg, variant.restoration, variant.link_model)
            == (last_slice_deg, restoration, link_model)
        )

    @property
    def ties(self) -> Ties:
        """What ties do to the variant that runs everywhere else: slices 0..70 deg, the path carried back."""
        return self.variant(70).ties

    def as_dict(self) -> dict[str, Any]:
        """The numbers ready for JSON."""
        return {"format": "hplan-reproduction/1", **asdict(self), "ties": asdict(self.ties)}
