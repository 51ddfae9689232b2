"""Checked, immutable values of a scene; their faults in the words of scenes instead of pydantic's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from hplan.base.arrays import MOST_SHOWN, Unquoted
from hplan.base.options import plain
from hplan.errors import SceneError

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # it has no public name

_Part = TypeVar("_Part", bound=BaseModel)


class _SceneErrors(ModelMetaclass):
    """Classes whose constructor raises a `SceneError` for a wrong value."""

    if not TYPE_CHECKING:

        def __call__(self, *arguments, **values):
            """Make an object."""
            try:
                return super().__call__(*arguments, **values)
            except ValidationError as error:
                raise scene_error(error, self.error) from error


class StrictModel(BaseModel, metaclass=_SceneErrors):
    """Immutable, no unknown keys, no NaN or infinity, no text where a number belongs; lists and arrays become tuples.

    Raises:
        SceneError: A value of the wrong kind or range.
    """

    #: Class of the error for a wrong value.
    error: ClassVar[type[SceneError]] = SceneError

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _takes_arrays(cls, content: Any) -> Any:
        return {key: plain(value) for key, value in content.items()} if isinstance(content, dict) else content

    if not TYPE_CHECKING:

        @classmethod
        def model_validate(cls, *arguments, **options):
            """As pydantic's, but for the error."""
            try:
                return super().model_validate(*arguments, **options)
            except ValidationError as error:
                raise scene_error(error, cls.error) from error

        def __repr_args__(self):
            """Names and values for `repr`, of what is given; of long lists the number of items."""
            fields = type(self).model_fields  # what dumps leave out stands behind what makes the thing
            for name, value in sorted(super().__repr_args__(), key=lambda item: bool(fields[item[0]].exclude)):
                if value is None:
                    continue
                long = isinstance(value, tuple) and len(value) > MOST_SHOWN
                yield name, Unquoted(f"<{len(value)} items>") if long else value


def validated(kind: type[_Part], content: Any, context: dict[str, Any]) -> _Part:
    """A part of a scene from its content, for callers who know more of where a fault is.

    Raises:
        ValidationError: A value of the wrong kind or range.
    """
    made: _Part = kind.__pydantic_validator__.validate_python(content, context=context)
    return made


def fault(message: str, *below: int | str) -> PydanticCustomError:
    """A fault of the scene as a whole that shows at one place; `hplan.scene.file` finds its line by `below`."""
    return PydanticCustomError("scene", "{message}", {"message": message, "below": below})


def scene_error(error: ValidationError, kind: type[SceneError] = SceneError) -> SceneError:
    """The error for a scene, or a part of one, or what else a class of errors is for, that was made in Python."""
    first = worst_fault(error)
    below = first.get("ctx", {}).get("below", ())
    # Pydantic puts an obstacle's kind before its keys.
    steps = [*(step for step in first["loc"] if step not in _kinds()), *below]
    value = None if isinstance(first["input"], dict) else first["input"]
    reason = plain_message(first)
    if first["type"] == "model_type":  # no mapping in a file, but an object in a program
        reason = f"expected a {first['ctx']['class_name']} (got {_short(value)})"
    return kind(reason, where=dotted(steps) or None, value=value)


def worst_fault(error: ValidationError) -> Any:
    """The fault to speak of: a key that does not exist, where there is one, for that may explain the others."""
    return min(error.errors(), key=lambda item: item["type"] != "extra_forbidden")


def dotted(steps: Sequence[int | str]) -> str:
    """The path of keys to a value, as `obstacles[0].radius`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.lstrip(".")


def plain_message(fault: Any, words: Mapping[str, str] = MappingProxyType({})) -> str:
    """Pydantic's message, plainly; `words` replace what is called otherwise where the value comes from."""
    kind, value = fault["type"], fault["input"]
    if kind == "extra_forbidden":
        return "unknown key"
    if kind == "missing":
        return "too few values" if isinstance(fault["loc"][-1], int) else "this key is missing"
    if kind == "union_tag_not_found":
        return f"this key is missing: kind ({', '.join(_kinds()[:-1])} or {_kinds()[-1]})"
    if kind == "union_tag_invalid":
        return f"kind is {fault['ctx']['tag']!r}, expected one of {fault['ctx']['expected_tags']}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"input should be a mapping of keys (got {_short(value)})"
    message = str(fault["msg"]).removeprefix("Value error, ")
    for theirs, ours in {**words, " after validation": ""}.items():
        message = message.replace(theirs, ours)
    message = message[0].lower() + message[1:]
    return message if isinstance(value, dict) else f"{message} (got {_short(value)})"


def _kinds(base: type[BaseModel] = StrictModel) -> list[str]:
    """Kinds of obstacles, as files name them."""
    own = [str(base.model_fields["kind"].default)] if "kind" in base.model_fields else []
    return sorted({*own, *(kind for below in base.__subclasses__() for kind in _kinds(below))})


def _short(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else f"{text[:57]}..."
