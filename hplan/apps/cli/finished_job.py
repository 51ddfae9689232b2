"""A finished job in its folder: the report, and the motion that it is about."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import REPORT, SCENE, TOUR_REPORT, TRAJECTORY, read_report, written_s
from hplan.base.data_files import robot_names, shipped_scenes
from hplan.errors import InputError

if TYPE_CHECKING:
    from hplan.apps.view.playback import Playback
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.clearance_curve import ClearanceCurve
    from hplan.certificate.digests import Digests
    from hplan.certificate.goal_contact import FruitContact
    from hplan.scene.model import Scene
    from hplan.trajectory.trajectory import Trajectory


class FinishedJob:
    """The report of a finished job, and where its motion is.

    Attributes:
        report: Its content; `certificate` and the digests in it are there.
        trajectory_paths: The files of its motion: one, or one for each leg of a tour.
    """

    def __init__(self, folder: Path, *, tours: bool = False) -> None:
        """Read the report of a plan or, if `tours` are wanted too, that of a tour where it is the later one."""
        self.path = max((folder / name for name in (REPORT, TOUR_REPORT)[: 1 + tours]), key=written_s)
        report = read_report(self.path)
        certificate = report.get("certificate")
        numbers = ("tracking_error_rad", "tracking_delay_s", "sigmas")
        if (
            not isinstance(certificate, dict)
            or not isinstance(certificate.get("digests"), dict)
            or not all(type(certificate.get(key)) in (int, float) for key in numbers)
        ):
            reason = f"it is no report of a plan with digests; {folder / TRAJECTORY} can be given by itself"
            raise self._fault(reason)
        files = report.get("files", [TRAJECTORY])
        if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
            raise self._fault("files: expected names")
        self.report = report
        self.trajectory_paths = [folder / name for name in files]

    def _fault(self, reason: str) -> InputError:
        return InputError(f"report file {self.path}: {reason}", path=str(self.path))

    @property
    def scene(self) -> str:
        """The job's scene: of a given path the file that the job has left, else one that ships, by its name.

        The digest tells whether it is the same.
        """
        name = self.report.get("scene")
        if "given" in self.report:
            return str(self.path.parent / SCENE)
        if name in shipped_scenes():
            return str(name)
        raise self._fault(f"it is about the scene {name!r}, which does not ship with hplan: give its file")

    @property
    def robot(self) -> str:
        """Name of the job's robot; the digest tells whether it is the same."""
        name = self.report.get("robot")
        if name not in robot_names():
            raise self._fault(f"it is about the robot {name!r}, which has no name in hplan: give its URDF by --robot")
        return str(name)

    def trajectory(self) -> Trajectory:
        """The job's motion; that of a tour is joined where there is a file for each leg."""
        from hplan.trajectory.trajectory import joined, read_csv

        return joined([read_csv(path) for path in self.trajectory_paths])

    def playback(self, trajectory: Trajectory) -> Playback:
        """The job's motion as the animated page shows it, with the times and phases of the report."""
        from hplan.apps.view.playback import Playback
        from hplan.trajectory.trajectory import Phase

        certificate, curve = self.certificate(), self.clearance_curve()
        picked: dict[str, float] = {}
        dropped: dict[str, float] = {}
        try:
            if self.path.name == REPORT:
                phases = [Phase(**phase) for phase in self.report["phases"]]
                fruit = (self.report["grasp"] or {}).get("fruit")
                reached = [phase.end_s for phase in phases if phase.name != "retreat"]
                picked |= {} if fruit is None else {fruit: reached[-1]}
                return Playback(trajectory, picked, {}, phases, certificate, curve)
            phases = []
            for leg in self.report["legs"]:
                if leg["fruit"] is not None:
                    picked[leg["fruit"]] = leg["picked_s"]
                phases += [Phase(**phase) for phase in leg["phases"]]
                if phases[-1].name == "drop":
                    dropped |= {name: phases[-1].end_s for name in picked if name not in dropped}
        except (AttributeError, IndexError, KeyError, TypeError) as error:
            raise self._fault("it does not say what happens when in the motion") from error
        return Playback(trajectory, picked, dropped, phases, certificate, curve)

    def certificate(self) -> Certificate:
        """What the report says was shown of the motion."""
        from hplan.certificate.certificate import Certificate
        from hplan.certificate.limit_use import LimitUse
        from hplan.collision.coal_scene import Contact

        saved = self.report["certificate"]
        try:
            return Certificate(
                verified=saved["verified"] is True,
                min_clearance_m=_number(saved["min_clearance_m"]),
                nearest=None if saved["nearest"] is None else Contact(**saved["nearest"]),
                limit_use=LimitUse(**{name: _number(value) for name, value in saved["limit_use"].items()}),
                checks=0,
                violations=tuple(map(str, saved["violations"])),
                uncovered_links=tuple(map(str, saved.get("uncovered_links", ()))),
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise self._fault("its certificate is not complete") from error

    def contacts(self, scene: Scene) -> tuple[FruitContact, ...]:
        """Windows of time in which the last link may touch fruits of the job's scene, where not the goal alone."""
        from hplan.certificate.goal_contact import FruitContact

        fruits = {fruit.name: fruit for fruit in scene.fruits}
        try:
            return tuple(
                FruitContact(fruits[told["fruit"]], float(told["begin_s"]), float(told["end_s"]))
                for told in self.report["certificate"].get("contacts", ())
            )
        except (KeyError, TypeError, ValueError) as error:
            raise self._fault("its contacts are no times with fruits of the scene") from error

    def clearance_curve(self) -> ClearanceCurve | None:
        """The clearance over time that the report has; None where it has none."""
        import numpy as np

        from hplan.base.arrays import readonly
        from hplan.certificate.clearance_curve import ClearanceCurve

        curve = self.report.get("clearance_curve")
        if curve is None:
            return None
        try:
            time, distance = (readonly([_number(value) for value in curve[name]]) for name in ("time_s", "distance_m"))
            # Nothing to meet, or nothing certain: both are null.
            unknown = np.where(distance < np.inf, -np.inf, np.inf)
            values = zip(curve["clearance_m"], unknown.tolist(), strict=True)
            clearance = readonly([none if value is None else float(value) for value, none in values])
            nearest = readonly(curve["nearest"], np.int64)
            pairs = tuple((str(link), str(other)) for link, other in curve["pairs"])
            fits = len(time) == len(distance) == len(nearest) > 0 and max(nearest) < len(pairs)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise self._fault("its clearance over time is malformed") from error
        if not fits:
            raise self._fault("its clearance over time has lists of different lengths")
        return ClearanceCurve(time, clearance, distance, nearest, pairs)

    def differing(self, digests: Digests | None) -> list[str]:
        """Those of robot, scene and trajectory that are not the report's."""
        saved = self.report["certificate"]["digests"]
        return [] if digests is None else [what for what, digest in vars(digests).items() if saved.get(what) != digest]


def _number(value: float | None) -> float:
    """A number of a report, where what was infinite is null."""
    return float("inf") if value is None else float(value)
