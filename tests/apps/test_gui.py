"""The interactive session, and the interface that shows it."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hplan import load_robot, load_scene
from hplan.apps.view.session import Session, contact_words
from hplan.errors import HplanError, InputError, OutputError, TiltedError
from hplan.scene import Attached, Goal, Sphere, Start, Upright


@pytest.fixture
def session() -> Session:
    return Session(load_robot(), load_scene("orchard-row"))


def test_moved_obstacle_is_met_where_it_is(session: Session) -> None:
    name, tool = session.scene.obstacles[0].name, session.robot.tool_positions(session.q)
    start = np.array(session.item(name).start)
    assert session.nearest_contact().distance_m > 0.0
    assert "is clear of" in contact_words(session.nearest_contact())
    session.shift(name, tool - start)
    contact = session.nearest_contact()
    assert (contact.obstacle, contact.distance_m < 0.0) == (name, True)
    assert contact_words(contact).startswith("CONTACT: link")
    session.shift(name, start - tool)
    assert session.nearest_contact().distance_m > 0.0
    with pytest.raises(InputError, match="did you mean"):
        session.shift(name[:-1] + "x", [0, 0, 0])


def test_joints_are_clipped_and_planned_from(session: Session) -> None:
    session.set_joints(session.q + np.array([0.3, 9.0, 0.0, 0.0]))
    assert session.q[1] == session.robot.upper[1]
    session.aim(Goal(fruit=session.scene.fruits[0].name))
    result = session.plan()
    assert result.certificate.verified
    np.testing.assert_allclose(result.trajectory.position[0], session.q)
    session.shift(session.scene.obstacles[0].name, [0.0, 0.0, 0.01])
    assert session.result is None  # it was for another scene


def test_saved_scene_begins_where_the_arm_is(session: Session, tmp_path) -> None:
    session.set_joints(session.q + np.array([0.3, 0.0, 0.0, 0.0]))
    path = session.save(tmp_path / "mine.yaml")
    np.testing.assert_allclose(load_scene(path).start.configuration, session.q)
    with pytest.raises(OutputError, match="it exists"):
        session.save(path)
    assert session.save(path, replaces=True) == path


def test_updates_while_dragging_are_quick(session: Session) -> None:
    """The slowest of 20 drags of an obstacle among 300 takes less than a second even on a loaded machine."""
    took = []
    for _ in range(20):
        begin = time.process_time()
        session.shift(session.scene.obstacles[5].name, [0.001, 0.0, 0.0])
        session.nearest_contact()
        took.append(time.process_time() - begin)
    assert max(took) < 1.0


def test_interface_does_what_its_widgets_say(session: Session, tmp_path) -> None:
    pytest.importorskip("viser", reason="the extra `viser` is not installed")
    from hplan.apps.view.gui import Gui

    with Gui(session, port=0, out=tmp_path / "scene.yaml") as gui:
        assert "is clear of" in gui.status
        gui._sliders[0].value = 20.0
        gui._move_joints()
        assert session.q[0] == pytest.approx(np.radians(20.0))
        gui.plan()
        assert "certified" in gui.status
        gui.play(session.result, speed=50.0)
        name = session.scene.obstacles[0].name
        gui._item.value = name
        gui._choose_item()
        gui._handle.position = session.robot.tool_positions(session.q)
        gui._drag_item()
        assert gui.status.startswith("CONTACT")
        gui.plan()
        assert "**" in gui.status  # the error: the start is in contact
        gui.save()
        gui.save()
        assert "it exists" in gui.status
    assert load_scene(tmp_path / "scene.yaml").obstacles[0].name == name


def test_options_have_types() -> None:
    with pytest.raises(HplanError):
        Session(load_scene(), load_robot())


def test_held_object_and_upright_axis_count_from_everywhere() -> None:
    held = Attached(object=Sphere(name="melon", center=(0.0, 0.0, 0.0), radius=0.5))
    start = Start(joints_deg=(0.0, 20.0, 40.0, 30.0))
    scene = load_scene().with_values(start=start, locked_joints=(), upright=Upright(max_tilt_deg=8.0))
    assert Session(load_robot(), scene.with_values(attached=(held,))).nearest_contact().link == "melon"
    session = Session(load_robot(), scene)
    session.set_joints(np.radians([0.0, 20.0, 40.0, 50.0]))
    with pytest.raises(TiltedError, match="start"):
        session.plan()
