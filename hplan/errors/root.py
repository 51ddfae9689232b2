"""The root of all hplan errors: a sentence, its facts as attributes, and how it travels between processes."""

from __future__ import annotations

import pickle
from typing import Any, ClassVar


class HplanError(Exception):
    """Root of all hplan errors.

    Errors can be pickled and copied, whatever their constructor takes: they are restored from what they hold, notes
    included. As for Python's own, traceback and cause stay behind; what cannot be pickled becomes its text.

    Attributes:
        data: The facts of the error, ready for JSON.
        exit_status: Exit status of the command line for this error.
    """

    exit_status: ClassVar[int] = 1

    def __init__(self, message: str, **data: Any) -> None:
        super().__init__(message)
        vars(self).update(data)
        self.message = message
        self.data: dict[str, Any] = data

    @property
    def kind(self) -> str:
        """Name of the error, as the report gives it."""
        return type(self).__name__

    def as_dict(self) -> dict[str, Any]:
        """The error as the report's `error` object: `kind`, `message` and the facts."""
        return {"kind": self.kind, "message": self.message, **self.data}

    def add(self, sentence: str, **data: Any) -> None:
        """Add a sentence and its facts."""
        self.message = f"{self.message}; {sentence}"
        self.args = (self.message, *self.args[1:])
        self.data |= data

    def __reduce__(self) -> tuple[Any, ...]:
        """Restore without the constructor, whose arguments are not kept."""
        state = {name: value if _can_be_pickled(value) else repr(value) for name, value in vars(self).items()}
        return _without_constructor, (type(self), self.args), state


def _without_constructor(kind: type[HplanError], arguments: tuple[Any, ...]) -> HplanError:
    """An error with its `args` and nothing else."""
    return kind.__new__(kind, *arguments)


def _can_be_pickled(value: object) -> bool:
    try:
        pickle.dumps(value)
    except Exception:  # whatever a foreign class raises
        return False
    return True
