"""What the commands of studies share: options of the Panda's problems, and how rows are told and kept."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.base.files import write_text

if TYPE_CHECKING:
    from rich.console import Console


def add_panda(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the options of the Panda's files, of its planning and of how many problems are taken.

    Args:
        parser: Of the command.
        required: Whether the files have to be named.
    """
    add = parser.add_argument
    add("--urdf", type=Path, required=required, metavar="FILE", help="panda.urdf of example-robot-data")
    add("--limits", type=Path, required=required, metavar="FILE", help="its limits file")
    add("--package-dir", type=Path, action="append", default=[], metavar="DIR", help="folder of its meshes; repeatable")
    add("--effort", choices=("quick", "default", "best"), default="default", help="default: default")
    add("--every", type=int, default=1, metavar="N", help="only every N-th problem of each set")


def add_rows(parser: argparse.ArgumentParser) -> None:
    """Add the option `--out`."""
    parser.add_argument("--out", type=Path, metavar="JSON", help="where rows are written to")


def tell(console: Console, lines: Iterable[str], rows: Sequence[Mapping[str, Any]], out: Path | None) -> None:
    """Print what the rows say, and write them where that is wanted.

    Args:
        console: Where lines go.
        lines: What is said.
        rows: What is kept.
        out: The file of `--out`; None for none.

    Raises:
        OutputError: The file cannot be written.
    """
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)
    if out is not None:
        from hplan.planning.report import report_text

        write_text(out, report_text({"rows": rows}))
