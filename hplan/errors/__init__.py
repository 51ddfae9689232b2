"""Every error that hplan raises on purpose, under one root.

An error carries its facts as attributes, so that a program can act on *which joint*, *which obstacle*, *how deep*
without reading the sentence; `data` gathers them for the report. Each is stored once, by the root; a class annotates
its own, and sets only those that JSON knows under another name or as another type. `exit_status` is what the command
line returns for it.
"""

from hplan.errors.bad_input import (
    ConfigurationInCollisionError,
    FrameError,
    InputError,
    JointLimitError,
    MovingObstacleError,
    NotOnMotionError,
    OptionError,
    OutputError,
    RobotFamilyError,
    RobotFileError,
    SceneError,
    StartStateError,
    StudyError,
)
from hplan.errors.motion import (
    BoundError,
    CertificationError,
    PathInContactError,
    RunningMotionBlockedError,
    TimingError,
    UnavoidableContactError,
)
from hplan.errors.no_motion import (
    ApproachError,
    BlockedError,
    NoPathError,
    NotFoundError,
    NotInTimeError,
    ObstacleInTimeError,
    PlanCancelledError,
    TourError,
    UnreachableError,
    WorkersLostError,
)
from hplan.errors.root import HplanError
from hplan.errors.warning import FarObstacleWarning, HplanWarning, MissingVisualWarning, UncoveredLinkWarning

__all__ = [
    "ApproachError",
    "BlockedError",
    "BoundError",
    "CertificationError",
    "ConfigurationInCollisionError",
    "FarObstacleWarning",
    "FrameError",
    "HplanError",
    "HplanWarning",
    "InputError",
    "JointLimitError",
    "MissingVisualWarning",
    "MovingObstacleError",
    "NoPathError",
    "NotFoundError",
    "NotInTimeError",
    "NotOnMotionError",
    "ObstacleInTimeError",
    "OptionError",
    "OutputError",
    "PathInContactError",
    "PlanCancelledError",
    "RobotFamilyError",
    "RobotFileError",
    "RunningMotionBlockedError",
    "SceneError",
    "StartStateError",
    "StudyError",
    "TimingError",
    "TourError",
    "UnavoidableContactError",
    "UncoveredLinkWarning",
    "UnreachableError",
    "WorkersLostError",
]
