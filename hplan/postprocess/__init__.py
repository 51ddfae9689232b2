"""From a grid path to a smooth curve worth executing, shown clear all along."""

from hplan.polyline import path_length
from hplan.postprocess.options import OBJECTIVES, Objective, PostprocessOptions
from hplan.postprocess.path import fast_path
from hplan.postprocess.shorten import shorten
from hplan.postprocess.smooth import smooth
from hplan.postprocess.spline import SplinePath

__all__ = [
    "OBJECTIVES",
    "Objective",
    "PostprocessOptions",
    "SplinePath",
    "fast_path",
    "path_length",
    "shorten",
    "smooth",
]
