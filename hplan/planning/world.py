"""The arm among its obstacles, prepared for planning and certification.

The required clearance differs between obstacles: an uncertain position adds a chosen number of standard deviations to
the scene's clearance. It also differs between links, by the tracking displacement bound, which is larger for the outer
links.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record
from hplan.base.deadline import check_deadline
from hplan.certificate.moving_obstacles import leaving_of
from hplan.collision.coal_arm import BASE_DEPTH
from hplan.collision.coal_scene import CoalScene, Leaving, OwnContact, base_contacts
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compliant_solids import LinkedSolids
from hplan.errors import ConfigurationInCollisionError, InputError
from hplan.planning.options import PlanOptions
from hplan.robot.files import neighbouring_links
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel, largest_fraction, name_margin
from hplan.robot.upright import UprightTool
from hplan.scene.model import Scene, growing_from, hanging_from
from hplan.scene.obstacle_kind import Sigmas, Solid, growths

#: Spare clearance by the compiled distances from which a configuration counts as clear [m].
_CLEARLY_M = 2e-3

#: Maximum number of cached clearances.
_KNOWN = 4096


@dataclass(frozen=True, eq=False)
class World(Record):
    """An arm among solid obstacles.

    Attributes:
        clearance: Required clearance from all solids [m].
        deviation: Tracking error of each joint at rest [rad].
        field: Distances between arm and solids, less the required clearance and the tracking displacement bound.
        checker: The solids in coal, each inflated for its position uncertainty.
        linked: The solids with their links and required clearances, as in `field`.
        growth: (solids,) inflation of each solid for its position uncertainty [m].
        yield_links: Names of the links that may push compliant obstacles; None for the links of the last two joints.
        touched: Names of the solids that the last link may touch.
        hanging: Names of the solids that touchable solids are attached to.
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
    def build(
        cls,
        robot: Robot,
        solids: Sequence[Solid],
        *,
        clearance: float = 0.0,
        tracking_error: float = 0.0,
        sigmas: Sigmas = 0.0,
        yield_links: Sequence[str] | None = None,
        leaving: Leaving | None = None,
        upright: UprightTool | None = None,
    ) -> World:
        """Prepare solids for planning.

        Args:
            clearance: Required clearance [m].
            tracking_error: Tracking error of any joint at rest [rad].
            sigmas: Inflation of an obstacle in standard deviations of its position; a mapping by name if they differ.
            yield_links: Links that may push compliant obstacles; None for the links of the last two joints.
            leaving: Start that may be nearer to obstacles than the clearance; None for none.
            upright: The tool axis that stays upright; None if the tool may tilt.

        Raises:
            OptionError: `yield_links` names an unknown link.
        """
        growth = growths(solids, sigmas)
        checker = CoalScene(
            robot, solids, growth=growth, deviation=tracking_error, clearance=clearance, yield_links=yield_links,
            leaving=leaving, upright=upright,
        )  # fmt: skip
        check_deadline()
        linked = LinkedSolids.build(robot, solids, clearance + growth, yield_links, growth)
        linked = linked.with_nearer(robot.dof, solids, checker.near_solids, growth)
        field = linked.field(robot, own_clearance=clearance, deviation=tracking_error, upright=upright)
        return cls(robot, tuple(solids), clearance, tracking_error, field, checker, linked, growth, yield_links)

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene, options: PlanOptions) -> World:
        """Return the robot among the scene's solids, all fruits included.

        The robot caches its last two worlds, so planning again among the same solids starts sooner.

        Raises:
            OptionError: `scene.yield_links` names an unknown link.
        """
        # Without required certification, no clearance is reserved for tracking errors; motions are certified anyway.
        tracking_error = options.tracking.still_rad
        leaving, upright = leaving_of(robot, scene), UprightTool.of_scene(robot, scene)
        # The solids of a scene, hundreds of objects, are listed for a new world only. A goal among wood is rigid.
        goal = None if scene.wood is None else scene.goal.fruit
        key = scene.surroundings, goal, tracking_error, options.sigmas, leaving, upright
        check_deadline()
        kept: deque[tuple[object, World]] = robot.cache("worlds", lambda: deque(maxlen=2))
        for known, world in tuple(kept):
            if known == key:
                return world
        world = cls.build(
            robot, scene.solids_with_goal, clearance=scene.clearance, tracking_error=tracking_error,
            sigmas=options.sigmas, yield_links=scene.yield_links, leaving=leaving, upright=upright,
        )  # fmt: skip
        kept.append((key, world))
        return world

    def allow_touch(self, name: str, hangs_from: Sequence[str] = ()) -> World:
        """Return the world in which the last link may touch a solid.

        Other links may push the solids that it is attached to.
        """
        rigid = [s.name for s in self.solids if s.name in hangs_from and not s.yields and not s.is_limb]
        touched, hanging = (*self.touched, name), (*self.hanging, *rigid)
        checker = self.checker.allow_touch(name, rigid)
        if not rigid:
            field = self.field.ignoring_last_link(self.linked.name_mask((name,)))
            return replace(self, field=field, checker=checker, touched=touched)
        whole = self.clearance + self.growth
        linked = LinkedSolids.build(self.robot, self.solids, whole, self.yield_links, self.growth, hanging)
        linked = linked.with_nearer(self.robot.dof, self.solids, checker.near_solids, self.growth)
        field = self._field(linked, self.deviation)
        field = field.ignoring_last_link(linked.name_mask(touched))
        return replace(self, field=field, checker=checker, linked=linked, touched=touched, hanging=hanging)

    @property
    def upright(self) -> UprightTool | None:
        """The tool axis that stays upright; None if the tool may tilt."""
        return self.checker.upright

    def _field(self, linked: LinkedSolids, deviation: float) -> ClearanceField:
        return linked.field(self.robot, own_clearance=self.clearance, deviation=deviation, upright=self.upright)

    def check_clear(self, q: FloatArray, which: str) -> float:
        """Clearance of a configuration at rest beyond the requirement [m].

        The requirement is the clearance to keep plus the tracking displacement bound of each link. Clearances are
        clamped to `hplan.collision.distance_checker.FAR`.

        Args:
            q: (dof,) configuration.
            which: Name of the configuration, for the error.

        Raises:
            ConfigurationInCollisionError: It has less; names link, obstacle or other part of the arm, and depth. If the
                tracking error alone is too large, it also names the largest one that would fit.
            TiltedError: The tool has to stay upright, and it does not hold it upright.
        """
        key = which.encode() + q.tobytes() if len(self.checker.near_pairs) else q.tobytes()
        found = self._cached_clearances.get(key)
        if found is None:
            found = self._check(q, which)
            if len(self._cached_clearances) < _KNOWN:
                self._cached_clearances[key] = found
        return found

    @cached_property
    def _firm_checker(self) -> CoalScene:
        """The checker in which all pairs keep the clearance, also those that are too near at the start."""
        return self.checker.without_leaving()

    @cached_property
    def _cached_clearances(self) -> dict[bytes, float]:
        """Cached clearances of collision-free configurations; tours check their stops repeatedly."""
        return {}

    def _check(self, q: FloatArray, which: str) -> float:
        if self.upright is not None:
            self.upright.check(self.robot, q, which, self.deviation)
        # Compiled distances are lower bounds, and quicker among clouds. Coal decides close cases, and certifies.
        spare = self.field.spare_clearance(q)
        if spare > _CLEARLY_M and not len(self.checker.near_pairs):
            return spare
        checker = self.checker if which == "start" else self._firm_checker
        try:
            by_coal = check_clear(checker, q, which)
        except ConfigurationInCollisionError as error:
            if self.deviation == 0.0:
                raise
            _, sway = self.checker.required_distances
            left = self.checker.pair_distances(q) - self.clearance
            fraction = float((left / np.maximum(sway, 1e-300)).min())
            name_margin(error, TrackingModel(self.deviation), self.robot.slides, fraction)
            raise
        # Coal's distances between hulls are accurate to its tolerance; the last digits depend on earlier queries.
        return spare if spare > 0.0 else by_coal

    def fraction_of_deviation(self, configurations: FloatArray, wanted: float) -> float:
        """Largest fraction of the deviation that leaves one configuration the clearance.

        Args:
            configurations: (n, dof).
            wanted: Requested clearance beyond the required one [m].

        Returns:
            The fraction, found as in `hplan.robot.tracking.largest_fraction`; 0 if no fraction suffices.
        """

        def is_clear(fraction: float) -> bool:
            deviation = fraction * self.deviation
            smaller = self._field(self.linked, deviation)
            if self.touched:
                smaller = smaller.ignoring_last_link(self.linked.name_mask(self.touched))
            return bool((smaller.spare_clearances(configurations) > wanted).any())

        return largest_fraction(is_clear)

    def check_base(self) -> None:
        """Refuse obstacles that intersect the base.

        No joint motion changes such an overlap. The ground may touch the base.

        Raises:
            InputError: An obstacle intersects them; names it, the body and the depth.
        """
        contacts = self.checker.base_contacts
        if contacts:
            worst = contacts[ties.argmin([contact.distance_m for contact in contacts])]
            raise InputError(
                f"obstacle {worst.obstacle!r} is {-1e3 * worst.distance_m:.3g} mm deep in the robot's {worst.link!r}, "
                "which does not move: move the obstacle, or the robot, or leave it out (--drop-inside)",
                obstacle=worst.obstacle,
                link=worst.link,
                depth_m=-worst.distance_m,
            )


def check_clear(checker: CoalScene, q: FloatArray, which: str) -> float:
    """Return the spare clearance of a configuration [m], inf without obstacles.

    Args:
        q: (dof,) configuration.
        which: Name of the configuration, for the error.

    Raises:
        ConfigurationInCollisionError: It touches an obstacle or itself, or comes closer than the checker's clearance
            plus displacement bound; names link, obstacle or other part of the arm, and depth.
    """
    if not checker.pairs:
        return float("inf")
    worst, distance, beyond = checker.nearest_spare(q)
    if beyond <= 0.0:
        kept, sways = checker.required_distances
        nearest = checker.contact(*checker.pairs[worst], distance)
        is_own, robot = isinstance(nearest, OwnContact), checker.robot
        error = ConfigurationInCollisionError(
            which, nearest.link, nearest.obstacle, -beyond, float(kept[worst] + sways[worst]),
            mover=robot.link_in_words(nearest.link),
            other=robot.link_in_words(nearest.obstacle) if is_own else nearest.other_name,
        )  # fmt: skip
        arms = [robot.owner_of(nearest.link), robot.owner_of(nearest.obstacle)]
        held = {item.name for item in robot.attached}.intersection((nearest.link, nearest.obstacle))
        if is_own and arms[0] != arms[1]:
            how = "if they touch by design, declare the pair in the cell's scene (may_touch:)"
            error.add(f"the two arms stand too close together: move a base (position:); {how}", arms=arms)
        elif is_own and held:
            error.add("if it may touch that part, name it in the object's may_touch", held=sorted(held))
        elif is_own:
            _name_neighbours(error, checker, q)
        raise error
    return beyond


def _name_neighbours(error: ConfigurationInCollisionError, checker: CoalScene, q: FloatArray) -> None:
    """Name the touching links that share a joint.

    Most robots have them overlap by design.
    """
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
        how = "declare it with an SRDF (--srdf) or allow_neighbours (--allow-neighbours)"
        error.add(f"is this intended? Neighbours that touch here: {named}; {how}", neighbours=found)


def without_inside(robot: Robot, scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene without obstacles and fruits inside the base.

    These are the ones that `World.check_base` refuses; trees measured without an arm may overlap it. Removed solids are
    not covered by any certificate. Meshes and point clouds stay, because only a part of each is inside. If the goal
    fruit is removed, the first remaining fruit becomes the goal.

    Returns:
        The scene, and the names of the removed obstacles and fruits, in scene order.
    """
    whole = {obstacle.name for obstacle in scene.obstacles if obstacle.kind in ("mesh", "points")}
    solids = [solid for solid in scene.solids_with_goal if solid.name not in whole]
    inside = {contact.obstacle for contact in base_contacts(robot, solids, margin=-BASE_DEPTH)}
    if not inside:
        return scene, ()
    parts = {key: getattr(scene, key) for key in Scene.model_fields}
    for key in ("obstacles", "fruits"):
        parts[key] = tuple(part for part in parts[key] if part.name not in inside)
    parts["obstacles"] = growing_from(parts["obstacles"])
    parts["fruits"] = hanging_from(parts["obstacles"], parts["fruits"])
    if scene.goal.fruit in inside and parts["fruits"]:
        parts["goal"] = scene.goal.copy_unchecked({"fruit": parts["fruits"][0].name})
    return Scene.model_validate(parts), tuple(
        part.name for part in (*scene.obstacles, *scene.fruits) if part.name in inside
    )
