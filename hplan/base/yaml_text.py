"""YAML subset of hplan's files: JSON types, comments, anchors, merge keys.

Plain scalars follow YAML 1.2. PyYAML follows YAML 1.1: `010` is 8, `1:30` is 90, `no` is False, `1e-2` is a string, and
a repeated key silently replaces the first. That is unacceptable in a file that moves a robot.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Final

import yaml

_TRUTH = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}

#: Plain scalars by type: pattern, possible first characters, conversion.
_PLAIN: dict[str, tuple[str, list[str], Callable[[str], Any]]] = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""], lambda _: None),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF"), _TRUTH.__getitem__),
    "int": (r"[-+]?[0-9]+", list("-+0123456789"), int),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
        lambda text: float(re.sub(r"\.(?=[iInN])", "", text)),
    ),
}

#: Maximum number of keys, values, lists and mappings of a document. (PyYAML reads about 30,000 per second.)
MOST_VALUES: Final = 500_000


def read_yaml(text: str) -> tuple[Any, yaml.Node | None]:
    """Read one document.

    Returns:
        The content (mappings as dict, lists as tuple) and its node, which has the line numbers; (None, None) if empty.

    Raises:
        yaml.MarkedYAMLError: Malformed text, a repeated key, a tag outside JSON's types, or more than `MOST_VALUES`
            values.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return (None, None) if node is None else (loader.construct_document(node), node)
    except RecursionError as error:
        raise yaml.MarkedYAMLError(problem="it is nested too deeply") from error
    except yaml.reader.ReaderError as error:
        raise yaml.MarkedYAMLError(problem=f"character {error.character!r} is not allowed in YAML") from error


def write_yaml(content: Any) -> str:
    """Return text that `read_yaml` reads back to equal content.

    Lists of scalars are written on one line.
    """
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


class _Loader(yaml.SafeLoader):
    """Loader of JSON's types only."""

    yaml_implicit_resolvers = {}  # noqa: RUF012
    yaml_constructors = {}  # noqa: RUF012
    values = 0

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.sizes: dict[str, int] = {}  # number of values of each anchored node, repeated ones included

    def scan_to_next_token(self) -> None:
        super().scan_to_next_token()
        while self.flow_level and self.peek() == "\t":  # inside braces JSON may be indented with tabs
            self.forward()
            super().scan_to_next_token()

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        repeats = isinstance(event, yaml.AliasEvent)
        if repeats and event.anchor in self.anchors and event.anchor not in self.sizes:
            problem = f"alias *{event.anchor} is inside the value that it repeats"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        before = self.values
        # Each repetition counts: a few lines of aliases can expand beyond any memory.
        self.values += self.sizes.get(event.anchor, 1) if repeats else 1
        if self.values > MOST_VALUES:
            raise yaml.MarkedYAMLError(problem=f"more than {MOST_VALUES:,} values", problem_mark=event.start_mark)
        node = super().compose_node(parent, index)
        if not repeats and event.anchor is not None:
            self.sizes[event.anchor] = self.values - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.MarkedYAMLError(problem="expected a mapping", problem_mark=node.start_mark)
        lines: dict[str, int] = {}
        merged: dict[Any, Any] = {}
        for key, value in node.value:
            if key.value == "<<" and key.style is None:
                merged |= self._merge_mappings(key, value)
                continue
            if key.tag != "tag:yaml.org,2002:str":
                raise yaml.MarkedYAMLError(problem="a key must be text", problem_mark=key.start_mark)
            if key.value in lines:
                problem = f"key {key.value!r} is already on line {lines[key.value]}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            lines[key.value] = key.start_mark.line + 1
        return merged | {k.value: self.construct_object(v, deep=deep) for k, v in node.value if k.value in lines}

    def _merge_mappings(self, key: yaml.Node, value: yaml.Node) -> dict[Any, Any]:
        """Values of the merge key `<<`, from a mapping or a list.

        In a list, earlier mappings take precedence.
        """
        parts = value.value if isinstance(value, yaml.SequenceNode) else [value]
        if not all(isinstance(part, yaml.MappingNode) for part in parts):
            raise yaml.MarkedYAMLError(problem="<< takes a mapping or a list of mappings", problem_mark=key.start_mark)
        merged: dict[Any, Any] = {}
        for part in reversed(parts):
            merged |= self.construct_mapping(part, deep=True)
        return merged


def _construct_text(loader: _Loader, node: yaml.ScalarNode) -> str:
    text = str(loader.construct_scalar(node))
    try:
        # JSON escapes a character beyond U+FFFF as a surrogate pair.
        return text.encode("utf-16", "surrogatepass").decode("utf-16")
    except UnicodeDecodeError as error:
        raise yaml.MarkedYAMLError(
            problem="the text contains half of a character (a lone surrogate)", problem_mark=node.start_mark
        ) from error


def _construct_list(loader: _Loader, node: yaml.SequenceNode) -> tuple[Any, ...]:
    return tuple(loader.construct_sequence(node, deep=True))


def _construct_mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


def _construct_unknown(_: _Loader, node: yaml.Node) -> Any:
    raise yaml.MarkedYAMLError(problem=f"tag {node.tag!r} is not allowed", problem_mark=node.start_mark)


def _plain_constructor(kind: str, meaning: Callable[[str], Any]) -> Callable[[_Loader, yaml.ScalarNode], Any]:
    def construct(loader: _Loader, node: yaml.ScalarNode) -> Any:
        text = loader.construct_scalar(node)
        try:
            return meaning(text)
        except (KeyError, ValueError) as error:
            problem = f"{text[:40]!r} cannot be read as {kind}"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from error

    return construct


class _Dumper(yaml.SafeDumper):
    """Quotes strings that the loader would read as another type."""


def _represent_list(dumper: yaml.SafeDumper, items: list[Any]) -> yaml.Node:
    flat = all(isinstance(item, (int, float, str)) for item in items)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=flat)


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    """Escape characters that PyYAML would read back as line breaks (U+0085)."""
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if text.isprintable() else '"')


_Loader.add_constructor("tag:yaml.org,2002:str", _construct_text)
_Loader.add_constructor("tag:yaml.org,2002:seq", _construct_list)
_Loader.add_constructor("tag:yaml.org,2002:map", _construct_mapping)
_Loader.add_constructor(None, _construct_unknown)
for _kind, (_pattern, _first, _meaning) in _PLAIN.items():
    _tag = f"tag:yaml.org,2002:{_kind}"
    _regexp = re.compile(f"^(?:{_pattern})$")
    _Loader.add_constructor(_tag, _plain_constructor(_kind, _meaning))
    _Loader.add_implicit_resolver(_tag, _regexp, _first)
    _Dumper.add_implicit_resolver(_tag, _regexp, _first)
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(str, _represent_text)
