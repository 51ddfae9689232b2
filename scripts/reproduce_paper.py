#!/usr/bin/env python3
"""Reproduce the paper: its numbers beside the measured ones, and its figures.

The paper plans for a three-link arm among one disc: analytic C-space (equations 1-3), a 2-D A* in every theta3 slice,
connectivity restoration, and a second A* on the sparse union. Three searches are run here:

- *dense*: A* on all 753,571 nodes, `hplan.search.dense_search`;
- *plain*: the two levels to the letter of the paper, written out in a page of plain code: A* in every slice, with or
  without a path; the first path carried back towards the start; A* on the union (`studies.paper.plain`);
- *hplan*: `hplan.search.two_level_search`, which floods before it searches, restores on both sides and is complete on
  the grid; once with plain A* and the paper's straight-line bound, once as it is by default, with jump points in the
  slices and a bound that knows the union.

Each figure has the number and the subject of the paper's; the layout is our own. What the paper's text leaves open, the
slices searched and what restoration carries back, is run each way.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if __name__ == "__main__":  # runs from a checkout too
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hplan.errors import HplanError, OptionError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.paper.random_scenes import SearchComparison
    from studies.paper.results import Reproduction

#: The random scenes are always the same ones.
SEED = 1

DISAGREE, INTERRUPTED = 5, 130

_EPILOG = """\
writes into DIR: reproduction.json, reproduction.md, figure-02-... to figure-16-... by the paper's numbers, and
overview (PNG)

exit status:
  0  done
  2  bad input
  5  the two searches disagree on a random scene
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        description="Print the paper's numbers beside the measured ones and draw its figures.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = result.add_argument
    add("--out", type=Path, metavar="DIR", help="folder to write into (default: a temporary one, named in the end)")
    add("--no-figures", action="store_true", help="numbers only")
    add("--markdown", action="store_true", help="print the report as Markdown instead of tables")
    add(
        "--scenes", type=int, default=0, metavar="N",
        help="compare two-level and dense search on N random planar scenes of 1 to 12 discs, some of them without a "
        "path (default: %(default)s, none; 2000 take a minute or two)",
    )  # fmt: skip
    return result


def run(options: argparse.Namespace, errors: Console) -> tuple[Reproduction, SearchComparison | None, int]:
    """Measure, draw and write what was asked for; the numbers, and how many files were written."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from studies.paper.figures import figures
    from studies.paper.measure import STEPS, measure
    from studies.paper.output import write_all
    from studies.paper.random_scenes import compare
    from studies.paper.tables import markdown

    from hplan.view.figure_style import png_bytes

    scenes: SearchComparison | None = None
    contents: dict[str, bytes] = {}
    with Progress(
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=errors, transient=True,
    ) as progress:  # fmt: skip
        steps = progress.add_task("measuring", total=STEPS)
        numbers, evidence = measure(
            report=lambda text: progress.update(steps, advance=1, description=f"measuring: {text}")
        )
        if options.scenes:
            compared = progress.add_task("random scenes", total=options.scenes)
            scenes = compare(options.scenes, SEED, lambda done: progress.update(compared, completed=done))
        if not options.no_figures:
            drawings = figures(numbers, evidence)
            drawn = progress.add_task("drawing", total=len(drawings))
            for name, draw in drawings.items():
                progress.update(drawn, description=f"drawing: {name}")
                contents[name] = png_bytes(draw())
                progress.advance(drawn)
    record = {**numbers.as_dict(), "random_scenes": None if scenes is None else scenes.as_dict()}
    contents["reproduction.md"] = markdown(numbers, scenes).encode()
    contents["reproduction.json"] = (json.dumps(record, indent=2) + "\n").encode()
    write_all(options.out, contents)
    return numbers, scenes, len(contents)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    from rich.console import Console

    console, errors = Console(), Console(stderr=True)
    try:
        if options.scenes < 0:
            raise OptionError("--scenes", options.scenes, "0 or more")
        if not options.no_figures:
            from hplan.view.figure_style import require_matplotlib

            require_matplotlib()
        from studies.paper.output import check_writable

        options.out = options.out or Path(tempfile.mkdtemp(prefix="hplan-"))
        check_writable(options.out)
        numbers, scenes, files = run(options, errors)
    except HplanError as error:
        errors.print("error:", style="bold red", end=" ")
        errors.print(error.message, markup=False, highlight=False, soft_wrap=True)
        return error.exit_status
    except KeyboardInterrupt:
        errors.print("interrupted")
        return INTERRUPTED
    from studies.paper.tables import markdown, show

    if options.markdown:
        sys.stdout.write(markdown(numbers, scenes))
    else:
        show(numbers, console, scenes)
        console.print(f"\nWritten to {options.out}: {files} files.", highlight=False, soft_wrap=True)
    return DISAGREE if scenes is not None and scenes.disagree else 0


if __name__ == "__main__":
    sys.exit(main())
