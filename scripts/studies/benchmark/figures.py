"""The numbers as pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.view.figure_style import GOAL, INK, OBSTACLE, PATH, QUIET, RESTORED, START, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOK = {
    "dense": (OBSTACLE, "dense A*"),
    "plan": (QUIET, "scene to certified motion"),
    "two_level": (PATH, "two-level search"),
    "cspace": (START, "C-space"),
}
_AXES = {"step": "nodes of the grid", "obstacles": "obstacles", "links": "nodes of the grid"}
_TITLES = {"step": "finer grid", "obstacles": "more obstacles", "links": "more links"}


def figures(results: dict[str, Any]) -> dict[str, Figure]:
    """All figures of a run, by file name without suffix."""
    found: dict[str, Figure] = {}
    if "reference" in results:
        found["benchmark-reference"] = reference(results["reference"])
    if "clutter" in results and results["clutter"]["rows"]:
        found["benchmark-clutter"] = clutter(results["clutter"])
    if "orchards" in results and results["orchards"]["all"]["solved"]:
        found["benchmark-orchards"] = orchards(results["orchards"])
    if "replanning" in results and results["replanning"]["replanned"]:
        found["benchmark-replanning"] = replanning(results["replanning"])
    if "growth" in results:
        found["benchmark-growth"] = growth(results["growth"])
    return found


@styled
def reference(r: dict[str, Any]) -> Figure:
    """Stages, searches and durations on the reference scene."""
    figure = new_figure(11.0, 4.3, "Reference scene")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.0, 0.85, 1.25])
    stages = r["stages_ms"]
    names = [name for name in stages if not name.startswith("total") and stages[name] > 0.01]
    _bars(left, names, [stages[name] for name in names], [PATH] * len(names), "{:.2f}")
    left.set_title(f"Time by stage: {stages['total']:.1f} ms in all")
    left.set_xlabel("CPU time [ms]")

    s, c = r["searches"], r["cspace"]
    pairs = [
        ("two-level", s["two_level"]["ms"], PATH),
        ("dense A*", s["dense"]["ms"], OBSTACLE),
        ("C-space", c["analytic_ms"], PATH),
        ("coal at each node", c["coal_ms"], OBSTACLE),
    ]
    _bars(middle, [p[0] for p in pairs], [p[1] for p in pairs], [p[2] for p in pairs], "{:.3g}")
    middle.set_xscale("log")
    middle.set_xlim(0.03, 30.0 * c["coal_ms"])
    middle.set_title(f"Search {s['ratio_dense']:.0f} x, C-space {c['ratio_coal']:,.0f} x")
    middle.set_xlabel("CPU time [ms]")

    m = r["motions"]["rows"]
    rows = [
        ("hplan", m["hplan"]["duration_s"], PATH),
        ("hplan, shortest path", m["hplan_length"]["duration_s"], PATH),
        ("(b) stops at corners", m["taut_stops"]["duration_s"], QUIET),
        ("(a) grid path, toppra", m["grid_spline"]["duration_s"], OBSTACLE),
    ]
    for name, p in (r["planners"] or {}).items():
        label = name.replace("BITstar", "BIT*")
        usable = f"{p['spline']['usable']} of {p['problems']} fit to run"
        rows.append((f"{label}, spline\n({usable})", p["spline"]["duration_s"], OBSTACLE))
        rows.append((f"{label},\nhplan's rounding", p["rounded"]["duration_s"], RESTORED))
    _bars(right, [row[0] for row in rows], [row[1] for row in rows], [row[2] for row in rows], "{:.2f}")
    right.set_title("Duration of the motion (medians)")
    right.set_xlabel("[s]")
    return figure


def _bars(axes: Axes, names: list[str], values: list[float], colours: list[str], text: str) -> None:
    """Horizontal bars, the first on top, each with its value."""
    y = np.arange(len(names))
    shown = [value if np.isfinite(value) else 0.0 for value in values]
    axes.barh(y, shown, color=colours, height=0.68)
    for place, value in zip(y, shown, strict=True):
        axes.annotate(text.format(value), (value, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(y, names)
    axes.invert_yaxis()
    axes.margins(x=0.16)
    axes.tick_params(axis="y", length=0)


@styled
def clutter(c: dict[str, Any]) -> Figure:
    """Distributions over the clutter scenes."""
    figure = new_figure(11.0, 4.6, f"{c['scenes']} scenes of clutter, {c['with_path']} with a path")
    left, middle, right = figure.subplots(1, 3)
    rows = c["rows"]
    series = [("hplan, certified motion", [row["total_ms"] for row in rows], PATH)]
    for planner, colour in (("RRTConnect", OBSTACLE), ("BITstar", GOAL)):
        found = [row[planner]["ms"] for row in rows if planner in row and "length_deg" in row[planner]]
        if found:
            series.append((f"{planner.replace('BITstar', 'BIT*')}, path only", found, colour))
    for name, values, colour in series:
        _distribution(left, values, colour, name)
    left.set_xscale("log")
    left.set_title("Time")
    left.set_xlabel("CPU time [ms]")
    left.set_ylabel("share of scenes")
    _legend(left)

    _distribution(middle, [row["search_ratio"] for row in rows], PATH, "all scenes")
    _distribution(middle, [row["search_ratio"] for row in rows if not row["direct"]], START, "around obstacles")
    middle.set_xscale("log")
    middle.set_xticks([2, 5, 10, 20, 50, 100, 200], ["2", "5", "10", "20", "50", "100", "200"])
    middle.minorticks_off()
    middle.set_xlim(0.8 * c["search_ratio"]["min"], 1.25 * c["search_ratio"]["max"])
    middle.set_title(f"Dense A* : two-level, median {c['search_ratio']['median']:.1f}")
    middle.set_xlabel("ratio of times")
    _legend(middle)

    for key, name, colour in (
        ("to_grid_spline", "(a) grid path, toppra", OBSTACLE),
        ("to_stops", "(b) stops at corners", RESTORED),
    ):
        _distribution(right, [row[key] for row in rows], colour, name)
    right.axvline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    right.set_title("Duration of hplan's motion to that of")
    right.set_xlabel("ratio of durations (below 1: hplan is quicker)")
    _legend(right)
    return figure


@styled
def orchards(o: dict[str, Any]) -> Figure:
    """Distributions over the problems in orchards, and what carried hplan's motions."""
    everything = o["all"]
    figure = new_figure(11.0, 4.6, f"{everything['problems']} problems in orchards, {everything['solved']} solved")
    left, middle, right = figure.subplots(1, 3)
    rows = [row for row in o["rows"] if row["solved"]]
    _distribution(left, [row["ms"] for row in rows], PATH, "hplan, certified motion")
    for planner, colour in (("RRTConnect", OBSTACLE), ("BITstar", GOAL)):
        found = [row[planner]["ms"] for row in rows if planner in row and row[planner]["solved"]]
        if found:
            _distribution(left, found, colour, f"{planner.replace('BITstar', 'BIT*')}, path only")
    left.set_xscale("log")
    left.set_title(f"Time, median {everything['ms']['median']:.0f} ms")
    left.set_xlabel("CPU time [ms]")
    left.set_ylabel("share of problems")
    _legend(left)

    for key, name, colour in (
        ("to_rounded", "their paths with rounded corners", RESTORED),
        ("to_processed", "their paths by hplan's post", OBSTACLE),
    ):
        _distribution(middle, [row[key] for row in rows], colour, name)
    middle.axvline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    middle.set_title("Duration of hplan's motion to that of OMPL's best")
    middle.set_xlabel("ratio of durations (below 1: hplan is quicker)")
    if o["planners"] is not None:
        _legend(middle)

    routes = sorted(everything["routes"].items(), key=lambda item: -item[1])
    _bars(right, [name for name, _ in routes], [count for _, count in routes], [PATH] * len(routes), "{:.0f}")
    right.set_title("What carried hplan's motions")
    right.set_xlabel("problems")
    return figure


@styled
def replanning(r: dict[str, Any]) -> Figure:
    """Distributions over the steps, by what became of the motion."""
    figure = new_figure(11.0, 4.6, f"{r['steps']:,} steps among {r['obstacles']} obstacles, one moves in each")
    left, right = figure.subplots(1, 2)
    rows = [row for row in r["rows"] if "certified" in row]
    groups = (
        ("kept", [row for row in rows if row["outcome"] == "kept"], PATH),
        ("mended", [row for row in rows if row["outcome"] == "mended"], RESTORED),
        ("anew", [row for row in rows if row["outcome"] not in ("kept", "mended")], OBSTACLE),
    )
    _distribution(left, [row["ms"] for row in rows], INK, "replanned")
    _distribution(left, [row["from_nothing_ms"] for row in rows], QUIET, "from nothing")
    for name, chosen, colour in groups:
        _distribution(left, [row["ms"] for row in chosen], colour, f"replanned, motion {name}: {len(chosen)}")
        _distribution(right, [row["to_from_nothing"] for row in chosen], colour, f"motion {name}")
    left.set_xscale("log")
    left.set_title(f"Time, median {r['all']['ms']['median']:.1f} and {r['all']['from_nothing_ms']['median']:.0f} ms")
    left.set_xlabel("CPU time [ms]")
    left.set_ylabel("share of steps")
    _legend(left)
    right.axvline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    right.set_title("Duration of the motion, replanned : from nothing")
    right.set_xlabel("ratio of durations (above 1: the replanned motion is slower)")
    _legend(right)
    return figure


def _legend(axes: Axes) -> None:
    """A legend below the axes, where it hides nothing."""
    axes.legend(loc="upper left", bbox_to_anchor=(-0.02, -0.17), fontsize=8, borderpad=0.0, labelspacing=0.3)


def _distribution(axes: Axes, values: list[float], colour: str, name: str) -> None:
    """Empirical distribution function."""
    ordered = np.sort([value for value in values if np.isfinite(value)])
    if len(ordered):
        axes.step(ordered, np.arange(1, len(ordered) + 1) / len(ordered), where="post", color=colour, label=name)
    axes.set_ylim(0.0, 1.02)


@styled
def growth(g: dict[str, Any]) -> Figure:
    """Time and memory against nodes and obstacles, with fitted exponents."""
    from matplotlib.ticker import NullFormatter

    figure = new_figure(11.0, 7.8, "Growth, with fitted exponents")
    panels = figure.subplots(2, 3)
    for column, (axis, label) in enumerate(_AXES.items()):
        cases, slopes = g[axis]["cases"], g[axis]["slopes"]
        sizes = np.array([case["size"] if axis == "obstacles" else case["nodes"] for case in cases], dtype=float)
        for row, (unit, names) in enumerate((("ms", tuple(_LOOK)), ("mb", ("dense", "two_level")))):
            axes = panels[row, column]
            for name in names:
                values = np.array([case[f"{name}_{unit}"] for case in cases], dtype=float)
                colour, text = _LOOK[name]
                kept = np.isfinite(values) & (values > 0.0)
                slope = slopes[f"{name}_{unit}"]
                shown = f"{text}: {slope:+.2f}" if np.isfinite(slope) else text
                axes.plot(sizes[kept], values[kept], "o-", color=colour, markersize=4, linewidth=1.5, label=shown)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.grid(visible=True, which="major", color="#E8ECEF", linewidth=0.7)
            axes.set_axisbelow(True)
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.set_xlabel(label)
            _legend(axes)
        panels[0, column].set_title(_TITLES[axis])
        if axis != "obstacles":
            panels[1, column].set_xlim(panels[0, column].get_xlim())  # a case too small to measure has its place too
            for case, size in zip(cases, sizes, strict=True):
                name = f"{case['size']:g}" + ("°" if axis == "step" else " links")
                panels[1, column].annotate(
                    name, (size, 1.0), (0, 3), xycoords=("data", "axes fraction"), textcoords="offset points",
                    ha="center", fontsize=7.5, color=QUIET,
                )  # fmt: skip
    panels[0, 0].set_ylabel("CPU time [ms]")
    panels[1, 0].set_ylabel("memory [MB]")
    return figure
