"""A planner that lives as long as the scene changes: obstacles come, move and go, and the motion is planned anew.

What does not change is kept from plan to plan: the robot's planar layers (a layer is computed again only if what the
arm plane cuts there has changed), and the motion itself, as long as it can still be certified. Every motion that is
handed out was certified among the obstacles as they are now.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from threading import RLock
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import between, number, one_of, text
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.forking import renewed_in_children
from hplan.certificate.certificate import with_violations
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.collision.far_obstacles import warn_of_far_obstacles
from hplan.collision.obstacle_rows import solid_rows
from hplan.collision.reach import largest_sway
from hplan.errors import HplanError, InputError, NotInTimeError, OptionError, PlanCancelledError
from hplan.online.arm_shape import arm_solids
from hplan.online.body_distances import distances_from_bodies
from hplan.online.frame import CloudOptions, Frame, FrameReport, SeenPoints, filter_frame, rigid
from hplan.online.frame_check import AcceptedFrame, check_content, check_order
from hplan.online.frame_kernels import Scratch
from hplan.online.next_view import NextView, shows, sweep
from hplan.online.scene_cloud import check_cloud_name, solids_named, with_cloud
from hplan.online.seen_space import UNSEEN, SeenSpace
from hplan.online.splice import RunningMotion, SplicedResult
from hplan.planning.motion import Transit
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task, plan_with
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.fault import StrictModel
from hplan.scene.limits import FARTHEST_M
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import FromData
from hplan.scene.obstacles import KINDS, Obstacle, PointCloud
from hplan.scene.tracks import Track


class Planner:
    """Plans again and again for one robot.

    **One clock.** Times that a planner is given are on the controller's clock, any clock that does not go back: when a
    motion begins (`begins_s`), what time it is (`now`), when a new motion may take over (`at`), when a frame was taken,
    and the times of the scene's tracks. What it hands out counts from its own first row, which is at its `begins_s` on
    the controller's clock; at a time t the controller follows `motion.trajectory.state_at(t - motion.begins_s)`. A
    planner that was never given a time takes the clock to begin with its first motion. One that was given one wants to
    know when each motion begins that is planned from rest: `plan(begins_s=)`, or `began` once it has.

    Several threads may use one planner. One plan at a time is made, and the next waits for it; changes, frames and
    stops do not wait. A plan is of the scene, and the options, that there were when its turn came. A child that is
    forked meanwhile may use it too, by itself. A planner can be pickled; its memory of layers and frames stays behind.

    Attributes:
        robot: The arm.
        options: How to plan.
        scene: The scene as it is now; its tracks count on the controller's clock.
        last: The last plan, taken to be what runs; None before the first.
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
        self._is_told = False
        self._cropped: dict[str, _Cropped] = {}
        self._closing: PointCloud | None = None
        self._make_ready()

    def _make_ready(self) -> None:
        """Begin with no memory of earlier plans and frames."""
        self._planning, self._changing, self._filtering = (renewed_in_children(RLock()) for _ in range(3))
        self._seen: dict[str, SeenPoints] = {}
        self._scratch = Scratch()
        self._space: SeenSpace | None = None
        self._known_since_s = -math.inf

    def __getstate__(self) -> dict[str, Any]:
        """The attributes that a user sees, whether a time was given, and what there is to know of clouds."""
        return {
            key: vars(self)[key] for key in ("robot", "scene", "options", "last", "_is_told", "_cropped", "_closing")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._make_ready()

    def plan(self, *, begins_s: float | None = None, cancel: Cancel | None = None) -> PlanResult:
        """Plan as `hplan.plan` does, whatever was planned before.

        Args:
            begins_s: When the motion is to begin, on the controller's clock [s]; what moves is seen from then on. None
                where no time was given yet: at 0; else it is not known, which only a scene where nothing moves allows.
            cancel: As for `hplan.plan`.

        Raises:
            OptionError: A time that is none, or none where one is needed.
            FrameError: A frame is older than its `max_age_s`.
            HplanError: As `hplan.plan`.
        """
        with self._turn(cancel):
            return self._from_rest(begins_s, None)

    @overload
    def replan(self, *, begins_s: float | None = None, cancel: Cancel | None = None) -> PlanResult: ...

    @overload
    def replan(
        self,
        *,
        at: float,
        now: float | None = None,
        measured: ArrayLike | None = None,
        cancel: Cancel | None = None,
    ) -> SplicedResult: ...

    def replan(
        self,
        *,
        at: float | None = None,
        now: float | None = None,
        measured: ArrayLike | None = None,
        begins_s: float | None = None,
        cancel: Cancel | None = None,
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
        whole; it begins at `begins_s`, where the last row up to now is, and runs from then on.

        Args:
            at: When the new motion may take over, on the controller's clock [s]; None before the motion is begun.
            now: The time on that clock [s]; without it the whole motion up to `at` has to be clear.
            measured: (dof,) where the arm is now [rad, m where a joint slides]: a motion that it is not on, as far as
                the tracking error covers that certificates are for, is not taken over. None to take it to be there.
            begins_s: As for `plan`, without `at`.
            cancel: As for `hplan.plan`.

        Raises:
            InputError: There is no motion that could run, or it is not known when it began.
            NotOnMotionError: The arm is not where the running motion has it.
            FrameError: A frame is older than its `max_age_s`.
            OptionError: A time before the motion or after it, or before now; `now` or `measured` without what they
                belong to.
            RunningMotionBlockedError: The running motion is not clear until then, or cannot be left without contact; it
                carries the stop on its path, where one is certified.
            HplanError: As `hplan.plan`.
        """
        if at is None:
            for option, value in (("now", now), ("measured", measured)):
                if value is not None:
                    raise OptionError(option, value, "None without `at`: of a motion that has not begun")
        for option, value in (("at", at), ("now", now)):
            if value is not None:
                number(option, value, "a time on the controller's clock in seconds")
        if at is not None and begins_s is not None:
            raise OptionError("begins_s", begins_s, "None with `at`: a splice begins as the motion before it runs")
        with self._turn(cancel):
            if at is None:
                return self._from_rest(begins_s, None if self.last is None else self.last.motion)
            scene, options, known_s = self.scene, self.options, at if now is None else now
            self._check_clouds(scene, options, known_s)
            spliced = self._running(scene, options, now, measured).spliced(at)
            self.last = self._with_ages(spliced, scene, known_s)
            return self.last

    def stop_at(self, t: float, *, now: float | None = None, measured: ArrayLike | None = None) -> CertifiedMotion:
        """The last motion with the quickest stop on its path from the first row at or after a time on.

        It is certified from now on among the obstacles as they are now; read `certificate.verified`. Among what moves
        `certificate.clear_until_s` says how long the arm may rest where it stops. Its trajectory begins, as its
        `begins_s` says, when the last motion did, and all its times count from there. The planner goes on to take the
        last motion for what runs.

        Args:
            t: The time, on the controller's clock [s].
            now: The time on that clock from which on it has to be clear [s]; None for when the motion began.
            measured: As for `replan`.

        Raises:
            InputError: There is no motion that could run, or it is not known when it began.
            NotOnMotionError: The arm is not where the running motion has it.
            OptionError: A time before the motion or after it, or before now; `measured` without `now`.
        """
        scene, options = self.scene, self.options
        found = self._running(scene, options, now, measured).stop_at(t)
        faults = [error.message for error in self._cloud_faults(scene, options, t if now is None else now)]
        return replace(found, certificate=with_violations(found.certificate, faults))

    def began(self, at_s: float) -> PlanResult:
        """Say when the motion that was planned last, from rest and among what stands still, has begun.

        Args:
            at_s: The time, on the controller's clock [s].

        Returns:
            The plan, which begins there.

        Raises:
            InputError: There is no such motion: among what moves it begins when it was planned for, and a splice when
                it says.
            OptionError: No time.
        """
        number("at_s", at_s, "a time on the controller's clock in seconds")
        with self._changing:
            if self.last is None:
                raise InputError("there is no motion that could begin: plan one first")
            if (isinstance(self.last, SplicedResult) or self.last.scene.moves) and at_s != self.last.begins_s:
                raise InputError(
                    f"the motion begins at {self.last.begins_s:.10g} s on the controller's clock, and at no other "
                    "time: it was planned for then"
                )
            self.last, self._is_told = replace(self.last, begins_s=float(at_s)), True
            return self.last

    def _from_rest(self, begins_s: float | None, before: Transit | None) -> PlanResult:
        """A plan of a motion that has not begun."""
        scene, options = self.scene, self.options
        begin = self._begin_of(begins_s, scene)
        self._check_clouds(scene, options, begins_s)
        self._check_known(scene)
        found = plan_with(self.robot, scene if math.isnan(begin) else scene.since(begin), options, before=before)
        self.last = self._with_ages(replace(found, begins_s=begin), scene, begins_s)
        return self.last

    def _begin_of(self, begins_s: float | None, scene: Scene) -> float:
        """When a motion begins, on the controller's clock [s]; NaN where that is not known.

        Raises:
            OptionError: No time; or none where one is needed.
        """
        expected = "a time on the controller's clock in seconds"
        if begins_s is not None:
            number("begins_s", begins_s, expected)
            self._is_told = True
            return float(begins_s)
        if not self._is_told:
            return 0.0
        if scene.moves:
            raise OptionError("begins_s", None, f"{expected}: something moves, and the clock has not begun only now")
        return math.nan

    def _running(
        self, scene: Scene, options: PlanOptions, now: float | None, measured: ArrayLike | None
    ) -> RunningMotion:
        if measured is not None and now is None:
            raise OptionError("now", None, "the time when the joints were measured, on the controller's clock")
        if self.last is None:
            raise InputError("there is no motion that could run: plan one first")
        self._is_told = True
        return RunningMotion(self.last, scene, options, now, measured)

    @contextmanager
    def _turn(self, cancel: Cancel | None) -> Iterator[None]:
        """Wait for the turn of a plan, whose time counts from now.

        Raises:
            NotInTimeError: Time is up before, or before the plan is begun.
            PlanCancelledError: It was cancelled.
        """
        with time_limit(self.options.deadline_s, cancel) as limit:
            # A plan that waits for another one checks this often whether it is cancelled [s].
            wait_s = 0.01
            while not self._planning.acquire(timeout=min(wait_s, max(limit.left_s, 0.0))):
                if limit.is_up:
                    raise limit.error(["another plan of the same planner is under way"])
            try:
                yield
            except TimeIsUpError:  # before the plan itself, which says what it tried
                raise limit.error(["the running motion up to where a new one may take over"]) from None
            finally:
                self._planning.release()

    def add(self, obstacle: Obstacle) -> None:
        """Add an obstacle.

        Raises:
            InputError: There is one of that name, or it is no obstacle.
        """
        _check_kind(obstacle)
        with self._changing:
            if obstacle.name in {item.name for item in (*self.scene.obstacles, *self.scene.fruits)}:
                message = f"there is an obstacle {obstacle.name!r} already; names must differ"
                raise InputError(message, name=obstacle.name)
            self._change((*self.scene.obstacles, obstacle))
            warn_of_far_obstacles(self.robot, self.scene)

    def remove(self, name: str) -> None:
        """Take an obstacle or a fruit away.

        Raises:
            InputError: There is none of that name, or it is the fruit that is the goal.
        """
        with self._changing:
            if any(fruit.name == name for fruit in self.scene.fruits):
                if name == self.scene.goal.fruit:
                    raise InputError(f"fruit {name!r} is the goal; aim elsewhere before it is removed", name=name)
                left = tuple(fruit for fruit in self.scene.fruits if fruit.name != name)
                self.scene = self.scene.copy_unchecked({"fruits": left})
                return
            if not any(key == name and last.cloud is None for key, last in self._cropped.items()):
                index = self._index(name)
                self._change((*self.scene.obstacles[:index], *self.scene.obstacles[index + 1 :]))
            self._seen.pop(name, None)
            self._cropped.pop(name, None)

    def move(self, name: str, **changes: Any) -> None:
        """Give an obstacle other values, as `move("post", center=(1, 0, 1))`.

        Raises:
            InputError: There is none of that name, or it has no such value, or cannot have it; it is a cloud that
                `set_cloud` has cropped to what is within reach where it was seen.
        """
        with self._changing:
            index, cropped = self._index(name), self._cropped.get(name)
            if cropped is not None and self.scene.obstacles[index] is cropped.cloud:
                raise InputError(f"cloud {name!r} was cropped to the reach where it was seen: set it anew", name=name)
            moved = _changed(self.scene.obstacles[index], changes)
            self._change((*self.scene.obstacles[:index], moved, *self.scene.obstacles[index + 1 :]))

    # Eleven parameters: a frame has many sides, and callers name them by keyword.
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
        yields: float = 0.0,
        unknown: Unknown = "free",
    ) -> FrameReport:
        """Take a frame of a depth camera for the obstacle of a name, in place of the last one.

        Left out are rows that are not finite, points that the arm cannot come near, its own, and those of what is to be
        ignored; the others become balls, fewer than points (`hplan.online.frame`). A frame that a failing camera, a
        wrong unit or a wrong pose may have made is refused (`hplan.online.frame_check`), and the obstacle of the last
        good frame stays; `CloudOptions` says what is acceptable. Where the base moves, the points stand where they were
        seen, from where it was then, and those count that come within reach anywhere on its track. What is left out
        could matter for a larger clearance, larger tracking errors or another track of the base: plans are refused then
        until the next frame.

        Args:
            name: Name of the cloud.
            points: (n, 3) or (rows, columns, 3) points in the camera's frame [m]; best float32 or float64.
            radius: Radius of the ball about each point [m].
            pose: Camera to `base_link`: a (4, 4) matrix, or x, y, z [m], roll, pitch, yaw about fixed axes [deg]; None
                where the points are in `base_link`, the camera then taken to be at its origin. Where the base moves,
                it is `base_link` as it is when the frame is taken.
            joints: (dof,) configuration of the arm when the frame was taken, so that its own points are left out [rad].
            ignore: Names of fruits and other obstacles whose points are left out: the fruit to pick, what stands in the
                scene already.
            keep_s: How long points are kept that were seen and are hidden now (`hplan.online.hidden_points`) [s].
            time_s: When the frame was taken, on the controller's clock [s]; it is needed where the base moves, or what
                is to be ignored does. None, else, for now.
            options: Voxels, paddings, outliers.
            yields: How deep the links that may push may be in the cloud [m].
            unknown: `solid`: space that no frame with this has seen through in the last `keep_s`, and where the arm has
                not been, is an obstacle of the name `unseen` (`hplan.online.seen_space`), as of this frame. It needs
                `joints`, and a base that stands still. `free`: it counts as free, and an obstacle of that name stays.

        Raises:
            InputError: Points, a pose or joints that are none; a name of what is no cloud; nothing of a name to ignore.
            OptionError: A radius, a time, a depth or options that cannot be.
            FrameError: The frame is older than the last one, has too few returns, is in millimetres, or leaves no
                obstacle. The scene is unchanged.
        """
        yields = between("yields", yields, 0.0, FARTHEST_M)
        one_of("unknown", unknown, get_args(Unknown))
        options = CloudOptions() if options is None else options
        if unknown == "solid" and joints is None:
            raise OptionError("joints", None, "those of the arm: unknown space is solid but for where it stands")
        with self._filtering:  # nothing else waits for it
            scene, planning = self.scene, self.options
            check_cloud_name(scene, name)
            if scene.base_track is not None and time_s is None:
                expected = "when the frame was taken, on the controller's clock: the base moves"
                raise OptionError("time_s", None, expected)
            last = self._cropped.get(name)
            before = None if last is None else last.frame
            frame = Frame.of(
                self.robot, points, radius=radius, pose=pose, joints=joints, keep_s=keep_s,
                time_s=time.monotonic() if time_s is None else time_s, base_track=scene.base_track,
            )  # fmt: skip
            check_order(name, time_s, before)
            found = filter_frame(
                self.robot,
                frame,
                options,
                ignored=solids_named(scene, ignore, name, time_s),
                clearance_m=self._room_m(scene, planning),
                before=self._seen.get(name),
                scratch=self._scratch,
            )
            accepted = check_content(name, found.report, options, time_s, before)
            cloud = None
            if len(found.points):
                cloud = PointCloud.thinned(name, found.points, found.report.radius_m, yields)
            unseen = None if unknown == "free" else self._unseen(scene, frame, options, ignore)
            with self._changing:
                check_cloud_name(self.scene, name)
                self.scene = with_cloud(self.scene, name, cloud)
                if unknown == "solid":
                    check_cloud_name(self.scene, UNSEEN)
                    self.scene, self._closing = with_cloud(self.scene, UNSEEN, unseen), unseen
                self._seen[name] = found.seen
                self._cropped[name] = _Cropped(cloud, found.kept_m, scene.base_track, accepted)
        return found.report

    def _unseen(self, scene: Scene, frame: Frame, options: CloudOptions, ignore: Sequence[str]) -> PointCloud | None:
        """What closes off the space that was not seen, a frame having been taken; None where all is known.

        Raises:
            OptionError: The base moves; or voxels far too small.
        """
        if frame.base_track is not None or frame.joints is None:
            raise OptionError("unknown", "solid", "'free' where the base moves")
        if self._space is None:
            self._space = SeenSpace(self.robot, options.unseen_edge_m)
        space, now_s = self._space, frame.time_s
        names = [fruit.name for fruit in scene.fruits if fruit.name in ignore]
        fruits = solids_named(scene, names, UNSEEN, now_s)
        # One that sways is no ball.
        balls = [
            (*fruit.core[0], fruit.rounding + options.ignore_padding_m) for fruit in fruits if len(fruit.core) == 1
        ]
        space.see(frame.points, (frame.rotation, frame.position), now_s, frame.radius, np.array(balls).reshape(-1, 4))
        space.free(arm_solids(self.robot, frame.joints), now_s, options.arm_padding_m + space.radius)
        space.free(fruits, now_s, space.radius)
        space.free([solid for item in options.known_free for solid in item.solids], now_s, 0.0)
        self._known_since_s = now_s - frame.keep_s
        border = space.border(self._known_since_s)
        return PointCloud.thinned(UNSEEN, border, space.radius) if len(border) else None

    def _check_known(self, scene: Scene) -> None:
        """Refuse a start that is not in known space, where unknown space is solid: nothing closes it off from there."""
        if all(item is not self._closing for item in scene.obstacles):
            return
        start = self.robot.check_configuration(self.robot.joints_of(scene.start, "start"), "start")
        if self._space is None or not self._space.holds(arm_solids(self.robot, start), self._known_since_s):
            raise InputError("start: the arm is in space that was not seen, and unknown space is solid: give a frame "
                "with the joints that it has there", option="start")  # fmt: skip

    def next_view(
        self,
        views: Sequence[ArrayLike],
        *,
        field_of_view_deg: tuple[float, float],
        farthest_m: float,
        carried_by: str | None = None,
        mount: ArrayLike | None = None,
        cancel: Cancel | None = None,
    ) -> NextView | None:
        """From which of some views a camera would see most of what keeps the arm from its goal, not being known.

        A motion to the goal is planned past what is known to be there, as if all unknown space were free. Of the voxels
        that it sweeps and that are not known those count that a view would look through: in its field of view, and
        nothing known in front of them, the arm among it. What is not known hides nothing here, so a view may show less
        than it promises; leave out what was looked from already.

        Args:
            views: Poses of the camera, camera to `base_link` as for `set_cloud`; z looks ahead, x to the right, y down.
                With `carried_by`: (dof,) configurations at which the arm may look.
            field_of_view_deg: Width and height of what the camera sees [deg].
            farthest_m: How far it measures [m].
            carried_by: The frame of the arm that carries the camera. Then the view is proposed that shows most of those
                to which a motion through known space is certified.
            mount: Camera to that frame, a pose as above; None where they are the same.
            cancel: As for `hplan.plan`.

        Returns:
            None where the motion would sweep known space alone, or no view shows any of the other.

        Raises:
            InputError: No frame was taken with `unknown="solid"`; views or a mount that are none, or a frame that the
                arm does not have.
            OptionError: Angles not within 0 and 180 degrees, or no distance.
            FrameError: A frame is older than its `max_age_s`.
            HplanError: As `plan`: what is known is in the way already.
        """
        wide, high = (between("field_of_view_deg", angle, 1.0, 179.0) for angle in field_of_view_deg)
        between("farthest_m", farthest_m, 0.0, FARTHEST_M)
        with self._turn(cancel):
            scene, space, since_s = self.scene, self._space, self._known_since_s
            if space is None:
                raise InputError('next_view: no frame was taken with unknown="solid"')
            self._check_clouds(scene, self.options, None)
            self._begin_of(None, scene)
            known = with_cloud(scene, UNSEEN, None)
            path = plan_with(self.robot, known, self.options).trajectory.position
            unseen = space.unknown(sweep(self.robot, path, space.edge), since_s)
            found = list[tuple[int, int]]()
            for number, view in enumerate(views):
                joints, pose = self._view(view, carried_by, mount)
                arm = [
                    body
                    for body in arm_solids(self.robot, path[0] if joints is None else joints)
                    # What the camera is in hides nothing.
                    if distances_from_bodies(pose[None, :3, 3], *solid_rows([body], 0.0))[0] > 0.0
                ]
                solids = [*known.solids_with_goal, *arm]
                shown = shows(unseen, space.radius, pose, solids, (wide, high), farthest_m)
                found.append((-int(shown.sum()), number))
            for count, number in sorted(found):
                if count == 0:
                    break
                joints, pose = self._view(views[number], carried_by, mount)
                motion = None
                if joints is not None:
                    there = scene.copy_unchecked({"goal": Goal(joints_rad=tuple(joints.tolist()))})
                    self._check_known(there)
                    try:
                        motion = plan_with(self.robot, there, self.options)
                    except (NotInTimeError, PlanCancelledError):
                        raise
                    except HplanError:
                        continue
                return NextView(number, readonly(pose), -count / len(unseen), readonly(unseen), motion)
            return None

    def _view(
        self, view: ArrayLike, carried_by: str | None, mount: ArrayLike | None
    ) -> tuple[FloatArray | None, FloatArray]:
        """The joints of a view where the arm carries the camera, and its pose."""
        rotation, position = rigid(view if carried_by is None else mount)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, position
        if carried_by is None:
            return None, pose
        joints = self.robot.check_configuration(numbers("views", view, (self.robot.dof,)), "views")
        return joints, self.robot.forward_kinematics(joints, carried_by) @ pose

    def aim(self, *, start: Start | None = None, goal: Goal | None = None) -> None:
        """Begin elsewhere, or go elsewhere.

        Raises:
            SceneError: A fruit that the scene does not have.
        """
        changes: dict[str, Any] = {key: value for key, value in (("start", start), ("goal", goal)) if value is not None}
        with self._changing:
            self.scene = _changed(self.scene, changes)

    def _room_m(self, scene: Scene, options: PlanOptions) -> float:
        """How near to where the arm is sent things matter: the clearance, and what tracking errors may take [m]."""
        deviations = options.certified_tracking.deviations(self.robot.velocity_limit)
        return scene.clearance + float(largest_sway(self.robot, deviations))

    def _check_clouds(self, scene: Scene, options: PlanOptions, now: float | None) -> None:
        """Refuse clouds that lack points that matter now, or whose frame is too old."""
        for fault in self._cloud_faults(scene, options, now):
            raise fault

    def _cloud_faults(self, scene: Scene, options: PlanOptions, now: float | None) -> list[InputError]:
        """Errors for clouds of the scene that lack points that matter now, or whose frame is too old."""
        room_m, faults = self._room_m(scene, options), list[InputError]()
        for name, frame in self._frames(scene).items():
            fault = frame.age_fault(name, now)
            faults += [] if fault is None else [fault]
        for obstacle in scene.obstacles:
            cropped = self._cropped.get(obstacle.name)
            if cropped is None or obstacle is not cropped.cloud:
                continue
            for lacks, what in (
                (room_m > cropped.kept_m + _SAME_M, f"clearance and tracking errors of {cropped.kept_m:.4g} m in all"),
                (_route(scene.base_track) != _route(cropped.base_track), "another track of the base"),
            ):
                if lacks:
                    message = (
                        f"cloud {obstacle.name!r} was cropped to the reach for {what}: set it anew, or, where it is "
                        "remembered (keep_s), remove it before"
                    )
                    faults.append(InputError(message))
        return faults

    def _frames(self, scene: Scene) -> dict[str, AcceptedFrame]:
        """The frames on which a plan in the scene relies, by the names of their clouds."""
        held = {id(obstacle) for obstacle in scene.obstacles}
        clouds = dict(self._cropped)
        return {name: last.frame for name, last in clouds.items() if last.cloud is None or id(last.cloud) in held}

    def _with_ages(self, found: _Result, scene: Scene, now: float | None) -> _Result:
        """The result with the ages of the frames in its report."""
        ages = {name: {"age_s": frame.age_s(now)} for name, frame in self._frames(scene).items()}
        return replace(found, told={**found.told, "frames": ages}) if ages else found

    def _change(self, obstacles: tuple[Obstacle, ...]) -> None:
        # Names and obstacles are checked: no need to check the scene again.
        self.scene = self.scene.copy_unchecked({"obstacles": obstacles})

    def _index(self, name: str) -> int:
        text("name", name, "the name of an obstacle")
        for index, obstacle in enumerate(self.scene.obstacles):
            if obstacle.name == name:
                return index
        raise InputError(f"there is no obstacle {name!r}", name=name)


class _Cropped(NamedTuple):
    """A cloud as `set_cloud` has left it.

    Attributes:
        cloud: The cloud; None where nothing was left of it.
        kept_m: All is in it that the arm can come so near to [m].
        base_track: On which track of the base.
        frame: The frame that it is from.
    """

    cloud: PointCloud | None
    kept_m: float
    base_track: Track | None
    frame: AcceptedFrame


def _route(track: Track | None) -> tuple[Any, ...]:
    """Where a track leads, whenever."""
    return () if track is None else (track.shifts_m, track.rpy_deg, track.about)


#: What space counts as that was not seen.
Unknown: TypeAlias = Literal["free", "solid"]

#: Differences of lengths that are none [m].
_SAME_M = 1e-9

_Model = TypeVar("_Model", bound=StrictModel)
_Result = TypeVar("_Result", bound=PlanResult)


def _check_kind(item: object) -> None:
    """Refuse what is no obstacle."""
    if not isinstance(item, KINDS):
        kinds = ", ".join(kind.__name__ for kind in KINDS)
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
    if isinstance(item, FromData) and not changes.keys() <= {"position", "rpy_deg"}:
        raise InputError("of a mesh or a point cloud only position and rpy_deg can be changed; add another instead")
    return item.with_(**changes)
