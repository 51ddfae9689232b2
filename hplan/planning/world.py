"""The arm among the solids that it has to keep clear of, made ready for planning and for certificates.

The clearance to keep differs from obstacle to obstacle: for one whose place is uncertain a chosen number of its
standard deviations comes to the scene's own. And it differs from link to link, by what a tracking error may take: the
outer links sway farther.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record
from hplan.base.deadline import check_deadline
from hplan.certificate.motion_bound import pair_sways
from hplan.collision.box_bounds import CENTRE, HALF, RADIUS
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene, OwnContact, base_contacts
from hplan.collision.giving_way import LinkedSolids
from hplan.errors import ConfigurationInCollisionError, InputError
from hplan.planning.options import PlanOptions
from hplan.robot.base_shapes import BASE_DEPTH, base_radius, turning_shapes
from hplan.robot.files import neighbouring_links
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel, largest_fraction, name_margin
from hplan.scene.model import Scene, hanging_from
from hplan.scene.obstacle_kind import Sigmas, Solid, growths

#: So many clearances are remembered at most.
_KNOWN = 4096


@dataclass(frozen=True, eq=False)
class World(Record):
    """An arm among solids.

    Attributes:
        clearance: Clearance to keep from all of them [m].
        deviation: By how much every joint may be off where the arm rests [rad].
        field: Distances between arm and solids, less the clearance to keep and what the deviation may take.
        checker: The solids in coal, each grown for its uncertainty.
        linked: The solids, and which links keep clear of them and by how much, as `field` has them.
        growth: (solids,) by how much each is grown for its uncertainty [m].
        yield_links: Names of the links that may push what gives way; None for those of the last two joints.
        touched: Names of the solids that the last link may touch.
        hanging: Names of those from which what may be touched hangs.
    """

    robot: Robot
    solids: tuple[Solid, ...]
    clearance: float
    deviation: float
    field: ClearanceField
    checker: CoalScene
    linked: LinkedSolids
    growth: FloatArray
    yield_links: Sequence[str] | None = None
    touched: tuple[str, ...] = ()
    hanging: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        robot: Robot,
        solids: Sequence[Solid],
        *,
        clearance: float = 0.0,
        tracking_error: float = 0.0,
        sigmas: Sigmas = 0.0,
        yield_links: Sequence[str] | None = None,
    ) -> World:
        """Make solids ready.

        Args:
            clearance: Clearance to keep [m].
            tracking_error: Deviation of any joint at rest that is to be allowed for [rad].
            sigmas: How many standard deviations of its place an obstacle grows by; by name where they differ.
            yield_links: Names of the links that may push what gives way; None for those of the last two joints.

        Raises:
            OptionError: A name of no link.
        """
        growth = growths(solids, sigmas)
        linked = LinkedSolids.of(robot, solids, clearance + growth, yield_links, growth)
        field = linked.field(robot, own_clearance=clearance, deviation=tracking_error)
        check_deadline()
        checker = CoalScene(
            robot, solids, growth=growth, deviation=tracking_error, clearance=clearance, yield_links=yield_links
        )
        return cls(robot, tuple(solids), clearance, tracking_error, field, checker, linked, growth, yield_links)

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene, options: PlanOptions) -> World:
        """Return the robot among the scene's solids, all fruits included.

        The robot keeps its last two worlds: planning again among the same solids starts sooner.

        Raises:
            OptionError: `scene.yield_links` names an unknown link.
        """
        # A motion that need not be certified need not leave room for tracking errors; it is certified all the same.
        tracking_error = options.tracking.still_rad
        key = scene.solids_with_goal, scene.clearance, tracking_error, options.sigmas, scene.yield_links
        check_deadline()
        kept: deque[tuple[object, World]] = robot.cached("worlds", lambda: deque(maxlen=2))
        for known, world in tuple(kept):
            if known == key:
                return world
        world = cls.of(
            robot, key[0], clearance=scene.clearance, tracking_error=tracking_error, sigmas=options.sigmas,
            yield_links=scene.yield_links,
        )  # fmt: skip
        kept.append((key, world))
        return world

    def touching(self, name: str, hangs_from: Sequence[str] = ()) -> World:
        """The world where the last link may touch the solid of a name, and others push what it hangs from."""
        rigid = [solid.name for solid in self.solids if solid.name in hangs_from and not solid.yields]
        touched, hanging = (*self.touched, name), (*self.hanging, *rigid)
        checker = self.checker.touching(name, rigid)
        if not rigid:
            field = self.field.sparing(self.linked.named((name,)))
            return replace(self, field=field, checker=checker, touched=touched)
        whole = self.clearance + self.growth
        linked = LinkedSolids.of(self.robot, self.solids, whole, self.yield_links, self.growth, hanging)
        field = linked.field(self.robot, own_clearance=self.clearance, deviation=self.deviation)
        field = field.sparing(linked.named(touched))
        return replace(self, field=field, checker=checker, linked=linked, touched=touched, hanging=hanging)

    def check_clear(self, q: FloatArray, which: str) -> float:
        """The clearance of a configuration at rest beyond the one to keep and each link's displacement bound [m].

        Args:
            q: (dof,) configuration.
            which: What it is, for the error.

        Raises:
            ConfigurationInCollisionError: It has less; names link, obstacle or other part of the arm, and depth, and
                where it is the deviation that leaves too little, the largest that would do.
        """
        key = q.tobytes()
        found = self._known.get(key)
        if found is None:
            found = self._checked(q, which)
            if len(self._known) < _KNOWN:
                self._known[key] = found
        return found

    @cached_property
    def _known(self) -> dict[bytes, float]:
        """Clearances of configurations that were found clear: tours ask for those of their stops again and again."""
        return {}

    def _checked(self, q: FloatArray, which: str) -> float:
        if self.deviation == 0.0:
            return check_clear(self.checker, q, self.clearance, which)
        sway = pair_sways(self.checker, np.full((1, self.robot.dof), self.deviation))[:, 0]
        try:
            return check_clear(self.checker, q, self.clearance, which, sway=sway)
        except ConfigurationInCollisionError as error:
            left = self.checker.pair_distances(q) - self.clearance
            fraction = float((left / np.maximum(sway, 1e-300)).min())
            name_margin(error, TrackingModel(self.deviation), self.robot.slides, fraction)
            raise

    def fraction_of_deviation(self, configurations: FloatArray, wanted: float) -> float:
        """Largest fraction of the deviation at which one of some configurations still has a clearance.

        Args:
            configurations: (n, dof).
            wanted: Clearance asked for beyond the one to keep [m].

        Returns:
            A fraction for which that is so, as `hplan.robot.tracking.largest_fraction` finds it; 0 where there is none.
        """

        def is_clear(fraction: float) -> bool:
            deviation = fraction * self.deviation
            smaller = self.linked.field(self.robot, own_clearance=self.clearance, deviation=deviation)
            if self.touched:
                smaller = smaller.sparing(self.linked.named(self.touched))
            return bool((smaller.along(configurations).min(axis=1) > wanted).any())

        return largest_fraction(is_clear)

    def check_base(self, yaw: float) -> None:
        """Refuse obstacles in which pedestal or turret stand: no motion of the arm changes that.

        The ground may touch the pedestal.

        Raises:
            InputError: There is one; names it, the body and the depth.
        """
        boxes = self.checker.boxes[0][len(self.checker.parts.all_shapes) :]
        sizes = np.linalg.norm(boxes[:, HALF:RADIUS], axis=1) + boxes[:, RADIUS]
        in_reach = np.linalg.norm(boxes[:, CENTRE:HALF], axis=1) <= sizes + base_radius(self.robot)
        close = [solid for solid, near in zip(self.solids, in_reach.tolist(), strict=True) if near]
        contacts = base_contacts(self.robot, close, yaw, margin=-BASE_DEPTH)
        if contacts:
            worst = contacts[ties.argmin([contact.distance_m for contact in contacts])]
            turns = any(shape.name == worst.link for shape in turning_shapes(self.robot))
            raise InputError(
                f"obstacle {worst.obstacle!r} is {-1e3 * worst.distance_m:.3g} mm deep in the robot's {worst.link!r}, "
                + (f"at a yaw of {math.degrees(yaw):.4g} deg" if turns else "which does not move")
                + ": move the obstacle, or the robot, or leave it out (--drop-inside)",
                obstacle=worst.obstacle,
                link=worst.link,
                depth_m=-worst.distance_m,
            )


def check_clear(checker: CoalScene, q: FloatArray, clearance: float, which: str, *, sway: ArrayLike = 0.0) -> float:
    """Distance of a configuration beyond the clearance to keep [m], inf without obstacles.

    Args:
        q: (dof,) configuration.
        clearance: Clearance to keep [m].
        which: Name of the configuration, for the error.
        sway: By how much each of the checker's pairs may come nearer than at this configuration [m].

    Raises:
        ConfigurationInCollisionError: It touches an obstacle or itself, or comes closer than `clearance` and
            displacement bound; names link, obstacle or other part of the arm, and depth.
    """
    if not checker.pairs:
        return float("inf")
    kept = np.broadcast_to(np.asarray(checker.kept(clearance)), (len(checker.pairs),))
    sways = np.broadcast_to(np.asarray(sway, dtype=np.float64), kept.shape)
    worst, distance = checker.nearest_pair(q, kept + sways)
    beyond = (distance - float(sways[worst])) - float(kept[worst])
    if beyond <= 0.0:
        nearest = checker.contact(*checker.pairs[worst], distance)
        is_own, robot = isinstance(nearest, OwnContact), checker.robot
        error = ConfigurationInCollisionError(
            which, nearest.link, nearest.obstacle, -beyond, float(kept[worst] + sways[worst]),
            mover=robot.link_in_words(nearest.link),
            other=robot.link_in_words(nearest.obstacle) if is_own else nearest.other,
        )  # fmt: skip
        arms = [robot.owner_of(nearest.link), robot.owner_of(nearest.obstacle)]
        if is_own and arms[0] != arms[1]:
            how = "if they touch by design, declare the pair in the cell's scene (may_touch:)"
            error.add(f"the two arms stand too close together: move a base (position:); {how}", arms=arms)
        elif is_own and robot.planar is None:
            _name_neighbours(error, checker, q)
        raise error
    return beyond


def _name_neighbours(error: ConfigurationInCollisionError, checker: CoalScene, q: FloatArray) -> None:
    """Say which of the links that touch one another have one joint between them: most robots mean them to."""
    neighbours = {frozenset(pair[:2]) for pair in neighbouring_links(checker.robot.model)}
    apart = checker.pair_distances(q)[len(checker.pairs) - len(checker.parts.own) :].tolist()
    touching = dict.fromkeys(
        (checker.obstacle_names[other], checker.mover_names[mover])
        for (mover, other), distance in zip(checker.pairs[-len(apart) :], apart, strict=True)
        if distance <= 0.0
    )
    found = [list(pair) for pair in touching if frozenset(pair) in neighbours]
    if found:
        named = ", ".join(" and ".join(pair) for pair in found)
        how = "say so by an SRDF (--srdf) or allow_neighbours (--allow-neighbours)"
        error.add(f"are they meant to? Neighbours that touch here: {named}; {how}", neighbours=found)


def without_inside(robot: Robot, scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene without what `World.check_base` would refuse: obstacles and fruits in pedestal or turret.

    Trees that were measured without an arm between them may stand in it. What is left out is in no proof. Meshes and
    clouds stay, of which only a part is inside. Where the goal is a fruit that is left out, the next one is the goal.

    Args:
        scene: The scene; the turret is taken as it stands at the start.

    Returns:
        The scene, and the names of what was left out, in the order of the scene.
    """
    yaw = robot.yaw_of(scene.start.configuration)
    whole = {obstacle.name for obstacle in scene.obstacles if obstacle.kind in ("mesh", "points")}
    solids = [solid for solid in scene.solids_with_goal if solid.name not in whole]
    inside = {contact.obstacle for contact in base_contacts(robot, solids, yaw, margin=-BASE_DEPTH)}
    if not inside:
        return scene, ()
    parts = {key: getattr(scene, key) for key in Scene.model_fields}
    for key in ("obstacles", "fruits"):
        parts[key] = tuple(part for part in parts[key] if part.name not in inside)
    parts["fruits"] = hanging_from(parts["obstacles"], parts["fruits"])
    if scene.goal.fruit in inside and parts["fruits"]:
        parts["goal"] = scene.goal.copy_unchecked({"fruit": parts["fruits"][0].name})
    return Scene.model_validate(parts), tuple(
        part.name for part in (*scene.obstacles, *scene.fruits) if part.name in inside
    )
