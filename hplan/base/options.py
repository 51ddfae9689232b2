"""Options whose types say what values they take: frozen dataclasses that pydantic checks."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, Self, TypeAlias, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from hplan.base.arguments import nearest_name
from hplan.errors import OptionError

#: Numbers above zero, and from zero on; texts that are not empty.
Positive: TypeAlias = Annotated[float, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0)]
Text: TypeAlias = Annotated[str, Field(min_length=1)]


class Options:
    """Base of frozen dataclasses: numbers are finite, lists and arrays become tuples, nothing else is converted.

    Raises:
        OptionError: A value that is not of its field's type, or out of the range given there (`pydantic.Field`).
    """

    def __post_init__(self) -> None:
        kind: Any = type(self)
        values = {field.name: plain(getattr(self, field.name)) for field in dataclasses.fields(kind)}
        try:
            checked = _model(kind).model_validate(values)
        except ValidationError as error:
            # Of a union each member has its fault; the one deepest inside is that of the member that is meant.
            fault = max(error.errors(), key=lambda fault: len(fault["loc"]))
            words = "more values" if fault["type"] == "missing" else fault["msg"]
            expected = re.sub(r"^\w+ should (be|have) ", "", words)
            raise OptionError(_place(values, fault["loc"]), fault["input"], expected) from None
        for name in values:
            object.__setattr__(self, name, getattr(checked, name))

    def with_(self, **changes: Any) -> Self:
        """Return a checked copy with other values.

        Args:
            changes: New values by field name.

        Raises:
            OptionError: A name that is no option, or a value that its option does not take.

        Examples:
            >>> from hplan import PlanOptions
            >>> PlanOptions().with_(speed=0.5).speed
            0.5
        """
        kind: Any = type(self)
        names = [field.name for field in dataclasses.fields(kind)]
        for key, value in changes.items():
            if key not in names:
                raise OptionError(key, value, f"an option of {kind.__name__}; {nearest_name(key, names)}")
        copied: Self = dataclasses.replace(self, **changes)  # type: ignore[type-var]
        return copied


@cache
def _model(kind: Any) -> type[BaseModel]:
    """What pydantic checks the values of a dataclass with."""
    fields: dict[str, Any] = {name: (hint, ...) for name, hint in get_type_hints(kind, include_extras=True).items()}
    return create_model(kind.__name__, __config__=ConfigDict(strict=True, allow_inf_nan=False), **fields)


def _place(value: Any, steps: Sequence[Any]) -> str:
    """Name of an option and the place in it, as `lower[2]`; pydantic puts names of types between."""
    name, value = str(steps[0]), value[steps[0]]
    for step in steps[1:]:
        if isinstance(value, dict | tuple) and (step in value or step in range(len(value))):
            name, value = f"{name}[{step!r}]", value[step]
    return name


def plain(value: Any) -> Any:
    """A value with tuples in place of lists and arrays, and Python's numbers in place of NumPy's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list) else value
