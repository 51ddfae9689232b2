"""Exception hierarchy of hplan, with the exit status of each class.

Every exception that hplan raises on purpose derives from `HplanError`. The number is the exit status of the command
line (`exit_status`); a class without a number inherits the one of its parent::

    HplanError                                 1
    +-- InputError                             2  an argument, file or option cannot be used
    |   +-- ConfigurationInCollisionError         start or goal is in collision or too close
    |   +-- FrameError                            camera frame is invalid or too old
    |   +-- JointLimitError                       configuration outside the joint limits
    |   +-- MovingObstacleError                   the call requires a static scene
    |   +-- NotOnMotionError                      arm is off the running motion
    |   +-- OptionError                           option or argument out of range
    |   +-- OutputError                           result cannot be written
    |   +-- RobotFamilyError                      robot is not a planar arm on an optional yaw joint
    |   +-- RobotFileError                        URDF or limits file cannot be used
    |   +-- SceneError (also a ValueError)        scene or scene file is invalid
    |   |   +-- StudyError                        study or study file is invalid
    |   +-- StartStateError                       start velocity or acceleration is infeasible
    |   +-- TiltedError                           start or goal does not hold the tool upright
    +-- ApproachError                          3  no straight approach of the required length
    +-- BlockedError                           3  every goal configuration is in collision
    +-- NoPathError                            3  proved: no path exists
    +-- TourError                              3  no fruit of the tour can be picked
    +-- DetourError                            3  a fruit lengthens its tour by more than allowed
    +-- UnreachableError                       3  no inverse kinematics solution
    +-- TimingError                            4  the path cannot be timed under the limits
    +-- BoundError                             5  a duration is below its own lower bound
    +-- CertificationError                     5  the safety of a motion is not proved
    +-- PathInContactError                     5  the given path is in collision
    +-- RunningMotionBlockedError              5  the running motion cannot be replaced in time
    +-- UnavoidableContactError                5  no collision-free stop from a start in motion
    +-- NotFoundError                          6  search inconclusive: no motion found
    |   +-- NotInTimeError                        deadline passed
    |   +-- ObstacleInTimeError                   a moving obstacle blocks the best motion found
    +-- PlanCancelledError                     6  the caller cancelled the call
    +-- WorkersLostError                       6  worker processes died

Warnings derive from `HplanWarning`, which is a `UserWarning`::

    HplanWarning
    +-- FarObstacleWarning                        obstacle sizes are probably in millimetres
    +-- MissingVisualWarning                      visual mesh file not found
    +-- RobotFileWarning                          robot file read without its harmless faults
    +-- UncoveredLinkWarning                      a link has visuals without collision shapes

An error carries its facts as attributes, so that a program can act on the joint, the obstacle or the depth without
parsing the message; `data` gathers them for the JSON report. The root class stores each fact once. A class annotates
its own facts and sets an attribute only if the JSON key has another name or type.

Examples:
    >>> from hplan.errors import HplanError, OptionError
    >>> try:
    ...     raise OptionError("speed", 2.0, "a number between 0 and 1")
    ... except HplanError as error:
    ...     print(error.kind, error.exit_status, error.option, error.value)
    OptionError 2 speed 2.0
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
    TiltedError,
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
    DetourError,
    NoPathError,
    NotFoundError,
    NotInTimeError,
    ObstacleInTimeError,
    PlanCancelledError,
    TourError,
    UnreachableError,
    WorkersLostError,
)
from hplan.errors.root import (
    FarObstacleWarning,
    HplanError,
    HplanWarning,
    MissingVisualWarning,
    RobotFileWarning,
    UncoveredLinkWarning,
)

__all__ = [
    "ApproachError",
    "BlockedError",
    "BoundError",
    "CertificationError",
    "ConfigurationInCollisionError",
    "DetourError",
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
    "RobotFileWarning",
    "RunningMotionBlockedError",
    "SceneError",
    "StartStateError",
    "StudyError",
    "TiltedError",
    "TimingError",
    "TourError",
    "UnavoidableContactError",
    "UncoveredLinkWarning",
    "UnreachableError",
    "WorkersLostError",
]
