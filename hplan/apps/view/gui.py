"""Graphical interface in a browser: joints, goal and obstacles are dragged, plans are made and played.

The interface uses viser (extra `viser`). What it shows and does is `hplan.apps.view.session.Session`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from threading import Event, RLock
from typing import Any

import numpy as np

from hplan.apps.view.live import LiveScene
from hplan.apps.view.session import Session, contact_words
from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal
from hplan.scene.obstacles import AnyObstacle

#: Entry of a list of names without a choice.
_NONE = "none"

#: Edge of the handles, as a fraction of the height of the tool above the base, at least [m].
_HANDLE, _SMALLEST_HANDLE = 0.2, 0.05


def _action(act: Callable[[Gui], None]) -> Callable[[Gui], None]:
    """Decorator of what a user starts: one after the other, and an error is shown."""

    @wraps(act)
    def run(gui: Gui) -> None:
        with gui.busy:
            try:
                act(gui)
            except HplanError as error:
                gui.update(f"**{error.message}**")

    return run


class Gui(LiveScene):
    """A live view whose arm, goal and obstacles are moved in the browser.

    Attributes:
        session: What is shown.
        status: The sentence about clearance and the last action.
        busy: Held during an action; others wait.
    """

    def __init__(self, session: Session, *, port: int = 8080, out: Path | str = "scene.yaml") -> None:
        """Start the server.

        Args:
            session: The arm among obstacles.
            port: Port of the server; the next free one if it is in use.
            out: Suggested scene file.

        Raises:
            InputError: viser is not installed.
        """
        super().__init__(session.robot, session.scene, port=port)
        self.session, self.status = session, ""
        self.busy, self._closed = RLock(), Event()
        gui = self.server.gui
        self._text = gui.add_markdown("")
        with gui.add_folder("Joints"):
            self._sliders = [self._add_slider(joint) for joint in range(session.robot.dof)]
        with gui.add_folder("Task"):
            fruits = [_NONE, *(fruit.name for fruit in session.scene.fruits)]
            self._fruit = gui.add_dropdown("goal fruit", fruits, initial_value=session.scene.goal.fruit or _NONE)
            self._fruit.on_update(lambda _: self._aim_at_fruit())
            names = [_NONE, *(item.name for item in (*session.scene.obstacles, *session.scene.fruits))]
            self._item = gui.add_dropdown("move", names)
            self._item.on_update(lambda _: self._choose_item())
            gui.add_button("Plan").on_click(lambda _: self.plan())
            gui.add_button("Play").on_click(lambda _: self.play_result())
        with gui.add_folder("Save", expand_by_default=False):
            self._path = gui.add_text("file", str(out))
            self._replaces = gui.add_checkbox("replace an existing file", initial_value=False)
            gui.add_button("Save scene").on_click(lambda _: self.save())
        self._size = max(_SMALLEST_HANDLE, _HANDLE * float(np.linalg.norm(self._tool())))
        fruit = session.scene.goal_fruit
        place = session.scene.goal.position or (self._tool() if fruit is None else fruit.center)
        self._goal = self.server.scene.add_transform_controls(
            "/goal", scale=self._size, disable_rotations=True, position=np.asarray(place)
        )
        self._goal.on_update(lambda _: self._drag_goal())
        self._handle: Any = None
        self.update("Drag the goal or an obstacle, or move the joints.")

    def wait(self) -> None:
        """Return when the interface is closed."""
        self._closed.wait()

    def close(self) -> None:
        """Stop the server."""
        self._closed.set()
        super().close()

    @_action
    def plan(self) -> None:
        """Plan from the present configuration to the goal; the status says how it ended."""
        result = self.session.plan()
        verdict = "certified" if result.certificate.verified else "not certified"
        self.update(f"Motion of {result.trajectory.duration:.2f} s, {verdict}.")

    @_action
    def play_result(self) -> None:
        """Play the last plan."""
        if self.session.result is None:
            self.update("There is no plan yet.")
            return
        self.play(self.session.result)
        self.session.set_joints(self.session.result.trajectory.position[-1])
        self._set_sliders()
        self.update("Played.")

    @_action
    def save(self) -> None:
        """Save the scene under the name in the text field."""
        self.update(f"Saved: {self.session.save(self._path.value, replaces=self._replaces.value)}.")

    def _add_slider(self, joint: int) -> Any:
        robot, unit = self.session.robot, self.session.robot.units[joint]
        low, high, value = (unit.factor * float(values[joint]) for values in (robot.lower, robot.upper, self.session.q))
        slider = self.server.gui.add_slider(
            f"{robot.joint_names[joint]} [{unit.shown}]", min=low, max=high, step=(high - low) / 1000.0,
            initial_value=min(max(value, low), high),
        )  # fmt: skip
        slider.on_update(lambda _: self._move_joints())
        return slider

    def _set_sliders(self) -> None:
        for joint, slider in enumerate(self._sliders):
            slider.value = self.session.robot.units[joint].factor * float(self.session.q[joint])

    @_action
    def _move_joints(self) -> None:
        units = self.session.robot.units
        self.session.set_joints([slider.value / unit.factor for slider, unit in zip(self._sliders, units, strict=True)])
        self.update()

    @_action
    def _aim_at_fruit(self) -> None:
        if self._fruit.value != _NONE:
            self.session.aim(Goal(fruit=self._fruit.value))
            item = self.session.item(self._fruit.value)
            self._goal.position = np.array(item.center) if isinstance(item, Fruit) else self._goal.position
            self.update(f"Goal: {self._fruit.value}.")

    @_action
    def _drag_goal(self) -> None:
        x, y, z = map(float, self._goal.position)
        self.session.aim(Goal(position=(x, y, z)))
        self._fruit.value = _NONE
        self.update()

    def _choose_item(self) -> None:
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        name = self._item.value
        if name == _NONE:
            return
        self._last = _middle(self.session.item(name))
        self._handle = self.server.scene.add_transform_controls(
            "/handle", scale=self._size, disable_rotations=True, position=self._last
        )
        self._handle.on_update(lambda _: self._drag_item())

    @_action
    def _drag_item(self) -> None:
        name, place = self._item.value, np.array(self._handle.position, dtype=np.float64)
        self.session.shift(name, place - self._last)
        self._last = place
        self.draw_item(self.session.item(name))
        self.update()

    def _tool(self) -> FloatArray:
        return np.asarray(self.session.robot.tool_positions(self.session.q))

    def update(self, words: str = "") -> None:
        """Show the configuration, its clearance and a sentence."""
        contact = self.session.nearest_contact()
        self.show(self.session.q)
        self.status = " ".join(filter(None, (contact_words(contact), words)))
        self._text.content = self.status


def _middle(item: AnyObstacle | Fruit) -> FloatArray:
    """(3,) middle of an item's points [m]."""
    if isinstance(item, Fruit):
        return np.array(item.center)
    points = np.concatenate([solid.core for solid in item.solids])
    middle: FloatArray = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return middle
