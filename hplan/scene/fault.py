"""A wrong value in a scene, in the words of scenes instead of pydantic's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from pydantic import ValidationError

from hplan.errors import SceneError

#: Steps that pydantic puts before the keys of an obstacle.
_KINDS = ("sphere", "capsule", "box", "mesh", "points")


def scene_error(error: ValidationError) -> SceneError:
    """The error for a scene, or a part of one, that was made in Python."""
    first = worst_fault(error)
    below = first.get("ctx", {}).get("below", ())
    steps = [*(step for step in first["loc"] if step not in _KINDS), *below]
    value = None if isinstance(first["input"], dict) else first["input"]
    reason = plain_message(first)
    if first["type"] == "model_type":  # no mapping in a file, but an object in a program
        reason = f"expected a {first['ctx']['class_name']} (got {_short(value)})"
    return SceneError(reason, where=dotted(steps) or None, value=value)


def worst_fault(error: ValidationError) -> Any:
    """The fault to speak of: a key that does not exist, where there is one, for that may explain the others."""
    return min(error.errors(), key=lambda item: item["type"] != "extra_forbidden")


def dotted(steps: Sequence[int | str]) -> str:
    """The way to a value, as `obstacles[0].radius`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.lstrip(".")


def plain_message(fault: Any, words: Mapping[str, str] = MappingProxyType({})) -> str:
    """Pydantic's message in plain words; `words` replace what is called otherwise where the value comes from."""
    kind, value = fault["type"], fault["input"]
    if kind == "extra_forbidden":
        return "unknown key"
    if kind == "missing":
        return "too few values" if isinstance(fault["loc"][-1], int) else "this key is missing"
    if kind == "union_tag_not_found":
        return "this key is missing: kind (sphere, capsule, box, mesh or points)"
    if kind == "union_tag_invalid":
        return f"kind is {fault['ctx']['tag']!r}, expected one of {fault['ctx']['expected_tags']}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"input should be a mapping of keys (got {_short(value)})"
    message = str(fault["msg"]).removeprefix("Value error, ")
    for theirs, ours in {**words, " after validation": ""}.items():
        message = message.replace(theirs, ours)
    message = message[0].lower() + message[1:]
    return message if isinstance(value, dict) else f"{message} (got {_short(value)})"


def _short(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else f"{text[:57]}..."
