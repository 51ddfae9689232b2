#!/usr/bin/env python3
"""Reproduce the paper's numbers, next to measured ones, and its figures.

The paper plans for a three-link arm among one disc: analytic C-space (equations 1-3), a 2-D A* in every theta3 slice,
connectivity restoration, and a second A* on the sparse union. Three searches are run here:

- *dense*: A* on all 753,571 nodes, `hplan.planar.grid.dense_search`;
- *plain*: the two levels to the letter of the paper, written out in a page of plain code (`studies.paper.plain`);
- *hplan*: `hplan.planar.grid.two_level_search`, which floods before it searches, restores on both sides and is complete
  on the grid; once with plain A* and the paper's straight-line bound, once with the default settings.

Each figure has the number and the subject of the paper's; the layout is our own. Choices that the paper's text leaves
open (the searched slices and the restored waypoints) are run each way.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

if __name__ == "__main__":  # runs from a checkout too
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hplan.apps.cli.options import command_parser
from hplan.apps.cli.terminal import progress_line, run_command
from hplan.base.files import prepare_folder, replace_file

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
writes into DIR: reproduction.json, reproduction.md, figure-02-... to figure-16-... by the paper's numbers, and
overview (PNG)

exit status:
  0  done
  2  bad input
"""


def main(argv: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = command_parser("Print the paper's numbers beside the measured ones and draw its figures.", _EPILOG)
    add = parser.add_argument
    add("--out", type=Path, metavar="DIR", help="folder to write into (default: a temporary one, named in the end)")
    add("--no-figures", action="store_true", help="numbers only")
    arguments = parser.parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _run(options: argparse.Namespace, console: Console, errors: Console) -> int:
    """Measure, draw and write the requested results."""
    from hplan.apps.view.figures import png_bytes, require_matplotlib

    if not options.no_figures:
        require_matplotlib()
    out: Path = options.out or Path(tempfile.mkdtemp(prefix="hplan-"))
    prepare_folder(out)
    from studies.paper import measure
    from studies.paper.figures import figures

    with progress_line(errors, quiet=False) as progress:
        numbers, evidence = measure.measure(report=progress)
        contents: dict[str, bytes] = {}
        for name, draw in {} if options.no_figures else figures(numbers, evidence).items():
            progress(name)
            contents[name] = png_bytes(draw())
    text = measure.markdown(numbers)
    record = json.dumps(numbers.as_dict(), indent=2) + "\n"
    contents |= {"reproduction.md": text.encode(), "reproduction.json": record.encode()}
    with ExitStack() as files:  # all or none
        for name, content in contents.items():
            files.enter_context(replace_file(out / name)).write_bytes(content)
    console.print(text, markup=False, soft_wrap=True)
    console.print(f"written to {out}: {len(contents)} files", markup=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
