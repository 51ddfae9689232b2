"""Scene files: contents, refusals, maximum size."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan import plan
from hplan.base import yaml_text
from hplan.certificate.digests import scene_digest
from hplan.errors import OutputError, SceneError
from hplan.scene import file as scene_file
from hplan.scene.file import dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.limits import FARTHEST_M, MOST_OBSTACLES
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, PointCloud, Sphere

HEAD = """\
format: hplan-scene/1
name: a scene
start: {joints_deg: [0, 0, 0, 0]}
goal: {joints_deg: [0, 45, 60, 70]}
"""
BALL = "  - {name: ball, kind: sphere, center: [1, 0, 1.9], radius: 0.15}\n"


# Good files


def test_robot_of_a_scene(tmp_path):
    scene = parse_scene(HEAD.replace("start", "robot: orchard_harvester\nstart", 1))
    assert scene.robot == "orchard_harvester"
    assert dump_scene(scene).splitlines()[1:3] == ["name: a scene", "robot: orchard_harvester"]
    assert load_scene(save_scene(scene, tmp_path / "scene.yaml")) == scene
    assert scene.with_obstacles([]).robot == scene.robot
    none = parse_scene(HEAD)
    assert none.robot is None
    assert "robot" not in dump_scene(none)
    assert scene_digest(none) == scene_digest(scene)  # the robot has a digest of its own
    with pytest.raises(SceneError, match=r"hplan has no robot with this name; there are harvester, orchard") as error:
        parse_scene(HEAD.replace("start", "robot: orchard_arm\nstart", 1))
    assert (error.value.where, error.value.line) == ("robot", 3)


def test_every_key():
    scene = parse_scene("""\
# a comment
format: hplan-scene/1
name: everything
start: {joints_rad: [0, 0.5, 1, 1.5]}
goal: {fruit: f1}
locked_joints: [base_yaw]
clearance: 0.01
obstacles:
  - {name: ball, kind: sphere, center: [1.0, 0.0, 1.9], radius: 0.15}
  - {name: branch, kind: capsule, from: [0, 0, 0], to: [0, 0, 1], radius: 0.02}
  - {name: can, kind: cylinder, center: [0, 1, 2], length: 0.14, radius: 0.03, rpy_deg: [0, 90, 0]}
  - name: post
    kind: box
    center: [0, 0, 1]
    size: [0.1, 0.1, 2]
    rpy_deg: [0, 0, 30]
fruits:
  - {name: f1, center: [1.2, 0.3, 1.4], radius: 0.04}
""")
    assert scene == Scene(
        name="everything",
        start=Start(joints_rad=(0.0, 0.5, 1.0, 1.5)),
        goal=Goal(fruit="f1"),
        locked_joints=("base_yaw",),
        clearance=0.01,
        obstacles=(
            Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15),
            Capsule(name="branch", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=0.02),
            Cylinder(name="can", center=(0.0, 1.0, 2.0), length=0.14, radius=0.03, rpy_deg=(0.0, 90.0, 0.0)),
            Box(name="post", center=(0.0, 0.0, 1.0), size=(0.1, 0.1, 2.0), rpy_deg=(0.0, 0.0, 30.0)),
        ),
        fruits=(Fruit(name="f1", center=(1.2, 0.3, 1.4), radius=0.04),),
    )


def test_json_is_yaml():
    content = {
        "format": "hplan-scene/1",
        "name": 'from JSON \u00e4 \U0001f34e a/b "quoted"',
        "start": {"joints_deg": [0, 0, 0, 0]},
        "goal": {"position": [1.0, 0.0, 1e0]},
        "obstacles": [{"name": "b", "kind": "sphere", "center": [1, 0, 2], "radius": 1e-2}],
    }
    for text in (json.dumps(content), json.dumps(content, indent="\t", ensure_ascii=False)):
        scene = parse_scene(text)
        assert scene.name == content["name"]
        assert scene.obstacles[0].radius == 0.01


@pytest.mark.parametrize(("text", "value"), [("1e-2", 0.01), ("+1.5e1", 15.0), (".5", 0.5), ("010", 10.0)])
def test_numbers_are_read_as_json_and_yaml_1_2_do(text, value):
    assert parse_scene(f"{HEAD}clearance: {text}\n").clearance == value


@pytest.mark.parametrize("name", ["no", "on", "2026-01-31", "1:30", "0x1F", "1_000", "a b", "=", "<<"])
def test_other_words_are_text(name):
    assert parse_scene(HEAD.replace("a scene", name)).name == name


# Round trip


names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
odd_names = st.sampled_from(
    ["1e5", "1.5e3", "08", "no", "null", "~", "2026-01-31", "a: b", "#", "- a", "'", '"', " a ", "\n", "a\x85b"]
)
numbers = st.floats(-FARTHEST_M, FARTHEST_M)
lengths = st.floats(1e-12, FARTHEST_M)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def scenes(draw):
    labels = draw(st.lists(names | odd_names, min_size=5, max_size=5, unique=True))
    joints = st.lists(numbers, max_size=5).map(tuple)
    return Scene(
        name=labels[0],
        start=draw(st.builds(Start, joints_deg=joints) | st.builds(Start, joints_rad=joints)),
        goal=draw(
            st.builds(Goal, joints_deg=joints) | st.builds(Goal, position=vectors) | st.just(Goal(fruit=labels[4]))
        ),
        locked_joints=draw(st.lists(names | odd_names, max_size=3).map(tuple)),
        clearance=draw(st.floats(0.0, FARTHEST_M)),
        obstacles=draw(
            st.tuples(
                st.builds(Sphere, name=st.just(labels[1]), center=vectors, radius=lengths),
                st.builds(
                    lambda start, end, radius: Capsule(name=labels[2], start=start, end=end, radius=radius),
                    *(vectors, vectors, lengths),
                ),
                st.builds(
                    Box,
                    name=st.just(labels[3]),
                    center=vectors,
                    size=st.tuples(lengths, lengths, lengths),
                    rpy_deg=vectors,
                ),
            )
        ),
        fruits=(draw(st.builds(Fruit, name=st.just(labels[4]), center=vectors, radius=lengths)),),
    )


@settings(max_examples=150)
@given(scenes())
def test_round_trip(scene):
    assert parse_scene(dump_scene(scene)) == scene


def test_save_and_load(scene, tmp_path):
    assert load_scene(save_scene(scene, tmp_path / "scene.yaml")) == scene
    with pytest.raises(OutputError, match="No such file"):
        save_scene(scene, tmp_path / "nowhere" / "scene.yaml")


# Bad content: each names the key and its line


def obstacle(text: str) -> str:
    return f"obstacles:\n{BALL}  - {{{text}}}\n"


BAD_CONTENT = {
    "unknown key": ("colour: red\n", 5, "colour", "unknown key; there are format, name, robot, start"),
    "unknown key of an obstacle": (
        obstacle("name: b, kind: sphere, centre: [0, 0, 0], radius: 1"),
        7,
        "obstacles[1].centre",
        "unknown key",
    ),
    "NaN": ("clearance: .nan\n", 5, "clearance", "finite number (got nan)"),
    "a coordinate of 1e308": (
        obstacle("name: b, kind: sphere, center: [0, -1e308, 0], radius: 1"),
        7,
        "obstacles[1].center[1]",
        "greater than or equal to -10000 (got -1e+308)",
    ),
    "text for a number": ("clearance: wide\n", 5, "clearance", "valid number (got 'wide')"),
    "text for a list": ("locked_joints: base_yaw\n", 5, "locked_joints", "should be a list (got 'base_yaw')"),
    "number for a name": ("locked_joints:\n  - base_yaw\n  - 3\n", 7, "locked_joints[1]", "should be text (got 3)"),
    "negative radius": (
        obstacle("name: b, kind: sphere, center: [0, 0, 0], radius: -1"),
        7,
        "obstacles[1].radius",
        "than 0 (got -1)",
    ),
    "too few values": (
        obstacle("name: b, kind: sphere, center: [0, 0], radius: 1"),
        7,
        "obstacles[1].center",
        "too few values",
    ),
    "one bad value": (
        "obstacles:\n  - name: b\n    kind: box\n    size: [1, 1, 1]\n    center:\n      - 0\n      - x\n      - 0\n",
        11,
        "obstacles[0].center[1]",
        "valid number (got 'x')",
    ),
    "missing key": (
        obstacle("name: b, kind: capsule, from: [0, 0, 0], radius: 1"),
        7,
        "obstacles[1].to",
        "this key is missing",
    ),
    "unknown kind": (
        obstacle("name: b, kind: cone"),
        7,
        "obstacles[1].kind",
        "kind is 'cone', expected one of 'sphere', 'capsule', 'cylinder', 'box'",
    ),
    "same name twice": (
        obstacle("name: ball, kind: sphere, center: [0, 0, 0], radius: 1"),
        7,
        "obstacles[1].name",
        "two obstacles are called 'ball'; names must differ",
    ),
    "fruit with an obstacle's name": (
        f"obstacles:\n{BALL}fruits:\n  - center: [0, 0, 0]\n    radius: 1\n    name: ball\n",
        10,
        "fruits[0].name",
        "two obstacles are called 'ball'",
    ),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", BAD_CONTENT)
def test_bad_content(case):
    text, line, where, message = BAD_CONTENT[case]
    with pytest.raises(SceneError) as caught:
        parse_scene(HEAD + text, path="my.yaml")
    error = caught.value
    assert message in error.reason
    assert (error.where, error.line) == (where, line)
    assert error.message == f"scene file my.yaml, line {line}, {where}: {error.reason}"
    assert len(error.message) < 200
    json.dumps(error.as_dict(), allow_nan=False)


# Text that is no scene at all


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "expected a mapping"),
        ("just text", None, "expected a mapping"),
        (f"{HEAD}name: again\n", 5, "key 'name' is already on line 2"),
        (f"{HEAD}obstacles:\n  - {{name: a, name: b}}\n", 6, "key 'name' is already on line 6"),
        (f"{HEAD}obstacles: [1, 2\n", 6, "malformed YAML"),
        (f"{HEAD}---\n{HEAD}", 5, "but found another document"),
        (f"{HEAD}[1, 2]: key\n", 5, "a key must be text"),
        (f"{HEAD}x: !!python/object/apply:os.system ['true']\n", 5, "python/object/apply:os.system' is not allowed"),
        (f"{HEAD}x: !!int abc\n", 5, "'abc' cannot be read as int"),
        (f"{HEAD}x: {'1' * 5000}\n", 5, "cannot be read as int"),
        (f"{HEAD}x: &a [*a]\n", 5, "alias *a is inside the value that it repeats"),
        (f"{HEAD}x: *b\n", 5, "undefined alias 'b'"),
        (f"{HEAD}x: {'[' * 5000}\n", None, "nested too deeply"),
        (f'{HEAD}x: "\\ud83c"\n', 5, "half of a character"),
        (f"{HEAD}x: \x01\n", None, "is not allowed in YAML"),
    ],
)
def test_text_that_is_not_a_scene(text, line, message):
    with pytest.raises(SceneError) as caught:
        parse_scene(text, path="my.yaml")
    assert message in caught.value.reason
    assert caught.value.line == line
    assert caught.value.message.startswith("scene file my.yaml")
    assert caught.value.exit_status == 2


@settings(max_examples=300)
@given(st.text(st.sampled_from("{}[]:,-?&*!|>'\"%@`#~.0123456789eEabnul \n\t<="), max_size=40))
def test_no_text_raises_anything_else(text):
    for whole in (text, HEAD + text, f"{HEAD}obstacles: {text}"):
        with contextlib.suppress(SceneError):
            parse_scene(whole)


def test_files_that_cannot_be_read(tmp_path: Path):
    with pytest.raises(SceneError, match=r"nowhere\.yaml: No such file or directory"):
        load_scene(tmp_path / "nowhere.yaml")
    with pytest.raises(SceneError, match="Is a directory"):
        load_scene(tmp_path)
    (tmp_path / "scene.yaml").write_bytes(HEAD.encode("utf-16"))
    with pytest.raises(SceneError, match="not UTF-8"):
        load_scene(tmp_path / "scene.yaml")


def test_anchors_and_merge_keys(write) -> None:
    text = """format: hplan-scene/1
name: wires
start: &home {joints_deg: [0, 90, 90, 90]}
goal: {joints_deg: [0, 0, 0, 0]}
obstacles:
  - &wire {name: low, kind: capsule, from: [3, -2, 1.0], to: [3, 2, 1.0], radius: 0.005}
  - {<<: *wire, name: high, from: [3, -2, 1.5], to: [3, 2, 1.5]}
"""
    scene = load_scene(write("scene.yaml", text))
    low, high = scene.obstacles
    assert (low.radius, high.radius) == (0.005, 0.005)
    assert (low.name, high.name, high.end[2], low.end[2]) == ("low", "high", 1.5, 1.0)


def test_aliases_count_their_repetitions(write) -> None:
    """A few lines that represent 9^7 values."""
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 8)]
    with pytest.raises(SceneError, match="more than 500,000 values"):
        load_scene(write("scene.yaml", "\n".join(lines)))


def ball(index: int) -> Sphere:
    return Sphere(name=f"b{index}", center=(2.0, 0.0, 1.0), radius=0.01)


def test_scene_has_a_largest_number_of_obstacles():
    balls = tuple(ball(i) for i in range(MOST_OBSTACLES + 1))
    start, goal = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0,) * 4)
    Scene(name="a", start=start, goal=goal, obstacles=balls[1:])
    with pytest.raises(ValueError, match="at most 20000 items"):
        Scene(name="a", start=start, goal=goal, obstacles=balls)
    fruits = tuple(Fruit(name=f"f{i}", center=(0.0, 0.0, 9.0), radius=0.1) for i in range(MOST_OBSTACLES + 1))
    with pytest.raises(ValueError, match="at most 20000 items"):
        Scene(name="a", start=start, goal=goal, fruits=fruits)


def test_yaml_file_has_a_largest_number_of_values(monkeypatch):
    monkeypatch.setattr(yaml_text, "MOST_VALUES", 21)
    assert parse_scene(HEAD).name == "a scene"
    with pytest.raises(SceneError, match="line 5: malformed YAML: more than 21 values"):
        parse_scene(f"{HEAD}obstacles: [1, 2, 3]\n")


def cube() -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return vertices, np.array(faces)


def test_files_of_a_scene_have_a_largest_size_together(tmp_path, monkeypatch):
    start, goal = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0,) * 4)
    meshes = tuple(Mesh.from_arrays(f"m{i}", *cube(), position=(2.0 * i, 5.0, 0.0)) for i in range(2))
    cloud = PointCloud.from_points("cloud", [[9.0, 9.0, 9.0]], 0.1)
    path = save_scene(Scene(name="a", start=start, goal=goal, obstacles=(*meshes, cloud)), tmp_path / "scene.yaml")
    sizes = [file.stat().st_size for file in sorted(tmp_path.glob("*.ply"))]
    monkeypatch.setattr(scene_file, "MOST_SHAPE_BYTES", sum(sizes))
    assert len(load_scene(path).obstacles) == 3
    monkeypatch.setattr(scene_file, "MOST_SHAPE_BYTES", sum(sizes) - 1)
    with pytest.raises(SceneError, match=r"obstacles\[2\]\.file: .*and the files before it") as caught:
        load_scene(path)
    assert caught.value.line is not None


@pytest.mark.filterwarnings("error")
def test_shapes_do_not_reach_farther_than_a_scene():
    vertices, faces = cube()
    millimetres = Mesh.from_arrays("m", 1e6 * vertices, faces, scale=1e-3)
    assert millimetres.surface[0].max() == pytest.approx(1e3)
    for shift, scale in ((2e7, 1e-3), (1e306, 1e-303), (1.0, 1e308)):
        with pytest.raises(SceneError, match=r"coordinates|across"):
            Mesh.from_arrays("m", vertices + shift, faces, scale=scale)
    with pytest.raises(SceneError, match=r"points have coordinates of 1.1e\+04; expected metres, at most 10000"):
        PointCloud.from_points("c", [[0.0, 0.0, 1.1e4]], 0.1)
    with pytest.raises(SceneError, match="less than or equal to 10000"):
        PointCloud.from_points("c", [[0.0, 0.0, 0.0]], 1e308)
    with pytest.raises(SceneError, match="less than or equal to 10000"):
        Mesh.from_arrays("m", vertices, faces, position=(0.0, 1e200, 0.0))


@pytest.mark.filterwarnings("error")
def test_obstacles_at_the_limit_are_planned_among(robot):
    far = Sphere(name="far", center=(FARTHEST_M, -FARTHEST_M, FARTHEST_M), radius=1.0)
    long = Capsule(name="long", start=(-FARTHEST_M, 5.0, 0.0), end=(FARTHEST_M, 5.0, 0.0), radius=1.0)
    scene = parse_scene(HEAD).with_obstacles([far, long])
    assert plan(robot, scene).certificate.verified


def test_ten_thousand_obstacles_are_planned_among(robot):
    """Before several geometry models, 4,000 did not finish in a minute."""
    rng = np.random.default_rng(0)
    places = rng.uniform([-2.5, -2.5, 0.3], [2.5, -0.25, 3.0], (10_000, 3)).tolist()
    balls = [Sphere(name=f"b{i}", center=tuple(place), radius=0.01) for i, place in enumerate(places)]
    scene = parse_scene(HEAD.replace("[0, 0, 0, 0]", "[60, 10, 20, 20]").replace("[0, 45", "[20, 45"))
    scene = scene.with_obstacles(balls)
    result = plan(robot, scene)
    assert result.certificate.verified
