"""The set's file: what each problem is made from, its digest, the best known duration, and who found that."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hplan.base.files import write_text

#: The file that comes with the project.
BEST_KNOWN = Path(__file__).with_name("best_known.json")

FORMAT = "hplan-best-known/1"

#: A duration is shorter than another only by more than this part of it.
SHORTER = 1e-9


@dataclass(frozen=True)
class DiscSource:
    """A scene of `studies.benchmark.scenes.random_scene`, base locked.

    Attributes:
        arm: Name of the robot.
        number: Of the scene.
    """

    arm: str
    number: int


@dataclass(frozen=True)
class PinchSource:
    """A pinch of `studies.benchmark.narrow.scenes.narrow_problem`, base locked.

    Attributes:
        arm: Name of the robot, or `drawn`.
        number: Of the problem.
        room_m: Room that its motion leaves [m].
    """

    arm: str
    number: int
    room_m: float


@dataclass(frozen=True)
class TreeSource:
    """A motion among a measured tree's branches and fruit (`studies.benchmark.orchard_scenes`).

    Attributes:
        arm: Name of the robot.
        tree: Name of the tree's file, without its suffix.
        distance_m: How far in front of the base the trunk stands [m].
        start: Configuration [rad].
        goal: Configuration [rad].
    """

    arm: str
    tree: str
    distance_m: float
    start: tuple[float, ...]
    goal: tuple[float, ...]


Source = DiscSource | PinchSource | TreeSource
_KINDS: dict[str, type[Source]] = {"discs": DiscSource, "pinch": PinchSource, "tree": TreeSource}


@dataclass(frozen=True)
class Record:
    """A problem and the best that is known of it.

    Attributes:
        name: The problem's.
        source: What it is made from.
        digest: Of robot and scene, so that other problems of the same name are noticed.
        duration_s: Best known duration of a certified motion [s].
        by: Who found it.
    """

    name: str
    source: Source
    digest: str
    duration_s: float
    by: str

    @property
    def group(self) -> str:
        """What it is counted with: `planar` or `trees`."""
        return "trees" if isinstance(self.source, TreeSource) else "planar"

    def improved(self, duration_s: float, by: str) -> Record:
        """The record after somebody certified a motion of some duration: the shorter one counts."""
        return replace(self, duration_s=duration_s, by=by) if self.is_beaten_by(duration_s) else self

    def is_beaten_by(self, duration_s: float) -> bool:
        """True if a duration is shorter than the best known [s]."""
        return duration_s < self.duration_s * (1.0 - SHORTER)


def read_records(path: Path = BEST_KNOWN) -> list[Record]:
    """The records of a file."""
    rows = json.loads(path.read_text(encoding="utf-8"))["problems"]
    return [_record(row) for row in rows]


def write_records(records: Iterable[Record], path: Path = BEST_KNOWN) -> Path:
    """Write records, a line each.

    Raises:
        OutputError: The file cannot be written.
    """
    lines = ",\n".join(json.dumps(_row(record)) for record in records)
    return write_text(path, f'{{"format": "{FORMAT}", "problems": [\n{lines}\n]}}\n')


def _row(record: Record) -> dict[str, object]:
    kind = next(name for name, made in _KINDS.items() if isinstance(record.source, made))
    best = {"digest": record.digest, "duration_s": round(record.duration_s, 9), "by": record.by}
    return {"name": record.name, "kind": kind, **asdict(record.source), **best}


def _record(row: Mapping[str, object]) -> Record:
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
    best = {key: values.pop(key) for key in ("name", "digest", "duration_s", "by")}
    source = _KINDS[str(values.pop("kind"))](**values)  # type: ignore[arg-type]
    return Record(source=source, **best)  # type: ignore[arg-type]
