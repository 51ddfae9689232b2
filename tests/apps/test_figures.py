from __future__ import annotations

import io
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from studies.planar_cspace import RoundedPolygon, arm_sections, joint_grid, planar_sections
from studies.view import figure_data, figures_arm
from studies.view.figures_arm import arm_and_obstacle, motions
from studies.view.figures_cspace import slice_paths, slices

from hplan.apps.view.cspace_surface import hidden, surface_net
from hplan.apps.view.figure_style import png_bytes
from hplan.base.arrays import FloatArray, IntArray
from hplan.errors import InputError
from hplan.grid import SearchResult, dense_search, two_level_search
from hplan.grid import occupancy as cspace
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.sections import ArmSections
from hplan.robot.model import load_robot
from hplan.robot.planar_family import PlanarArm
from hplan.scene.file import load_scene


@dataclass(frozen=True)
class Case:
    arm: PlanarArm
    sections: ArmSections
    grid: Grid
    occupancy: Occupancy
    field: FloatArray
    start: IntArray
    goal: IntArray
    result: SearchResult
    path: IntArray
    first: int
    heads: dict[int, IntArray]


@pytest.fixture(scope="module")
def case() -> Case:
    robot, scene = load_robot(), load_scene()
    sections = arm_sections(robot, scene.solids)
    grid = joint_grid(robot.arm, math.radians(3.0))
    occupancy = cspace.occupancy(robot.arm, sections, grid)
    start, goal = np.array([0, 0, 0]), np.array([15, 20, 23])
    result = two_level_search(occupancy, start, goal)
    assert result.path is not None
    first = min(result.slice_paths)
    heads = {}
    kept = result.slice_paths[first]
    for number in range(first - 1, -1, -1):
        blocked = np.flatnonzero(occupancy.occupied[kept[:, 0], kept[:, 1], number])
        kept = kept[: blocked[0]] if len(blocked) else kept
        heads[number] = np.column_stack([kept[:, :2], np.full(len(kept), number)])
    field = figure_data.clearance_field(robot.arm, sections, grid)
    return Case(robot.arm, sections, grid, occupancy, field, start, goal, result, result.path, first, heads)


SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def ball(radius: float = 7.5) -> FloatArray:
    grid = Grid.over((0.0, 0.0, 5.0), (60.0, 60.0, 25.0), 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    return np.asarray(np.linalg.norm(mesh - (30.0, 30.0, 15.0), axis=-1) - radius)


CENTRE, RADIUS = (1.0, 1.3), 0.15
DRAWINGS: dict[str, tuple[Callable[[Case], Any], tuple[float, float]]] = {
    "arm": (
        lambda c: arm_and_obstacle(c.arm, CENTRE, RADIUS, c.grid.coordinates(c.start), c.grid.coordinates(c.goal)),
        (7.2, 5.2),
    ),
    "slices": (
        lambda c: slices(c.arm, c.sections, c.occupancy, c.start, c.goal, [0, 10, 14, 15, 23, 30]),
        (9.6, 6.9),
    ),
    "slice paths": (
        lambda c: slice_paths(
            c.occupancy, c.start, c.goal, c.result.slice_paths, c.heads, [0, 7, c.first - 1, c.first, 20, 23]
        ),
        (9.6, 9.2),
    ),
    "motions": (
        lambda c: motions(c.arm, CENTRE, RADIUS, {"A": c.grid.coordinates(c.path)}),
        (10.4, 6.7),
    ),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_each_figure_is_a_png_of_its_size_with_something_on_it(case: Case, name: str) -> None:
    draw, inches = DRAWINGS[name]
    content = png_bytes(draw(case), dpi=80)
    with Image.open(io.BytesIO(content)) as image:
        assert image.format == "PNG"
        assert image.size == pytest.approx([80 * side for side in inches], abs=1)
        pixels = np.asarray(image.convert("RGB")).astype(int)
    inked = (pixels < 250).any(axis=2)
    assert 0.02 < inked.mean() < 0.9
    assert not inked[0].any(), "something is clipped at the top"
    assert not inked[-1].any(), "something is clipped at the bottom"
    assert not inked[:, 0].any(), "something is clipped on the left"
    assert not inked[:, -1].any(), "something is clipped on the right"


def test_the_same_figure_gives_the_same_bytes(case: Case) -> None:
    draw, _ = DRAWINGS["slices"]
    assert png_bytes(draw(case), dpi=60) == png_bytes(draw(case), dpi=60)


def test_figures_never_import_pyplot() -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(SCRIPTS)!r}); from studies.paper.figure_link_cases import link_case;"
        "from hplan.apps.view.figure_style import png_bytes; assert 'matplotlib' not in sys.modules;"
        "png_bytes(link_case(1), 40); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_matplotlib_the_error_says_what_to_install(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"figures need the extra: pip install 'hplan\[figures\]'") as caught:
        motions(case.arm, CENTRE, RADIUS, {"A": case.grid.coordinates(case.path)})
    assert caught.value.exit_status == 2
    assert caught.value.data == {"extra": "figures"}


def test_clearance_field_is_negative_exactly_on_the_occupied_nodes(case: Case) -> None:
    grid = joint_grid(case.arm, math.radians(1.0))
    occupied = cspace.occupancy(case.arm, case.sections, grid).occupied
    field = figure_data.clearance_field(case.arm, case.sections, grid)
    assert occupied.sum() == 128_891
    np.testing.assert_array_equal(field <= 0.0, occupied)


def test_half_angles_are_where_the_link_begins_to_touch() -> None:
    length, radius = 0.8, 0.19
    for rho in np.linspace(radius + 0.01, length + radius - 0.01, 40):
        half = float(figure_data.half_angles(rho, length, radius))
        for turn, touches in ((half - 1e-6, True), (half + 1e-6, False)):
            along = np.clip(rho * math.cos(turn), 0.0, length)
            distance = math.hypot(rho * math.cos(turn) - along, rho * math.sin(turn))
            assert (distance <= radius) == touches
    assert math.isnan(figure_data.half_angles(length + radius + 1e-9, length, radius))
    assert float(figure_data.half_angles(0.5 * radius, length, radius)) == math.pi


def test_reached_mask_agrees_with_the_search(case: Case) -> None:
    flat = Grid(case.grid.lower[:2], case.grid.step[:2], case.grid.shape[:2])
    for number in range(0, 31, 3):
        free = ~case.occupancy.occupied[:, :, number]
        reached = figure_data.reached_mask(free, (0, 0))
        result = dense_search(Occupancy.from_mask(flat, ~free), [0, 0], [15, 20])
        assert bool(reached[15, 20]) == (result.path is not None)
        if result.path is None:
            assert reached.sum() == result.expansions.total


def test_capsule_outline_is_everywhere_at_its_radius() -> None:
    outline = figures_arm.capsule_outline((0.3, -0.2), (1.1, 0.7), 0.05)
    axis = np.array([0.8, 0.9])
    share = np.clip(((outline - (0.3, -0.2)) @ axis) / (axis @ axis), 0.0, 1.0)
    distance = np.linalg.norm(outline - ((0.3, -0.2) + share[:, None] * axis), axis=1)
    np.testing.assert_allclose(distance, 0.05, atol=1e-12)


def test_figures_of_one_disc_refuse_other_obstacles(case: Case) -> None:
    disc = RoundedPolygon(np.array([[1.0, 1.3]]), 0.15)
    bar = RoundedPolygon(np.array([[1.0, 1.3], [1.2, 1.3]]), 0.05)
    for shapes in ([], [disc, disc], [bar]):
        sections = planar_sections(shapes, case.arm.half_widths)
        with pytest.raises(InputError, match="exactly one disc"):
            figure_data.clearance_field(case.arm, sections, case.grid)


class TestSurfaceNet:
    def test_ball(self) -> None:
        index = np.stack(np.indices((24, 24, 24)), axis=-1)
        field = np.linalg.norm(index - 11.5, axis=-1) - 8.0
        vertices, faces = surface_net(field)
        np.testing.assert_allclose(np.linalg.norm(vertices - 11.5, axis=1), 8.0, atol=0.12)
        self.assert_closed(faces)
        assert self.volume(vertices, faces) == pytest.approx(4 / 3 * math.pi * 8**3, rel=0.03)

    def test_it_is_closed_on_the_faces_of_the_grid(self) -> None:
        field = -np.ones((6, 7, 8))
        vertices, faces = surface_net(field)
        self.assert_closed(faces)
        assert self.volume(vertices, faces) == pytest.approx(5 * 6 * 7, rel=0.25)
        assert vertices.min() >= -0.01
        assert (vertices.max(axis=0) <= np.array([5, 6, 7]) + 0.01).all()

    @staticmethod
    def assert_closed(faces: IntArray) -> None:
        edges: dict[tuple[int, int], int] = {}
        for face in faces:
            for a, b in zip(face, np.roll(face, -1), strict=True):
                edges[int(a), int(b)] = edges.get((int(a), int(b)), 0) + 1
        assert all(edges.get((b, a)) == count for (a, b), count in edges.items())

    @staticmethod
    def volume(vertices: FloatArray, faces: IntArray) -> float:
        total = 0.0
        for a, b, c in ((0, 1, 2), (0, 2, 3)):
            p, q, r = (vertices[faces[:, k]] for k in (a, b, c))
            total += float(np.einsum("ij,ij->i", p, np.cross(q, r)).sum()) / 6.0
        return total


def test_hidden_is_what_lies_behind_the_ball() -> None:
    field = ball()
    points = np.array([[30.0, 50.0, 10.0], [30.0, 5.0, 10.0], [50.0, 50.0, 10.0]])
    assert hidden(field, points, np.array([0.0, -1.0, 0.0])).tolist() == [True, False, False]
