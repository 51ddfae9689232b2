"""Figure of a study: share of fruit picked over cost, Pareto front."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from hplan.apps.view.figure_style import FAINT, INK, PATH, QUIET, new_figure, styled
from hplan.study.run import StudyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Maximum number of choices on the front that are named below the figure, and line width of these names [characters].
_NAMED, _WIDTH = 9, 84


@styled
def draw_study(result: StudyResult) -> Figure:
    """Draw the choices of a study and its Pareto front.

    The cost is the time for each fruit [s] if it was measured, else the arm's reach [m].

    Raises:
        InputError: Matplotlib is not installed.
    """
    shown = [choice for choice in result.choices if choice.share > 0.0]
    best = sorted((choice for choice in shown if choice.is_best), key=lambda choice: choice.cost)
    words = list[str]()
    for number, one in enumerate(best[:_NAMED], start=1):
        height = f", {one.height_m:g} m high" if one.height_m else ""
        words += textwrap.wrap(f"{number}  {one.arm}, {one.distance_m:g} m{height}", _WIDTH, subsequent_indent="     ")
    figure = new_figure(6.4, 4.2 + 0.17 * len(words), result.name)
    axes = figure.add_subplot()
    others = [choice for choice in shown if not choice.is_best]
    axes.plot([one.cost for one in others], [100.0 * one.share for one in others], "o", ms=4, color=QUIET, alpha=0.6)
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
