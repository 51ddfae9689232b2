"""The reproduction of the paper, measured once for all tests that look at it."""

from __future__ import annotations

import functools

from studies.paper import measure

#: The paper's figures, by its numbers, in the order in which a folder lists them.
FIGURES = [
    "figure-02-link-and-circle-case-1.png",
    "figure-03-link-and-circle-case-2.png",
    "figure-04-link-and-circle-case-3.png",
    "figure-05-two-links.png",
    "figure-06-workspace-path.png",
    "figure-07-workspace-layers.png",
    "figure-08-arm-and-obstacle.png",
    "figure-09-cspace.png",
    "figure-10-slices.png",
    "figure-11-slice-paths.png",
    "figure-12-sparse-path.png",
    "figure-13-execution.png",
    "figure-14-paths-in-cspace.png",
    "figure-15-paths-in-workspace.png",
    "figure-16-comparison.png",
]


@functools.cache
def measured_paper() -> tuple[measure.Reproduction, measure.Evidence]:
    """Numbers and evidence; times of one run."""
    return measure.measure(repetitions=1)
