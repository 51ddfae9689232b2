"""Start, parameters, robot and shutdown that hplan's ROS nodes share.

A node's parameters are the fields of a dataclass of `Options`, so that their types and ranges are checked in one place.
They are read once, at the start.
"""

from __future__ import annotations

import dataclasses
import gc
import inspect
import os
import re
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

from hplan.apps.ros.moveit_scene import OpenMeshes
from hplan.apps.ros.scene_updates import SceneUpdates
from hplan.base.arguments import nearest_name
from hplan.base.checked import NotNegative, Options
from hplan.base.lazy_import import extra
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start

_Parameters = TypeVar("_Parameters", bound=Options)

#: How long a node waits for a robot description, and for its SRDF after that [s].
_DESCRIPTION_S, _SEMANTIC_S = 10.0, 1.0

#: Most time until a signal is noticed [s].
_POLL_S: Final = 0.1


@dataclass(frozen=True)
class RobotOptions(Options):
    """Parameters of the robot and its scene.

    Attributes:
        robot: Name or URDF file of the robot; empty for the topic `robot_description`.
        srdf: SRDF file; empty for the topic `robot_description_semantic`, if the robot is from a topic.
        limits_file: Limits file, for example MoveIt's `joint_limits.yaml`; empty for the default of `load_robot`.
        joints: Moving joints, from the base on; empty for the default of `load_robot`.
        tool_frame: Frame at the end of the arm; empty for the default of `load_robot`.
        package_dirs: Folders that hold the packages of meshes, in addition to those of `AMENT_PREFIX_PATH`.
        scene: Scene file or name of a shipped scene; empty for no obstacles except those of messages.
        leave_out: Parts of planning scenes to ignore (`read_planning_scene`).
        planning_frame_m: Origin of MoveIt's planning frame in the base of the robot [m].
        planning_frame_deg: Roll, pitch and yaw of that frame about fixed axes [deg].
        open_meshes: `refuse` meshes of planning scenes that are open, or use their convex `hull`.
    """

    robot: str = ""
    srdf: str = ""
    limits_file: str = ""
    joints: tuple[str, ...] = ()
    tool_frame: str = ""
    package_dirs: tuple[str, ...] = ()
    scene: str = ""
    leave_out: tuple[str, ...] = ("allowed_collision_matrix", "link_padding")
    planning_frame_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    planning_frame_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    open_meshes: OpenMeshes = "refuse"


@dataclass(frozen=True)
class NodeOptions(Options):
    """Parameters of all nodes.

    Attributes:
        diagnostics_period_s: Period of the node's state on `/diagnostics` [s]; 0 for none.
    """

    diagnostics_period_s: NotNegative = 1.0


def import_ros() -> Any:
    """The module `rclpy`.

    Raises:
        InputError: It is not installed.
    """
    with extra("ros2", "a ROS node needs rclpy"):
        import rclpy
        import rclpy.executors
        import rclpy.node
        import rclpy.qos
    return rclpy


def find_message(name: str) -> Any:
    """Class of a message, service or action, such as `moveit_msgs/msg/PlanningScene`; None if not installed."""
    package, kind, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), message)
    except ImportError:
        return None


def need_message(name: str, purpose: str) -> Any:
    """Class of a message, service or action.

    Raises:
        InputError: Its package is not installed.
    """
    found = find_message(name)
    if found is None:
        package = name.split("/")[0]
        raise InputError(f"{purpose} needs the ROS package {package}, which is not installed", package=package)
    return found


def read_parameters(node: Any, *kinds: type[Options]) -> list[Any]:
    """Declare and read the parameters of a node.

    Args:
        node: The node.
        kinds: Dataclasses whose fields are the parameters.

    Returns:
        An instance of each class.

    Raises:
        OptionError: A parameter is unknown, or has another type or range.
    """
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.exceptions import InvalidParameterTypeException
    from rclpy.parameter import Parameter

    names = [field.name for kind in kinds for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for name in node._parameter_overrides:
        if name not in names and name not in ("use_sim_time", "start_type_description_service"):
            raise OptionError(name, _override(node, name), f"a parameter of this node; {nearest_name(name, names)}")
    found = []
    for kind in kinds:
        values, described = dict[str, Any](), describe_fields(kind)
        for field in dataclasses.fields(kind):  # type: ignore[arg-type]
            default: Any = field.default
            descriptor = ParameterDescriptor(description=described.get(field.name, ""), read_only=True)
            # The type of an empty list cannot be seen.
            is_list = isinstance(default, tuple)
            numbers = is_list and bool(default) and isinstance(default[0], float)
            array = Parameter.Type.DOUBLE_ARRAY if numbers else Parameter.Type.STRING_ARRAY
            try:
                parameter = node.declare_parameter(field.name, array if is_list else default, descriptor)
            except InvalidParameterTypeException as error:
                expected = f"a {type(default).__name__}" + (", such as 1.0" if isinstance(default, float) else "")
                raise OptionError(field.name, _override(node, field.name), expected) from error
            given = parameter.value
            values[field.name] = default if given is None else tuple(given) if is_list else given
        found.append(kind(**values))
    return found


def describe_fields(kind: type[Options]) -> dict[str, str]:
    """Description of each field, from the attributes in the docstring of a dataclass.

    Examples:
        >>> describe_fields(NodeOptions)
        {'diagnostics_period_s': "Period of the node's state on `/diagnostics` [s]; 0 for none."}
    """
    _, _, attributes = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    found = re.findall(r"^    (\w+): (.+(?:\n {6,}.+)*)", attributes, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}


def _override(node: Any, name: str) -> Any:
    return node._parameter_overrides[name].value


def load_arm(node: Any, options: RobotOptions) -> tuple[Robot, Scene]:
    """Robot and scene of a node's parameters.

    The start of a scene without a file is a configuration in the middle of the joint ranges.

    Raises:
        InputError: No robot description arrives.
        HplanError: Any error of `load_robot` or `load_scene`.
    """
    scene = load_scene(options.scene) if options.scene else None
    folders = [*options.package_dirs]
    folders += [str(Path(prefix, "share")) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if prefix]
    chosen: dict[str, Any] = {"package_dirs": [path for path in folders if Path(path).is_dir()]}
    for option, name in (("srdf", "srdf"), ("limits", "limits_file"), ("tool_frame", "tool_frame")):
        if getattr(options, name):
            chosen[option] = getattr(options, name)
    if options.joints:
        chosen["joints"] = options.joints
    source: Any = options.robot or (None if scene is None else scene.robot)
    with tempfile.TemporaryDirectory() as folder, _warning_in_log(node):
        if source is None:
            topic = node.resolve_topic_name("robot_description")
            node.get_logger().info(f"waiting for the robot on {topic}")
            source = _wait_for_text(node, "robot_description", _DESCRIPTION_S)
            if source is None:
                raise InputError(
                    f"no robot description on {topic} within {_DESCRIPTION_S:g} s; set the parameter robot to a URDF "
                    "file, or start robot_state_publisher"
                )
            semantic = None if options.srdf else _wait_for_text(node, "robot_description_semantic", _SEMANTIC_S)
            if semantic is not None:
                chosen["srdf"] = Path(folder, "robot.srdf")
                chosen["srdf"].write_text(semantic, encoding="utf-8")
        robot = load_robot(source, **chosen)
    if scene is None:
        middle = tuple((0.5 * (robot.lower + robot.upper)).tolist())
        scene = Scene(name="ros", start=Start(joints_rad=middle), goal=Goal(joints_rad=middle))
    return robot, scene


def latched(rclpy: Any, depth: int = 1) -> Any:
    """Quality of service of a topic that keeps its last messages for late subscribers."""
    durability = rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL
    return rclpy.qos.QoSProfile(depth=depth, durability=durability)


def _wait_for_text(node: Any, topic: str, most_s: float) -> str | None:
    """First latched `std_msgs/msg/String` on a topic; None if none arrives in time."""
    rclpy = import_ros()
    from std_msgs.msg import String

    found = list[str]()
    subscription = node.create_subscription(String, topic, lambda message: found.append(message.data), latched(rclpy))
    end = node.get_clock().now().nanoseconds + round(1e9 * most_s)
    while not found and not _Shutdown.asked and node.get_clock().now().nanoseconds < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    node.destroy_subscription(subscription)
    return found[0] if found else None


@contextmanager
def _warning_in_log(node: Any) -> Iterator[None]:
    """Log warnings with the node's logger."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: node.get_logger().warning(str(message))
        yield


class _Shutdown:
    """Whether a signal asked the process to end."""

    asked = False


def run_node(make: Callable[[], Any], ros_arguments: Sequence[str] = ()) -> int:
    """Create a node and spin it until SIGINT or SIGTERM; returns the exit status 0.

    The node's `close` is called while it can still send messages.

    Args:
        make: Creates the node; called after `rclpy.init`.
        ros_arguments: Arguments for ROS, for example `["--ros-args", "-p", "robot:=panda"]`.

    Raises:
        InputError: rclpy is not installed, or an argument for ROS is malformed.
        HplanError: Any error of the node's construction.
    """
    rclpy = import_ros()
    from rclpy.executors import ExternalShutdownException, ShutdownException
    from rclpy.signals import SignalHandlerOptions

    def ask(*_: Any) -> None:
        _Shutdown.asked = True

    _Shutdown.asked = False
    handlers = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    node = None
    try:
        try:
            rclpy.init(args=list(ros_arguments), signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:
            raise InputError(f"ROS refuses the arguments {' '.join(ros_arguments)}: {error}") from error
        with suppress(ExternalShutdownException, ShutdownException):
            node = make()
            # A collection among all objects of the libraries takes a tenth of a second.
            gc.collect()
            gc.freeze()
            executor = rclpy.executors.SingleThreadedExecutor()
            executor.add_node(node)
            while not _Shutdown.asked:
                executor.spin_once(timeout_sec=_POLL_S)
    finally:
        if node is not None:
            if rclpy.ok():
                node.close()
            node.destroy_node()
        rclpy.try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return 0


def watch_scene(node: Any, options: RobotOptions, see: Callable[[Any], None], *, fetch: bool) -> SceneUpdates | None:
    """Subscribe to `planning_scene`, and ask for the whole scene once.

    Args:
        node: The node.
        options: How planning scenes are read.
        see: Receives the messages.
        fetch: Whether to ask the service `get_planning_scene`.

    Returns:
        Where `see` should apply the messages; None without moveit_msgs.

    Raises:
        InputError: There is neither moveit_msgs nor a scene file, so that no obstacles can be known.
    """
    kind = find_message("moveit_msgs/msg/PlanningScene")
    if kind is None:
        if not options.scene:
            need_message("moveit_msgs/msg/PlanningScene", "a node without the parameter scene")
        return None
    updates = SceneUpdates(
        position=options.planning_frame_m,
        rpy_deg=options.planning_frame_deg,
        open_meshes=options.open_meshes,
        leave_out=options.leave_out,
        starts_empty=bool(options.scene),
    )
    node.create_subscription(kind, "planning_scene", see, DEPTH)
    service = find_message("moveit_msgs/srv/GetPlanningScene")
    if fetch and service is not None:
        client = node.create_client(service, "get_planning_scene")

        def ask() -> None:
            if client.service_is_ready():
                node.destroy_timer(timer)
                request = service.Request()
                request.components.components = 1023  # all of PlanningSceneComponents
                client.call_async(request).add_done_callback(lambda done: see(done.result().scene))

        timer = node.create_timer(0.2, ask)
    return updates


#: Levels of `diagnostic_msgs/msg/DiagnosticStatus`.
OK, WARN, ERROR = b"\0", b"\1", b"\2"


class Diagnostics:
    """The state of a node on `/diagnostics`, at a fixed period."""

    def __init__(
        self, node: Any, options: NodeOptions, state: Callable[[], tuple[bytes, str, Mapping[str, Any]]]
    ) -> None:
        """Begin to publish.

        Args:
            node: The node.
            options: The period.
            state: Returns level, message and values.
        """
        self._node, self._state = node, state
        array = find_message("diagnostic_msgs/msg/DiagnosticArray") if options.diagnostics_period_s > 0.0 else None
        self._publisher = None if array is None else node.create_publisher(array, "/diagnostics", 10)
        if self._publisher is not None:
            node.create_timer(options.diagnostics_period_s, self.publish)

    def publish(self) -> None:
        """Publish the state now."""
        if self._publisher is None:
            return
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        level, words, values = self._state()
        status = DiagnosticStatus(level=level, name=self._node.get_fully_qualified_name(), message=words)
        status.hardware_id = "hplan"
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)


#: Most messages that wait for a node.
DEPTH: Final = 10
