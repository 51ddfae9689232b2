"""Measure hplan's ROS nodes on the real middleware: round trips, frames, a soak.

    python scripts/measure_ros.py judge --count 300        # a motion of 400 points, to the judge and back
    python scripts/measure_ros.py plan --count 100          # a cloud of 100,000 points, to the new motion
    python scripts/measure_ros.py soak --seconds 3600      # 10 clouds and motions per second: losses and memory

It needs rclpy (extra `ros2`). Times are wall-clock times of an idle machine, from the call of `publish` in this process
to the callback in this process; the nodes are processes of their own.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import hplan
from hplan.apps.ros import to_joint_trajectory, to_message
from hplan.apps.ros.fields import stack_rows
from hplan.scene import Box, Goal, Scene, Start, save_scene
from hplan.trajectory.trajectory import Trajectory

#: Ends of the Panda's motion [rad], points of the judged motion, and points of a cloud.
A, B = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), (1.2, -0.3, 0.2, -1.9, 0.2, 1.7, 0.9)
POINTS, CLOUD = 400, 100_000
#: Most clouds that wait in a queue.
WAITING = 10


def panda_scene() -> Scene:
    """Ten boxes beside the Panda, which the motion from A to B passes."""
    boxes = tuple(
        Box(name=f"box {k}", center=(0.4 + 0.1 * k, -0.6 + 0.05 * k, 0.1 * k), size=(0.1, 0.1, 0.1)) for k in range(10)
    )
    return Scene(name="panda", start=Start(joints_rad=A), goal=Goal(joints_rad=B), obstacles=boxes)


def judged_motion(robot: hplan.Robot, scene: Scene) -> dict[str, Any]:
    """A motion of 400 points, as other planners send it."""
    motion = hplan.plan(robot, scene, hplan.PlanOptions(speed=0.5)).trajectory
    time_s = np.linspace(0.0, motion.duration, POINTS)
    rows = [np.array(each) for each in zip(*(motion.state_at(at) for at in time_s), strict=True)]
    torque = robot.dynamics.torques(*rows)
    return to_joint_trajectory(Trajectory(motion.joint_names, time_s, *rows, torque, motion.slides))


class Peer:
    """This process's node: publishes, and waits for what comes back."""

    def __init__(self) -> None:
        import rclpy

        rclpy.init()
        self.node = rclpy.create_node("hplan_measure")
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._rclpy = rclpy

    def wait(self, done: Callable[[], Any], most_s: float) -> bool:
        """Spin until a function returns true; False if it does not in time."""
        end = time.monotonic() + most_s
        # Also after a delay of this process, which would otherwise send clouds without the arm's state between them.
        self._executor.spin_once(timeout_sec=0.0)
        while not done():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=max(0.0, min(0.05, end - time.monotonic())))
        return True

    def close(self) -> None:
        """End ROS in this process."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


@contextmanager
def node(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A node of hplan, ended by SIGINT."""
    process = subprocess.Popen([sys.executable, "-m", "hplan.apps.cli", "ros", *words])
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        if process.wait(timeout=30) != 0:
            raise RuntimeError(f"the node ended with status {process.returncode}")


def memory_mb(process: subprocess.Popen[bytes]) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def describe(name: str, values_ms: Sequence[float]) -> str:
    """Median, 95 % and maximum in a line."""
    median, most, worst = np.percentile(values_ms, (50, 95, 100))
    return f"{name}: median {median:.1f} ms, 95 % {most:.1f} ms, maximum {worst:.1f} ms of {len(values_ms)}"


def measure_judge(folder: Path, count: int) -> list[float]:
    """Round trips of a motion of 400 points [ms]."""
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    scene, robot = panda_scene(), hplan.load_robot("panda")
    message = to_message(JointTrajectory, judged_motion(robot, scene))
    file, peer, found, verdicts = save_scene(scene, folder / "scene.yaml"), Peer(), list[float](), list[Any]()
    with node("judge", "--ros-args", "-p", "robot:=panda", "-p", f"scene:={file}"):
        motions = peer.node.create_publisher(JointTrajectory, "/hplan_judge/trajectory", 10)
        peer.node.create_subscription(String, "/hplan_judge/verdict", verdicts.append, 10)
        peer.wait(motions.get_subscription_count, 60.0)
        peer.wait(lambda: False, 1.0)
        for number in range(count):
            began = time.perf_counter()
            motions.publish(message)
            if not peer.wait(lambda number=number: len(verdicts) > number, 5.0):  # type: ignore[misc]
                raise RuntimeError(f"no verdict on motion {number}")
            found.append(1e3 * (time.perf_counter() - began))
            time.sleep(0.02)
    peer.close()
    inside = [json.loads(each.data)["judged_ms"] for each in verdicts]
    print(describe("round trip to the judge", found))
    print(describe("of which conversion and certificate", inside))
    print(f"verified: {sum(json.loads(each.data)['verified'] for each in verdicts)} of {len(verdicts)}")
    return found


class ControllerPeer(Peer):
    """A controller on a topic, and a camera."""

    def __init__(self, robot: hplan.Robot) -> None:
        from sensor_msgs.msg import JointState, PointCloud2
        from std_msgs.msg import String
        from trajectory_msgs.msg import JointTrajectory

        super().__init__()
        self.robot, self._state, self.q = robot, JointState, np.array(A)
        self.motions: list[tuple[float, Any]] = []
        self.events: list[dict[str, Any]] = []
        self._running: tuple[float, np.ndarray, np.ndarray] | None = None
        self.node.create_subscription(JointTrajectory, "joint_trajectory", self._receive, 10)
        self.node.create_subscription(String, "/hplan_planner/status", self._note, 100)
        self.states = self.node.create_publisher(JointState, "joint_states", 10)
        self.goals = self.node.create_publisher(JointState, "/hplan_planner/goal", 10)
        self.clouds = self.node.create_publisher(PointCloud2, "points", WAITING)
        self.node.create_timer(0.01, self._update)
        fields = [{"name": axis, "offset": 4 * k, "datatype": 7, "count": 1} for k, axis in enumerate("xyz")]
        layout = {"height": 1, "width": CLOUD, "fields": fields, "point_step": 12, "row_step": 12 * CLOUD}
        self._cloud = to_message(PointCloud2, {**layout, "header": {"frame_id": "panda_link0"}, "is_dense": True})

    def _note(self, message: Any) -> None:
        self.events.append(json.loads(message.data))

    def _receive(self, message: Any) -> None:
        self.motions.append((time.perf_counter(), message))
        rows = stack_rows([point.positions for point in message.points])
        times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points]
        if rows is not None:
            self._running = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, np.array(times), rows

    def _update(self) -> None:
        now = self.node.get_clock().now()
        if self._running is not None:
            begin, times, rows = self._running
            at = now.nanoseconds * 1e-9 - begin
            self.q = np.array([np.interp(at, times, column) for column in rows.T])
        state = self._state(name=list(self.robot.joint_names), position=self.q.tolist())
        state.header.stamp = now.to_msg()
        self.states.publish(state)

    @property
    def ends_s(self) -> float:
        """Time until the running motion ends [s]."""
        if self._running is None:
            return -np.inf
        return self._running[0] + float(self._running[1][-1]) - self.node.get_clock().now().nanoseconds * 1e-9

    def go_to(self, q: Sequence[float]) -> None:
        """Request a goal."""
        self.goals.publish(self._state(name=list(self.robot.joint_names), position=list(map(float, q))))

    def see(self, near: np.ndarray, number: int) -> float:
        """Publish a cloud: a floor, and some points; returns the time before."""
        rng = np.random.default_rng(number)
        floor = rng.uniform((-1.5, -1.5, -0.3), (1.5, 1.5, -0.25), (CLOUD - len(near), 3))
        self._cloud.data = array("B", np.vstack([floor, near]).astype(np.float32).tobytes())
        self._cloud.header.stamp = self.node.get_clock().now().to_msg()
        began = time.perf_counter()
        self.clouds.publish(self._cloud)
        return began


def _planner_words(folder: Path) -> tuple[str, ...]:
    scene = panda_scene().with_obstacles(())
    file = save_scene(scene, folder / "plan.yaml")
    options = {"robot": "panda", "scene": file, "output": "topic", "speed": 0.25, "ahead_s": 0.25, "radius_m": 0.02}
    options |= {"growth_m": 0.02, "tracking_error": 0.005, "tracking_delay_s": 0.005, "points_reliable": "true"}
    options["points_depth"] = WAITING
    return ("plan", "--ros-args", *(word for key, value in options.items() for word in ("-p", f"{key}:={value}")))


def measure_plan(folder: Path, count: int) -> list[float]:
    """Times from a cloud that invalidates the running motion to the new one at the controller [ms]."""
    robot = hplan.load_robot("panda")
    peer, found, stops = ControllerPeer(robot), list[float](), 0
    with node(*_planner_words(folder)) as process:
        peer.wait(peer.goals.get_subscription_count, 120.0)
        peer.wait(lambda: False, 1.0)
        nothing = np.empty((0, 3))
        for number in range(count):
            for goal in (A, B):  # the second one is interrupted
                peer.see(nothing, number)
                peer.wait(lambda: False, 0.2)
                sent = len(peer.motions)
                peer.go_to(goal)
                if peer.wait(lambda sent=sent: len(peer.motions) > sent, 3.0) and goal is A:  # type: ignore[misc]
                    peer.wait(lambda: peer.ends_s < -0.1, 30.0)
            if len(peer.motions) == sent:
                raise RuntimeError(f"no motion {number}: {peer.events[-3:]}")
            peer.wait(lambda: False, 0.2)
            # Points about the tool's place later in the motion.
            _, motion = peer.motions[-1]
            q = np.array(motion.points[int(0.5 * len(motion.points))].positions)
            ball = robot.tool_positions(q[None])[0] + np.random.default_rng(number).normal(size=(200, 3)) * 0.01
            sent, kinds = len(peer.motions), len(peer.events)
            began = peer.see(ball, number)
            if peer.wait(lambda sent=sent: len(peer.motions) > sent, 2.0):  # type: ignore[misc]
                found.append(1e3 * (peer.motions[sent][0] - began))
                print(f"frame {number}: {found[-1]:.1f} ms", flush=True)
            peer.wait(lambda: False, 0.05)
            stops += any(event.get("kind") == "stop" for event in peer.events[kinds:])
            peer.see(nothing, number)
            peer.wait(lambda: peer.ends_s < -0.1, 30.0)
        print(f"memory of the node: {memory_mb(process):.0f} MB")
    peer.close()
    print(describe(f"frame of {CLOUD:,} points to the new motion", found))
    inside = [event["reaction_ms"] for event in peer.events if event.get("reaction_ms") is not None]
    print(describe("of which in the node", inside))
    print(f"{len(found)} of {count} frames led to a new motion, {stops} of these to a stop")
    return found


def soak(folder: Path, seconds: float) -> None:
    """Clouds at 10 Hz while the arm moves between two goals: messages lost, memory."""
    robot = hplan.load_robot("panda")
    peer = ControllerPeer(robot)
    with node(*_planner_words(folder)) as process:
        peer.wait(peer.goals.get_subscription_count, 120.0)
        peer.wait(lambda: False, 1.0)
        begin, number, goals, memory, asked_s = time.monotonic(), 0, 0, [memory_mb(process)], 0.0
        nothing = np.empty((0, 3))
        while time.monotonic() - begin < seconds:
            peer.see(nothing, number)
            number += 1
            if peer.ends_s < -0.2 and time.monotonic() > asked_s + 2.0:
                peer.go_to(B if goals % 2 == 0 else A)
                goals, asked_s = goals + 1, time.monotonic()
            peer.wait(lambda number=number: time.monotonic() - begin >= 0.1 * number, 1.0)  # type: ignore[misc]
            if number % 300 == 0:
                memory.append(memory_mb(process))
        peer.wait(lambda: False, 1.0)
        from diagnostic_msgs.msg import DiagnosticArray

        states: list[Any] = []
        peer.node.create_subscription(DiagnosticArray, "/diagnostics", states.append, 10)
        peer.wait(lambda: states, 5.0)
        counts = {each.key: each.value for each in states[-1].status[0].values}
    peer.close()
    seen = {name: sum(event["event"] == name for event in peer.events) for name in ("sent", "done", "not planned")}
    print(f"{seconds:g} s: {number} clouds sent, {counts.get('clouds', 0)} taken, "
          f"{counts.get('cloud refused', 0)} refused; {goals} goals, {seen}")  # fmt: skip
    print(f"events in the node {counts}, received here {len(peer.events)}; motions received {len(peer.motions)}")
    print(f"memory {', '.join(f'{each:.0f}' for each in memory)} MB")


def main(argv: Sequence[str] | None = None) -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description="Measure hplan's ROS nodes.")
    parser.add_argument("what", choices=("judge", "plan", "soak"))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--folder", type=Path, default=Path("/tmp"), help="for the scene files")
    given = parser.parse_args(argv)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("FASTDDS_DEFAULT_PROFILES_FILE", str(Path(__file__).parent / "ros" / "large_messages.xml"))
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.what == "soak":
        soak(given.folder, given.seconds)
    else:
        {"judge": measure_judge, "plan": measure_plan}[given.what](given.folder, given.count)


if __name__ == "__main__":
    main()
