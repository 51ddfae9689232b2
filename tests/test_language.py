"""Docstrings, comments and guides are written in the field's terms (`docs/glossary.md`)."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

#: Phrases of noun clauses and bare participles that a reader has to translate.
DIALECT = re.compile(
    r"\b(what(ever)?(?! if\b)|told|tells of|asked for|asks for|wanted|is shown|are shown|not shown|made ready"
    r"|gives? way"
    r"|none of|there is none|it is none|so (many|much|far|deep|long|large)(?! as\b| that\b)|beside|in the way"
    r"|(of|by|from|about|to|at|with|for) which|where (there|it|that|they|none|nothing) (is|are|was|has|have|can|cannot)"
    r"|anybody|nobody|somebody|stands|stand(?! for\b|-off))\b",
    re.IGNORECASE,
)

#: Maximum share of lines with such a phrase: a phrase is a place to look, and some uses are right.
SHARE = 0.03


def prose_of(path: Path) -> Iterator[str]:
    """Lines of at least three words of the docstrings and comments of a file, or of a page outside code blocks."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        lines = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL).splitlines()
    else:
        documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, documented)]
        lines = [line for node in nodes for line in (ast.get_docstring(node) or "").splitlines()]
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        lines += [token.string.lstrip("#: ") for token in tokens if token.type == tokenize.COMMENT]
    return (line for line in lines if len(line.split()) >= 3)


def check(paths: list[Path]) -> None:
    """Assert that few lines of some files have a phrase of the dialect."""
    lines = [(path, line) for path in paths for line in prose_of(path)]
    found = [f"{path.relative_to(ROOT)}: {line.strip()}" for path, line in lines if DIALECT.search(line)]
    assert len(found) <= SHARE * len(lines), "\n".join(found)


@pytest.mark.parametrize("room", sorted({path.parent.name for path in ROOT.glob("hplan/*/__init__.py")}))
def test_docstrings_of_a_room_use_the_fields_terms(room: str) -> None:
    check(sorted((ROOT / "hplan" / room).rglob("*.py")))


@pytest.mark.parametrize("folder", ["tests", "scripts/examples", "docs"])
def test_prose_of_a_folder_uses_the_fields_terms(folder: str) -> None:
    check(
        sorted(
            path for ending in ("*.py", "*.md") for path in (ROOT / folder).rglob(ending) if "_build" not in path.parts
        )
    )
