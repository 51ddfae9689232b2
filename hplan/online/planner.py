"""A planner that lives as long as the scene changes: obstacles come, move and go, and the motion is planned anew.

What does not change is kept from plan to plan: the robot's planar layers (a layer is computed again only if what the
arm plane cuts there has changed), and the motion itself, as long as it can still be certified. Every motion that is
handed out was certified among the obstacles as they are now.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from threading import RLock
from typing import Any, TypeVar, overload

from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.forking import renewed_in_children
from hplan.bodies.reach import largest_sway
from hplan.errors import InputError, SceneError
from hplan.online.splice import RunningMotion, SplicedResult
from hplan.perception.frame import CloudOptions, Frame, FrameReport, SeenPoints, filter_frame
from hplan.perception.frame_kernels import Scratch
from hplan.perception.scene_cloud import check_cloud_name, solids_named, with_cloud
from hplan.planning.plan import PlanResult, check_task, plan_with
from hplan.planning.task import PlanningCache
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.limits import Vector
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, PointCloud, Sphere
from hplan.verification.retimed_certificate import CertifiedMotion

#: How often a plan that waits for another one looks whether it is still wanted [s].
_WAIT_S = 0.01


class Planner:
    """Plans again and again for one robot.

    Several threads may use one planner: a change and a plan wait for the plan that is under way. So may a child forked
    meanwhile, by itself. A planner can be
    pickled; its memory of layers stays behind.

    Attributes:
        robot: The arm.
        options: How to plan.
        scene: The scene as it is now; its tracks count by the clock of the last motion.
        last: The last plan; None before the first.
    """

    def __init__(self, robot: Robot, scene: Scene, options: PlanOptions | None = None) -> None:
        """Begin with a scene.

        Args:
            robot: The arm.
            scene: Obstacles and task.
            options: How to plan.

        Raises:
            OptionError: One of them is none.
        """
        check_task(robot, scene, options)
        self.robot = robot
        self.options = PlanOptions() if options is None else options
        self.scene = scene
        self.last: PlanResult | None = None
        self._cache = PlanningCache(robot)
        self._lock = renewed_in_children(RLock())
        self._seen: dict[str, SeenPoints] = {}
        self._scratch = Scratch()

    def __getstate__(self) -> dict[str, Any]:
        """The attributes that a user sees."""
        return {"robot": self.robot, "scene": self.scene, "options": self.options, "last": self.last}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        vars(self).update(state, _cache=PlanningCache(state["robot"]), _seen={}, _scratch=Scratch())
        self._lock = renewed_in_children(RLock())

    def plan(self, *, cancel: Cancel | None = None) -> PlanResult:
        """Plan as `hplan.plan` does, whatever was planned before.

        Args:
            cancel: As for `hplan.plan`.

        Raises:
            HplanError: As `hplan.plan`.
        """
        with self._turn(cancel):
            self.last = plan_with(self._cache, self.scene, self.options)
            return self.last

    @overload
    def replan(self, *, cancel: Cancel | None = None) -> PlanResult: ...

    @overload
    def replan(self, *, at: float, now: float = 0.0, cancel: Cancel | None = None) -> SplicedResult: ...

    def replan(
        self, *, at: float | None = None, now: float = 0.0, cancel: Cancel | None = None
    ) -> PlanResult | SplicedResult:
        """Plan again after a change, before the motion is begun or while it runs.

        The last motion stays if it can be certified among the obstacles as they are now, and is repaired if it cannot.
        A new one is searched for where that fails too, where a straight motion has become possible, where start or goal
        has changed, and to a fruit or a point. So the result depends on what was planned before; `plan` gives the one
        that does not.

        With `at`, the last motion is taken to run. It stays as it is up to the first row at or after that time, and up
        to its end where it still solves the task and is certified from now on among the obstacles as they are now; a
        new motion takes over else, without a jump of position, velocity or acceleration. What is returned is a
        `SplicedResult`: its trajectory is the running one from now on and, from `seam_s`, the new one, certified as a
        whole; on the running motion's clock it begins at `begins_s`, the last row up to now. It runs from then on.

        Tracks of the planner's scene count by the clock of the last motion. So what moves is seen where it is when the
        running motion gets there, and after a splice the scene is shifted to the new motion's clock: it becomes
        `scene.since(begins_s)`. To plan a motion from rest that begins at a time on the old clock, shift it likewise.

        Args:
            at: When the new motion may take over, on the clock of the running one [s]; None before the motion is begun.
            now: The time on that clock [s]; without it the whole motion up to `at` has to be clear.
            cancel: As for `hplan.plan`.

        Raises:
            InputError: There is no motion that could run.
            OptionError: A time before the motion or after it, or before now.
            RunningMotionBlockedError: The running motion is not clear until then, or cannot be left without contact; it
                carries the stop on its path, where one is certified.
            HplanError: As `hplan.plan`.
        """
        with self._turn(cancel):
            if at is not None:
                spliced = self._running(now).spliced(at)
                self.last, self.scene = spliced, self.scene.since(spliced.begins_s)
                return spliced
            before = None if self.last is None else self.last.motion
            self.last = plan_with(self._cache, self.scene, self.options, before=before)
            return self.last

    def stop_at(self, t: float, *, now: float = 0.0) -> CertifiedMotion:
        """The last motion with the quickest stop on its path from the first row at or after a time on.

        It is certified from now on among the obstacles as they are now; read `certificate.verified`. Among what moves
        `certificate.clear_until_s` says how long the arm may rest where it stops, on the motion's clock.

        Args:
            t: The time, on the motion's clock [s].
            now: The time on that clock from which on it has to be clear [s].

        Raises:
            InputError: There is no motion that could run.
            OptionError: A time before the motion or after it.
        """
        with self._lock:
            return self._running(now).stop_at(t)

    def _running(self, now: float) -> RunningMotion:
        if self.last is None:
            raise InputError("there is no motion that could run: plan one first")
        return RunningMotion(self.last, self._cache, self.scene, self.options, now)

    @contextmanager
    def _turn(self, cancel: Cancel | None) -> Iterator[None]:
        """Wait for the turn of a plan, whose time counts from now.

        Raises:
            NotInTimeError: Time is up before, or before the plan is begun.
            PlanCancelledError: Nobody wants the plan any more.
        """
        with time_limit(self.options.deadline_s, cancel) as limit:
            while not self._lock.acquire(timeout=min(_WAIT_S, max(limit.left_s, 0.0))):
                if limit.is_up:
                    raise limit.error(["another plan of the same planner is under way"])
            try:
                yield
            except TimeIsUpError:  # before the plan itself, which says what it tried
                raise limit.error(["the running motion up to where a new one may take over"]) from None
            finally:
                self._lock.release()

    def add(self, obstacle: Obstacle) -> None:
        """Add an obstacle.

        Raises:
            InputError: There is one of that name, or it is no obstacle.
        """
        _check_kind(obstacle)
        with self._lock:
            if obstacle.name in {item.name for item in (*self.scene.obstacles, *self.scene.fruits)}:
                message = f"there is an obstacle {obstacle.name!r} already; names must differ"
                raise InputError(message, name=obstacle.name)
            self._change((*self.scene.obstacles, obstacle))

    def remove(self, name: str) -> None:
        """Take an obstacle or a fruit away.

        Raises:
            InputError: There is none of that name, or it is the fruit that is the goal.
        """
        with self._lock:
            if any(fruit.name == name for fruit in self.scene.fruits):
                if name == self.scene.goal.fruit:
                    raise InputError(f"fruit {name!r} is the goal; aim elsewhere before it is removed", name=name)
                left = tuple(fruit for fruit in self.scene.fruits if fruit.name != name)
                self.scene = self.scene.model_copy(update={"fruits": left})
                return
            index = self._index(name)
            self._change((*self.scene.obstacles[:index], *self.scene.obstacles[index + 1 :]))
            self._seen.pop(name, None)

    def move(self, name: str, **changes: Any) -> None:
        """Give an obstacle other values, as `move("post", center=(1, 0, 1))`.

        Raises:
            InputError: There is none of that name, or it has no such value, or cannot have it.
        """
        with self._lock:
            index = self._index(name)
            moved = _changed(self.scene.obstacles[index], changes)
            self._change((*self.scene.obstacles[:index], moved, *self.scene.obstacles[index + 1 :]))

    # Ten parameters: a frame has many sides, and callers name them by keyword.
    def set_cloud(
        self,
        name: str,
        points: ArrayLike,
        *,
        radius: float,
        pose: ArrayLike | None = None,
        joints: ArrayLike | None = None,
        ignore: Sequence[str] = (),
        keep_s: float = 0.0,
        time_s: float | None = None,
        options: CloudOptions | None = None,
    ) -> FrameReport:
        """Take a frame of a depth camera for the obstacle of a name, in place of the last one.

        Left out are rows that are not finite, points that the arm cannot come near, its own, and those of what is to be
        ignored; the others become balls, fewer than points (`hplan.perception.frame`). A frame of which nothing is left
        takes the obstacle away.

        Args:
            name: Name of the cloud.
            points: (n, 3) or (rows, columns, 3) points in the camera's frame [m]; best float32 or float64.
            radius: Radius of the ball about each point [m].
            pose: Camera to `base_link`: a (4, 4) matrix, or x, y, z [m], roll, pitch, yaw about fixed axes [deg]; None
                where the points are in `base_link`, the camera then taken to be at its origin.
            joints: (dof,) configuration of the arm when the frame was taken, so that its own points are left out [rad].
            ignore: Names of fruits and other obstacles whose points are left out: the fruit to pick, what stands in the
                scene already.
            keep_s: How long points are kept that were seen and are hidden now (`hplan.perception.hidden_points`) [s].
            time_s: When the frame was taken, on any clock that does not go back [s]; None for now.
            options: Voxels, paddings, outliers.

        Raises:
            InputError: Points, a pose or joints that are none; a name of what is no cloud; nothing of a name to ignore.
            OptionError: A radius, a time or options that cannot be.
        """
        taken_s = time.monotonic() if time_s is None else time_s
        frame = Frame.of(self.robot, points, radius=radius, pose=pose, joints=joints, keep_s=keep_s, time_s=taken_s)
        with self._lock:
            check_cloud_name(self.scene, name)
            found = filter_frame(
                self.robot,
                frame,
                CloudOptions() if options is None else options,
                ignored=solids_named(self.scene, ignore, name),
                clearance_m=self.scene.clearance + self._largest_sway_m(),
                before=self._seen.get(name),
                scratch=self._scratch,
            )
            self.scene = with_cloud(self.scene, name, found.points, found.report.radius_m)
            self._seen[name] = found.seen
        return found.report

    def aim(self, *, start: Start | None = None, goal: Goal | None = None) -> None:
        """Begin elsewhere, or go elsewhere.

        Raises:
            SceneError: A fruit that the scene does not have.
        """
        changes: dict[str, Any] = {key: value for key, value in (("start", start), ("goal", goal)) if value is not None}
        with self._lock:
            self.scene = _changed(self.scene, changes)

    def _largest_sway_m(self) -> float:
        """How far tracking errors may take the arm from where it is sent [m]."""
        return float(largest_sway(self.robot, self.options.tracking.deviations(self.robot.velocity_limit)))

    def _change(self, obstacles: tuple[Obstacle, ...]) -> None:
        # The names were looked at, and the obstacles are checked: no need to check the scene again.
        self.scene = self.scene.model_copy(update={"obstacles": obstacles})

    def _index(self, name: str) -> int:
        for index, obstacle in enumerate(self.scene.obstacles):
            if obstacle.name == name:
                return index
        raise InputError(f"there is no obstacle {name!r}", name=name)


_Model = TypeVar("_Model", bound=BaseModel)
_KINDS = (Sphere, Capsule, Cylinder, Box, Mesh, PointCloud)
_VECTOR: TypeAdapter[Vector] = TypeAdapter(Vector, config=ConfigDict(allow_inf_nan=False, strict=True))


def _check_kind(item: object) -> None:
    """Refuse what is no obstacle."""
    if not isinstance(item, _KINDS):
        kinds = ", ".join(kind.__name__ for kind in _KINDS)
        raise InputError(f"expected one of {kinds}, got {type(item).__name__} {item!r}")


def _changed(item: _Model, changes: Mapping[str, Any]) -> _Model:
    """A checked copy with other values.

    Raises:
        InputError: A value that it does not have.
        SceneError: A value that it cannot have, or values that contradict each other.
    """
    fields = type(item).model_fields
    unknown = [key for key in changes if key not in fields]
    if unknown:
        raise InputError(f"a {type(item).__name__.lower()} has no {unknown[0]!r}; it has {', '.join(fields)}")
    if isinstance(item, (Mesh, PointCloud)) and not changes.keys() <= {"position", "rpy_deg"}:
        raise InputError("of a mesh or a point cloud only position and rpy_deg can be changed; add another instead")
    copied = item.model_copy
    if isinstance(item, (Mesh, PointCloud)):
        # What was read from the file stays.
        return copied(update={key: _vector(key, value) for key, value in changes.items()})
    return type(item).model_validate({**{key: getattr(item, key) for key in fields}, **changes})


def _vector(key: str, value: Any) -> Vector:
    try:
        return _VECTOR.validate_python(value)
    except ValidationError as error:
        raise SceneError(f"expected three finite numbers (got {value!r})", where=key, value=value) from error
