r"""Limbs that bend and fruit that hang, as bodies of a MuJoCo model.

**Limbs.** A segment is divided into elements that shorten towards the clamp. An element of length :math:`h` bends in
two universal joints of stiffness :math:`2 E I / h` at its Gauss points, :math:`h / (2 \sqrt 3)` to either side of its
middle. The displacement by a force is an integral of a quadratic function over the element, which two Gauss points
integrate exactly; so the chain has the compliance of a beam for loads at the ends of elements, and a close one for
loads between them. At each Gauss point there is a joint for torsion as well, softer by `hplan.scene.limbs.TWIST_RATIO`.

**Damping** is proportional to stiffness, with a damping ratio for the first mode of each limb. The stiffness times the
time step is added to it: with MuJoCo's implicit damping this is the implicit Euler method, which is stable for any
stiffness.

**Contacts** with limbs and fruit are linear springs (`Wood.contact_stiffness`), frictionless by default.

**Gravity.** Trees are measured as they hang, so the weight of wood is compensated. Fruit hang on rigid stalks: the
weight gives each a restoring moment about its stalk's upper end, towards the measured place. The stalk breaks at a
given force, weight included, and the fruit falls.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import Field
from scipy.sparse.linalg import eigsh

from hplan.apps.execution.wind import Wind
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.checked import NotNegative, Options, Positive
from hplan.scene.fruit import Fruit
from hplan.scene.limbs import TWIST_RATIO, Limbs
from hplan.scene.wood import GRAVITY, STALK_M, Wood, limits_by_segment

#: Position of an element's first joint, as a share of its length; the second one is at 1 minus this.
GAUSS_POINT: Final = 0.5 - 0.5 / math.sqrt(3.0)

#: Contact bit that no link has; MuJoCo discards geometries of a URDF without any.
_UNUSED_BIT = 1 << 10

#: Maximum length of an element relative to its distance from the start of its segment.
_GROWTH = 1.8

#: Impedance of contacts with wood, and the inverse mass that MuJoCo scales them with [1/kg]. A small impedance makes a
#: contact a spring that does not depend on the masses.
_IMPEDANCE, _INVERSE_MASS = 0.1, 1000.0

#: Damping ratio of contacts, for a mass of 5 g [kg].
_CONTACT_DAMPING_RATIO, _CONTACT_MASS = 0.1, 0.005

#: Limbs slower than this may sleep [rad/s], and relative tolerance of the contact solver.
_SLEEP_TOLERANCE, _SOLVER_TOLERANCE = 1e-6, 1e-10


@dataclass(frozen=True)
class BendingTrees(Options):
    """Properties of simulated trees.

    Attributes:
        youngs_modulus_gpa: Young's modulus of the wood [GPa]; None for the largest one of each limb's interval.
        damping_ratio: Damping ratio of the first mode of each limb, and of fruit on their stalks.
        wood_strength_mpa: Bending stress at which a limb counts as broken [MPa].
        stalk_strength_n: Force at which a stalk breaks [N].
        friction: Coefficient of friction between the arm and wood or fruit.
        wind: Wind on limbs that bend and fruit that hangs; None for none.

    Examples:
        >>> from hplan.apps.execution.bending_wood import BendingTrees
        >>> BendingTrees(friction=0.4).stalk_strength_n
        20.0
    """

    youngs_modulus_gpa: Annotated[float, Field(gt=0.0)] | None = None
    damping_ratio: Positive = 0.07
    wood_strength_mpa: Positive = 40.0
    stalk_strength_n: Positive = 20.0
    friction: NotNegative = 0.0
    wind: Wind | None = None

    def youngs_modulus(self, limbs: Limbs, wood: Wood) -> FloatArray:
        """(n,) Young's modulus of limb segments [Pa]."""
        if self.youngs_modulus_gpa is None:
            return limits_by_segment(limbs, wood).stiffest
        return np.full(len(limbs.names), 1e9 * self.youngs_modulus_gpa)


def divide_segment(length: float, radius: float, nodes: Sequence[float] = ()) -> FloatArray:
    """(n + 1,) boundaries of a segment's elements, from 0 to its length [m].

    The first element is at most 5 radii long, since points nearer to the clamp are not bent like a beam. An element is
    at most `_GROWTH` times as long as its distance from the start: then the displacement at points within it differs
    from a beam's by at most about 3 %.

    Args:
        length: Length of the segment [m].
        radius: Its radius [m].
        nodes: Points where other limbs grow from it; they become boundaries [m].

    Examples:
        >>> from hplan.apps.execution.bending_wood import divide_segment
        >>> divide_segment(0.4, 0.004).round(3).tolist()
        [0.0, 0.02, 0.054, 0.147, 0.4]
        >>> divide_segment(0.4, 0.004, [0.2]).round(3).tolist()
        [0.0, 0.02, 0.043, 0.093, 0.2, 0.4]
    """
    boundaries, same = [0.0], 0.1 * radius
    for node in (*sorted(node for node in nodes if node < length - same), length):
        last = boundaries[-1]
        if node - last < same:
            continue
        first = min(max(last, 5.0 * radius), node)
        if last < first:
            boundaries.append(first)
        if node > first:
            count = math.ceil(math.log(node / first) / math.log(1.0 + _GROWTH) - 1e-9)
            boundaries += np.geomspace(first, node, count + 1)[1:].tolist()
    boundaries[-1] = length
    return np.array(boundaries)


class Carrier(NamedTuple):
    """A body that a point of the wood moves with, and the body's origin at rest [m]."""

    body: Any
    origin: FloatArray


@dataclass(eq=False)
class _Joints:
    """Joints of the limbs: name of the body, segment, and stiffness in bending [N m/rad]."""

    names: list[str] = field(default_factory=list)
    segment: list[int] = field(default_factory=list)
    stiffness: list[float] = field(default_factory=list)


class WoodBodies:
    """Bodies of limbs and fruit in a MuJoCo model.

    Limbs that bend consist of bodies with joints. Limbs that they carry move along undeformed. All bodies have the
    world's orientation at rest. Limbs that do not move are left out.

    Attributes:
        limbs: The limbs of the scene.
        wood: Properties known to the planner.
        trees: Properties of the simulated trees.
        bends: (n,) True for segments with joints.
        obstacle_of: Name of the limb or fruit by the name of each geometry.
        fruits: The fruit that hang.
        joints: Joints of the limbs, at the first and the second Gauss point of each element in turn.
        decay_s: Time constant of the decay of the first mode of each kinematic tree [s]; 0 for trees without limbs.
    """

    def __init__(
        self, mujoco: ModuleType, spec: Any, limbs: Limbs, wood: Wood, trees: BendingTrees, *, meets: int = 1
    ) -> None:
        """Prepare an empty set of bodies.

        Args:
            mujoco: The module.
            spec: The `MjSpec` to add bodies to.
            limbs: The limbs.
            wood: Properties known to the planner.
            trees: Properties of the simulated trees.
            meets: Contact bits of the geometries.
        """
        self.limbs, self.wood, self.trees = limbs, wood, trees
        self.bends: BoolArray = np.zeros(len(limbs.names), dtype=np.bool_)
        self.obstacle_of: dict[str, str] = {}
        self.fruits: list[Fruit] = []
        self.joints = _Joints()
        self.decay_s: FloatArray = np.zeros(0)
        self._mujoco, self._meets = mujoco, meets
        self._rigidity = limbs.flexural_rigidity(trees.youngs_modulus(limbs, wood))
        self._stations: dict[int, tuple[FloatArray, list[Carrier]]] = {}
        self._ground = Carrier(spec.worldbody, np.zeros(3))

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies of limbs, then of fruit."""
        return [*self.joints.names, *(f"fruit:{fruit.name}" for fruit in self.fruits)]

    def add_limbs(self, names: Collection[str]) -> None:
        """Add the limbs that bend and those that they carry.

        Args:
            names: Names of the limbs that bend. Clamped ones do not; segments between others and their clamp do.
        """
        limbs = self.limbs
        for number, name in enumerate(limbs.names):
            if name in names:
                self.bends[list(limbs.path(number))] = True
        for number in limbs.order.tolist():
            self._add_segment(number)

    def carrier(self, number: int, along: float) -> Carrier:
        """Body that a point of a limb moves with.

        Args:
            number: Number of the segment; -1 for the world.
            along: Distance of the point from the segment's start [m].
        """
        if number < 0:
            return self._ground
        stations, carriers = self._stations[number]
        return carriers[int(np.searchsorted(stations, along, side="right"))]

    def _add_segment(self, number: int) -> None:
        """Add the bodies and geometries of a segment to those of its parent."""
        limbs = self.limbs
        parent, length, axis = int(limbs.parent[number]), float(limbs.length[number]), limbs.axis[number]
        on = 0.0 if parent < 0 else float((limbs.joint[number] - limbs.start[parent]) @ limbs.axis[parent])
        carrier = self.carrier(parent, on)
        stations, carriers = np.zeros(0), [carrier]
        if self.bends[number]:
            children = np.flatnonzero((limbs.parent == number) & self.bends)
            nodes = (limbs.joint[children] - limbs.start[number]) @ axis
            boundaries = divide_segment(length, float(limbs.radius[number]), nodes.tolist())
            lengths = np.diff(boundaries)
            stations = (boundaries[:-1, None] + lengths[:, None] * [GAUSS_POINT, 1.0 - GAUSS_POINT]).ravel()
            stiffness = np.repeat(2.0 * self._rigidity[number] / lengths, 2)
            for along, spring in zip(stations.tolist(), stiffness.tolist(), strict=True):
                name = f"limb:{number}:{len(carriers)}"
                carrier = self._add_body(carrier, name, limbs.start[number] + along * axis)
                for at, direction in enumerate(across_and_along(axis)):
                    hinge = self._mujoco.mjtJoint.mjJNT_HINGE
                    carrier.body.add_joint(name=f"{name}:{at}", type=hinge, axis=direction)
                carriers.append(carrier)
                self.joints.names.append(name)
                self.joints.segment.append(number)
                self.joints.stiffness.append(spring)
        self._stations[number] = stations, carriers
        if carriers[-1].body is self._ground.body:
            return
        cuts = [0.0, *stations.tolist(), length]
        for piece, (first, last) in enumerate(itertools.pairwise(cuts)):
            ends = limbs.start[number] + np.array([[first], [last]]) * axis - carriers[piece].origin
            self._add_geom(
                carriers[piece],
                f"limb:{number}:piece:{piece}",
                limbs.names[number],
                type=self._mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=ends.ravel(),
                size=[limbs.radius[number], 0.0, 0.0],
                mass=self.wood.density * math.pi * limbs.radius[number] ** 2 * (last - first),
            )

    def add_fruits(
        self, fruits: Sequence[Fruit], names: Collection[str], without_contact: Collection[str] = ()
    ) -> None:
        """Hang fruit on the limbs; the limbs are there.

        Fruit that is farther than `STALK_M` from all limbs, or that is not named and hangs from a static limb, is left
        out.

        Args:
            fruits: The fruit.
            names: Names of fruit that hang.
            without_contact: Names of fruit that touches nothing.
        """
        for fruit in fruits:
            hold = self._find_hold(fruit)
            if hold is None or (hold[0].body is self._ground.body and fruit.name not in names):
                continue
            carrier, anchor = hold
            name, center = f"fruit:{fruit.name}", np.array(fruit.center)
            hung = self._add_body(carrier, name, anchor)
            hung.body.add_joint(name=name, type=self._mujoco.mjtJoint.mjJNT_BALL)
            self._add_geom(
                hung, name, fruit.name, type=self._mujoco.mjtGeom.mjGEOM_SPHERE,
                pos=center - anchor, size=[fruit.radius, 0.0, 0.0],
                mass=self.wood.fruit_density * 4.0 / 3.0 * math.pi * fruit.radius**3,
                **({"conaffinity": _UNUSED_BIT} if fruit.name in without_contact else {}),
            )  # fmt: skip
            self.fruits.append(fruit)

    def _find_hold(self, fruit: Fruit) -> tuple[Carrier, FloatArray] | None:
        """Body and point that a fruit hangs from; None if it is far from all limbs."""
        limbs = self.limbs
        hold = limbs.nearest(np.array(fruit.center), fruit.hangs_from)
        if hold is None:
            return None
        number, along, distance = hold
        if distance - limbs.radius[number] - fruit.radius > STALK_M:
            return None
        return self.carrier(number, along), limbs.start[number] + along * limbs.axis[number]

    def _add_body(self, carrier: Carrier, name: str, origin: FloatArray) -> Carrier:
        return Carrier(carrier.body.add_body(name=name, pos=origin - carrier.origin, gravcomp=1.0), origin)

    def _add_geom(self, carrier: Carrier, name: str, obstacle: str, **shape: Any) -> None:
        # Wood has priority over links, so that its contact parameters count.
        friction = self.trees.friction
        given = {"contype": 0, "conaffinity": self._meets, "priority": 1, "condim": 1 if friction == 0.0 else 3}
        carrier.body.add_geom(name=name, **given | {"friction": [friction, 0.0, 0.0]} | shape)
        self.obstacle_of[name] = obstacle

    # The compiled model.

    def finish(self, model: Any, data: Any) -> None:
        """Set stiffness, damping and contact springs of the compiled model.

        Args:
            model: The `MjModel`.
            data: Its `MjData`, at rest.
        """
        self._mujoco.mj_forward(model, data)
        step = float(model.opt.timestep)
        joints = self.joint_numbers(model).ravel()
        stiffness = np.outer(self.joints.stiffness, [1.0, 1.0, TWIST_RATIO]).ravel()
        dofs = np.array(model.jnt_dofadr[joints], dtype=np.int64)
        times = self._find_damping_times(model, data, dofs, stiffness)
        _set_coefficients(model.jnt_stiffness, joints, stiffness)
        _set_coefficients(model.dof_damping, dofs, stiffness * (times + step))
        for fruit in self.fruits:
            joint, geom = model.joint(f"fruit:{fruit.name}"), model.geom(f"fruit:{fruit.name}")
            mass, stalk = float(model.body_mass[geom.bodyid[0]]), float(np.linalg.norm(geom.pos))
            spring = mass * GRAVITY * max(stalk, fruit.radius)
            inertia = mass * (stalk**2 + 0.4 * fruit.radius**2)
            damping = 2.0 * self.trees.damping_ratio * math.sqrt(spring * inertia) + step * spring
            _set_coefficients(model.jnt_stiffness, np.array([joint.id]), np.array([spring]))
            _set_coefficients(model.dof_damping, int(joint.dofadr[0]) + np.arange(3), np.full(3, damping))
        self._make_springs(model)
        self._mujoco.mj_forward(model, data)

    def joint_numbers(self, model: Any) -> IntArray:
        """(m, 3) numbers of the joints of each body of the limbs: two across the axis, then that of torsion."""
        names = ((f"{name}:{at}" for at in range(3)) for name in self.joints.names)
        return np.array([[model.joint(name).id for name in row] for row in names], dtype=np.int64).reshape(-1, 3)

    def _find_damping_times(self, model: Any, data: Any, dofs: IntArray, stiffness: FloatArray) -> FloatArray:
        """(m,) ratio of damping to stiffness of each joint [s], by the first mode of each limb."""
        found, self.decay_s = np.zeros(len(dofs)), np.zeros(model.ntree)
        if not len(dofs):
            return found
        mass = np.zeros((model.nv, model.nv))
        self._mujoco.mj_fullM(model, data, mass)
        trees = model.dof_treeid[dofs]
        for tree in np.unique(trees).tolist():
            which = np.flatnonzero(trees == tree)
            rows, scale = dofs[which], 1.0 / np.sqrt(stiffness[which])
            slowest = _largest_eigenvalue(scale[:, None] * mass[np.ix_(rows, rows)] * scale)  # 1 / frequency^2
            found[which] = 2.0 * self.trees.damping_ratio * math.sqrt(slowest)
            self.decay_s[tree] = math.sqrt(slowest) / self.trees.damping_ratio
        return found

    def _make_springs(self, model: Any) -> None:
        """Make contacts with limbs and fruit linear springs."""
        geoms = np.array([model.geom(name).id for name in self.obstacle_of], dtype=np.int64)
        stiffness = self.wood.contact_stiffness
        damping = 2.0 * _CONTACT_DAMPING_RATIO * math.sqrt(stiffness * _CONTACT_MASS)
        bodies = np.unique(model.geom_bodyid[geoms])
        model.body_invweight0[bodies[bodies > 0], 0] = _INVERSE_MASS
        # MuJoCo's contact force is (reference acceleration - acceleration) / R, with R = (1 - d) / d times the inverse
        # mass and the reference acceleration (stiffness * depth + damping * speed) / d for an impedance d.
        factor = (1.0 - _IMPEDANCE) * _INVERSE_MASS
        model.geom_solref[geoms] = [-factor * stiffness, -factor * damping]
        model.geom_solimp[geoms] = [_IMPEDANCE, _IMPEDANCE, 1e-3, 0.5, 2.0]


def set_solver(mujoco: ModuleType, spec: Any, *, sleeps: bool) -> None:
    """Make the simulation of trees cheap.

    The dual solver's effort grows with the number of contacts, that of the others with the number of joints. Limbs that
    sleep are not simulated until they are touched or wind blows on them; at rest this changes nothing.

    Args:
        mujoco: The module.
        spec: The `MjSpec` to change.
        sleeps: True to let limbs sleep.
    """
    spec.option.solver, spec.option.tolerance = mujoco.mjtSolver.mjSOL_PGS, _SOLVER_TOLERANCE
    if sleeps:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        spec.option.sleep_tolerance = _SLEEP_TOLERANCE


def _largest_eigenvalue(matrix: FloatArray) -> float:
    """Largest eigenvalue of a symmetric matrix, to 1 %."""
    if len(matrix) < 10:
        return float(np.linalg.eigvalsh(matrix)[-1])
    start = np.ones(len(matrix))  # deterministic
    return float(eigsh(matrix, k=1, v0=start, tol=1e-2, return_eigenvectors=False)[0])


def across_and_along(axis: FloatArray) -> FloatArray:
    """(3, 3) rows: two directions across a (3,) axis, then the axis."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


def _set_coefficients(table: Any, rows: IntArray, values: FloatArray) -> None:
    """Set stiffness or damping; from version 4 on MuJoCo has polynomials, of which this is the first coefficient."""
    if table.ndim == 1:
        table[rows] = values
    else:
        table[rows, 0] = values
