"""The table of the camera: from an array of points to a certified motion."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, number, percent

_NOTE = (
    "Times [ms] from the array of points to the certified motion, the motion of the frame before being there; parts "
    "are medians: frame to balls, tree, plan. Radius: of the balls, their growth in it. First: nothing planned yet. "
    "Query: distances of all links from all balls at one configuration. Contacts: certified motions that touch true "
    "wood or fruit, of which a camera sees one side. VAMP's CAPT (Ramsey et al., RSS 2024) is published with less than "
    "10 ns for whether one ball touches a cloud of thousands of points, for radii in a range fixed when it is built; "
    "each of its leaves holds all points that such a ball may touch, so it takes more memory the larger the range. A "
    "tree of balls takes each point once and gives distances of any link, which a proof over continuous time needs; a "
    "query grows with the logarithm of the balls."
)


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.camera` measured.
    """
    rows = tuple(
        (
            f"{int(size):,}",
            *(number(of[key], 4) for key in ("rows", "balls")),
            *(number(of[key]) for key in ("radius_mm", "filter_ms", "structure_ms", "plan_ms")),
            *(number(of["total_ms"][key]) for key in ("median", "p95")),
            number(of["first_ms"]["median"]),
            percent(of["certified"], of["frames"]),
            str(of["contacts"]),
            number(of["query_us"], 2),
        )
        for size, of in results["sizes"].items()
    )
    columns = (
        "returns", "rows", "balls", "radius [mm]", "filter", "tree", "plan", "in all", "95 %", "first", "certified",
        "contacts", "query [us]",
    )  # fmt: skip
    return [Table("Camera: frames of an orchard row to certified motions", columns, rows, _NOTE)]
