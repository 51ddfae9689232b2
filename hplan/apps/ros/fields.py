"""Fields of ROS messages: dictionaries, objects of rclpy or rosbags, and files.

Readers ask for fields by name and do not care which of them a message is. Arrays are taken from the objects as they
are, without a copy of the message as a dictionary.
"""

from __future__ import annotations

import dataclasses
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import yaml

from hplan.base.arguments import file_path
from hplan.base.arrays import FloatArray
from hplan.base.files import ByteBudget
from hplan.base.yaml_text import read_yaml
from hplan.errors import HplanError, InputError
from hplan.scene.limits import MOST_SCENE_BYTES

_Message = TypeVar("_Message")
_Found = TypeVar("_Found")


def _cached(function: Callable[[Any], _Found]) -> Callable[[Any], _Found]:
    """`functools.cache`, for functions of a class."""
    return cache(function)


class MessageFields(Mapping[str, Any]):
    """A message object as a mapping of its fields, which are read on access."""

    def __init__(self, message: Any) -> None:
        self._message, self._names = message, _field_names(message)

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise KeyError(name)
        return getattr(self._message, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return repr(self._message)


def is_message(content: Any) -> bool:
    """True for a dictionary and for a message object of rclpy or rosbags."""
    if isinstance(content, Mapping | SimpleNamespace) or hasattr(content, "get_fields_and_field_types"):
        return True
    return dataclasses.is_dataclass(content) and hasattr(content, "__msgtype__")


def are_messages(items: Iterable[Any]) -> bool:
    """True if all items are messages; asks once for each class."""
    return all(map(is_message, {type(item): item for item in items}.values()))


def fields_of(message: Any) -> Mapping[str, Any]:
    """Mapping of the fields of a message, which satisfies `is_message`.

    Examples:
        >>> from types import SimpleNamespace
        >>> fields_of({"sec": 1})["sec"], fields_of(SimpleNamespace(sec=1))["sec"]
        (1, 1)
    """
    return message if isinstance(message, Mapping) else MessageFields(message)


def _field_names(message: Any) -> tuple[str, ...]:
    if isinstance(message, SimpleNamespace):
        return tuple(vars(message))
    return _names_of(type(message))


@_cached
def _names_of(kind: Any) -> tuple[str, ...]:
    """Field names of a class of rclpy or rosbags."""
    if hasattr(kind, "get_fields_and_field_types"):
        return tuple(kind.get_fields_and_field_types())
    return tuple(each.name for each in dataclasses.fields(kind))


def column(messages: Sequence[Any], name: str) -> list[Any]:
    """Values of one field of many messages; None where a dictionary lacks it."""
    if messages and isinstance(messages[0], Mapping):
        return [(each if type(each) is dict else fields_of(each)).get(name) for each in messages]
    return [getattr(each, name, None) for each in messages]


def stack_rows(rows: Sequence[Any]) -> FloatArray | None:
    """(n, m) array of n equally long `array.array`s of doubles; None for anything else.

    It joins their bytes, which is ten times as fast as a conversion number by number.
    """
    if not rows or any(type(row) is not array or row.typecode != "d" for row in rows):
        return None
    length = len(rows[0])
    if any(len(row) != length for row in rows):
        return None
    return np.frombuffer(b"".join(rows), np.float64).reshape(len(rows), length)


def read_message(source: Any, error: Callable[..., HplanError] = InputError) -> tuple[Mapping[str, Any], Path | None]:
    """Fields of a message, or of a YAML or JSON file, and the path of the file.

    Args:
        source: A dictionary, a message object, or the path of a file as `ros2 topic echo --once --full-length` prints.
        error: Error class; constructed with the reason and, for `SceneError`, with path and line.

    Raises:
        HplanError: The file is missing or malformed, holds several messages or none.
        OptionError: `source` is none of these.
    """
    if is_message(source):
        return fields_of(source), None
    path = file_path("source", source)

    def fault(reason: str, line: int | None = None) -> HplanError:
        if error is InputError:
            at = "" if line is None else f", line {line}"
            return error(f"{path}{at}: {reason}", path=str(path))
        return error(reason, path=path, line=line)

    text = ByteBudget(MOST_SCENE_BYTES).text(path, fault)
    # `ros2 topic echo` ends each message with a line of three hyphens.
    text = re.sub(r"(\n---[ \t\r]*)+\s*\Z", "\n", text)
    try:
        content, _ = read_yaml(text)
    except yaml.MarkedYAMLError as found:
        line = None if found.problem_mark is None else found.problem_mark.line + 1
        reason = f"malformed YAML: {found.problem}"
        if "another document" in str(found.problem):
            reason = "there are several messages; expected one, as `ros2 topic echo --once --full-length` prints it"
        raise fault(reason, line) from found
    if not isinstance(content, Mapping):
        raise fault("expected a message: a mapping of its fields")
    return content, path


def to_message(kind: type[_Message], content: Mapping[str, Any]) -> _Message:
    """Message object of rclpy from a dictionary; omitted fields keep their defaults.

    Args:
        kind: Class of the message, for example `trajectory_msgs.msg.JointTrajectory`.
        content: Its fields, nested messages as dictionaries.

    Raises:
        InputError: The message has no such field; names it.
    """
    message, nested = kind(), _nested_kinds(kind)
    for name, value in content.items():
        if name not in nested:
            raise InputError(f"{kind.__name__} has no field {name!r}; it has {', '.join(nested)}", field=name)
        inner = nested[name]
        if inner is not None and isinstance(value, Mapping):
            value = to_message(inner, value)
        elif inner is not None:
            value = [to_message(inner, each) if isinstance(each, Mapping) else each for each in value]
        setattr(message, name, value)
    return message


@_cached
def _nested_kinds(kind: Any) -> dict[str, Any]:
    """Class of the messages in each field of a class of rclpy; None for other fields."""
    found = dict[str, Any]()
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        inner = getattr(slot, "value_type", slot)
        spaces = getattr(inner, "namespaces", None)
        found[name] = None if spaces is None else getattr(import_module(".".join(spaces)), inner.name)
    return found
