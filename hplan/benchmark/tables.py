"""The numbers as tables, for the terminal and for Markdown; ratios first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from hplan.benchmark.growth import QUANTITIES

NOT_INSTALLED = "not installed"

#: What stands where there is no number.
NONE = "-"

#: Ways to make a motion of a planner's path, as in `hplan.benchmark.paths`.
_WAYS = {"spline": "spline", "rounded": "rounding", "processed": "hplan's post"}


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
        title: What it shows.
        columns: Headings; the first column holds names, the others numbers.
        rows: Cells.
        note: What one must know to read it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def tables(results: dict[str, Any]) -> list[Table]:
    """All tables of a run."""
    found: list[Table] = []
    makers = {
        "reference": _reference,
        "clutter": _clutter,
        "orchards": _orchards,
        "replanning": _replanning,
        "recheck": _recheck,
        "growth": _growth,
    }
    for name, make in makers.items():
        if name in results:
            found.extend(make(results[name]))
    return found


def to_markdown(results: dict[str, Any]) -> str:
    """The whole run as Markdown."""
    lines = [f"{preamble(results)}\n"]
    for table in tables(results):
        lines.append(f"**{table.title}**\n")
        lines.append(_row(table.columns))
        lines.append("|---|" + "---:|" * (len(table.columns) - 1))
        lines.extend(_row(row) for row in table.rows)
        lines.append(f"\n{table.note}\n" if table.note else "")
    return "\n".join(lines).rstrip() + "\n"


def show(console: Console, results: dict[str, Any]) -> None:
    """The whole run on a terminal."""
    console.print(f"\n{preamble(results)}", markup=False)
    for table in tables(results):
        drawn = RichTable(box=box.SIMPLE_HEAD, padding=(0, 1))
        for number, column in enumerate(table.columns):
            drawn.add_column(escape(column), justify="right" if number else "left", no_wrap=number == 0)
        for row in table.rows:
            drawn.add_row(*(escape(cell) for cell in row))
        console.print(f"\n[bold]{escape(table.title)}[/]")
        console.print(drawn)
        if table.note:
            console.print(table.note, markup=False, style="dim")
    console.print()


def preamble(results: dict[str, Any]) -> str:
    """What was run, and on what."""
    where, how = results["environment"], results["settings"]
    packages = ", ".join(f"{name} {version}" for name, version in where["versions"].items())
    quick = " Quick run: few repetitions." if how["quick"] else ""
    return (
        f"{where['processor']}, {where['cores']} cores, {where['system']}, Python {where['python']}; {packages}. "
        f"Seed {how['seed']}. Times are medians of CPU time on one thread, after a first call that does not count; "
        f"`x` is how many times hplan's it is.{quick}"
    )


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits; a dash for none."""
    if value is None or not math.isfinite(value):
        return NONE
    if value != 0.0 and abs(value) >= 10.0 ** (digits - 1):
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def _times(value: float) -> str:
    return f"{number(value)} x" if math.isfinite(value) else NONE


# The reference scene


def _reference(r: dict[str, Any]) -> list[Table]:
    return [_stages(r), _parts(r), _motions(r), *_planners(r)]


def _stages(r: dict[str, Any]) -> Table:
    stages = r["stages_ms"]
    names = [name for name in stages if not name.startswith("total")]
    rest = stages["total"] - sum(stages[name] for name in names)
    rows = [(name, number(stages[name]), _percent(stages[name], stages["total"])) for name in names if stages[name]]
    rows.append(("scene set up, checks, report", number(rest), _percent(rest, stages["total"])))
    rows.append(("scene to certified trajectory", number(stages["total"]), "100 %"))
    note = f"Wall-clock time of the whole: {number(stages['total_wall'])} ms. Warm, median of {r['repetitions']}."
    return Table("Reference scene: time by stage", ("stage", "ms", "share"), tuple(rows), note)


def _percent(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.0f} %"


def _parts(r: dict[str, Any]) -> Table:
    s, c = r["searches"], r["cspace"]
    fast, space = s["two_level"], c["analytic_ms"]

    def search(name: str, key: str) -> tuple[str, ...]:
        ms = s[key]["ms"]
        return name, _times(ms / fast["ms"]), number(fast["ms"]), number(ms), f"{s[key]['expansions']:,} expansions"

    rows = (
        search("dense A*", "dense"),
        search("dense A*, octile bound", "dense_octile"),
        search("the paper's two-level method", "two_level_paper"),
        (
            "C-space: coal at each node",
            _times(c["ratio_coal"]),
            number(space),
            number(c["coal_ms"]),
            f"{c['differing_nodes']} nodes differ",
        ),
        (
            f"C-space: {c['many_discs']} discs",
            NONE,
            number(c["many_ms"]),
            NONE,
            f"{number(c['many_grid_ms'])} ms for the grid; {_percent(c['many_occupied_share'], 1.0)} occupied",
        ),
    )
    note = (
        f"The C-space has {c['nodes']:,} nodes. Both stages of the two-level search: "
        f"{fast['expansions']:,} expansions and {fast['flooded']:,} flooded "
        f"cells, cost {fast['cost_deg']:.6f} deg with {fast['points']} points (dense: {s['dense']['cost_deg']:.6f} "
        f"with {s['dense']['points']})."
    )
    return Table("Reference scene: search and C-space", ("peer", "ratio", "hplan [ms]", "peer [ms]", ""), rows, note)


_MOTIONS = {
    "hplan": "hplan",
    "hplan_length": "hplan, objective length",
    "hplan_no_jerk": "hplan, jerk not limited",
    "grid_spline": "(a) grid path, toppra",
    "grid_defaults": "grid path, toppra's defaults",
    "taut_stops": "(b) shortened, stops at corners",
    "taut_spline": "shortened, toppra",
    "taut_defaults": "shortened, toppra's defaults",
}


def _motions(r: dict[str, Any]) -> Table:
    rows = []
    for key, name in _MOTIONS.items():
        m = r["motions"]["rows"][key]
        rows.append((name, _times(m["ratio"]), f"{m['duration_s']:.3f}", f"{m['length_deg']:.2f}", _verdict(m)))
    m = r["motions"]
    corners = m["rows"]["taut_stops"]["corners"]
    note = (
        f"hplan takes {number(m['hplan_to_grid_spline'])} of (a) and {number(m['hplan_to_stops'])} of (b); without a "
        f"jerk limit, which no recipe here has, {number(m['no_jerk_to_grid_spline'])} and "
        f"{number(m['no_jerk_to_stops'])}. toppra gets a cubic spline through the waypoints and is used as advised "
        "(parameters by length, waypoints among the grid points, ParametrizeConstAccel, interpolation) or by its "
        f"defaults. (b) stops at {corners} corners, the quickest of several shortened paths. Verdicts on recipes: "
        "samples every 1 ms, derivatives by differences."
    )
    columns = ("motion", "to hplan's", "[s]", "[deg]", "verdict")
    return Table("Reference scene: the motion", columns, tuple(rows), note)


def _verdict(m: dict[str, Any]) -> str:
    if m["certified"]:
        return "certified" if "velocity" in m else "shown clear"
    faults = []
    if m.get("collides"):
        faults.append(f"{number(m['depth_mm'], 2)} mm deep")
    if m.get("leaves_range"):
        faults.append(f"{number(m['outside_deg'], 2)} deg out of range")
    faults += [f"{what} x {m[what]:.3f}" for what in ("velocity", "acceleration", "torque") if m.get(what, 0.0) > 1.001]
    return ", ".join(faults) or "no fault seen"


_PLANNER_COLUMNS = ("planner, motion", "to hplan's", "in all [ms]", "path [ms]", "compiled [ms]", "path [deg]", "fit")

_PLANNER_NOTE = (
    "Duration of the motion to that of hplan's, time to the motion, time to the path, its length; only hplan's times "
    "contain setting up and checking the scene. OMPL asks "
    "hplan's compiled kernel about whole motions by way of Python; `compiled` is an estimate of the time to the path "
    "with the Python part of those calls taken out. RRTConnect stops at its first path, BIT* when its time is up (or "
    "the straight line is found clear), after 1 s at most; both simplify. A path becomes a motion by a spline (cubic, "
    "through the waypoints, toppra as advised, no limit on jerk), by rounding (hplan's corner rounding and timing), "
    "or by hplan's post (all of its post-processing). Fit: certified; for splines no fault seen in samples every 1 ms."
)


def _planners(r: dict[str, Any]) -> list[Table]:
    stages = r["stages_ms"]
    path_ms = number(stages["total"] - sum(stages[name] for name in ("postprocess", "timing", "certificate")))
    grid = number(r["searches"]["two_level"]["cost_deg"], 4)
    first = ("hplan", "1 x", number(stages["total"]), path_ms, path_ms, grid, "1 of 1")
    length = r["motions"]["rows"]["hplan"]["length_deg"]
    note = f"{_PLANNER_NOTE} hplan's path here is that on the grid; its motion is {length:.1f} deg long."
    return _planner_tables("Reference scene", first, r["planners"], note)


def _planner_tables(where: str, first: tuple[str, ...], planners: dict[str, Any] | None, note: str) -> list[Table]:
    """Times and durations, then the faults of splines; just the word where OMPL is not installed."""
    rows, faults = [first], []
    if planners is None:
        rows += [(f"OMPL {name}", NOT_INSTALLED, *[""] * (len(first) - 2)) for name in ("RRTConnect", "BIT*")]
    for name, p in (planners or {}).items():
        label = name.replace("BITstar", "BIT*")
        for way, text in _WAYS.items():
            w = p[way]
            count = w["usable"] if way == "spline" else w["certified"]
            times = number(w["total_ms"]), number(p["path_ms"]), number(p["compiled_ms"])
            length = number(p["length_deg"], 4)
            rows.append((f"{label}, {text}", _times(w["ratio"]), *times, length, f"{count} of {p['problems']}"))
        w = p["spline"]
        faults.append(
            (
                label,
                f"{w['colliding']} of {w['timed']}",
                number(w["worst_depth_mm"]),
                str(w["outside_range"]),
                number(w["worst_outside_deg"]),
                str(w["over_limits"]),
                f"{p['rounded']['faster_than_hplan']}",
                f"{p['processed']['faster_than_hplan']}",
            )
        )
    found = [Table(f"{where}: sampling planners", _PLANNER_COLUMNS, tuple(rows), note)]
    if faults:
        columns = (
            "planner",
            "collide",
            "deepest [mm]",
            "out of range",
            "farthest [deg]",
            "over limits",
            "quicker by rounding",
            "quicker by hplan's post",
        )
        text = (
            "How many splines collide, leave the joint range or break a velocity, acceleration or torque limit by more "
            "than 0.1 %; then how many certified motions along the planner's path are quicker than hplan's own."
        )
        found.append(Table(f"{where}: faults of splines, and where planners win", columns, tuple(faults), text))
    return found


# Clutter


def _clutter(c: dict[str, Any]) -> list[Table]:
    around = c["around"]

    def ratio(name: str, key: str, *, inverse: bool = False) -> tuple[str, ...]:
        values, part = c[key], around[key]
        cells = [values["median"], part["median"], values["p95"], values["max"]]
        return name, *(number(1.0 / v if inverse else v, 4) for v in cells)

    t, a = c["total_ms"], around["total_ms"]
    rows = (
        ratio("dense A* : two-level, time", "search_ratio"),
        ratio("two-level : dense A*, cost", "cost_ratio"),
        ratio("duration, hplan : (a) grid path through toppra", "to_grid_spline"),
        ratio("the same, jerk not limited", "no_jerk_to_grid_spline"),
        ratio("duration, hplan : (b) straight with stops", "to_stops"),
        ratio("the same, jerk not limited", "no_jerk_to_stops"),
        ("scene to certified trajectory [ms]", *(number(v) for v in (t["median"], a["median"], t["p95"], t["max"]))),
    )
    found = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in c["fallbacks"].items())
    note = (
        f"{c['scenes']} scenes, {c['with_path']} with a path on the grid: {c['planned']} planned, {c['certified']} "
        f"certified; of {c['blocked']} without one, hplan and the dense search agree on all but {c['disagreeing']}. "
        f"Around obstacles: the {around['scenes']} scenes where the straight motion is not clear. 99th percentile of "
        f"the time: {number(t['p99'])} ms. Median length {number(c['length_deg'])} deg, duration "
        f"{number(c['duration_s'])} s. Cost optimal in {c['cost_ratio']['optimal']} of {c['planned']}. "
        f"Fallbacks: {found}."
    )
    columns = ("", "median", "around obstacles", "95 %", "largest")
    first = Table("Clutter: ratios and times", columns, rows, note)
    ours = (
        "hplan",
        "1 x",
        number(t["median"]),
        NONE,
        NONE,
        number(c["length_deg"]),
        f"{c['certified']} of {c['with_path']}",
    )
    note = f"{_PLANNER_NOTE} Medians over the scenes solved. hplan's length is that of its motions."
    planners = _planner_tables("Clutter", ours, c["planners"], note)
    return [first, *planners, *_failures("Clutter", c["failed"])]


def _failures(where: str, failed: Sequence[dict[str, Any]]) -> list[Table]:
    if not failed:
        return []
    rows = tuple(
        (str(f["number"]), f["kind"], number(f.get("spare_clearance_mm")), f["message"][:120]) for f in failed[:20]
    )
    columns = ("scene", "error", "clearance at start or goal [mm]", "message")
    return [Table(f"{where}: scenes that failed ({len(failed)})", columns, rows)]


# Orchards


#: Problems that are listed by name, at most, the worst first.
_LISTED = 30


def _orchards(o: dict[str, Any]) -> list[Table]:
    everything = o["all"]
    times = everything["ms"]
    first = (
        "hplan",
        "1 x",
        number(times["median"]),
        NONE,
        NONE,
        number(everything["length_deg"]),
        f"{everything['certified']} of {everything['problems']}",
    )
    note = (
        f"{_PLANNER_NOTE} Here RRTConnect has {o['patience_s']:g} s, and BIT* {o['improving_s']:g} s; where hplan or "
        f"RRTConnect finds nothing, it has {o['patience_s']:g} s too. Medians over the problems that both solve. "
        "hplan's length is that of its motions."
    )
    planners = _planner_tables("Orchards", first, o["planners"], note)
    return [_fruits(o), _solved(o), _routes(o), _durations(o), *planners, *_to_look_at(everything)]


def _fruits(o: dict[str, Any]) -> Table:
    rows = []
    for group, f in o["fruits"].items():
        without = dict(f["without"])
        blocked, straight = without.pop("blocked", 0), without.pop("no_approach", 0)
        why = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in sorted(without.items()))
        rows.append((group, *map(str, (f["orchards"], f["fruits"], f["goals"], blocked, straight)), why or "0"))
    note = (
        "All four joints move. Goals: fruits with a grasp that is clear but for the last link at the fruit itself, and "
        "has a clear straight approach of 0.1 m; the others are a goal for no planner. Problems: from the tucked home "
        "pose to where the approach to each of them begins, and from each of these places to the next. All fruits are "
        "obstacles. Measured trees stand alone, their trunk that far in front of the base; fruit hangs at the tips of "
        "branches, those within reach first."
    )
    blocked_home = [name for f in o["fruits"].values() for name in f["home_not_clear"]]
    if blocked_home:
        note += f" Home is not clear, so nothing begins there: {', '.join(blocked_home)}."
    if o["without_trees"] is not None:
        note += f" No measured trees: {o['without_trees']}."
    columns = ("orchards", "number", "fruits", "goals", "blocked", "no approach", "out of reach")
    return Table("Orchards: fruits", columns, tuple(rows), note)


def _solved(o: dict[str, Any]) -> Table:
    rows = []
    for group, n in {**o["groups"], "all": o["all"]}.items():
        theirs = [str(n["planners"].get(name, NONE)) for name in ("RRTConnect", "BITstar")]
        ms = [number(n["ms"][key]) for key in ("median", "p95", "p99", "max")]
        counts = str(n["problems"]), str(n["solved"]), *theirs, str(len(n["missed"])), str(n["certified"])
        rows.append((group, *counts, *ms))
    note = (
        f"Solved by each planner; missed: by OMPL, and not by hplan. RRTConnect has {o['patience_s']:g} s, BIT* "
        f"{o['improving_s']:g} s, and {o['patience_s']:g} s where hplan or RRTConnect finds nothing. Times [ms] of "
        "hplan from the scene to the certified trajectory. Of its trajectories, looked at every 1 ms, "
        f"{o['all']['colliding']} touch an obstacle."
    )
    columns = ("", "problems", "hplan", "RRTConnect", "BIT*", "missed", "certified", "median", "95 %", "99 %", "max")
    return Table("Orchards: solved, and how fast", columns, tuple(rows), note)


def _routes(o: dict[str, Any]) -> Table:
    found = sorted(o["all"]["routes"], key=lambda route: -o["all"]["routes"][route])
    rows = [
        (group, *(str(n["routes"].get(route, 0)) for route in found))
        for group, n in {**o["groups"], "all": o["all"]}.items()
    ]
    note = (
        "The straight motion, a roadmap of few configurations, the two-level search over layers of yaw, or what it "
        "falls back on."
    )
    columns = ("hplan's motions by", *(route.replace("_", " ") for route in found))
    return Table("Orchards: what carried the motion", columns, tuple(rows), note)


def _durations(o: dict[str, Any]) -> Table:
    rows = []
    for group, n in {**o["groups"], "all": o["all"]}.items():
        cells: list[str] = []
        for ratios in (n["to_rounded"], n["to_processed"]):
            cells += [*(number(ratios[key], 4) for key in ("median", "p95", "max")), str(len(ratios["slower"]))]
        rows.append((group, str(n["to_rounded"]["count"]), number(n["duration_s"]), *cells))
    note = (
        "Duration of hplan's motion to that of the quickest certified one along any of OMPL's paths: these with "
        "rounded corners under the same timing, then (post) with all of hplan's post-processing. Slower: problems "
        "where hplan takes more than 1.02 of it."
    )
    ratio = ("median", "95 %", "max", "slower")
    columns = ("hplan : OMPL's best", "problems", "[s]", *ratio, *(f"post: {name}" for name in ratio))
    return Table("Orchards: duration of the motion", columns, tuple(rows), note)


def _to_look_at(n: dict[str, Any]) -> list[Table]:
    """The problems that are missed, slow to solve, or solved by slow motions."""
    missed = dict.fromkeys(n["missed"], "missed")
    rows = [(row["name"], missed.get(row["name"], "not solved"), row["error"]) for row in n["failed"]]
    rows += [(name, "slower than OMPL", _times(ratio)) for name, ratio in n["to_rounded"]["slower"].items()]
    rows += [(name, "slower than OMPL's by post", _times(ratio)) for name, ratio in n["to_processed"]["slower"].items()]
    if not rows:
        return []
    note = "OMPL solves what is missed, and not what is only not solved." if n["failed"] else ""
    return [Table(f"Orchards: problems to look at ({len(rows)})", ("problem", "", ""), tuple(rows[:_LISTED]), note)]


# Replanning


#: What became of the motion, in the order of the rows, and how the obstacle moved.
_REPLANNED = {
    "kept": "motion kept",
    "mended": "mended",
    "direct": "anew, straight",
    "roadmap": "anew, on a roadmap",
    "search": "anew, on a grid",
    "no_path": "no path",
    "failed": "failed",
}
_MOVED = {"shifted": "obstacle shifted", "close": "obstacle put close to the motion"}


def _replanning(r: dict[str, Any]) -> list[Table]:
    by_outcome = r["by_outcome"]
    groups = {
        "all with a motion": r["all"],
        **{_REPLANNED.get(key, key): by_outcome[key] for key in {**_REPLANNED, **by_outcome} if key in by_outcome},
        **{text: r["by_move"][key] for key, text in _MOVED.items()},
    }
    return [_replan_times(r, groups), _replan_durations(groups), *_failures("Replanning", r["failed"])]


def _replan_times(r: dict[str, Any], groups: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for name, g in groups.items():
        ours = (number(g["ms"][key]) for key in ("median", "p95", "p99", "max"))
        theirs = (number(g["from_nothing_ms"][key]) for key in ("median", "p95", "p99", "max"))
        rows.append((name, _times(g["ratio"]["median"]), str(g["steps"]), *ours, *theirs))
    low, high = (number(100.0 * shift) for shift in r["shift_m"])
    note = (
        f"{r['scenes']} scenes with a motion to begin with (of {r['drawn']} drawn), {r['obstacles']} obstacles each, "
        f"half of them branches and half fruit; all four joints free. In each of {r['steps']:,} steps one obstacle "
        f"moves, drawn at random: it is shifted by {low} to {high} cm, or, in {_percent(r['close_share'], 1.0)} of the "
        "draws, put close to the motion of the moment, in its way or beside it; "
        f"{number(100.0 * r['room_m'])} cm stay free at start and goal. Where a step has no motion the obstacle goes "
        "back. Ratio: time to plan the same scene from nothing (plan) to that of replanning, the median of the steps. "
        "Times [ms] to the certified motion. "
        f"{number(r['per_second'])} replans per second in the median. All steps, those without a motion too, take "
        f"{number(r['in_all_s'])} s together, and {number(r['in_all_from_nothing_s'])} s from nothing. Replanned: "
        f"{r['replanned']:,}, certified: {r['certified']:,}; looked at every 1 ms, {r['colliding']} touch an obstacle. "
        f"Steps with a motion by replanning alone: {len(r['only_replanned'])}; from nothing alone: "
        f"{len(r['only_from_nothing'])}."
    )
    columns = ("", "ratio", "steps", "median", "95 %", "99 %", "max")
    nothing = tuple(f"plan: {name}" for name in columns[3:])
    return Table("Replanning: time", (*columns, *nothing), tuple(rows), note)


def _replan_durations(groups: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for name, g in groups.items():
        ratios = g["to_from_nothing"]
        if ratios["count"]:
            cells = (number(ratios[key], 4) for key in ("median", "p95", "p99", "max"))
            rows.append((name, *cells, str(ratios["count"]), str(ratios["longer"]), str(ratios["shorter"])))
    note = (
        "What keeping a motion costs: its duration to that of the motion planned from nothing at that step. Longer, "
        "and shorter: by more than 2 %."
    )
    columns = ("replanned : from nothing", "median", "95 %", "99 %", "max", "steps", "longer", "shorter")
    return Table("Replanning: duration of the motion", columns, tuple(rows), note)


# Recheck


def _recheck(r: dict[str, Any]) -> list[Table]:
    rows = []
    for name, count in r["violation_counts"].items():
        use = r["worst_use"].get(name)
        cells = [NONE, NONE] if use is None else [f"{use['use']:.5f}", str(use["number"])]
        rows.append((name, str(count), *cells))
    note = (
        f"{r['with_path']:,} scenes with a path (of {r['drawn']:,} drawn), {r['around']:,} of them with obstacles in "
        f"the straight way: {r['planned']:,} planned, {r['certified']:,} certified. {r['instants']:,} instants in "
        f"{r['motion_s']:,.0f} s of motion, from the CSV as the csv module reads it. Smallest clearance seen: "
        f"{number(r['least_clearance_mm'])} mm; never less than certified, by "
        f"{number(r['least_clearance_beyond_certificate_mm'])} mm at least (at one instant in fifty)."
    )
    columns = ("checked every 0.1 ms", "violations", "largest use", "in scene")
    first = Table("Recheck: certified trajectories looked at again", columns, tuple(rows), note)
    shares = []
    for key, name in (("hplan", "hplan"), ("hplan_no_jerk", "hplan, jerk not limited")):
        s = r["reference"][key]
        parts = [s.get(k) for k in ("any", "any_at_95_percent", "velocity", "acceleration", "torque", "jerk")]
        shares.append((name, *(NONE if part is None else f"{100.0 * part:.1f} %" for part in parts)))
    second = Table(
        "Recheck: share of the time at a limit, reference scene",
        ("", ">= 0.999", ">= 0.95", "velocity", "acceleration", "torque", "jerk"),
        tuple(shares),
        "At >= 0.999 and >= 0.95 of some limit; then at >= 0.999 of each.",
    )
    return [first, second, *_failures("Recheck", r["failed"])]


# Growth


_GROWTH_NOTE = (
    "Times [ms] of the C-space, the two-level search, dense A*, and all from scene to certified motion. Memory: "
    "largest rise of resident memory during the call, of the two-level search with its C-space, of the dense search "
    "without."
)

_GROWTH = {"step": "grid step [deg]", "obstacles": "obstacles", "links": "links"}


def _growth(g: dict[str, Any]) -> list[Table]:
    columns = ("", "dense : ours", "nodes", "C-space", "search", "dense", "motion", "search MB", "dense MB")
    found = []
    for axis, title in _GROWTH.items():
        rows = [
            (
                f"{case['size']:g}" if case.get("certified") else f"{case['size']:g}, no motion",
                _times(case["dense_ms"] / case["two_level_ms"]),
                f"{case['nodes']:,}",
                *(number(case[name]) for name in QUANTITIES),
            )
            for case in g[axis]["cases"]
        ]
        against = "obstacles" if axis == "obstacles" else "nodes"
        slopes = g[axis]["slopes"]
        rows.append(("exponent", "", "", *(number(slopes[name], 2) for name in QUANTITIES)))
        found.append(Table(f"Growth: {title}", columns, tuple(rows), f"{_GROWTH_NOTE} Exponents: against {against}."))
    return found
