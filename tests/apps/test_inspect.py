"""`hplan inspect`: all faults of a robot file at once, a template for limits, a mended copy, a picture."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from toy_urdf import six_axis_arm, six_axis_picker

from hplan.apps.cli.main import main
from hplan.robot.inspection import inspect_robot
from hplan.robot.model import load_robot

ARM = six_axis_arm()
#: No velocity, no effort, no acceleration, a decimal comma, a misspelled element, another tool frame.
FAULTY = (
    ARM.replace('velocity="3" effort="150"', 'velocity="0" effort="0"', 1)
    .replace('<mass value="2"/>', '<mass value="2,5"/>', 1)
    .replace('xyz="0 0 0.21"', 'xzy="0 0 0.21"', 1)
    .replace('"tool0"', '"tip"')
)


def run(*arguments: object) -> int:
    return main(["inspect", *map(str, arguments)])


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def test_from_a_faulty_file_to_an_arm_that_loads(tmp_path, capsys):
    path = write(tmp_path, FAULTY)
    assert run(path, "--repair", tmp_path / "mended.urdf", "--write-limits", tmp_path / "mended.limits.yaml") == 2
    shown = " ".join(capsys.readouterr().out.split())
    assert "4 faults" in shown
    for part in (
        "velocity of <limit> is '0'", "effort of <limit> is '0'", "value of <mass> is '2,5'", "'2.5'",
        "xzy of <origin> has no meaning", "is called xyz now",
        f"written: {tmp_path}/mended.urdf",
    ):  # fmt: skip
        assert part in shown, part
    template = (tmp_path / "mended.limits.yaml").read_text()
    assert "velocity_rad_s:\n  shoulder_pan: 1  # guess: the URDF has no positive velocity\n" in template
    assert "  shoulder_lift: 6  # guess: full speed in 0.5 s\n" in template
    assert run(tmp_path / "mended.urdf") == 0
    shown = capsys.readouterr().out
    assert "'tip' is taken" in shown
    assert re.search(r"shoulder_pan +revolute +rad +-3 +3 +1 +2 +\d", shown)
    with pytest.warns(UserWarning, match="'tip' is taken"):
        robot = load_robot(tmp_path / "mended.urdf")
    assert robot.velocity_limit.tolist() == [1.0, 3.0, 3.0, 3.0, 3.0, 3.0]
    # Twice what five links of 2 kg weigh at the ends of the links below, less than 0.09 + 0.2 + 0.5 m up to 1.4 m away.
    assert 150.0 < robot.torque_limit[0] < 2 * 5 * 2.5 * 9.81 * 1.5
    assert load_robot(ARM, limits=tmp_path / "mended.limits.yaml").dof == 6


def test_what_is_there_is_not_overwritten(tmp_path, capsys):
    path, out = write(tmp_path, ARM), tmp_path / "limits.yaml"
    out.write_text("mine\n")
    assert run(path, "--write-limits", out) == 2
    assert out.read_text() == "mine\n"
    assert run(path, "--write-limits", path) == 2
    assert run(path, "--write-limits", out, "--force") == 0
    assert "it has no acceleration limits; 2 /s times" in " ".join(capsys.readouterr().out.split())
    assert load_robot(path, limits=out).acceleration_limit.tolist() == [6.0] * 6


def test_touching_links_and_links_without_shapes(tmp_path):
    found = inspect_robot(write(tmp_path, six_axis_picker().replace('radius="0.07"', 'radius="0.2"')))
    assert not found.faults
    assert "it has no acceleration limits" in " ".join(found.warnings)
    pairs = {(pair.first, pair.second): pair for pair in found.touching}
    pan_and_lift = pairs["shoulder_pan_link", "shoulder_lift_link"]
    assert (pan_and_lift.at, pan_and_lift.are_neighbours) == ("zero and middle", True)
    assert ("base_link", "wrist_3_link") not in pairs
    assert found.tool_frames == ("tool0",)
    bare = inspect_robot(write(tmp_path, ARM.replace("<collision>", "<drawn>").replace("</collision>", "</drawn>")))
    assert bare.without_shape[:2] == ("shoulder_pan_link", "shoulder_lift_link")


def test_a_picture(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("matplotlib")
    assert run(write(tmp_path, ARM), "--picture", tmp_path / "arm.png", "--quiet") == 0
    with image.open(tmp_path / "arm.png") as picture:
        colours = picture.convert("RGB").getcolors(1 << 24)
    assert len(colours) > 20  # shaded bodies, not an empty page


def test_a_file_that_is_none(tmp_path, capsys):
    assert run(tmp_path / "nothing.urdf") == 2
    assert "No such file" in capsys.readouterr().err
    assert run(write(tmp_path, "<sdf/>")) == 2
    assert "the root element is <sdf>" in capsys.readouterr().err
