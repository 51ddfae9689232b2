"""Tables of the reference scene: stages, search and C-space, the motion, sampling planners."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.planners import PLANNER_NOTE, planner_tables, row_of_hplan
from studies.benchmark.tables.table import NONE, Table, number, percent, times

#: Motions, in the order of the rows.
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


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.reference` measured.
    """
    return [_stages(results), _parts(results), _motions(results), *_planners(results)]


def _stages(r: dict[str, Any]) -> Table:
    stages = r["stages_ms"]
    names = [name for name in stages if not name.startswith("total")]
    rest = stages["total"] - sum(stages[name] for name in names)
    rows = [(name, number(stages[name]), percent(stages[name], stages["total"])) for name in names if stages[name]]
    rows.append(("scene set up, checks, report", number(rest), percent(rest, stages["total"])))
    rows.append(("scene to certified trajectory", number(stages["total"]), "100 %"))
    note = f"Wall-clock time of the whole: {number(stages['total_wall'])} ms. Warm, median of {r['repetitions']}."
    return Table("Reference scene: time by stage", ("stage", "ms", "share"), tuple(rows), note)


def _parts(r: dict[str, Any]) -> Table:
    s, c = r["searches"], r["cspace"]
    fast, space = s["two_level"], c["analytic_ms"]

    def search(name: str, key: str) -> tuple[str, ...]:
        ms = s[key]["ms"]
        return name, times(ms / fast["ms"]), number(fast["ms"]), number(ms), f"{s[key]['expansions']:,} expansions"

    rows = (
        search("dense A*", "dense"),
        search("dense A*, octile bound", "dense_octile"),
        search("the paper's two-level method", "two_level_paper"),
        (
            "C-space: coal at each node",
            times(c["ratio_coal"]),
            number(space),
            number(c["coal_ms"]),
            f"{c['differing_nodes']} nodes differ",
        ),
        (
            f"C-space: {c['many_discs']} discs",
            NONE,
            number(c["many_ms"]),
            NONE,
            f"{number(c['many_grid_ms'])} ms for the grid; {percent(c['many_occupied_share'], 1.0)} occupied",
        ),
    )
    note = (
        f"The C-space has {c['nodes']:,} nodes. Both stages of the two-level search: "
        f"{fast['expansions']:,} expansions and {fast['flooded']:,} flooded "
        f"cells, cost {fast['cost_deg']:.6f} deg with {fast['points']} points (dense: {s['dense']['cost_deg']:.6f} "
        f"with {s['dense']['points']})."
    )
    return Table("Reference scene: search and C-space", ("peer", "ratio", "hplan [ms]", "peer [ms]", ""), rows, note)


def _motions(r: dict[str, Any]) -> Table:
    rows = []
    for key, name in _MOTIONS.items():
        m = r["motions"]["rows"][key]
        rows.append((name, times(m["ratio"]), f"{m['duration_s']:.3f}", f"{m['length_deg']:.2f}", _verdict(m)))
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


def _planners(r: dict[str, Any]) -> list[Table]:
    stages = r["stages_ms"]
    path_ms = number(stages["total"] - sum(stages[name] for name in ("postprocess", "timing", "certificate")))
    first = row_of_hplan(stages["total"], r["searches"]["two_level"]["cost_deg"], "1 of 1", path_ms=path_ms, digits=4)
    length = r["motions"]["rows"]["hplan"]["length_deg"]
    note = f"{PLANNER_NOTE} hplan's path here is that on the grid; its motion is {length:.1f} deg long."
    return planner_tables("Reference scene", first, r["planners"], note)
