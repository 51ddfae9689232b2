"""Plant bugs one at a time, and report which the tests notice.

Each bug of tests/planted_bugs.toml is one small change to the package: a text that a file holds exactly once, and its
replacement. It is planted in a copy of the tree, and the tests named with it run until the first failure. A bug that no
test notices is a hole in the suite.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests" / "planted_bugs.toml"

_EPILOG = """\
exit status:
  0  every bug was noticed
  2  a bug does not fit the tree: its text is not found, or found more than once; or the test fails without it
  5  a bug went unnoticed
"""

#: The parts of the tree that the tests need.
_COPIED = ("hplan", "scripts", "tests", "urdf", "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "docs", ".ci")

#: A bug that makes the tests run longer than this is noticed [s].
_PATIENCE_S = 600.0


@dataclass(frozen=True)
class Bug:
    """A small change to one file.

    Attributes:
        id: Its name.
        file: The file, from the root of the tree.
        old: Text that the file holds exactly once.
        new: Its replacement.
        tests: Arguments of pytest: the tests that should notice.
        what: The consequence for a user.
    """

    id: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    what: str

    def planted(self, root: Path) -> str:
        """The text of the file with the bug."""
        text = (root / self.file).read_text(encoding="utf-8")
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.file} holds its text {count} times")
        changed = text.replace(self.old, self.new)
        try:
            ast.parse(changed)
        except SyntaxError as error:
            raise ValueError(f"what stands there instead is no Python: {error}") from error
        return changed


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("ids", nargs="*", metavar="ID", help="the bugs to plant (default: all)")
    parser.add_argument("--check", action="store_true", help="only see that all of them fit the tree")
    arguments = parser.parse_args(argv)
    bugs = read_table()
    if unknown := set(arguments.ids) - {bug.id for bug in bugs}:
        parser.error(f"there is no bug {', '.join(sorted(unknown))}")
    bugs = [bug for bug in bugs if not arguments.ids or bug.id in arguments.ids]
    stale = _stale(bugs)
    for line in stale:
        print(line)
    if arguments.check or stale:
        return 2 if stale else 0
    return _campaign(bugs)


def read_table() -> list[Bug]:
    """The bugs of the table."""
    with TABLE.open("rb") as stream:
        rows = tomllib.load(stream)["bug"]
    return [Bug(**{**row, "tests": tuple(row["tests"])}) for row in rows]


def _stale(bugs: Sequence[Bug]) -> list[str]:
    """Why bugs do not fit the tree, a line each."""
    lines = []
    for bug in bugs:
        try:
            bug.planted(ROOT)
        except (OSError, ValueError) as error:
            lines.append(f"{bug.id}: stale: {error}")
    return lines


def _campaign(bugs: Sequence[Bug]) -> int:
    """Plant bug after bug, telling of each; returns the exit status."""
    caught, missed, broken = 0, list[str](), list[str]()
    for bug in bugs:
        begin = time.perf_counter()
        failure = _failure(bug.tests, bug)
        if failure is None:
            missed.append(bug.id)
            verdict = "MISSED"
        elif "::" in failure and _failure((failure,)) is not None:
            broken.append(bug.id)
            verdict = "BROKEN"  # the test fails without the bug, too
        else:
            caught += 1
            verdict = "caught"
        print(f"{bug.id:28}{verdict:8}{time.perf_counter() - begin:6.0f} s  {failure or ''}", flush=True)
    print(f"\n{caught} of {len(bugs)} caught; missed: {', '.join(missed) or 'none'}")
    return 2 if broken else 5 if missed else 0


def _failure(tests: Sequence[str], bug: Bug | None = None) -> str | None:
    """The first failing test or startup error; None if all pass.

    They run in a copy of the tree, with its compiled kernels and optionally a planted bug.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in _COPIED:
            source, target = ROOT / name, root / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("*.pyc", ".*_cache"))
            elif source.exists():
                shutil.copy2(source, target)
        if bug is not None:
            (root / bug.file).write_text(bug.planted(ROOT), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header", *tests]
        own = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        own["PYTHONPATH"] = str(root)
        try:
            done = subprocess.run(
                command, cwd=root, env=own, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
            )
        except subprocess.TimeoutExpired:
            return f"no end after {_PATIENCE_S:.0f} s"
    if done.returncode == 0:
        return None
    named = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return named[0] if named else f"pytest ends with {done.returncode}: {done.stdout[-200:]!r}"


if __name__ == "__main__":
    sys.exit(main())
