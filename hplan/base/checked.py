"""Frozen option dataclasses and models, validated by pydantic.

`Options` raise `OptionError`, like the checks of single arguments (`hplan.base.arguments`). A `StrictModel` is the
schema of a file: it raises `SceneError` with the key path, to which `hplan.scene.file` adds the line.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeAlias, TypeVar, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator
from pydantic_core import PydanticCustomError

from hplan.base.arguments import nearest_name
from hplan.base.arrays import MOST_SHOWN, Unquoted
from hplan.errors import OptionError, SceneError

_Part = TypeVar("_Part", bound=BaseModel)

#: Positive numbers, nonnegative numbers, non-empty strings.
Positive: TypeAlias = Annotated[float, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0)]
Text: TypeAlias = Annotated[str, Field(min_length=1)]


def plain(value: Any) -> Any:
    """Convert lists and arrays to tuples, NumPy numbers to Python numbers."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list) else value


class Options:
    """Base of frozen option dataclasses.

    Numbers are finite; lists and arrays become tuples; nothing else is converted.

    Raises:
        OptionError: A value is not of its field's type, or outside the field's range (`pydantic.Field`).
    """

    def __new__(cls, *_: Any, **values: Any) -> Self:
        """Refuse unknown options, which a dataclass refuses with an error of its own."""
        cls._check_names(values)
        return super().__new__(cls)

    @classmethod
    def _check_names(cls, values: Mapping[str, Any]) -> None:
        kind: Any = cls
        names = [field.name for field in dataclasses.fields(kind)]
        for key, value in values.items():
            if key not in names:
                raise OptionError(key, value, f"an option of {cls.__name__}; {nearest_name(key, names)}")

    def __post_init__(self) -> None:
        kind: Any = type(self)
        values = {field.name: plain(getattr(self, field.name)) for field in dataclasses.fields(kind)}
        try:
            checked = _model(kind).model_validate(values)
        except ValidationError as error:
            # A union has one fault per member; the deepest one belongs to the intended member.
            fault = max(error.errors(), key=lambda fault: len(fault["loc"]))
            words = "more values" if fault["type"] == "missing" else fault["msg"]
            expected = re.sub(r"^\w+ should (be|have) ", "", words)
            raise OptionError(_value_path(values, fault["loc"]), fault["input"], expected) from None
        for name in values:
            object.__setattr__(self, name, getattr(checked, name))

    def with_values(self, **changes: Any) -> Self:
        """Return a checked copy with other values.

        Args:
            changes: New values by field name.

        Raises:
            OptionError: A name is not an option, or its option does not accept the value.

        Examples:
            >>> from hplan import PlanOptions
            >>> PlanOptions().with_values(speed=0.5).speed
            0.5
        """
        self._check_names(changes)
        copied: Self = dataclasses.replace(self, **changes)  # type: ignore[type-var]
        return copied


@cache
def _model(kind: Any) -> type[BaseModel]:
    """Pydantic model that checks the values of a dataclass."""
    fields: dict[str, Any] = {name: (hint, ...) for name, hint in get_type_hints(kind, include_extras=True).items()}
    return create_model(kind.__name__, __config__=ConfigDict(strict=True, allow_inf_nan=False), **fields)


def _value_path(value: Any, steps: Sequence[Any]) -> str:
    """Path to the invalid value, as `lower[2]`, without pydantic's type names."""
    name, value = str(steps[0]), value[steps[0]]
    for step in steps[1:]:
        if isinstance(value, dict | tuple) and (step in value or step in range(len(value))):
            name, value = f"{name}[{step!r}]", value[step]
    return name


class StrictModel(BaseModel):
    """Immutable model without unknown keys, NaN, infinity or text as number.

    Lists and arrays become tuples. Values are checked by each way to make an object: the constructor, `with_values` and
    pydantic's `model_copy`.

    Raises:
        SceneError: A value has the wrong type or range.
    """

    #: Class of the error for an invalid value.
    error: ClassVar[type[SceneError]] = SceneError

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _takes_arrays(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        names = cls._names()
        for key in content:
            if key in names:
                continue
            # A model that ignores unknown keys refuses misspelt ones.
            if cls.model_config["extra"] == "forbid" or get_close_matches(str(key), names, 1):
                facts = {"message": f"unknown key; {nearest_name(str(key), names)}", "below": (key,)}
                raise PydanticCustomError("extra_forbidden", "{message}", facts)
        return {key: plain(value) for key, value in content.items()}

    @classmethod
    def _names(cls) -> Mapping[str, str]:
        """Map names and aliases to field names."""
        return _names_of(cls)

    def with_values(self, **changes: Any) -> Self:
        """Return a checked copy with other values.

        All values are checked together, as in the constructor. Nested models may be given as objects or as mappings.

        Args:
        changes: New values by field name or alias.

        Raises:
        SceneError: A name is not a field, a value has the wrong type or range, or values contradict each other.

        Examples:
            >>> from hplan.scene import Sphere
            >>> apple = Sphere(name="apple", center=(1.0, 0.0, 1.5), radius=0.04)
            >>> apple.with_values(radius=0.05).radius
            0.05
            >>> apple.with_values(centre=(0.0, 0.0, 1.0))
            Traceback (most recent call last):
            ...
            hplan.errors.bad_input.SceneError: scene, centre: a Sphere has no 'centre'; did you mean 'center'?
        """
        fields, names = type(self).model_fields, type(self)._names()
        for key in changes:
            if key not in names:
                raise self.error(f"a {type(self).__name__} has no {key!r}; {nearest_name(key, names)}", where=key)
        kept = {key: getattr(self, key) for key in fields if key in self.model_fields_set}
        return self._validate(kept | {names[key]: value for key, value in changes.items()})

    def copy_unchecked(self, changes: Mapping[str, Any]) -> Self:
        """Return an unchecked copy with other values, computed by hplan itself."""
        return super().model_copy(update=changes)

    def _validate(self, values: dict[str, Any]) -> Self:
        """Construct an object of the same class from values by field name.

        Raises:
            SceneError: A value has the wrong type or range.
        """
        try:
            return validate_part(type(self), values, self._context(values))
        except ValidationError as error:
            raise scene_error(error, self.error) from error

    def _context(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Validation context for a copy with some values."""
        del values  # used by classes with data in a file
        return {}

    if not TYPE_CHECKING:

        def __init__(self, /, **values):
            """Validate the values.

            pydantic does not call this for parts of other models.
            """
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise scene_error(error, self.error) from error

        __init__.__pydantic_base_init__ = True

        def model_copy(self, *, update=None, deep=False):
            """Copy as in pydantic, but check new values as `with_values` does."""
            return super(StrictModel, self if not update else self.with_values(**update)).model_copy(deep=deep)

        def copy(self, *, update=None, deep=False):
            """Copy as `model_copy` does."""
            return self.model_copy(update=update, deep=deep)

        @classmethod
        def model_construct(cls, _fields_set=None, **values):
            """Construct a checked object, as the constructor does."""
            return cls(**values)

        def __setattr__(self, name, value):
            """Refuse to change a field; private attributes may change."""
            if not name.startswith("_"):
                owner = type(self).__name__
                raise self.error(f"a {owner} is immutable; with_values({name}=...) returns a changed copy", where=name)
            super().__setattr__(name, value)

        @classmethod
        def model_validate(cls, *arguments, **options):
            """Validate as in pydantic, but raise `SceneError`."""
            try:
                return super().model_validate(*arguments, **options)
            except ValidationError as error:
                raise scene_error(error, cls.error) from error

        def __repr_args__(self):
            """Names and values for `repr`, without None; long lists by their length."""
            fields = type(self).model_fields  # fields excluded from dumps come last
            for name, value in sorted(super().__repr_args__(), key=lambda item: bool(fields[item[0]].exclude)):
                if value is None:
                    continue
                long = isinstance(value, tuple) and len(value) > MOST_SHOWN
                yield name, Unquoted(f"<{len(value)} items>") if long else value


@cache
def _names_of(kind: type[BaseModel]) -> Mapping[str, str]:
    fields = kind.model_fields
    aliases = {str(field.validation_alias): name for name, field in fields.items() if field.validation_alias}
    return aliases | {name: name for name in fields}


def validate_part(kind: type[_Part], content: Any, context: dict[str, Any]) -> _Part:
    """Validate a part of a scene; the caller adds a fault's place.

    Raises:
        ValidationError: A value has the wrong type or range.
    """
    made: _Part = kind.__pydantic_validator__.validate_python(content, context=context)
    return made


def check_values(model: StrictModel, *place: int | str) -> None:
    """Check an object's values, nested models included, as the constructor does.

    The constructor checks objects already; this is for objects whose values were changed by bypassing it.

    Args:
        model: The object.
        place: Key path of the object, for the error.

    Raises:
        SceneError: A value has the wrong type or range, is missing, or is not a field.
    """
    kind = type(model)
    values = {key: value for key, value in vars(model).items() if key in kind.model_fields or not hasattr(kind, key)}
    for key, value in values.items():
        if isinstance(value, StrictModel):
            check_values(value, *place, key)
        elif isinstance(value, tuple) and value and isinstance(value[0], StrictModel):
            for index, part in enumerate(value):
                if isinstance(part, StrictModel):  # anything else is refused below, with its key path
                    check_values(part, *place, key, index)
    try:
        validate_part(kind, dict(values), model._context(values))
    except ValidationError as error:
        found = scene_error(error, model.error)
        where = ".".join(filter(None, (format_key_path(place), found.where))) or None
        reason = f"{found.reason}; it was changed without checks: with_values(...) returns a checked copy"
        raise model.error(reason, where=where, value=found.value) from error


def fault(message: str, *below: int | str) -> PydanticCustomError:
    """Return a fault at a key path, for checks of several values.

    `hplan.scene.file` finds its line by `below`.
    """
    return PydanticCustomError("scene", "{message}", {"message": message, "below": below})


def scene_error(error: ValidationError, kind: type[SceneError] = SceneError) -> SceneError:
    """Convert a pydantic error of an object made in Python."""
    first = worst_fault(error)
    below = first.get("ctx", {}).get("below", ())
    # Pydantic inserts an obstacle's kind before its keys.
    steps = [*(step for step in first["loc"] if step not in _kinds()), *below]
    value = None if isinstance(first["input"], dict) else first["input"]
    if first["type"] == "extra_forbidden" and below:
        value = first["input"][below[0]]
    reason = plain_message(first)
    if first["type"] == "model_type":  # not a mapping in a file, but an object in a program
        reason = f"expected a {first['ctx']['class_name']} (got {_shorten(value)})"
    return kind(reason, where=format_key_path(steps) or None, value=value)


def worst_fault(error: ValidationError) -> Any:
    """Select the fault to report: first an unknown key.

    It may explain the other faults.
    """
    return min(error.errors(), key=lambda item: item["type"] != "extra_forbidden")


def format_key_path(steps: Sequence[int | str]) -> str:
    """Format a key path, for example `obstacles[0].radius`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.lstrip(".")


def plain_message(fault: Any, words: Mapping[str, str] = MappingProxyType({})) -> str:
    """Pydantic's message in plain words; `words` are further replacements."""
    kind, value = fault["type"], fault["input"]
    if kind == "extra_forbidden":
        return str(fault["msg"]) if "ctx" in fault else "unknown key"
    if kind == "missing":
        return "too few values" if isinstance(fault["loc"][-1], int) else "this key is missing"
    if kind == "union_tag_not_found":
        return f"this key is missing: kind ({', '.join(_kinds()[:-1])} or {_kinds()[-1]})"
    if kind == "union_tag_invalid":
        return f"kind is {fault['ctx']['tag']!r}, expected one of {fault['ctx']['expected_tags']}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"input should be a mapping of keys (got {_shorten(value)})"
    message = str(fault["msg"]).removeprefix("Value error, ")
    for theirs, ours in {**words, " after validation": ""}.items():
        message = message.replace(theirs, ours)
    message = message[0].lower() + message[1:]
    return message if isinstance(value, dict) else f"{message} (got {_shorten(value)})"


def _kinds(base: type[BaseModel] = StrictModel) -> list[str]:
    """Kinds of obstacles, as in files."""
    own = [str(base.model_fields["kind"].default)] if "kind" in base.model_fields else []
    return sorted({*own, *(kind for below in base.__subclasses__() for kind in _kinds(below))})


def _shorten(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else f"{text[:57]}..."
