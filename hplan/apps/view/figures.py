"""Figures of a tree row, a study and a trajectory.

Also the style of all figures.
"""

from __future__ import annotations

import functools
import io
import itertools
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.files import write_bytes
from hplan.base.lazy_import import extra
from hplan.base.units import joint_unit
from hplan.planning.failures import REASON_WORDS, REASONS, Reason
from hplan.robot.model import Robot
from hplan.scene.obstacles import Capsule
from hplan.trajectory.trajectory import Trajectory, check_trajectory_joints

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hplan.study.run import Choice, StudyResult
    from hplan.tour.row import BaseStop, RowResult

_P = ParamSpec("_P")
_R = TypeVar("_R")

#: Resolution of the PNGs [dots per inch].
_DPI = 160

# Okabe and Ito's palette, which colour-blind readers can distinguish, and tints of it.
INK = "#22303C"
QUIET = "#7A8793"
FAINT = "#D9DFE4"
OBSTACLE = "#D55E00"
OBSTACLE_TINT = "#F0B183"
PATH = "#0072B2"
RESTORED = "#E69F00"
START = "#009E73"
GOAL = "#AA4488"
LINKS = ("#34495E", "#5D7F9E", "#9DBBD3")

#: matplotlib's settings for all figures.
_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.titlesize": 9.5,
    "figure.facecolor": "white",
    "figure.titlesize": 12.5,
    "figure.titleweight": "bold",
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "savefig.facecolor": "white",
    "text.color": INK,
    "xtick.color": QUIET,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.color": QUIET,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8.5,
}


def require_matplotlib() -> None:
    """Check that matplotlib can be imported.

    Raises:
        InputError: Matplotlib is not installed.
    """
    with extra("figures", "figures need matplotlib"):
        import matplotlib  # noqa: F401


def apply_style(draw: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a drawing function so that it uses hplan's style.

    The decorated function raises an InputError if matplotlib is not installed.
    """

    @functools.wraps(draw)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        require_matplotlib()
        from matplotlib import rc_context

        style: Any = _STYLE
        with rc_context(style):
            return draw(*args, **kwargs)

    return wrapper


def new_figure(width: float, height: float, title: str) -> Figure:
    """Create an empty figure with its own canvas.

    The layout keeps axes from overlapping, and notebooks show the figure as PNG.

    Args:
        width: Width [inch].
        height: Height [inch].
        title: Title; empty for a figure without one.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(width, height))
    figure.set_layout_engine(ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.09, wspace=0.04, hspace=0.04))
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.012, ha="left")
    figure._repr_png_ = functools.partial(png_bytes, figure, 100)  # type: ignore[attr-defined]  # for notebooks
    return figure


@apply_style
def png_bytes(figure: Figure, dpi: int = _DPI) -> bytes:
    """Render a figure as PNG; equal figures give equal bytes."""
    from PIL import Image  # comes with matplotlib

    rendered, stream = io.BytesIO(), io.BytesIO()
    figure.savefig(rendered, format="png", dpi=dpi)
    with Image.open(rendered) as image:
        # 256 colours suffice for these drawings and reduce the size to a third.
        few = image.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
        few.save(stream, format="png", optimize=True, dpi=(dpi, dpi))
    return stream.getvalue()


def write_png(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG.

    Raises:
        OutputError: The file cannot be written.
    """
    return write_bytes(path, png_bytes(figure))


#: Marker and colour of fruits that are not picked, by reason; None for fruits that were left out.
UNPICKED: Final[dict[Reason | None, tuple[str, str]]] = {
    "out_of_reach": ("o", QUIET),
    "blocked": ("X", OBSTACLE),
    "no_approach": ("^", GOAL),
    "no_motion": ("s", INK),
    None: ("o", OBSTACLE_TINT),
}

#: Colours of neighbouring stops and their fruits, used in turn.
_STOPS = (PATH, START, RESTORED, LINKS[1])


@apply_style
def draw_row(result: RowResult) -> Figure:
    """Draw the stops of the base and the fruits picked from each.

    The views are from above and from the front. Neighbouring stops have different colours.

    Raises:
        InputError: Matplotlib is not installed.
    """
    from matplotlib.lines import Line2D

    scene, report = result.scene, result.report
    share = f"{100.0 * report['share_picked']:.0f} % of {report['fruits']} fruits"
    pace = f"{report['total_s_per_fruit']:.2f} s each"
    stops = len(result.stops)
    stands = [(place.along, _lateral_position(place, result)) for place, names in result.candidates.items() if names]
    fruit = np.array([fruit.center for fruit in scene.fruits])
    (y, x), z = np.concatenate([np.array(stands), fruit[:, 1::-1]]).T, fruit[:, 2]
    # Margin around the contents [m], and maximum size of both views together [inch].
    room_m, largest = 0.25, (9.0, 8.0)
    ends = [(float(values.min()) - room_m, float(values.max()) + room_m) for values in (y, x, z)]
    wide, deep, high = (end - begin for begin, end in ends)
    scale = min(largest[0] / wide, largest[1] / (deep + high))  # inches for each metre
    title = f"{scene.name}: {share} from {stops} stop{'s' * (stops > 1)}, {pace}"
    figure = new_figure(max(6.4, wide * scale + 1.0), (deep + high) * scale + 2.2, title)
    above, front = figure.subplots(2, 1, height_ratios=(deep, high))
    _draw(above, result, 0, "x: across the row [m]", (ends[0], ends[1]))
    _draw(front, result, 2, "z [m]", (ends[0], ends[2]))
    front.set_xlabel("y: along the row [m]")
    above.set_title("from above; numbers are stops, dots the fruits that can be picked from each candidate")
    front.set_title("from the front")
    handles = [Line2D([], [], marker="o", ls="none", color=PATH, label="picked (a colour for each stop)")]
    count = Counter(one.reason for one in result.unpicked.values())
    for reason, (marker, color) in UNPICKED.items():
        if count[reason]:
            words = "left out" if reason is None else REASON_WORDS[reason]
            handles.append(Line2D([], [], marker=marker, ls="none", color=color, label=f"{words} ({count[reason]})"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _lateral_position(place: BaseStop, result: RowResult) -> float:
    """Position of the base's axis across the tree row [m]."""
    return 2.0 * result.options.distance * (place.side - 1)


def _draw(
    axes: Any, result: RowResult, axis: int, label: str, ends: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    """Draw one view: y to the right, the coordinate `axis` upwards."""
    from matplotlib.collections import LineCollection

    wood = [one for one in result.scene.obstacles if isinstance(one, Capsule)]
    lines = [[(end[1], end[axis]) for end in (one.start, one.end)] for one in wood]
    widths = [max(0.8, 60.0 * one.radius) for one in wood]
    axes.add_collection(LineCollection(lines, colors="#C8B49E", linewidths=widths, capstyle="round", zorder=1))
    stop_of = {name: number for number, stop in enumerate(result.stops) for name in stop.tour.order}
    for fruit in result.scene.fruits:
        if fruit.name in stop_of:
            marker, color = "o", _STOPS[stop_of[fruit.name] % len(_STOPS)]
        else:
            marker, color = UNPICKED[result.unpicked[fruit.name].reason]
        axes.plot(fruit.center[1], fruit.center[axis], marker, ms=4.5, color=color, zorder=3)
    if axis == 0:
        _draw_stops(axes, result)
    axes.set_ylabel(label)
    axes.set(xlim=ends[0], ylim=ends[1], aspect="equal")
    axes.grid(color=FAINT, lw=0.5)
    axes.set_axisbelow(True)


def _draw_stops(axes: Any, result: RowResult) -> None:
    """Draw the candidate stops as dots and the stops with their numbers.

    The area of a dot grows with the number of fruits that can be picked from it.
    """
    some = {place: len(names) for place, names in result.candidates.items() if names}
    places = [(place.along, _lateral_position(place, result)) for place in some]
    sizes = [1.0 + 22.0 * count / max(some.values()) for count in some.values()]
    axes.scatter(*np.array(places).T, s=sizes, color=QUIET, alpha=0.5, lw=0, zorder=2)
    for number, stop in enumerate(result.stops):
        at, color = (stop.place.along, _lateral_position(stop.place, result)), _STOPS[number % len(_STOPS)]
        axes.plot(*at, "s", ms=13, color=color, mec="white", zorder=4)
        axes.annotate(str(number + 1), at, ha="center", va="center", color="white", fontweight="bold", zorder=5)
        if stop.place.height:
            away = 12 if stop.place.side == 2 else -18
            axes.annotate(
                f"{stop.place.height:+.2g} m", at, (0, away), textcoords="offset points", ha="center", color=INK
            )


#: Maximum number of choices on the front that are named below the figure, and line width of these names [characters].
_NAMED, _WIDTH = 9, 84


@apply_style
def draw_study(result: StudyResult) -> Figure:
    """Draw the choices of a study, its Pareto front, and why fruit is not picked.

    The cost is the time for each fruit [s] if it was measured, else the arm's reach [m]. The bars below are the
    fractions of the fruit by reason, for the first choices of the front and the best of the others.

    Raises:
        InputError: Matplotlib is not installed.
    """
    shown = [choice for choice in result.choices if choice.share > 0.0]
    best = sorted((choice for choice in shown if choice.is_best), key=lambda choice: choice.cost)
    words = list[str]()
    for number, one in enumerate(best[:_NAMED], start=1):
        height = f", {one.height_m:g} m high" if one.height_m else ""
        words += textwrap.wrap(f"{number}  {one.arm}, {one.distance_m:g} m{height}", _WIDTH, subsequent_indent="     ")
    others = sorted((one for one in result.choices if not one.is_best), key=lambda one: (-one.share, one.cost))
    barred = [*best[:_NAMED], *others][:_NAMED]
    heights = 3.6 + 0.17 * len(words), 0.5 + 0.22 * len(barred)
    figure = new_figure(6.4, sum(heights) + 0.6, result.name)
    axes, why = figure.subplots(2, 1, height_ratios=heights)
    _draw_reasons(why, barred, [*best])
    rest = [choice for choice in shown if not choice.is_best]
    axes.plot([one.cost for one in rest], [100.0 * one.share for one in rest], "o", ms=4, color=QUIET, alpha=0.6)
    axes.plot(
        [one.cost for one in best], [100.0 * one.share for one in best], "o-", drawstyle="steps-post", ms=6, color=PATH
    )
    for number, one in enumerate(best, start=1):
        at = one.cost, 100.0 * one.share
        axes.annotate(str(number), at, (5, 5), textcoords="offset points", color=INK, fontweight="bold")
    is_timed = any(choice.seconds_per_fruit is not None for choice in shown)
    axes.set_xlabel("\n".join(["time per fruit [s]" if is_timed else "reach of the arm [m]", "", *words]))
    axes.xaxis.label.set(ha="left", x=0.0)
    axes.set_ylabel("fraction of the fruits picked [%]")
    axes.margins(x=0.08, y=0.12)
    axes.set_ylim(bottom=0.0)
    axes.grid(color=FAINT, lw=0.6)
    axes.set_axisbelow(True)
    return figure


def _draw_reasons(axes: Any, choices: Sequence[Choice], best: Sequence[Choice]) -> None:
    """Draw a stacked bar for each choice: picked, and not picked by reason."""
    parts: dict[str, tuple[str, list[float]]] = {"picked": (PATH, [one.share for one in choices])}
    for reason in REASONS:
        parts[REASON_WORDS[reason]] = UNPICKED[reason][1], [one.not_picked.get(reason, 0.0) for one in choices]
    left, places = np.zeros(len(choices)), -np.arange(len(choices))
    for words, (color, shares) in parts.items():
        if any(shares):
            axes.barh(places, 100.0 * np.array(shares), left=left, color=color, height=0.7, label=words)
            left += 100.0 * np.array(shares)
    numbers = [f"{best.index(one) + 1}  " if one in best else "" for one in choices]
    names = [f"{number}{one.arm[:32]}, {one.distance_m:g} m" for number, one in zip(numbers, choices, strict=True)]
    axes.set_yticks(places, names)
    for place, one in zip(places, choices, strict=True):
        for name, count in [*one.obstacles.items()][:1]:
            axes.annotate(
                f"most often {name} ({count})",
                (100.0, place),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=7,
            )
    axes.set(xlim=(0.0, 100.0), xlabel="fraction of the fruits [%]")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5)


_LINE_COLORS = (PATH, OBSTACLE, START, GOAL, INK, RESTORED, QUIET)


@apply_style
def draw_trajectory(trajectory: Trajectory, robot: Robot | None = None) -> Figure:
    """Draw a trajectory over time.

    Args:
        trajectory: The trajectory.
        robot: Robot whose limits are drawn as dotted lines; None for no limits.

    Raises:
        InputError: Matplotlib is not installed, or the joints of the trajectory are not the robot's.
    """
    if robot is not None:
        check_trajectory_joints(trajectory, robot)
    slides = trajectory.slides or (False,) * len(trajectory.joint_names)
    units = [joint_unit(slide) for slide in slides]
    factors = np.array([unit.factor for unit in units])
    shown = ", ".join(dict.fromkeys(unit.shown for unit in units))
    efforts = ", ".join(dict.fromkeys(unit.effort for unit in units))
    ends: list[tuple[FloatArray, ...]] = [(), (), (), ()]
    if robot is not None:
        largest = robot.velocity_limit, robot.acceleration_limit, robot.torque_limit
        ends = [(robot.lower, robot.upper), *((-limit, limit) for limit in largest)]
    rows = (
        (f"position [{shown}]", factors, trajectory.position),
        (f"velocity [{shown}/s]", factors, trajectory.velocity),
        (f"acceleration [{shown}/s²]", factors, trajectory.acceleration),
        (f"effort [{efforts}]", np.ones(len(units)), trajectory.torque),
    )
    figure = new_figure(7.2, 8.0, f"{trajectory.duration:.3f} s")
    axes = figure.subplots(4, sharex=True)
    for axis, (label, factor, values), limits in zip(axes, rows, ends, strict=True):
        axis.grid(color=FAINT, lw=0.6)
        axis.set_ylabel(label)
        for joint, name in enumerate(trajectory.joint_names):
            style, color = "-" if joint < len(_LINE_COLORS) else "--", _LINE_COLORS[joint % len(_LINE_COLORS)]
            axis.plot(trajectory.time, factor[joint] * values[:, joint], style, lw=1.3, color=color, label=name)
        low, high = axis.get_ylim()
        for joint, limit in itertools.product(range(len(units)), limits):
            axis.axhline(factor[joint] * limit[joint], ls=":", lw=0.8, color=_LINE_COLORS[joint % len(_LINE_COLORS)])
        axis.set_ylim(low, high)  # limits far outside the trajectory do not rescale the axis
    axes[-1].set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figure
