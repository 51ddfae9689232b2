"""README and documentation: code and commands run as written, in order; files exist.

Blocks `python` of a page are run, and each line of `sh`; `yaml` and `xml` are files that their first lines name. Code
of other libraries is in blocks `py`.
"""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from script_loader import load_script

import hplan
from hplan.apps.cli.main import COMMANDS, main
from hplan.apps.cli.options import names_robots
from hplan.base.data_files import shipped_scenes
from hplan.errors import InputError
from hplan.robot.limits_file import read_limits
from hplan.study.definition import load_study

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]

#: Optional extras: blocks that import them are skipped without them.
OPTIONAL = {"ompl"}


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks(page: Path, *languages: str) -> list[tuple[str, str]]:
    found = re.findall(r"^```(\w+)\n(.*?)^```$", text_of(page), re.MULTILINE | re.DOTALL)
    return [(language, text) for language, text in found if language in languages]


def is_installed(block: str) -> bool:
    """False if a block imports something optional that is not there."""
    named = [node for node in ast.walk(ast.parse(block)) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {alias.name for node in named for alias in node.names} | {getattr(node, "module", None) for node in named}
    missing = {name for name in OPTIONAL if importlib.util.find_spec(name) is None}
    return not missing & {str(name).partition(".")[0] for name in names}


def run_line(line: str) -> None:
    """Run one command; `# exit status 5` after it is its expected status, if not 0."""
    words, expected = shlex.split(line, comments=True), re.search(r"#.* exit status (\d+)", line)
    match words:
        case ["hplan", *rest]:
            status = main(rest)
        case ["python", script, *rest]:
            status = subprocess.run([sys.executable, ROOT / script, *rest], check=False).returncode
        case ["pip", "install", what]:
            status = int(not set(re.findall(r"[\w-]+", what.partition("[")[2])) <= EXTRAS.keys())
        case []:
            return
        case _:
            pytest.fail(f"no test runs {line!r}")
    assert status == int(expected[1] if expected else 0), line


def check_file(path: Path) -> None:
    """Read a file that a page shows."""
    match text_of(path).partition("format: ")[2].split()[:1]:
        case ["hplan-scene/1"] if names_robots(str(path)):
            hplan.load_cell(path)
        case ["hplan-scene/1"]:
            hplan.load_scene(path)
        case ["hplan-study/1"]:
            load_study(path)
        case ["hplan-limits/1"]:
            names = tuple(re.findall(r"(\w+): [\d.]+[,}]", text_of(path)))
            assert len(read_limits(path, names, [False] * len(names))[0]) == len(names)
        case other:
            pytest.fail(f"{path.name} is a file of {other}")


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the files of the clone that pages name."""
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shown(page: Path) -> Iterator[tuple[str, str]]:
    return iter(blocks(page, "python", "sh", "yaml", "xml"))


@pytest.mark.parametrize("page", [page for page in PAGES if any(shown(page))], ids=lambda page: page.stem)
def test_page_runs(page: Path, clone: Path) -> None:
    space: dict[str, Any] = {"__name__": "__main__"}
    for language, text in shown(page):
        if language in ("yaml", "xml"):
            name = re.match(r"(?:#|<!--) ([\w.-]+)", text)
            assert name, f"a {language} block of {page.name} begins with no name of a file"
            (clone / name[1]).write_text(text, encoding="utf-8")
            if language == "yaml":
                check_file(clone / name[1])
        elif language == "sh":
            for line in text.splitlines():
                run_line(line)
        elif is_installed(text):
            try:
                exec(compile(text, str(page), "exec"), space)
            except InputError as error:
                if error.data.get("extra") is None:
                    raise
                pytest.skip(str(error))
    for result in space.values():
        if isinstance(result, hplan.PlanResult):
            assert result.certificate.verified


def test_readme_is_a_landing_page() -> None:
    (_, block), *_ = blocks(README, "python")
    assert len([line for line in block.splitlines() if line.strip()]) <= 8
    assert len(text_of(README).splitlines()) <= 120
    assert len(text_of(README).split()) < 1000


def test_ci_runs_commands_of_readme() -> None:
    ci = text_of(ROOT / ".ci" / "run")
    lines = re.findall(r"^    (.+)$|`(pip install -e .*?)`", text_of(README), re.MULTILINE)
    told = [part.strip() for line in lines for part in "".join(line).split("&&")]
    assert any("pytest" in part for part in told)
    for part in told:
        if part.startswith("pip install"):
            assert set(re.findall(r"[\w-]+", part.partition("[")[2])) <= EXTRAS.keys()
        else:
            assert part.replace("sphinx-build", "sphinx-build -q") in ci or part in ci, part


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_names_on_a_page_exist(page: Path) -> None:
    text = text_of(page)
    named = re.findall(r"`((?:docs|hplan|scripts|tests|urdf)/[\w./-]*\w)`", text)
    made = re.compile("docs/_build|NAME")
    assert [name for name in named if not (made.search(name) or (ROOT / name).exists())] == []
    for link in re.findall(r"\]\(([^)#:]+)(?:#[\w-]+)?\)", text):
        is_made = link.startswith("generated/")  # the site's build checks these, and all headings
        assert is_made or (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_blocks_are_fenced(page: Path) -> None:
    """So that each is run, or is of a language that is not."""
    if page != README:
        loose = re.findall(r"^ {4,}(?:hplan|python|pip|import|from) .*", text_of(page), re.MULTILINE)
        inside = "\n".join(text for _, text in blocks(page, "python", "py", "text"))
        assert [line for line in loose if line not in inside] == []


def test_pictures_are_of_todays_motions() -> None:
    pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")
    assert load_script("make_pictures").stale() == []


def test_every_command_has_its_options_documented() -> None:
    text = text_of(ROOT / "docs" / "commands.md")
    assert [name for name in COMMANDS if f"## hplan {name}\n" not in text] == []
    assert [name for name in COMMANDS if f"```{{command}} {name}\n" not in text] == []
    assert [name for name in shipped_scenes() if f"`{name}`" not in text] == []
