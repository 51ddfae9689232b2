"""A finished job in its folder: its report and its motion."""

from __future__ import annotations

import math
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
    """The report of a finished job and the paths of its motion.

    Attributes:
        path: Path of the report file.
        report: Content of the report; it has a `certificate` with `digests`.
        trajectory_paths: Files of the motion: one, or one for each leg of a tour.
    """

    def __init__(self, folder: Path, *, tours: bool = False) -> None:
        """Read the report of the latest job in a folder.

        Args:
            folder: The folder that the job wrote.
            tours: Accept a tour's report too, if it is newer than a plan's.

        Raises:
            InputError: The report is missing or malformed, is that of a job that failed, or has no certificate with
                digests.
        """
        self.path = max((folder / name for name in (REPORT, TOUR_REPORT)[: 1 + tours]), key=written_s)
        report = read_report(self.path)
        if isinstance(error := report.get("error"), dict):
            raise self._fault(f"the job failed ({error.get('kind')}: {error.get('message')})")
        certificate = report.get("certificate")
        numbers = ("tracking_error_rad", "tracking_delay_s", "sigmas")
        if (
            not isinstance(certificate, dict)
            or not isinstance(certificate.get("digests"), dict)
            or not all(type(certificate.get(key)) in (int, float) for key in numbers)
        ):
            reason = f"it is not the report of a plan with digests; {folder / TRAJECTORY} can be given by itself"
            raise self._fault(reason)
        files = report.get("files", [TRAJECTORY])
        if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
            raise self._fault("files: expected a list of file names")
        self.report = report
        self.trajectory_paths = [folder / name for name in files]

    def _fault(self, reason: str) -> InputError:
        return InputError(f"report file {self.path}: {reason}", path=str(self.path))

    @property
    def scene(self) -> str:
        """File of the job's scene, or the name of a shipped scene.

        For a path that was given by the user (`hplan time --scene`), it is the scene file that the job wrote. The
        digest in the report detects a scene that has changed since.

        Raises:
            InputError: The job's scene does not ship with hplan.
        """
        name = self.report.get("scene")
        if "given" in self.report:
            return str(self.path.parent / SCENE)
        if name in shipped_scenes():
            return str(name)
        raise self._fault(f"its scene {name!r} does not ship with hplan: give the scene file")

    @property
    def robot(self) -> str:
        """Name of the job's robot; the digest detects whether it has changed.

        Raises:
            InputError: No robot of that name is known to hplan.
        """
        name = self.report.get("robot")
        if name not in robot_names():
            raise self._fault(f"its robot {name!r} does not ship with hplan: give the URDF with --robot")
        return str(name)

    def trajectory(self) -> Trajectory:
        """Read the job's motion, joining the legs of a tour."""
        from hplan.trajectory.trajectory import join_trajectories, read_csv

        return join_trajectories([read_csv(path) for path in self.trajectory_paths])

    def playback(self, trajectory: Trajectory) -> Playback:
        """Return the motion, with the report's times and phases, for playback.

        Raises:
            InputError: The report does not have valid phases or legs.
        """
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
            unreached = {one["fruit"]: one.get("reason", "no_motion") for one in self.report.get("unreached", ())}
            unpicked = {name: str(reason) for name, reason in unreached.items() if reason is not None}
            phases = []
            for leg in self.report["legs"]:
                if leg["fruit"] is not None:
                    picked[leg["fruit"]] = leg["picked_s"]
                phases += [Phase(**phase) for phase in leg["phases"]]
                if phases[-1].name == "drop":
                    dropped |= {name: phases[-1].end_s for name in picked if name not in dropped}
        except (AttributeError, IndexError, KeyError, TypeError) as error:
            raise self._fault("the phases of its motion are missing or malformed") from error
        return Playback(trajectory, picked, dropped, phases, certificate, curve, unpicked=unpicked)

    def certificate(self) -> Certificate:
        """Restore the certificate of the motion from the report.

        Raises:
            InputError: The certificate in the report is incomplete.
        """
        from hplan.certificate.certificate import Certificate
        from hplan.certificate.limit_use import LimitUse
        from hplan.collision.coal_scene import Contact

        saved = self.report["certificate"]
        tilt_deg = (saved.get("upright") or {}).get("bound_deg")
        try:
            return Certificate(
                verified=saved["verified"] is True,
                min_clearance_m=_number(saved["min_clearance_m"]),
                nearest=None if saved["nearest"] is None else Contact(**saved["nearest"]),
                limit_use=LimitUse(**{name: _number(value) for name, value in saved["limit_use"].items()}),
                checks=0,
                violations=tuple(map(str, saved["violations"])),
                uncovered_links=tuple(map(str, saved.get("uncovered_links", ()))),
                max_tilt_rad=None if tilt_deg is None else math.radians(tilt_deg),
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise self._fault("its certificate is incomplete") from error

    def contacts(self, scene: Scene) -> tuple[FruitContact, ...]:
        """Time windows in which the last link may touch fruits.

        Empty if the report lists none, as for a motion that may touch its goal fruit only.

        Raises:
            InputError: A window names a fruit that is not in the scene, or its times are not numbers.
        """
        from hplan.certificate.goal_contact import FruitContact

        fruits = {fruit.name: fruit for fruit in scene.fruits}
        try:
            return tuple(
                FruitContact(fruits[told["fruit"]], float(told["begin_s"]), float(told["end_s"]))
                for told in self.report["certificate"].get("contacts", ())
            )
        except (KeyError, TypeError, ValueError) as error:
            raise self._fault("its contacts are not time intervals with fruits of the scene") from error

    def clearance_curve(self) -> ClearanceCurve | None:
        """Clearance over time from the report; None if the report lacks it.

        Raises:
            InputError: The curve is malformed, or its lists differ in length.
        """
        import numpy as np

        from hplan.base.arrays import readonly
        from hplan.certificate.clearance_curve import ClearanceCurve

        curve = self.report.get("clearance_curve")
        if curve is None:
            return None
        try:
            time, distance = (readonly([_number(value) for value in curve[name]]) for name in ("time_s", "distance_m"))
            # A null clearance means inf without obstacles, and -inf if no clearance is certified.
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

    def list_differences(self, digests: Digests | None) -> list[str]:
        """Names among robot, scene and trajectory whose digests differ from the report's."""
        saved = self.report["certificate"]["digests"]
        return (
            [] if digests is None else [what for what, digest in digests.as_dict().items() if saved.get(what) != digest]
        )


def _number(value: float | None) -> float:
    """Convert a number of a report; null, which encodes infinity, becomes inf."""
    return float("inf") if value is None else float(value)
