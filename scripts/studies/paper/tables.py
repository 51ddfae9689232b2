"""The report: tables and sentences, for the terminal and as Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from studies.paper.plain import RESTORATIONS
from studies.paper.random_scenes import SearchComparison
from studies.paper.results import Reproduction

if TYPE_CHECKING:
    from rich.console import Console

Rows = list[tuple[str, ...]]

VARIANTS_TITLE = "Plain by slices searched [deg], path or first waypoint carried back, link model"


def comparison_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table beside the paper's Fig. 16."""
    paper = r.paper
    header = ("", "paper", "plain", "straight line", "hplan")
    rows: Rows = [
        ("dense A*: cost [deg]", f"{paper.dense_cost_deg:.6f}", f"{r.dense.cost:.6f}", "", ""),
        ("dense A*: points", f"{paper.dense_points}", f"{r.dense.points}", "", ""),
        ("dense A*: expansions", f"{paper.dense_expansions:,}", f"{r.dense.path_expansions:,}", "", ""),
        ("dense A*: time [ms]", f"{1e3 * paper.dense_time_s:,.0f}", f"{r.dense.total_ms:.1f}", "", ""),
    ]
    runs, by_nodes = (r.plain, r.straight, r.hplan), (r.plain, r.straight)
    rows += [
        ("two-level: cost [deg]", f"{paper.two_level_cost_deg:.6f}", *(f"{run.cost:.6f}" for run in runs)),
        ("two-level: points", f"{paper.two_level_points}", *(f"{run.points}" for run in runs)),
        ("  second level: nodes", f"{paper.two_level_expansions:,}",
         *(f"{run.path_expansions - run.settled:,}" for run in runs)),
        ("  second level: rows", "-", "-", "-", f"{r.hplan.settled:,}"),
        ("  layers: nodes", "not given", *(f"{run.layer_expansions:,}" for run in by_nodes), "-"),
        ("  layers: jump points", "-", "-", "-", f"{r.hplan.layer_expansions:,}"),
        ("  in all", "not given", *(f"{run.total_expansions:,}" for run in runs)),
        ("  flooded", "-", *(f"{run.flooded:,}" for run in runs)),
        ("two-level: time [ms]", f"{1e3 * paper.two_level_time_s:,.0f}", *(f"{run.total_ms:.1f}" for run in runs)),
        ("time, dense / two-level", f"{paper.time_ratio:.1f}",
         *(f"{r.dense.total_ms / run.total_ms:.1f}" for run in runs)),
    ]  # fmt: skip
    return header, rows


def model_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of the link models: nodes, slices with a path, dense A*."""
    header = ("link model", "occupied", "slices [deg]", "cost [deg]", "points", "expanded", "[ms]")
    rows: Rows = [
        (
            row.link_model,
            f"{row.occupied:,}",
            f"{row.first_feasible_deg}..{row.last_feasible_deg}",
            f"{row.dense_cost_deg:.6f}",
            str(row.dense_points),
            f"{row.dense_expansions:,}",
            f"{row.cspace_ms:.2f}",
        )
        for row in r.models
    ]
    rows.append(
        ("published", "-", f"from {r.paper.first_feasible_deg}", f"{r.paper.dense_cost_deg:.6f}",
         str(r.paper.dense_points), f"{r.paper.dense_expansions:,}", "-")
    )  # fmt: skip
    return header, rows


def variant_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of what the paper's text leaves open."""
    header = ("slices", "model", "cost [deg]", "points", "layers", "second", "over ties")
    rows: Rows = [
        (
            f"0..{variant.last_slice_deg}, {variant.restoration.removesuffix(' waypoint')}",
            variant.link_model,
            f"{variant.cost_deg:.6f}",
            str(variant.points),
            f"{variant.layer_expansions:,}",
            f"{variant.path_expansions:,}",
            f"{variant.ties.fewest_expansions:,}..{variant.ties.most_expansions:,}",
        )
        for variant in sorted(r.variants, key=lambda variant: RESTORATIONS.index(variant.restoration))
    ]
    paper = r.paper
    rows.append(
        ("published", "-", f"{paper.two_level_cost_deg:.6f}", str(paper.two_level_points), "-",
         f"{paper.two_level_expansions:,}", "-")
    )  # fmt: skip
    return header, rows


def demo_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of the workspace demonstration."""
    header = ("workspace", "cost", "points", "layers", "second", "in all", "time [ms]")
    rows: Rows = [
        (
            name,
            f"{run.cost:.4f}",
            str(run.points),
            f"{run.layer_expansions:,}",
            f"{run.path_expansions:,}",
            f"{run.total_expansions:,}",
            f"{run.total_ms:.1f}",
        )
        for name, run in (("dense A*", r.demo_dense), (f"two-level, {r.demo_layers} layers", r.demo_two_level))
    ]
    return header, rows


def left_open(r: Reproduction) -> list[str]:
    """What the paper's text leaves open, how it is read here, and what the other reading gives."""
    near, far = r.variant(70), r.variant(90)
    near_letter, far_letter = r.variant(70, link_model="paper"), r.variant(90, link_model="paper")
    alone = r.variant(70, "first waypoint")
    published = f"{r.paper.two_level_cost_deg:.6f} deg with {r.paper.two_level_points} points"
    return [
        f"Slices. The paper gives no range of theta3. Over 0..70 deg, from the start's slice to the goal's, the second "
        f"level expands {near.path_expansions:,} nodes ({near_letter.path_expansions:,} with the paper's own link "
        f"model), over 0..90 deg {far.path_expansions:,} ({far_letter.path_expansions:,}); the paper reports "
        f"{r.paper.two_level_expansions:,}, more than any of {near.ties.choices} choices among equally short slice "
        f"paths ({max(near.ties.most_expansions, near_letter.ties.most_expansions):,} and "
        f"{max(far.ties.most_expansions, far_letter.ties.most_expansions):,} at most). Cost and points are the same. "
        "0..70 deg runs here.",
        f'Restoration. "First waypoint propagated backward" has two readings. The one that runs here carries back the '
        f"first slice path, waypoint by waypoint from its first on, cut before contact: {near.cost_deg:.6f} deg with "
        f"{near.points} points, up to {near.ties.highest_cost_deg:.6f} deg over the ties, the paper's {published} "
        f"between them. The other carries back the first waypoint alone: the wrist alone then turns up to "
        f"{r.gap.last_without_deg} deg, and the cost is {alone.cost_deg:.6f} deg with {alone.points} points and "
        f"{alone.path_expansions:,} nodes expanded, {alone.ties.lowest_cost_deg:.6f} to "
        f"{alone.ties.highest_cost_deg:.6f} deg over the ties; no choice of slice paths gives less. It is not the "
        "paper's.",
    ]


def left_out(r: Reproduction) -> list[str]:
    """What the paper does not count."""
    total = r.plain.total_expansions
    return [
        f"The layer searches. The paper's {r.paper.two_level_expansions:,} expansions are of the order of the second "
        f"level alone ({r.plain.path_expansions:,} here). Before it, a plain A* in {r.gap.layers_searched} slices "
        f"expands {r.plain.layer_expansions:,} nodes, {r.gap.expansions_without:,} of them in the "
        f"{r.gap.layers_without} slices that have no path. In all {total:,}, against {r.dense.total_expansions:,} "
        f"for the dense A*: {total / r.dense.total_expansions:.2f} of it, not "
        f"{r.paper.two_level_expansions / r.paper.dense_expansions:.3f}.",
        f"The total time. Its {r.paper.two_level_time_s:g} s stand beside the expansions of the second level, and its "
        f"dense A* takes {r.paper.dense_time_s:g} s, {r.paper.time_ratio:.1f} times as long. Here the plain run takes "
        f"{r.plain.total_ms:.0f} ms, {r.plain.layer_ms:.0f} ms of it in the layers; the dense A* "
        f"{r.dense.total_ms:.0f} ms, {r.dense.total_ms / r.plain.total_ms:.1f} times as long; hplan's two levels "
        f"{r.hplan.total_ms:.1f} ms.",
        "What happens where restoration does not reach: a gap on the goal's side or in the middle, or no slice with a "
        "path. The method as printed is not complete.",
    ]


def differences(r: Reproduction) -> list[str]:
    """Where hplan differs from the paper."""
    link, plane, ties = r.slip_link_frame, r.slip_arm_plane, r.ties
    own = next(row for row in r.models if row.link_model == "paper")
    goal = "the goal is free" if link.goal_is_free else "the goal itself is forbidden"
    return [
        f"Bearing. The paper prints arctan(x/y). With x and y in the frame of the link before, {goal}: "
        f"{link.feasible_slices or 'no'} slice has a path, and {'one' if link.cost_deg else 'none'} exists in 3-D. "
        f"With x and y in the arm plane {plane.feasible_slices} slices have one and the dense cost is "
        f"{plane.cost_deg or math.inf:.6f} deg. Read as arctan2(y, x), slices, cost and points are the paper's.",
        f"Ties. Many slice paths are equally short, and which one a search returns decides what the second level can "
        f"use. Over {ties.choices} choices its cost goes from {ties.lowest_cost_deg:.6f} to "
        f"{ties.highest_cost_deg:.6f} deg with {ties.fewest_points} to {ties.most_points} points; the paper's "
        f"{r.paper.two_level_cost_deg:.6f} deg with {r.paper.two_level_points} lies between. The dense A* has ties "
        f"too: with the paper's own link model it expands {own.dense_expansions:,} nodes here, "
        f"{r.paper.dense_expansions:,} in the paper.",
        f"Flooding. hplan settles which slices have a path by bit-parallel flooding ({r.straight.flooded:,} nodes, 64 "
        f"at once) and searches only those: by the same A* {r.straight.layer_expansions:,} nodes instead of "
        f"{r.plain.layer_expansions:,}.",
        f"Jump points. By default hplan searches a slice by jump points and takes {r.hplan.layer_expansions:,} of them "
        "from the open lists. Each is found by scans over many nodes, which are not counted: the number is no count "
        "of nodes and does not compare with those beside it. The times do.",
        f"Bound. By default the second level is searched with a bound that knows its graph. It takes "
        f"{r.hplan.settled:,} rows from open lists beforehand (each row once for each of two weights) and then "
        f"{r.hplan.path_expansions - r.hplan.settled:,} nodes: {r.hplan.path_expansions:,} entries, where the "
        f"straight-line bound takes {r.straight.path_expansions:,} nodes on a union of other, equally short paths.",
        "Restoration. The paper carries the first path back towards the start; hplan also carries the last one on "
        "towards the goal and closes gaps in the middle from both sides. Where that does not join start and goal, all "
        "slices of the grid are tried, not only those between the two. Where that fails too, the grid is flooded: a "
        "dense search follows, or the proof that there is no path.",
    ]


def columns_text() -> str:
    """What the columns of the comparison are."""
    return (
        "plain: the paper's method to the letter. straight line: hplan's two-level search with plain A* and the "
        "paper's bound. hplan: the same as it is by default, with jump points in the layers and, in the second level, "
        "a bound for which rows are settled first. Nodes, rows and jump points are counted as they are taken from the "
        "open lists; they are not the same work. Flooded nodes are not counted with them."
    )


def gap_text(r: Reproduction) -> str:
    """The feasibility gap in a sentence."""
    gap = r.gap
    return (
        f"theta3 = {gap.last_without_deg} deg has no path (the start reaches {gap.reached_without:,} nodes of the "
        f"slice), {gap.first_with_deg} deg has one ({gap.reached_with:,} nodes). The paper: from "
        f"{r.paper.first_feasible_deg} deg."
    )


def scene_rows(c: SearchComparison) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of the random scenes."""

    def share(part: int, whole: int) -> str:
        return f"{100.0 * part / whole:.1f} %" if whole else "-"

    def ratio(value: float | None) -> str:
        return "-" if value is None else f"{value:.4f}"

    found = sum(c.fallbacks.values())
    header = ("", "number", "share")
    rows: Rows = [
        ("scenes", f"{c.scenes:,}", ""),
        ("  the searches disagree on feasibility", f"{c.disagree:,}", share(c.disagree, c.scenes)),
        ("  without a path", f"{c.scenes - c.with_path:,}", share(c.scenes - c.with_path, c.scenes)),
        ("  with a path", f"{c.with_path:,}", share(c.with_path, c.scenes)),
        ("paths of the two-level search", f"{found:,}", ""),
        ("  slices between start and goal suffice", f"{c.fallbacks['none']:,}", share(c.fallbacks["none"], found)),
        ("  all slices are needed", f"{c.fallbacks['all_slices']:,}", share(c.fallbacks["all_slices"], found)),
        ("  the dense search is needed", f"{c.fallbacks['dense']:,}", share(c.fallbacks["dense"], found)),
        ("cost, two-level / dense", "", ""),
        ("  median", ratio(c.ratio_median), ""),
        ("  99th percentile", ratio(c.ratio_high), ""),
        ("  worst", ratio(c.ratio_worst), ""),
    ]
    return header, rows


def scenes_title(c: SearchComparison) -> str:
    """What is compared."""
    return f"Two-level and dense search on random scenes, seed {c.seed}"


def markdown(r: Reproduction, scenes: SearchComparison | None = None) -> str:
    """The report as Markdown."""

    def table(header: tuple[str, ...], rows: Rows) -> str:
        lines = ["| " + " | ".join(header) + " |", "|---" + "|---:" * (len(header) - 1) + "|"]
        return "\n".join([*lines, *("| " + " | ".join(cell.strip() for cell in row) + " |" for row in rows)])

    blocks = [
        table(*comparison_rows(r)),
        columns_text(),
        f"The feasibility gap: {gap_text(r)}",
        f"The link models: occupied nodes of {r.nodes:,}, slices with a path, dense A*, time of the C-space [ms].",
        table(*model_rows(r)),
        "The workspace demonstration, straight-line bound: cost in its own unit; expansions of the layers, of the "
        "second level and in all.",
        table(*demo_rows(r)),
        VARIANTS_TITLE + ": second-level cost and points; nodes expanded in the layers, by the second level, and by it "
        f"over {r.ties.choices} choices among equally short slice paths.",
        table(*variant_rows(r)),
        "What the paper's text leaves open:\n\n" + "\n".join(f"- {text}" for text in left_open(r)),
        "What the paper leaves out:\n\n" + "\n".join(f"- {text}" for text in left_out(r)),
        "Where hplan differs:\n\n" + "\n".join(f"- {text}" for text in differences(r)),
    ]
    if scenes is not None:
        blocks += [f"{scenes_title(scenes)}: 1 to 12 discs, start and goal free.", table(*scene_rows(scenes))]
    return "\n\n".join(blocks) + "\n"


def show(r: Reproduction, console: Console, scenes: SearchComparison | None = None) -> None:
    """Print the report."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    def table(title: str, header: tuple[str, ...], rows: Rows) -> None:
        result = Table(
            title=Text(title, style="bold"),
            title_justify="left",
            header_style="bold",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
        )
        for place, name in enumerate(header):
            style = "yellow" if name == "paper" else ""
            result.add_column(Text(name), justify="right" if place else "left", style=style)
        for row in rows:
            result.add_row(*(Text(cell, no_wrap=True) for cell in row))
        console.print()
        console.print(result)

    table("Fig. 16: dense A* and the two-level method", *comparison_rows(r))
    console.print(Text(columns_text(), style="dim"))
    console.print("\n[bold]The feasibility gap[/bold]")
    console.print(gap_text(r), markup=False)
    table(f"Link models: occupied of {r.nodes:,}, slices with a path, dense A*, C-space [ms]", *model_rows(r))
    table("The workspace demonstration, straight-line bound: cost in its own unit", *demo_rows(r))
    table(f"{VARIANTS_TITLE}: nodes expanded", *variant_rows(r))
    for title, texts in (
        ("What the paper's text leaves open", left_open(r)),
        ("What the paper leaves out", left_out(r)),
        ("Where hplan differs", differences(r)),
    ):
        console.print(f"\n[bold]{title}[/bold]")
        items = Table.grid(padding=(0, 1))
        for text in texts:
            items.add_row("-", Text(text))
        console.print(items)
    if scenes is not None:
        table(scenes_title(scenes), *scene_rows(scenes))
