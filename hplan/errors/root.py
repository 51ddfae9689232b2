"""Root classes of hplan's errors and warnings.

They carry a message and facts as attributes, and can be pickled.
"""

from __future__ import annotations

import pickle
from typing import Any, ClassVar


class HplanError(Exception):
    """Root of all hplan errors.

    Errors can be pickled and copied, notes included, for any constructor signature: unpickling restores the attributes.
    As with Python's own exceptions, traceback and cause are dropped. An attribute that cannot be pickled is replaced by
    its `repr`.

    Attributes:
        message: The sentence for the user.
        data: Facts of the error by name, JSON-serializable.
        exit_status: Exit status of the command line for this error.

    Examples:
        >>> from hplan.errors import HplanError
        >>> error = HplanError("joint 'elbow' is locked", joint="elbow")
        >>> error.joint
        'elbow'
        >>> error.as_dict()
        {'kind': 'HplanError', 'message': "joint 'elbow' is locked", 'joint': 'elbow'}
    """

    exit_status: ClassVar[int] = 1

    def __init__(self, message: str, **data: Any) -> None:
        super().__init__(message)
        vars(self).update(data)
        self.message = message
        self.data: dict[str, Any] = data

    @property
    def kind(self) -> str:
        """Class name of the error, as in the report."""
        return type(self).__name__

    def as_dict(self) -> dict[str, Any]:
        """Return the report's `error` object: `kind`, `message` and the facts."""
        return {"kind": self.kind, "message": self.message, **self.data}

    def add(self, sentence: str, **data: Any) -> None:
        """Append a sentence to the message, and its facts to `data`."""
        self.message = f"{self.message}; {sentence}"
        self.args = (self.message, *self.args[1:])
        self.data |= data

    def __reduce__(self) -> tuple[Any, ...]:
        """Restore without the constructor, whose arguments are not stored."""
        state = {name: value if _can_be_pickled(value) else repr(value) for name, value in vars(self).items()}
        return _without_constructor, (type(self), self.args), state


def _without_constructor(kind: type[HplanError], arguments: tuple[Any, ...]) -> HplanError:
    """Return an error with its `args`, constructor skipped."""
    return kind.__new__(kind, *arguments)


def _can_be_pickled(value: object) -> bool:
    try:
        pickle.dumps(value)
    except Exception:  # third-party classes raise arbitrary exceptions
        return False
    return True


class HplanWarning(UserWarning):
    """Root of the hplan warnings, for filters.

    Examples:
        >>> import warnings
        >>> from hplan.errors import HplanWarning
        >>> warnings.simplefilter("ignore", HplanWarning)
    """


class FarObstacleWarning(HplanWarning):
    """Obstacles are far from the arm, or held objects large; their unit is probably millimetres.

    Examples:
        >>> from hplan.errors import FarObstacleWarning, HplanWarning
        >>> issubclass(FarObstacleWarning, HplanWarning)
        True
    """


class UncoveredLinkWarning(HplanWarning):
    """A link has visuals that its collision shapes do not cover.

    Plans and certificates say nothing about that link.

    Examples:
        >>> from hplan.errors import UncoveredLinkWarning
        >>> issubclass(UncoveredLinkWarning, UserWarning)
        True
    """


class RobotFileWarning(HplanWarning):
    """A robot file has faults that no motion depends on.

    It was read without them.

    Examples:
        >>> from hplan.errors import HplanWarning, RobotFileWarning
        >>> issubclass(RobotFileWarning, HplanWarning)
        True
    """


class MissingVisualWarning(HplanWarning):
    """A visual's mesh file is missing, so the link is not drawn.

    Plans do not change.

    Examples:
        >>> import warnings
        >>> from hplan.errors import MissingVisualWarning
        >>> warnings.filterwarnings("error", category=MissingVisualWarning)
    """
