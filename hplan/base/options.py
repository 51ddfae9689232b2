"""Option dataclasses whose types declare the accepted values, checked by pydantic."""

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

#: Positive numbers, nonnegative numbers, non-empty strings.
Positive: TypeAlias = Annotated[float, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0)]
Text: TypeAlias = Annotated[str, Field(min_length=1)]


class Options:
    """Base of frozen option dataclasses.

    Numbers are finite; lists and arrays become tuples; nothing else is converted.

    Raises:
        OptionError: A value is not of its field's type, or outside the field's range (`pydantic.Field`).
    """

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
            raise OptionError(_place(values, fault["loc"]), fault["input"], expected) from None
        for name in values:
            object.__setattr__(self, name, getattr(checked, name))

    def with_(self, **changes: Any) -> Self:
        """Return a checked copy with other values.

        Args:
            changes: New values by field name.

        Raises:
            OptionError: A name is not an option, or its option does not accept the value.

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
    """Pydantic model that checks the values of a dataclass."""
    fields: dict[str, Any] = {name: (hint, ...) for name, hint in get_type_hints(kind, include_extras=True).items()}
    return create_model(kind.__name__, __config__=ConfigDict(strict=True, allow_inf_nan=False), **fields)


def _place(value: Any, steps: Sequence[Any]) -> str:
    """Path to the invalid value, as `lower[2]`, without pydantic's type names."""
    name, value = str(steps[0]), value[steps[0]]
    for step in steps[1:]:
        if isinstance(value, dict | tuple) and (step in value or step in range(len(value))):
            name, value = f"{name}[{step!r}]", value[step]
    return name


def plain(value: Any) -> Any:
    """Convert lists and arrays to tuples, NumPy numbers to Python numbers."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(plain, value)) if isinstance(value, list) else value
