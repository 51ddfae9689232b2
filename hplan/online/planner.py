"""A planner that replans as the scene changes.

Obstacles appear, move and disappear. State that does not change is reused between plans: what was prepared for the same
obstacles, and the motion itself while it can still be certified. Every returned motion is certified among the current
obstacles.
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

from hplan.base.arguments import check_between, instance, number, one_of, text
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.base.checked import StrictModel
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.forking import renewed_in_children
from hplan.base.log import LOG
from hplan.certificate.certificate import with_violations
from hplan.certificate.digests import Digests
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.collision.compiled_obstacles import solid_rows
from hplan.collision.far_obstacles import warn_of_far_obstacles
from hplan.collision.held_objects import holding
from hplan.collision.motion_coefficients import largest_sway
from hplan.errors import (
    FrameError,
    HplanError,
    InputError,
    NotInTimeError,
    OptionError,
    PlanCancelledError,
    RunningMotionBlockedError,
)
from hplan.online.arm_shape import arm_solids
from hplan.online.body_distances import distances_from_bodies
from hplan.online.frame import CloudOptions, Frame, FrameReport, SeenPoints, filter_frame, rigid
from hplan.online.frame_check import (
    AcceptedFrame,
    check_cloud_name,
    check_content,
    check_order,
    solids_named,
    with_cloud,
)
from hplan.online.frame_kernels import Scratch
from hplan.online.seen_space import UNSEEN, NextView, SeenSpace, shows, sweep
from hplan.online.splice import RunningMotion, SplicedResult
from hplan.planning.growing_trees import Pairs
from hplan.planning.motion import Motion
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task, solve_scene
from hplan.planning.problem import NO_MEMORY, Problem, SearchMemory
from hplan.planning.recent_paths import with_motion, with_path
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.robot.upright import with_fixed_axis
from hplan.scene.attached import Attached
from hplan.scene.limits import FARTHEST_M
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import FromData
from hplan.scene.obstacles import KINDS, Obstacle, PointCloud
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import SAME_TIME, Phase


class Planner:
    """Replans for one robot while its scene changes.

    **One clock.** All times in arguments are on the controller's clock, any clock that does not run backward: the start
    of a motion (`begins_s`), the current time (`now`), the takeover by a new motion (`at`), the time of a frame, and
    the times of the scene's tracks. A returned motion counts time from its own first sample, which is at `begins_s` on
    the controller's clock; at a time t the controller follows `motion.trajectory.state_at(t - motion.begins_s)`. A
    planner that has never received a time assumes that the clock starts with its first motion. After it has received
    one, it requires the start time of each motion that is planned from rest: `plan(begins_s=)`, or `began` once the
    motion has started.

    Several threads may use one planner. It computes one plan at a time and further calls wait; changes, frames and
    stops do not wait. A plan uses the scene and the options at the time when its turn came. A forked child process may
    use the planner too, independently. A planner can be pickled, without its memory of layers and frames.

    Attributes:
        options: Planning options.
        scene: The current scene; its tracks are on the controller's clock.
        last: The last plan, assumed to be the running one; None before the first.

    Examples:
        >>> from hplan import Planner, load_robot, load_scene
        >>> from hplan.scene import Sphere
        >>> planner = Planner(load_robot(), load_scene())
        >>> planner.add(Sphere(name="post", center=(1.5, 0.0, 1.0), radius=0.05))
        >>> planner.move("post", center=(1.5, 0.2, 1.0))
        >>> planner.scene.obstacles[-1].center
        (1.5, 0.2, 1.0)
        >>> planner.remove("post")
        >>> print(planner.last)
        None
    """

    def __init__(self, robot: Robot, scene: Scene, options: PlanOptions | None = None) -> None:
        """Start with a scene.

        Args:
            robot: The arm.
            scene: Obstacles and task.
            options: Planning options; None for the defaults.

        Raises:
            OptionError: An argument has the wrong type.
        """
        check_task(robot, scene, options)
        self._arm = robot
        self.options = PlanOptions() if options is None else options
        self.scene = with_fixed_axis(robot, scene)
        self.last: PlanResult | None = None
        self._is_told = False
        self._cropped: dict[str, _Cropped] = {}
        self._closing: PointCloud | None = None
        self._make_ready()

    def _make_ready(self) -> None:
        """Start without memory of earlier plans and frames."""
        self._planning, self._changing, self._filtering = (renewed_in_children(RLock()) for _ in range(3))
        self._seen: dict[str, SeenPoints] = {}
        self._scratch = Scratch()
        self._recent: tuple[FloatArray, ...] = ()
        self._pairs = Pairs()
        self._space: SeenSpace | None = None
        self._known_since_s = -math.inf

    def __getstate__(self) -> dict[str, Any]:
        """Return the public attributes and the state of clock and clouds."""
        return {
            key: vars(self)[key] for key in ("_arm", "scene", "options", "last", "_is_told", "_cropped", "_closing")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._make_ready()

    @property
    def robot(self) -> Robot:
        """The arm, with the objects that it holds."""
        return holding(self._arm, self.scene.attached)

    def plan(self, *, begins_s: float | None = None, cancel: Cancel | None = None) -> PlanResult:
        """Plan as `hplan.plan` does, independent of earlier plans.

        Args:
            begins_s: Start time of the motion on the controller's clock [s]; moving obstacles are considered from then
                on. None for 0 if the planner has never received a time; otherwise for an unknown start, which is
                allowed only in a static scene.
            cancel: Cancels the plan, as for `hplan.plan`.

        Raises:
            OptionError: `begins_s` is not a time, or is missing although something moves.
            InputError: The start is in unknown space, and unknown space is solid.
            FrameError: A frame is older than its `max_age_s`.
            HplanError: Any error of `hplan.plan`.
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
        """Replan after a change, before the motion starts or while it runs.

        The last motion is kept if it can be certified among the current obstacles, and repaired otherwise. A new one is
        planned if the repair fails, if a straight motion has become possible, if start or goal has changed, and always
        for a fruit or point goal. So the result depends on earlier plans; `plan` gives a result that does not.

        With `at`, the last motion is assumed to be running. It stays unchanged up to the first sample at or after that
        time, and up to its end if it still solves the task and is certified from now on among the current obstacles;
        otherwise a new motion takes over with continuous position, velocity and acceleration. The returned
        `SplicedResult` contains the running motion from now on and, from `seam_s`, the new one, certified as a whole.
        It starts at `begins_s`, the time of the last sample at or before now, and counts as the running motion from
        then on.

        Args:
            at: Takeover time of the new motion on the controller's clock [s]; None if the motion has not started.
            now: Current time on that clock [s]; without it the whole motion up to `at` must be collision-free.
            measured: (dof,) current configuration of the arm [rad, m for a prismatic joint]. A motion is not taken over
                if the arm is farther from it than the tracking error that certificates cover. None to assume that the
                arm is on the motion.
            begins_s: Start time of the motion, as for `plan`; only without `at`.
            cancel: Cancels the plan, as for `hplan.plan`.

        Raises:
            InputError: There is no motion that could be running, or its start time is unknown; without `at`, the start
                is in unknown space, and unknown space is solid.
            NotOnMotionError: The arm is not on the running motion.
            FrameError: A frame is older than its `max_age_s`.
            OptionError: A time is before the motion, after it, or before now; `now` or `measured` is given without
                `at`, `measured` without `now`, or `begins_s` with `at`.
            RunningMotionBlockedError: The running motion is not collision-free until then, or cannot be left without
                contact; the error carries the stop on its path if that is certified.
            HplanError: Any error of `hplan.plan`.
        """
        if at is None:
            for option, value in (("now", now), ("measured", measured)):
                if value is not None:
                    raise OptionError(option, value, "None without `at`: of a motion that has not begun")
        for option, value in (("at", at), ("now", now)):
            if value is not None:
                number(option, value, "a time on the controller's clock in seconds")
        if at is not None and begins_s is not None:
            raise OptionError(
                "begins_s", begins_s, "None with `at`: a splice takes its start time from the running motion"
            )
        with self._turn(cancel):
            for key in list(self._pairs)[:-_PAIRS]:
                del self._pairs[key]
            if at is None:
                return self._from_rest(begins_s, None if self.last is None else self.last.motion)
            scene, options, known_s = self.scene, self.options, at if now is None else now
            self._check_clouds(scene, options, known_s)
            try:
                spliced = self._running_motion(scene, options, now, measured).splice(at)
            except RunningMotionBlockedError as error:
                LOG.warning("at %.6g s: %s", known_s, error.message)
                raise
            end_s = spliced.begins_s + spliced.trajectory.duration
            if spliced.is_kept:
                LOG.info("at %.6g s: the motion is kept until %.6g s", known_s, end_s)
            else:
                seam_s = spliced.begins_s + spliced.seam_s
                LOG.info("at %.6g s: a new motion takes over at %.6g s, until %.6g s", known_s, seam_s, end_s)
            if not spliced.is_kept:
                self._remember(spliced)
            self.last = self._with_ages(spliced, scene, known_s)
            return self.last

    def _remember(self, plan: PlanResult) -> None:
        """Remember the points of a motion, or the path that a first motion is near, for later searches."""
        is_first = plan.problem.options.at_once and not (isinstance(plan, SplicedResult) and plan.is_improved)
        if is_first and len(plan.grid_path) > 2:
            self._recent = with_path(self._recent, plan.grid_path, plan.robot)
        else:
            self._recent = with_motion(self._recent, plan.trajectory, plan.robot)

    def _memory(self, scene: Scene, options: PlanOptions) -> SearchMemory:
        """What earlier searches found: trees among obstacles that rest, if a first motion is wanted at once."""
        grows_on = (options.at_once or options.deadline_s is not None) and not scene.moves
        return SearchMemory(self._recent, self._pairs if grows_on else None)

    def stop_at(self, t: float, *, now: float | None = None, measured: ArrayLike | None = None) -> CertifiedMotion:
        """Return the last motion with the fastest stop on its path.

        The stop starts at the first sample at or after `t`. It is certified from now on among the current obstacles;
        read `certificate.verified`. Among moving obstacles `certificate.clear_until_s` is the time until which the arm
        may rest at the stop. The trajectory starts with the last motion, at its `begins_s`, and all its times count
        from there. The planner still assumes that the last motion is running.

        Args:
            t: Start of the stop on the controller's clock [s].
            now: Current time on that clock [s]; the motion must be collision-free from then on. None for the start
                of the motion.
            measured: (dof,) current configuration of the arm, as for `replan`.

        Raises:
            InputError: There is no motion that could be running, or its start time is unknown.
            NotOnMotionError: The arm is not on the running motion.
            OptionError: A time is before the motion, after it, or before now; `measured` is given without `now`.
        """
        scene, options = self.scene, self.options
        found = self._running_motion(scene, options, now, measured).stop_at(t)
        LOG.info("stop from %.6g s, at rest at %.6g s", t, found.begins_s + found.trajectory.duration)
        faults = [error.message for error in self._cloud_faults(scene, options, t if now is None else now)]
        return replace(found, certificate=with_violations(found.certificate, faults))

    def use(self, motion: CertifiedMotion) -> PlanResult:
        """Set the motion that the controller runs: the last one at other speeds, or with a stop.

        For a speed override of 50 % from a time t of the motion on:
        `planner.use(planner.last.scale_speed([(0, 1), (t, 1), (t, 0.5)]))`. The planner then assumes that the arm
        follows it: `replan` and `stop_at` continue from it, and certify it anew among the current obstacles.

        Args:
            motion: Result of `scale_speed` or `stop_at` of the last plan, or of the planner's own `stop_at`.

        Returns:
            The last plan with this trajectory, its certificate and phases; read `certificate.verified`, since a slower
            motion meets moving obstacles at other places.

        Raises:
            InputError: There is no last plan, or the motion is not on its path or has another start time.
            OptionError: `motion` is not a `CertifiedMotion`.
        """
        instance("motion", motion, CertifiedMotion, "PlanResult.scale_speed or stop_at")
        with self._changing:
            last = self.last
            if last is None:
                raise InputError("there is no motion to change: plan one first")
            if not motion.begins_s == last.begins_s and not math.isnan(motion.begins_s):
                raise InputError(
                    f"the motion begins at {motion.begins_s:.10g} s on the controller's clock, but the last plan at "
                    f"{last.begins_s:.10g} s"
                )
            own, clock = last.trajectory, motion.clock
            names = motion.trajectory.joint_names
            if names != own.joint_names or not np.allclose(
                own.positions(np.minimum(clock, own.duration)), motion.trajectory.position, rtol=0.0, atol=_ON_PATH
            ):
                raise InputError("the motion is not on the path of the last plan: take scale_speed or stop_at of it")
            begun = [phase for phase in last.phases if phase.start_s <= clock[-1]]
            phases = tuple(phase.retime(clock, motion.trajectory.time) for phase in begun)
            changes: dict[str, Any] = {"trajectory": motion.trajectory, "certificate": motion.certificate}
            changes |= {"phases": phases, "bound": None}
            if clock[-1] < own.duration - SAME_TIME:
                changes |= _stopped_changes(last, motion)
            if isinstance(last, SplicedResult):
                changes["seam_s"] = (
                    Phase("seam", last.seam_s, last.seam_s).retime(clock, motion.trajectory.time).start_s
                )
            self.last = replace(last, **changes)
            LOG.info("the controller runs the motion until %.6g s", last.begins_s + motion.trajectory.duration)
            return self.last

    def set_start_time(self, at_s: float) -> PlanResult:
        """Set the actual start time of the last motion.

        For a motion planned from rest in a static scene.

        Args:
            at_s: Start time on the controller's clock [s].

        Returns:
            The plan with this start time.

        Raises:
            InputError: There is no motion, or the start time is fixed: a motion among moving obstacles starts at its
                planned time, a spliced one at its own `begins_s`.
            OptionError: `at_s` is not a time.
        """
        number("at_s", at_s, "a time on the controller's clock in seconds")
        with self._changing:
            if self.last is None:
                raise InputError("there is no motion to begin: plan one first")
            if (isinstance(self.last, SplicedResult) or self.last.scene.moves) and at_s != self.last.begins_s:
                raise InputError(
                    f"the motion begins at {self.last.begins_s:.10g} s on the controller's clock and at no "
                    "other time: it was planned for that time"
                )
            self.last, self._is_told = replace(self.last, begins_s=float(at_s)), True
            return self.last

    def _from_rest(self, begins_s: float | None, before: Motion | None) -> PlanResult:
        """Plan a motion that has not started."""
        scene, options = self.scene, self.options
        begin = self._begin_of(begins_s, scene)
        self._check_clouds(scene, options, begins_s)
        self._check_known(scene)
        shown = scene if math.isnan(begin) else scene.starting_at(begin)
        memory = NO_MEMORY if before is None else self._memory(scene, options)
        if before is not None and before.problem.robot.attached != scene.attached:
            before = None  # its torques are those of another load
        problem = replace(Problem.from_scene(self.robot, shown, options), memory=memory)
        found = solve_scene(problem, before=before)
        self._remember(found)
        self.last = self._with_ages(replace(found, begins_s=begin), scene, begins_s)
        return self.last

    def _begin_of(self, begins_s: float | None, scene: Scene) -> float:
        """Start time of a motion [s]; NaN if unknown.

        On the controller's clock.
        """
        expected = "a time on the controller's clock in seconds"
        if begins_s is not None:
            number("begins_s", begins_s, expected)
            self._is_told = True
            return float(begins_s)
        if not self._is_told:
            return 0.0
        if scene.moves:
            raise OptionError(
                "begins_s", None, f"{expected}: the scene has moving bodies, and the clock is already running"
            )
        return math.nan

    def _running_motion(
        self, scene: Scene, options: PlanOptions, now: float | None, measured: ArrayLike | None
    ) -> RunningMotion:
        if measured is not None and now is None:
            raise OptionError("now", None, "the time when the joints were measured, on the controller's clock")
        if self.last is None:
            raise InputError("there is no running motion: plan one first")
        self._is_told = True
        return RunningMotion(self.last, scene, options, now, measured, self._memory(scene, options))

    @contextmanager
    def _turn(self, cancel: Cancel | None) -> Iterator[None]:
        """Wait for this plan's turn; its deadline counts from now.

        Raises:
            NotInTimeError: The deadline is over before the plan starts.
            PlanCancelledError: The plan was cancelled.
        """
        with time_limit(self.options.deadline_s, cancel) as limit:
            # A waiting plan checks for cancellation at this interval [s].
            wait_s = 0.01
            while not self._planning.acquire(timeout=min(wait_s, max(limit.left_s, 0.0))):
                if limit.is_up:
                    raise limit.error(["another plan of the same planner is under way"])
            try:
                yield
            except TimeIsUpError:  # Before the plan itself, which reports its own attempts.
                raise limit.error(["the running motion up to the point where a new one may take over"]) from None
            finally:
                self._planning.release()

    def add(self, obstacle: Obstacle) -> None:
        """Add an obstacle.

        Raises:
            InputError: The name is taken, or `obstacle` is not an obstacle.
        """
        _check_kind(obstacle)
        with self._changing:
            scene = self.scene
            if obstacle.name in {item.name for item in (*scene.obstacles, *scene.fruits, *scene.attached)}:
                message = f"there already is an obstacle {obstacle.name!r}; names must differ"
                raise InputError(message, name=obstacle.name)
            self._change((*self.scene.obstacles, obstacle))
            warn_of_far_obstacles(self.robot, self.scene)

    def hold(self, attached: Sequence[Attached]) -> None:
        """Change the objects that the arm holds; an empty list puts all of them away.

        Raises:
            InputError: `attached` is not a list of `Attached`.
            SceneError: A name occurs twice, is that of an obstacle or of a frame, or a frame or link does not exist.
        """
        with self._changing:
            scene = self.scene.with_attached(attached)
            holding(self._arm, scene.attached)
            self.scene = scene

    def remove(self, name: str) -> None:
        """Remove an obstacle or a fruit.

        Raises:
            InputError: There is no such name, or it is the goal fruit.
        """
        with self._changing:
            if any(fruit.name == name for fruit in self.scene.fruits):
                if name == self.scene.goal.fruit:
                    raise InputError(f"fruit {name!r} is the goal; set another goal before removing it", name=name)
                left = tuple(fruit for fruit in self.scene.fruits if fruit.name != name)
                self.scene = self.scene.copy_unchecked({"fruits": left})
                return
            if not any(key == name and last.cloud is None for key, last in self._cropped.items()):
                index = self._index(name)
                self._change((*self.scene.obstacles[:index], *self.scene.obstacles[index + 1 :]))
            self._seen.pop(name, None)
            self._cropped.pop(name, None)

    def move(self, name: str, **changes: Any) -> None:
        """Change values of an obstacle or a fruit, for example `move("post", center=(1, 0, 1))`.

        Raises:
            InputError: There is no such obstacle; it has no such value, or the value is invalid; or it is a cloud that
                `set_cloud` has cropped to the workspace at its observed pose.
        """
        with self._changing:
            if any(fruit.name == name for fruit in self.scene.fruits):
                fruits = (_with_changes(f, changes) if f.name == name else f for f in self.scene.fruits)
                self.scene = self.scene.copy_unchecked({"fruits": tuple(fruits)})
                return
            index, cropped = self._index(name), self._cropped.get(name)
            if cropped is not None and self.scene.obstacles[index] is cropped.cloud:
                raise InputError(
                    f"cloud {name!r} was cropped to the reach of the arm where it was seen: set it again", name=name
                )
            moved = _with_changes(self.scene.obstacles[index], changes)
            self._change((*self.scene.obstacles[:index], moved, *self.scene.obstacles[index + 1 :]))

    # Eleven parameters: a frame has many aspects, and callers name them by keyword.
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
        """Replace the obstacle `name` by a frame of a depth camera.

        Left out are rows that are not finite, points that the arm cannot come near, points of the arm, and points of
        ignored objects; the others become balls, fewer than points (`hplan.online.frame`). A frame that indicates a
        failing camera, a wrong unit or a wrong pose is refused (`hplan.online.frame_check`), and the obstacle of the
        last good frame stays; `CloudOptions` sets the limits. If the base moves, the points keep their position as seen
        from the base at that time, and points within range anywhere on its track count. Points left out could matter
        for a larger clearance, larger tracking errors or another track of the base: plans are then refused until the
        next frame.

        Args:
            name: Name of the cloud.
            points: (n, 3) or (rows, columns, 3) points in the camera's frame [m]; best float32 or float64.
            radius: Radius of the ball around each point [m].
            pose: Camera to `base_link`: a (4, 4) matrix, or x, y, z [m], roll, pitch, yaw about fixed axes [deg]; None
                if the points are in `base_link`, with the camera assumed at its origin. If the base moves, `base_link`
                at the time of the frame.
            joints: (dof,) configuration of the arm at the time of the frame, to remove its own points [rad]; None to
                remove no points of the arm.
            ignore: Names of fruits and other obstacles whose points are left out: the fruit to pick, and objects
                already in the scene.
            keep_s: Hidden points are remembered this long (`hplan.online.hidden_points`) [s].
            time_s: Time of the frame on the controller's clock [s]; required if the base or an ignored object moves.
                None for now otherwise.
            options: Voxels, paddings, outliers; None for the defaults.
            yields: Maximum deflection of the cloud by the links that may touch it [m].
            unknown: `solid`: space that no such frame has seen through in the last `keep_s`, and where the arm has not
                been, becomes an obstacle named `unseen` (`hplan.online.seen_space`) with this frame. Requires `joints`
                and a fixed base. `free`: unknown space counts as free, and an existing `unseen` obstacle stays.

        Returns:
            The numbers of points and balls.

        Raises:
            InputError: Points, pose or joints are invalid; an obstacle other than a cloud has the name; or an ignored
                name is unknown.
            OptionError: A radius, time, depth or option is invalid.
            FrameError: The frame is older than the last one, has too few returns, is in millimetres, or leaves no
                obstacle. The scene is unchanged.
        """
        yields = check_between("yields", yields, 0.0, FARTHEST_M)
        one_of("unknown", unknown, get_args(Unknown))
        options = CloudOptions() if options is None else options
        if unknown == "solid" and joints is None:
            raise OptionError(
                "joints", None, "the joint positions of the arm: unknown space is solid except for the space of the arm"
            )
        with self._filtering:  # Only other frames wait for this lock.
            scene, planning = self.scene, self.options
            check_cloud_name(scene, name)
            if scene.base_track is not None and time_s is None:
                expected = "the time of the frame on the controller's clock: the base moves"
                raise OptionError("time_s", None, expected)
            last = self._cropped.get(name)
            before = None if last is None else last.frame
            frame = Frame.validate(
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
            try:
                accepted = check_content(name, found.report, options, time_s, before)
            except FrameError as error:
                LOG.warning("frame of %r refused: %s", name, error.message)
                raise
            cloud = None
            if len(found.points):
                cloud = PointCloud.from_thinned(name, found.points, found.report.radius_m, yields)
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
        """Obstacle that closes off unknown space; None if all is known.

        It includes the given frame.
        """
        if frame.base_track is not None or frame.joints is None:
            raise OptionError("unknown", "solid", "'free' if the base moves")
        if self._space is None:
            self._space = SeenSpace(self.robot, options.unseen_edge_m)
        space, now_s = self._space, frame.time_s
        names = [fruit.name for fruit in scene.fruits if fruit.name in ignore]
        fruits = solids_named(scene, names, UNSEEN, now_s)
        # A swaying fruit is not a ball.
        balls = [
            (*fruit.core[0], fruit.rounding + options.ignore_padding_m) for fruit in fruits if len(fruit.core) == 1
        ]
        space.see(frame.points, (frame.rotation, frame.position), now_s, frame.radius, np.array(balls).reshape(-1, 4))
        space.free(arm_solids(self.robot, frame.joints), now_s, options.arm_padding_m + space.radius)
        space.free(fruits, now_s, space.radius)
        space.free([solid for item in options.known_free for solid in item.solids], now_s, 0.0)
        self._known_since_s = now_s - frame.keep_s
        border = space.border(self._known_since_s)
        return PointCloud.from_thinned(UNSEEN, border, space.radius) if len(border) else None

    def _check_known(self, scene: Scene) -> None:
        """Refuse a start in unknown space if unknown space is solid.

        Nothing closes off unknown space from there.
        """
        if all(item is not self._closing for item in scene.obstacles):
            return
        _, start = self.robot.about_start(scene.start)
        if self._space is None or not self._space.holds(arm_solids(self.robot, start), self._known_since_s):
            raise InputError("start: the arm is in unseen space, and unknown space is solid: give a frame with the "
                "joint positions of the arm there", option="start")  # fmt: skip

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
        """Choose the camera view that reveals the most relevant unknown space.

        A motion to the goal is planned around the known obstacles, with all unknown space free. The unknown voxels
        swept by this motion are counted for each view that would look through them: they lie in its field of view, with
        no known object in front of them, the arm included. Unknown space hides nothing here, so a view may reveal less
        than promised; leave out views that were used already.

        Args:
            views: Camera poses, camera to `base_link` as for `set_cloud`; z points forward, x to the right, y down.
                With `carried_by`: (dof,) configurations of the arm.
            field_of_view_deg: Width and height of the field of view [deg].
            farthest_m: Maximum range of the camera [m].
            carried_by: Frame of the arm that carries the camera; None for a camera off the arm. With it, the best view
                among the ones that a motion certified through known space can reach is chosen.
            mount: Camera to that frame, a pose as above; None if they coincide.
            cancel: Cancels the plan, as for `hplan.plan`.

        Returns:
            The chosen view; None if the motion sweeps only known space, or if no view reveals any unknown voxel.

        Raises:
            InputError: No frame was given with `unknown="solid"`; views or mount are invalid, or the arm has no such
                frame.
            OptionError: An angle is outside 1 to 179 degrees, or the distance is invalid.
            FrameError: A frame is older than its `max_age_s`.
            HplanError: Any error of `plan`: known obstacles alone block the goal.
        """
        wide, high = (check_between("field_of_view_deg", angle, 1.0, 179.0) for angle in field_of_view_deg)
        check_between("farthest_m", farthest_m, 0.0, FARTHEST_M)
        with self._turn(cancel):
            scene, space, since_s = self.scene, self._space, self._known_since_s
            if space is None:
                raise InputError('next_view: no frame was taken with unknown="solid"')
            self._check_clouds(scene, self.options, None)
            self._begin_of(None, scene)
            known = with_cloud(scene, UNSEEN, None)
            path = solve_scene(Problem.from_scene(self.robot, known, self.options)).trajectory.position
            unseen = space.unknown(sweep(self.robot, path, space.edge), since_s)
            found = list[tuple[int, int]]()
            for number, view in enumerate(views):
                joints, pose = self._view(view, carried_by, mount)
                arm = [
                    body
                    for body in arm_solids(self.robot, path[0] if joints is None else joints)
                    # A body that contains the camera hides nothing.
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
                        motion = solve_scene(Problem.from_scene(self.robot, there, self.options))
                    except (NotInTimeError, PlanCancelledError):
                        raise
                    except HplanError:
                        continue
                return NextView(number, readonly(pose), -count / len(unseen), readonly(unseen), motion)
            return None

    def _view(
        self, view: ArrayLike, carried_by: str | None, mount: ArrayLike | None
    ) -> tuple[FloatArray | None, FloatArray]:
        """Joints (if the arm carries the camera) and pose of a view."""
        rotation, position = rigid(view if carried_by is None else mount)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, position
        if carried_by is None:
            return None, pose
        joints = self.robot.about(view).check_configuration(numbers("views", view, (self.robot.dof,)), "views")
        return joints, self.robot.forward_kinematics(joints, carried_by) @ pose

    @overload
    def aim(self, *, start: Start | None = None, goal: Goal | None = None) -> None: ...

    @overload
    def aim(
        self,
        *,
        start: Start | None = None,
        goal: Goal | None = None,
        now: float,
        at: float | None = None,
        measured: ArrayLike | None = None,
    ) -> CertifiedMotion: ...

    def aim(
        self,
        *,
        start: Start | None = None,
        goal: Goal | None = None,
        now: float | None = None,
        at: float | None = None,
        measured: ArrayLike | None = None,
    ) -> CertifiedMotion | None:
        """Change start or goal; with `now`, return what the arm can follow meanwhile.

        That is the running motion up to `at`, and from there its fastest stop, as from `stop_at`: certified before any
        motion to the new goal is known. Compute this motion with `replan(at=, now=)`, for example in another thread; if
        it comes before `at`, follow it, and otherwise the stop (`use`).

        Args:
            start: The new start; None to keep it.
            goal: The new goal; None to keep it.
            now: Current time on the controller's clock [s]; None if no motion is running.
            at: Start of the stop, by when the motion to the new goal should be known [s]; None for now.
            measured: (dof,) current configuration of the arm, as for `replan`.

        Returns:
            The last motion with the stop; None without `now`.

        Raises:
            SceneError: The goal is a fruit that the scene does not have.
            InputError, NotOnMotionError, OptionError: As for `stop_at`; or `at` or `measured` is given without `now`.
        """
        for option, value in (("at", at), ("measured", measured)):
            if value is not None and now is None:
                raise OptionError(option, value, "None without `now`: no motion is running")
        changes: dict[str, Any] = {key: value for key, value in (("start", start), ("goal", goal)) if value is not None}
        # Of the values of a scene only the name of a fruit depends on others. Checking all takes as long as a stop.
        is_checked = isinstance(start, Start | None) and isinstance(goal, Goal | None) and not (goal and goal.fruit)
        with self._changing:
            scene = self.scene
            self.scene = scene.copy_unchecked(changes) if is_checked else _with_changes(scene, changes)
        return None if now is None else self.stop_at(now if at is None else at, now=now, measured=measured)

    def _room_m(self, scene: Scene, options: PlanOptions) -> float:
        """Distance within which points matter: clearance plus tracking displacement bound [m]."""
        deviations = options.certified_tracking.deviations(self.robot.velocity_limit)
        return scene.clearance + float(largest_sway(self.robot, deviations))

    def _check_clouds(self, scene: Scene, options: PlanOptions, now: float | None) -> None:
        """Refuse clouds without points that matter, or with old frames."""
        for fault in self._cloud_faults(scene, options, now):
            raise fault

    def _cloud_faults(self, scene: Scene, options: PlanOptions, now: float | None) -> list[InputError]:
        """Errors for clouds without points that matter, or with old frames."""
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
                        f"cloud {obstacle.name!r} was cropped to the reach for {what}: set it again or, if it is "
                        "remembered (keep_s), remove it first"
                    )
                    faults.append(InputError(message))
        return faults

    def _frames(self, scene: Scene) -> dict[str, AcceptedFrame]:
        """Frames that a plan in the scene relies on, by cloud name."""
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
    """State of a cloud after `set_cloud`.

    Attributes:
        cloud: The cloud; None if the frame left no points.
        kept_m: The cloud contains all points that the arm can come this near to [m].
        base_track: The base's track at that time.
        frame: The frame that it is from.
    """

    cloud: PointCloud | None
    kept_m: float
    base_track: Track | None
    frame: AcceptedFrame


def _route(track: Track | None) -> tuple[Any, ...]:
    """Poses of a track, without its times."""
    return () if track is None else (track.shifts_m, track.rpy_deg, track.about)


#: How unknown space counts.
Unknown: TypeAlias = Literal["free", "solid"]

#: Maximum difference of a retimed motion's joint values from the path of its original [rad; m for prismatic joints].
_ON_PATH = 1e-3

#: Differences of lengths up to this count as zero [m].
_SAME_M = 1e-9

#: Number of pairs of trees that grow on in later searches.
_PAIRS = 8

_Model = TypeVar("_Model", bound=StrictModel)
_Result = TypeVar("_Result", bound=PlanResult)


def _stopped_changes(last: PlanResult, motion: CertifiedMotion) -> dict[str, Any]:
    """Fields of a plan whose motion stops early: its task is to reach the stop."""
    problem, end = last.motion.problem, tuple(motion.trajectory.position[-1].tolist())
    scene = problem.scene.copy_unchecked({"goal": Goal(joints_rad=end)})
    digests = Digests(last.robot, scene, motion.trajectory)
    return {
        "grasp": None,
        "motion": replace(last.motion, problem=replace(problem, scene=scene)),
        "certificate": replace(motion.certificate, digests=digests),
    }


def _check_kind(item: object) -> None:
    """Refuse an object that is not an obstacle."""
    if not isinstance(item, KINDS):
        kinds = ", ".join(kind.__name__ for kind in KINDS)
        raise InputError(f"expected one of {kinds}, got {type(item).__name__} {item!r}")


def _with_changes(item: _Model, changes: Mapping[str, Any]) -> _Model:
    """Return a checked copy with other values.

    Raises:
        InputError: A key is unknown.
        SceneError: A value is invalid, or values contradict each other.
    """
    fields = type(item).model_fields
    unknown = [key for key in changes if key not in fields]
    if unknown:
        raise InputError(f"a {type(item).__name__.lower()} has no {unknown[0]!r}; it has {', '.join(fields)}")
    if isinstance(item, FromData) and not changes.keys() <= {"position", "rpy_deg"}:
        raise InputError("only position and rpy_deg of a mesh or a point cloud can be changed; add another one instead")
    return item.with_values(**changes)
