from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from script_loader import load_script

from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.scene.orchard import FruitZone, MeasuredOptions, measured_orchard

TREE = (
    "kind,x1,y1,z1,x2,y2,z2,radius\ntrunk,0,0,0,0,0,2,0.02\n"
    "branch,0,0,1.5,-0.9,0,1.6,0.005\nbranch,0,0,1.8,0,-0.9,1.9,0.005\n"
)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("make_orchard")


@pytest.fixture
def make(script: ModuleType, tmp_path: Path) -> Callable[..., Scene]:
    """The scene that the command writes."""

    def make(*options: str) -> Scene:
        out = tmp_path / "out.yaml"
        assert script.main([*options, "--out", str(out)]) == 0
        return load_scene(out)

    return make


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    path = tmp_path / "tree.csv"
    path.write_text(TREE)
    return path


def test_measured_trees(make: Callable[..., Scene], tree: Path) -> None:
    assert make("--import", str(tree), "--fruits", "2") == measured_orchard(
        [tree], MeasuredOptions(fruits=2, name="out")
    )
    assert len(make("--import", str(tree)).fruits) == 20
    text = (
        "--fruits 6 --distance 1.6 --spacing 2 --height 0.3 --turn 40 --seed 3 --fruit-heights 1.8 3 --clearance 0.01"
    )
    assert make("--import", str(tree), str(tree), *text.split()) == measured_orchard(
        [tree, tree],
        MeasuredOptions(
            fruits=6,
            name="out",
            distance=1.6,
            spacing=2.0,
            height=0.3,
            yaw_deg=40.0,
            seed=3,
            fruit_zone=FruitZone(1.8, 3.0),
            clearance=0.01,
        ),
    )


def test_fruit_in_the_base_is_left_out(
    make: Callable[..., Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = tmp_path / "wide.csv"
    fruit = "".join(f"fruit,{x},0,{z},{x},0,{z},0.04\n" for x, z in ((-1.4, 0.3), (-0.4, 1.3), (-0.3, 1.6)))
    tree.write_text(TREE + fruit)
    whole = measured_orchard([tree], MeasuredOptions(name="out"))
    kept = make("--import", str(tree))
    assert whole.goal.fruit == whole.fruits[0].name
    assert kept.fruits == whole.fruits[1:]
    assert kept.goal.fruit == kept.fruits[0].name
    assert kept.obstacles == whole.obstacles
    assert f"removed, inside the pedestal or turret: {whole.fruits[0].name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--seed -1", "seed = -1"),
        ("--robot orchard", "robot file orchard: No such file or directory; robots that ship with hplan: harvester"),
        ("--fruits 1000", "for which there was room in the zone"),
        ("--shipped orchid", "--shipped = 'orchid': expected one of orchard-row"),
        ("--shipped tour --seed 0", "--seed = 0: expected no value together with --shipped"),
        ("--import TREE --trees 3", "--trees = 3: expected no value together with --import"),
        ("--import none.csv", "No such file"),
        ("--turn 3", "--turn = 3.0: expected no value without --import, as it is for measured trees"),
    ],
)
def test_bad_input(
    script: ModuleType, tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: str, message: str
) -> None:
    out = tmp_path / "out.yaml"
    words = [str(tree) if word == "TREE" else word for word in options.split()]
    assert script.main([*words, "--out", str(out)]) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert not out.exists()


def test_input_file_is_not_replaced(
    script: ModuleType, tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert script.main(["--import", str(tree), "--out", str(tree)]) == 2
    assert "a file other than the inputs" in capsys.readouterr().err
    assert tree.read_text() == TREE
    assert script.main(["--out", str(tmp_path / "no" / "scene.yaml")]) == 2
    assert "its folder does not exist" in capsys.readouterr().err
