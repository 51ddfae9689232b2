"""Definition of a study: arms, trees, base positions, compliance; its YAML file."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from hplan.base.arguments import file_path
from hplan.base.checked import StrictModel, fault
from hplan.certificate.digests import robot_digest
from hplan.errors import HplanError, OptionError, StudyError
from hplan.robot.family.members import load_member
from hplan.robot.family.spec import HARVESTER, ORCHARD_HARVESTER, ArmSpec
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import read_model
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Name
from hplan.scene.orchard import TUCKED_DEG, MeasuredOptions, measured_orchard
from hplan.scene.robot_source import RobotSource

#: Measurement of a design: pickable fruit at one stop; a tour at one stop; tours at stops along the tree row.
Measure = Literal["reach", "tour", "row"]

#: Arms with a specification that can be varied.
_SPECS: Final = {spec.name: spec for spec in (HARVESTER, ORCHARD_HARVESTER)}


class _StudyPart(StrictModel):
    """Base of a study's models; their errors are `StudyError`."""

    error: ClassVar[type[StudyError]] = StudyError


class Arm(_StudyPart):
    """An arm, or a family of arms with varied specification values.

    Attributes:
        robot: Robot name or URDF for `load_robot`, or its file with options (`RobotSource`), relative to the study's
            folder.
        name: Name in the results; None for the robot's name.
        vary: Fields of `ArmSpec` with their values, in all combinations; only for `harvester`, `orchard_harvester` or a
            given `spec`. `lower_deg` and `upper_deg` set `lower` and `upper`.
        spec: A specification in place of the robot; None to use `robot`.
        start_deg: Start configuration [deg]; None for the tucked harvester, or for an arm of other joints a free one
            that is found beside the trees.
    """

    robot: Name | RobotSource = "orchard_harvester"
    name: Name | None = None
    vary: dict[str, tuple[Any, ...]] = Field(default_factory=dict)
    spec: ArmSpec | None = None
    start_deg: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _is_an_arm(self) -> Self:
        if self.vary and self.spec is None and not (isinstance(self.robot, str) and self.robot in _SPECS):
            raise fault(f"only {' and '.join(_SPECS)} can be varied; write an ArmSpec for others", "vary")
        for key, values in self.vary.items():
            if not values:
                raise fault("the list of values is empty", "vary", key)
        try:
            for _, robot in self.members():
                loaded = _robot(robot)
                if self.start_deg is not None:
                    loaded.check_configuration([math.radians(value) for value in self.start_deg], "start_deg")
        except (HplanError, TypeError) as error:
            raise fault(str(error)) from error
        return self

    def members(self) -> Iterator[tuple[str, str | RobotSource | ArmSpec]]:
        """Iterate over the arms: name, and specification or `load_robot` argument.

        Raises:
            OptionError: `ArmSpec` refuses a value.
            TypeError: A key is not a field of `ArmSpec`.
        """
        given = self.robot if isinstance(self.robot, str) else Path(self.robot.urdf).name.partition(".")[0]
        base = _SPECS.get(given) if self.spec is None and given == self.robot else self.spec
        called = self.name or (given if self.spec is None else self.spec.name)
        if base is None or not (self.vary or self.spec):
            yield called, self.robot
            return
        for values in itertools.product(*self.vary.values()):
            chosen = dict(zip(self.vary, values, strict=True))
            words = [f"{key} {_words(value)}" for key, value in chosen.items() if len(self.vary[key]) > 1]
            for key in ("lower", "upper"):
                if f"{key}_deg" in chosen:
                    chosen[key] = [math.radians(value) for value in chosen.pop(f"{key}_deg")]
            yield ", ".join([called, *words]), replace(base, **chosen)


class Yields(_StudyPart):
    """Compliance: maximum deflection of thin wood and of fruit [m].

    Attributes:
        wood: Maximum deflection of thin wood [m].
        below: Radius below which wood is thin [m].
        fruit: Maximum deflection of fruit [m].
    """

    wood: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    below: Annotated[float, Field(ge=0.0, le=10.0)] = 0.008
    fruit: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0


class Study(_StudyPart):
    """A study: all combinations of arm, trees, base position and compliance.

    Attributes:
        name: Name of the study.
        arms: The arms; a string is the name of a robot, and an `ArmSpec` is an arm as well.
        trees: Files of measured trees (`hplan.scene.orchard.import_tree`), or lists of files that form one tree row. In
            a study file they are relative to its folder, and may contain `*`.
        measure: The measurement.
        distances: Distances of the base's axis from the tree row [m].
        heights: Heights of the base above the trees' feet, for example of a lift or a mast [m].
        turns_deg: Rotations of the trees [deg]; 0 and 180 are both sides of a tree.
        yields: Compliance of wood and fruit.
        spacing: Distance of neighbouring trunks in a row [m].
        effort: Effort preset for the motions of a tour.

    Examples:
        >>> from hplan import Study
        >>> study = Study(name="reach", arms=["harvester"], trees=["apple.csv"], distances=(1.2, 1.4))
        >>> [(design.arm, design.distance) for design in study.designs()]
        [('harvester', 1.2), ('harvester', 1.4)]
    """

    format: Literal["hplan-study/1"] = "hplan-study/1"
    name: Name
    arms: Annotated[tuple[Arm, ...], Field(min_length=1)]
    trees: Annotated[tuple[tuple[Path, ...], ...], Field(min_length=1)]
    measure: Measure = "reach"
    distances: Annotated[tuple[float, ...], Field(min_length=1)] = (1.4,)
    heights: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    turns_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    yields: Annotated[tuple[Yields, ...], Field(min_length=1)] = (Yields(),)
    spacing: Annotated[float, Field(ge=0.0)] = 1.1
    effort: Literal["quick", "default", "best"] = "quick"

    @field_validator("arms", mode="before")
    @classmethod
    def _arms_of_words(cls, arms: Any) -> Any:
        if not isinstance(arms, list | tuple):
            return arms
        kinds = (str, "robot"), (ArmSpec, "spec")
        return tuple(next(({key: arm} for kind, key in kinds if isinstance(arm, kind)), arm) for arm in arms)

    @field_validator("trees", mode="before")
    @classmethod
    def _files(cls, trees: Any, info: ValidationInfo) -> Any:
        if not isinstance(trees, list | tuple):
            return trees
        folder = (info.context or {}).get("folder", Path())
        rows = list[Any]()
        for number, row in enumerate(trees):
            if isinstance(row, str) and "*" in row:
                found = sorted(folder.glob(row)) if not Path(row).is_absolute() else sorted(Path("/").glob(row[1:]))
                if not found:
                    raise fault(f"there is no file {row}", number)
                rows += [(path,) for path in found]
            else:
                try:
                    listed = row if isinstance(row, list | tuple) and row else (row,)
                    rows.append(tuple(folder / file_path("trees", path) for path in listed))
                except OptionError as error:
                    raise fault(error.message, number) from error
        return tuple(rows)

    @model_validator(mode="after")
    def _is_of_some_size(self) -> Self:
        count = math.prod(map(len, (self.trees, self.distances, self.heights, self.turns_deg, self.yields)))
        # Maximum number of designs of a study.
        most_designs = 100_000
        if count * sum(math.prod(map(len, arm.vary.values())) for arm in self.arms) > most_designs:
            raise fault(f"more than {most_designs:,} designs")
        names = [name for arm in self.arms for name, _ in arm.members()]
        again = next((name for name in names if names.count(name) > 1), None)
        if again is not None:
            raise fault(f"two arms are called {again!r}: give one a `name`", "arms")
        return self

    def designs(self) -> tuple[Design, ...]:
        """Return all designs, arm by arm.

        Raises:
            InputError: A tree file cannot be read.
        """
        arms = [
            (name, robot, arm.start_deg or _usual_start(robot)) for arm in self.arms for name, robot in arm.members()
        ]
        places = itertools.product(arms, self.trees, self.distances, self.heights, self.turns_deg, self.yields)
        return tuple(
            Design(*arm, trees, distance, height, turn, yields, self.spacing, self.measure, self.effort)
            for arm, trees, distance, height, turn, yields in places
        )


@dataclass(frozen=True)
class Design:
    """One arm in front of one tree row, measured as one row."""

    arm: str
    spec: str | RobotSource | ArmSpec
    start_deg: tuple[float, ...] | None
    trees: tuple[Path, ...]
    distance: float
    height: float
    turn_deg: float
    yields: Yields
    spacing: float
    measure: Measure
    effort: Literal["quick", "default", "best"]

    @property
    def robot(self) -> Robot:
        """The arm."""
        return _robot(self.spec)

    @property
    def tree(self) -> str:
        """Name of the trees, from their files."""
        return " ".join(path.stem for path in self.trees)

    @property
    def digest(self) -> str:
        """16 hexadecimal digits that identify names, arm, file contents and numbers."""
        numbers = [self.start_deg, self.distance, self.height, self.turn_deg, self.yields, self.spacing]
        names = [self.arm, self.tree, self.measure, self.effort]
        parts = [*names, robot_digest(self.robot), *map(_content_digest, self.trees), *map(repr, numbers)]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    @property
    def scene(self) -> Scene:
        """Scene of the trees with fruit, in the base frame.

        Raises:
            InputError: A tree file is invalid.
            OptionError: A distance, height or rotation is out of range, or trees without fruit have no room for it.
        """
        contents, dof = tuple(map(_content_digest, self.trees)), self.robot.dof
        start_deg = self.start_deg or (0.0,) * dof
        scene = _scene(
            contents, self.trees, self.distance, self.height, self.turn_deg, self.yields, self.spacing, start_deg
        )
        if self.start_deg is not None:
            return scene
        from hplan.planning.fitted_orchard import find_start, measure_workspace

        return scene.with_values(start=find_start(self.robot, scene, measure_workspace(self.robot).far))


@lru_cache(maxsize=64)
def _robot(spec: str | RobotSource | ArmSpec) -> Robot:
    return load_member(spec) if isinstance(spec, ArmSpec) else load_robot(spec)


def _usual_start(spec: str | RobotSource | ArmSpec) -> tuple[float, ...] | None:
    """The tucked harvester [deg]; None for arms of other joints."""
    try:
        _robot(spec).check_configuration([math.radians(value) for value in TUCKED_DEG], "start_deg")
    except HplanError:
        return None
    return TUCKED_DEG


def _content_digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise StudyError(f"tree file {path}: {error.strerror}", where="trees") from error


@lru_cache(maxsize=16)
def _scene(
    _contents: tuple[str, ...],
    trees: tuple[Path, ...],
    distance: float,
    height: float,
    turn_deg: float,
    yields: Yields,
    spacing: float,
    start_deg: tuple[float, ...],
) -> Scene:
    stands = MeasuredOptions(
        name=" ".join(path.stem for path in trees), spacing=spacing, distance=distance, height=-height,
        yaw_deg=turn_deg, wood_yields=yields.wood, yields_below=yields.below, fruit_yields=yields.fruit,
    )  # fmt: skip
    return measured_orchard(trees, stands, start_deg=start_deg)


def _words(value: Any) -> str:
    return "/".join(f"{item:g}" for item in value) if isinstance(value, list | tuple) else f"{value}"


def load_study(path: Path | str) -> Study:
    """Read a study file (YAML); tree files are relative to its folder.

    Raises:
        StudyError: The file is missing or malformed, a key is unknown or repeated, or a value has the wrong type or
            range. The error names the key and its line.
    """
    return read_model(Study, file_path("path", path))
