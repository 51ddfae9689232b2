"""Common style of all figures: colours, matplotlib's settings, PNG output.

Figures do not use pyplot, so they neither need nor open a display. Matplotlib is an optional dependency, imported on
first use.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from hplan.base.files import write_bytes
from hplan.base.lazy_import import extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def styled(draw: Callable[_P, _R]) -> Callable[_P, _R]:
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


@styled
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
