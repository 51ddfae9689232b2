from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text
from paper_run import FIGURES, measured_paper
from PIL import Image
from studies.paper.figure_two_links import SecondLink
from studies.paper.figures import figures
from studies.paper.figures_joint_space import OTHER_VIEW, VIEW, sparse_path
from studies.view.figure_data import clearance_field, pair_mask

from hplan.apps.view.figure_style import GOAL, START, png_bytes


@pytest.fixture(scope="module")
def measured() -> Any:
    return measured_paper()


@pytest.mark.parametrize("name", [*FIGURES, "overview.png"])
def test_each_figure_is_drawn_whole(measured: Any, name: str) -> None:
    drawing = figures(*measured)[name]()
    with Image.open(io.BytesIO(png_bytes(drawing, dpi=60))) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    inked = (pixels < 250).any(axis=2)
    assert 0.02 < inked.mean() < 0.9
    for edge in (inked[0], inked[-1], inked[:, 0], inked[:, -1]):
        assert not edge.any(), "something is clipped at the edge"
    if name.startswith("figure"):
        number = int(name[7:9])
        assert drawing.get_suptitle().startswith(f"Fig. {number}.  ")
        if 6 <= number <= 15:
            above_legend = pixels[: int(0.9 * len(pixels))]
            for color in (START, GOAL):
                wanted = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
                assert (np.abs(above_legend - wanted).max(axis=2) < 30).sum() >= 8, f"no marker of colour {color}"


def test_figures_of_one_run_are_the_same_bytes(measured: Any) -> None:
    for name in ("figure-07-workspace-layers.png", "figure-16-comparison.png"):
        first, second = (png_bytes(figures(*measured)[name](), dpi=50) for _ in range(2))
        assert first == second


def texts_of(drawing: Any) -> str:
    return "\n".join(text.get_text() for text in drawing.findobj(Text))


def test_figures_show_the_papers_slices_and_layers(measured: Any) -> None:
    drawings = figures(*measured)
    for name in ("figure-10-slices.png", "figure-11-slice-paths.png"):
        titles = [axes.get_title(loc="left") for axes in drawings[name]().axes[:6]]
        assert [title.split(" = ")[1].split("°")[0] for title in titles] == ["0", "22", "44", "45", "66", "70"]
    layers = [axes.get_title(loc="left") for axes in drawings["figure-07-workspace-layers.png"]().axes]
    assert [title.split(":")[0] for title in layers] == [f"z = {z}" for z in (5, 6, 12, 18, 24, 25)]


def test_numbers_in_figures_are_the_measured_ones(measured: Any) -> None:
    r, e = measured
    drawings = figures(r, e)
    for name, needed in {
        "figure-02-link-and-circle-case-1.png": ["= 14.5°", "25.5°", "54.5°"],
        "figure-03-link-and-circle-case-2.png": ["= 8.7°", "31.3°", "48.7°", "1.151 m"],
        "figure-05-two-links.png": ["0.698 m", "14.6°", "46.2°", "960 of 8,281"],
        "figure-09-cspace.png": ["128,891 of 753,571"],
        "figure-11-slice-paths.png": ["74 of 123 points kept", "130.7°, 123 points"],
        "figure-12-sparse-path.png": ["145.21°, 107 points"],
        "figure-13-execution.png": ["1.3 mm (point 67)", "(45, 60, 70)°"],
        "figure-16-comparison.png": [
            "154,647", "6,605; layers not given", "153,911", "146,296 + 5,412", "23.5 s", "2.56 s,  9.2 x faster",
            "145.800739°, 108 points", "45 slices without a path: 93,348 nodes",
        ],
    }.items():  # fmt: skip
        text = texts_of(drawings[name]())
        for part in needed:
            assert part in text, (name, part)


def test_forbidden_angles_of_the_second_link_are_those_of_the_grid(measured: Any) -> None:
    e = measured[1]
    grid = e.occupancy.grid
    second = SecondLink.over(e.robot.arm, e.sections, grid.axis(0))
    theta2 = grid.axis(1)[None, :]
    with np.errstate(invalid="ignore"):
        inside = np.abs(theta2 - second.bearing[:, None]) <= second.half[:, None]
    np.testing.assert_array_equal(inside, pair_mask(e.robot.arm, e.sections, grid))


def test_a_path_behind_the_obstacle_is_drawn_too(measured: Any) -> None:
    e = measured[1]
    grid = e.occupancy.grid
    field = clearance_field(e.robot.arm, e.sections, grid)
    labels = []
    for view in (VIEW, OTHER_VIEW):
        drawing = sparse_path(grid, field, e.plain.paths, e.plain.heads, e.plain.second.path, view=view)
        labels.append([text.get_text() for text in drawing.legends[0].get_texts()])
    assert "path" in labels[0]
    assert "path (dotted: behind)" in labels[1]
