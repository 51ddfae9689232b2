"""Generated parts of the site: commands, API reference, gallery, formulas.

The directive `command` of a page inserts the text of `hplan plan --help`. The reference has a page for each subpackage
(`docs/generated/reference`) with its public names: the members of `hplan.__all__` and of the subpackages' own
`__all__`, and names imported by a documentation page or an example. Formulas become MathML, which needs no script.
"""

from __future__ import annotations

import argparse
import ast
import html
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.pycode import ModuleAnalyzer

from hplan.apps.cli.main import COMMANDS

DOCS = Path(__file__).parent
ROOT = DOCS.parent
PACKAGE, EXAMPLES = ROOT / "hplan", ROOT / "scripts" / "examples"
REFERENCE, GALLERY = DOCS / "generated" / "reference", DOCS / "generated" / "gallery"
#: Files copied to the site unchanged: pages of motions, pictures.
EXTRA = DOCS / "generated" / "extra" / "motions"


class Command(Directive):
    """Usage, arguments and options of a command, generated from its parser."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the help of a command, or a table of all commands."""
        if self.arguments:
            name = self.arguments[0]
            lines = _command_lines(importlib.import_module(f"hplan.apps.cli.{name}").parser(f"hplan {name}"))
        else:
            rows = (f"| [`hplan {name}`](#hplan-{name}) | {words} |" for name, words in COMMANDS.items())
            lines = iter(["| command | does |", "|---|---|", *rows])
        box = nodes.container()
        self.state.nested_parse(StringList(list(lines)), self.content_offset, box)
        return box.children


def _command_lines(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the Markdown of a parser."""
    yield from (" ".join((parser.description or "").split()), "", "```text")
    yield from (*parser.format_usage().splitlines(), "```", "")
    usual = {"positional arguments", "options"}
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, _ASIDE)]
        if actions:
            title = "" if group.title in usual else group.title
            yield from (f"| {title} | |", "|---|---|", *map(_row, actions), "")
    if parser.epilog:
        yield from ("```text", *parser.epilog.splitlines(), "```", "")


_ASIDE = (argparse._HelpAction, argparse._VersionAction)


def _row(action: argparse.Action) -> str:
    """Return the table row of an argument or option."""
    shown = argparse.HelpFormatter("", width=200)._format_action_invocation(action)
    text = (action.help or "") % (vars(action) | {"prog": ""})
    return "| `{}` | {} |".format(*(part.replace("|", "\\|") for part in (shown, text)))


# The reference.


#: Names of `hplan` that come first in the reference.
_FIRST = ("plan", "load_robot", "load_scene", "PlanOptions", "PlanResult", "certify", "Planner", "plan_tour", "finish")


def public_names() -> dict[str, dict[str, str]]:
    """Paths of the public names by subpackage, with their modules.

    Every name occurs once, under the module that documents it.
    """
    rooms: dict[str, dict[str, str]] = {"hplan": {}}
    seen: set[int] = set()
    listed = [_module(path) for path in sorted(PACKAGE.rglob("__init__.py"), key=lambda path: len(path.parts))]
    for module in listed:
        room = ".".join(module.split(".")[:2])
        for name in getattr(importlib.import_module(module), "__all__", ()):
            _take(rooms.setdefault(room, {}), seen, module, name)
    for module, name in sorted(_imported_by_docs()):
        _take(rooms.setdefault(".".join(module.split(".")[:2]), {}), seen, module, name)
    first = [path for path in map("hplan.{}".format, _FIRST) if path in rooms["hplan"]]
    rooms["hplan"] = dict.fromkeys(first, "hplan") | rooms["hplan"]
    return rooms


def _take(room: dict[str, str], seen: set[int], module: str, name: str) -> None:
    value = getattr(importlib.import_module(module), name)
    is_named = inspect.isclass(value) or inspect.isfunction(value)
    if (is_named and id(value) in seen) or inspect.ismodule(value):
        return
    seen.add(id(value))
    room[f"{module}.{name}"] = module


def _module(init: Path) -> str:
    return ".".join(init.parent.relative_to(ROOT).parts)


def _imported_by_docs() -> set[tuple[str, str]]:
    """(module, name) of all package imports in pages and examples."""
    pages = "\n".join(path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *DOCS.glob("*.md")])
    texts = [block for _, block in code_blocks(pages, "python")]
    texts += [path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.py")]
    found = set()
    for text in texts:
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hplan"):
                found |= {(str(node.module), alias.name) for alias in node.names}
    return found


def code_blocks(page: str, *languages: str) -> list[tuple[str, str]]:
    """Language and text of a page's fenced blocks, in order."""
    found = re.findall(r"^```(\w+)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    return [(language, text) for language, text in found if language in languages]


def _reference_page(room: str, names: dict[str, str]) -> str:
    """Return the page of a subpackage: its purpose, a table of its names, and their entries."""
    doc = inspect.getdoc(importlib.import_module(room)) or ""
    lines = [f"# {room}", "", doc, "", *_summary(names), ""]
    for path, module in names.items():
        lines += ["```{eval-rst}", *_entry(path, module), "```", ""]
    return "\n".join(lines)


def _summary(names: dict[str, str]) -> list[str]:
    """Return the table of names, each with the first line of its docstring."""
    rows = []
    for path, module in names.items():
        name = path.rpartition(".")[2]
        value = getattr(importlib.import_module(module), name)
        is_named = inspect.isclass(value) or inspect.isfunction(value)
        lines = (inspect.getdoc(value) or "").splitlines() if is_named else _comment(module, name)
        words = (lines or [""])[0].replace("|", "\\|")
        rows.append(f"| {{py:obj}}`{name} <{path}>` | {words} |")
    return ["| name | |", "|---|---|", *rows]


def _entry(path: str, module: str) -> list[str]:
    """Return the reStructuredText entry of a name."""
    name = path.rpartition(".")[2]
    value = getattr(importlib.import_module(module), name)
    if inspect.isclass(value):
        return [f".. autoclass:: {path}", "   :members:", "   :show-inheritance:"]
    if inspect.isfunction(value):
        return [f".. autofunction:: {path}"]
    return [f".. py:data:: {path}", "", *(f"   {line}" for line in _comment(module, name))]


def _comment(module: str, name: str) -> list[str]:
    """Return the `#:` comment above a constant's assignment."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and any(alias.name == name for alias in node.names):
            return _comment(str(node.module), name)
    return list(ModuleAnalyzer.for_module(module).find_attr_docs().get(("", name), []))


def write_reference(_: Any = None) -> None:
    """Write a page for each public subpackage, and an index."""
    REFERENCE.mkdir(parents=True, exist_ok=True)
    rooms = {room: names for room, names in public_names().items() if names}
    for room, names in rooms.items():
        _write(REFERENCE / f"{room}.md", _reference_page(room, names))
    count = sum(map(len, rooms.values()))
    words = f"{count} names: what each takes, gives and raises. All errors derive from {{py:class}}`hplan.HplanError`."
    listed = "\n".join(rooms)
    _write(REFERENCE / "index.md", f"# Reference\n\n{words}\n\n```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n")


def _write(path: Path, text: str) -> None:
    """Write a page if its text changed; Sphinx skips unchanged files."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _plain_signature(
    _app: Sphinx, _what: str, _name: str, _obj: Any, _options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Show aliases of types within other types by their names."""
    plain = partial(re.sub, r"TypeAliasForwardRef\('(\w+)'\)", r"\1")
    return signature and plain(signature), returned and plain(returned)


def _as_rst(_app: Sphinx, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Escape asterisks, bars and trailing underscores in docstrings, except between backticks."""
    for number, line in enumerate(lines):
        if what != "module":
            parts = line.split("`")
            parts[::2] = [re.sub(r"[|*]|(?<=\w)_(?!\w)", r"\\\g<0>", part) for part in parts[::2]]
            lines[number] = "`".join(parts)
    if what == "property":
        lines.insert(0, "")  # prevents napoleon from parsing the words before a colon as a type


# The gallery.


def write_gallery(_: Any = None) -> None:
    """Run and draw outdated examples, and write all example pages."""
    GALLERY.mkdir(parents=True, exist_ok=True)
    newest = max(path.stat().st_mtime for path in [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.js")])
    # Examples that need ROS run only on a machine with ROS.
    shown = sorted(path for path in EXAMPLES.glob("*.py") if "import rclpy" not in path.read_text(encoding="utf-8"))
    old = [path for path in shown if not _is_newer(EXTRA / f"{path.stem}.txt", max(newest, path.stat().st_mtime))]
    draw = [sys.executable, str(ROOT / "scripts" / "make_pictures.py"), "--gallery", str(EXTRA)]
    if old:
        subprocess.run([*draw, *(path.stem for path in old)], check=True)
    for path in shown:
        _write(GALLERY / f"{path.stem}.md", _example_page(path))
    cards = "".join(map(_card, shown))
    listed = "\n".join(path.stem for path in shown)
    _write(
        GALLERY / "index.md",
        f"# Gallery\n\nPrograms of `scripts/examples`, run and drawn when this site was built.\n\n"
        f'<div class="cards">\n{cards}</div>\n\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n',
    )


def _is_newer(path: Path, than: float) -> bool:
    return path.is_file() and path.stat().st_mtime > than


def _docstring(path: Path) -> tuple[str, str]:
    """First sentence of an example's docstring, and the whole docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0], text


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize().replace("ur5", "UR5").replace("Ur5", "UR5")


def _card(path: Path) -> str:
    name = path.stem
    is_drawn = (EXTRA / f"{name}.png").is_file()  # False without Chromium
    picture = f'<img src="../../motions/{name}.png" alt="" loading="lazy">' if is_drawn else ""
    return f'<a href="{name}.html">{picture}<b>{_title(name)}</b><span>{html.escape(_docstring(path)[0])}</span></a>\n'


def _example_page(path: Path) -> str:
    """Return an example's page: description, player or picture, output, source."""
    name, said = path.stem, (EXTRA / f"{path.stem}.txt").read_text(encoding="utf-8")
    if (EXTRA / f"{name}.html").is_file():
        shown = f'<iframe class="motion" src="../../motions/{name}.html" title="{name}" loading="lazy"></iframe>'
    else:
        shown = f'<img src="../../motions/{name}.png" alt="{name}">'
    source = f"```{{literalinclude}} ../../../scripts/examples/{name}.py\n```"
    return f"# {_title(name)}\n\n{_docstring(path)[0]}\n\n{shown}\n\nIt prints:\n\n```text\n{said}```\n\n{source}\n"


# Formulas and links.


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _display(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f"<div class=math>{convert(node.astext(), display='block')}</div>")
    raise nodes.SkipNode


def check_links(app: Sphinx, exception: Exception | None) -> None:
    """Check that every internal link leads to an existing anchor.

    Raises:
        SphinxError: A link is broken.
    """
    if exception is not None or app.builder.format != "html":
        return
    out = Path(app.outdir).resolve()
    pages = {path: path.read_text(encoding="utf-8") for path in out.rglob("*.html") if "motions" not in path.parts}
    names = {path: set(re.findall(r'\s(?:id|name)="([^"]+)"', text)) for path, text in pages.items()}
    dead = []
    for path, text in pages.items():
        for address in sorted(set(re.findall(r'\s(?:href|src)="([^"]+)"', text))):
            link = urlsplit(html.unescape(address))
            if link.scheme or link.netloc:
                continue
            target = (path.parent / unquote(link.path)).resolve() if link.path else path
            if target.is_dir():
                target /= "index.html"
            there = target.is_file() and (target not in names or not link.fragment or link.fragment in names[target])
            if not there:
                dead.append(f"{path.relative_to(out)}: {address}")
    if dead:
        raise SphinxError("dead links:\n" + "\n".join(dead))


def check_widths(app: Sphinx, exception: Exception | None) -> None:
    """Check that no page overflows a desktop or phone window.

    Elements that scroll by themselves are exempt. Needs Chromium.

    Raises:
        SphinxError: A page overflows.
    """
    if exception is not None or app.builder.format != "html" or shutil.which("chromium") is None:
        return
    out = Path(app.outdir).resolve()
    pages = [path.relative_to(out).as_posix() for path in sorted(out.glob("*.html"))]
    pages += [path.relative_to(out).as_posix() for path in sorted((out / "generated").rglob("index.html"))]
    measure = out / "measure.html"
    measure.write_text(_MEASURE % json.dumps(pages), encoding="utf-8")
    with tempfile.TemporaryDirectory() as profile:
        flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--no-first-run"]
        command = ["chromium", *flags, f"--user-data-dir={profile}", "--virtual-time-budget=120000", "--dump-dom"]
        text = subprocess.run([*command, measure.as_uri()], capture_output=True, text=True, check=True).stdout
    measure.unlink()
    found = html.unescape(text.partition("measured:")[2].partition("<")[0]).split("|")
    if found[0] != str(2 * len(pages)):
        raise SphinxError(f"Chromium measured {found[0] or 'none'} of {2 * len(pages)} windows")
    if found[1:]:
        raise SphinxError("cut off:\n" + "\n".join(found[1:]))


#: Opens each page at two window widths, one after the other, and records the overflowing elements.
_MEASURE = """<!DOCTYPE html><body><script>
(async () => {
  const found = [];
  let count = 0;
  for (const width of [1280, 390]) for (const page of %s) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `width: ${width}px; height: 800px; border: 0`;
    frame.src = page;
    document.body.appendChild(frame);
    await new Promise(done => { frame.onload = done; });
    const inside = frame.contentDocument, style = item => frame.contentWindow.getComputedStyle(item);
    const scrolls = item => item.tagName !== "ARTICLE"
      && (style(item).overflowX !== "visible" || style(item).position === "fixed" || scrolls(item.parentElement));
    for (const item of inside.querySelectorAll("article *")) {
      const right = item.getBoundingClientRect().right;
      if (right > width + 1 && !scrolls(item)) {
        found.push(`${page} at ${width} px: <${item.tagName}> ends at ${Math.round(right)} px`);
        break;
      }
    }
    frame.remove();
    count += 1;
  }
  document.body.textContent = "measured:" + [count, ...found].join("|");
})();
</script>"""


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive, the math renderer and event handlers with Sphinx."""
    EXTRA.mkdir(parents=True, exist_ok=True)  # Sphinx requires it before it has any files
    app.add_directive("command", Command)
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    app.connect("builder-inited", write_reference)
    app.connect("builder-inited", write_gallery)
    app.connect("autodoc-process-docstring", _as_rst, priority=400)
    app.connect("autodoc-process-signature", _plain_signature)
    app.connect("build-finished", check_links)
    app.connect("build-finished", check_widths)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
