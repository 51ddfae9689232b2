"""Response of simulated trees: forces, stresses, deflections, breakage, fruit knocked off."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from hplan.apps.execution.bending_wood import GAUSS_POINT, WoodBodies
from hplan.apps.view.body_motions import BodyMotion, BodyMotions
from hplan.base.arrays import FloatArray, IntArray, Record, readonly
from hplan.scene.wood import GRAVITY, Wood

#: Extrapolation of the moments at an element's two joints to its start.
_TO_START = GAUSS_POINT / (1.0 - 2.0 * GAUSS_POINT)

#: Stresses and stalks are watched for this time after a contact [s].
_SETTLES_S = 1.0

#: Time for which the wind has one speed [s].
_GUST_S = 0.01

#: Time in which wind rises on limbs that begin to move [s].
_RISE_S = 1.0

#: Limbs sway as if the wind had blown before after this number of decay times, and this time at least and at most [s].
_DECAYS, _SETTLES_IN_S = 3.0, (2.0, 10.0)

#: Limbs move on for this time after the arm has been near or touched them [s].
_AFTER_S = 1.0


@dataclass(frozen=True)
class LimbContact:
    """Contact of a link with a limb or a hung fruit in a simulation.

    Attributes:
        limb: Name of the limb or fruit.
        link: Name of the link in the URDF.
        begin_s: Time of the first contact [s].
        end_s: Time of the last contact [s].
        force_s: Time of the largest force [s].
        force_n: Largest sum of the normal forces; for a fruit the most by which the force on its stalk exceeds that at
            rest, as certificates bound it [N].
        stress_mpa: Largest bending stress between the clamp and the limb's end, during contact [MPa]; 0 for fruit.
        deflection_m: Largest displacement of the limb at the contact [m].
        is_fruit: True for a fruit.
    """

    limb: str
    link: str
    begin_s: float
    end_s: float
    force_s: float
    force_n: float
    stress_mpa: float
    deflection_m: float
    is_fruit: bool = False

    def is_within(self, wood: Wood) -> bool:
        """True if force and stress are within the limits of this limb or fruit."""
        wood = wood.of(self.limb)
        limit = wood.fruit_force if self.is_fruit else wood.contact_force
        return self.force_n <= limit and self.stress_mpa <= wood.wood_stress_mpa


@dataclass(frozen=True)
class Damage:
    """A limb that broke, or a fruit that was knocked off.

    Attributes:
        name: Name of the limb or fruit.
        time_s: Time when its load first exceeded its strength [s].
        load: Bending stress of the limb [MPa], or force on the stalk [N], at that time.
    """

    name: str
    time_s: float
    load: float


@dataclass(frozen=True, eq=False)
class TreeResponse(Record):
    """Response of the trees to a motion.

    Attributes:
        wood: Limits of force and stress.
        contacts: Contacts with limbs and hung fruit, in order of first touch.
        broken: Limbs that broke.
        knocked_off: Fruit that was knocked off.
        hung: Names of the fruit that hung at the start.
        fruit_displacement_m: Displacement of each fruit that still hangs at the end of the motion [m], by name.
        motions: Motions of limbs and fruit.
    """

    wood: Wood
    contacts: tuple[LimbContact, ...]
    broken: tuple[Damage, ...]
    knocked_off: tuple[Damage, ...]
    hung: frozenset[str]
    fruit_displacement_m: Mapping[str, float]
    motions: BodyMotions

    @property
    def ok(self) -> bool:
        """True if no limit was exceeded, no limb broke and no fruit was knocked off."""
        return not self.broken and not self.knocked_off and all(one.is_within(self.wood) for one in self.contacts)

    @property
    def limb_force_n(self) -> float:
        """Largest force between a link and a limb [N]."""
        return max((one.force_n for one in self.contacts if not one.is_fruit), default=0.0)

    @property
    def fruit_force_n(self) -> float:
        """Largest force between a link and a hung fruit [N]."""
        return max((one.force_n for one in self.contacts if one.is_fruit), default=0.0)

    def displacement_at(self, fruit: str, time_s: float) -> float | None:
        """Displacement of a fruit that hung at the start [m]; None for other fruit.

        Args:
            fruit: Name of the fruit.
            time_s: Time, interpolated between recorded poses [s].
        """
        if fruit not in self.hung:
            return None
        for motion in self.motions.fruits:
            if fruit in motion.names:
                place = [float(np.interp(time_s, self.motions.time, axis)) for axis in motion.position.T]
                return float(np.linalg.norm(place - motion.position[0]))
        return 0.0


@dataclass
class _Extremes:
    """The largest values of a contact until now, as in `LimbContact`."""

    begin_s: float
    is_fruit: bool
    end_s: float = 0.0
    force_s: float = 0.0
    force_n: float = 0.0
    stress_mpa: float = 0.0
    deflection_m: float = 0.0

    def __post_init__(self) -> None:
        self.force_s = self.begin_s


class TreeMonitor:
    """Measures limbs and fruit during a simulation, and blows on them.

    Attributes:
        bodies: The bodies of limbs and fruit.
        measured: Names of the fruit that hangs, and of the limbs that bend or are carried.
        max_stress_pa: (n,) largest bending stress of each limb [Pa].
        touched_still: Names of limbs and fruit that were touched while the wind did not move them.
    """

    def __init__(self, mujoco: ModuleType, model: Any, data: Any, bodies: WoodBodies) -> None:
        """Finish the model of the trees, at rest.

        Args:
            mujoco: The module.
            model: The compiled `MjModel`.
            data: Its `MjData`.
            bodies: The bodies in the model.
        """
        bodies.finish(model, data)
        self.bodies = bodies
        self._mujoco, self._model, self._data = mujoco, model, data
        joints = bodies.joint_numbers(model)
        #: Addresses of the joints' angles in bending.
        self._q_at = np.array(model.jnt_qposadr[joints[:, :2]], dtype=np.int64)
        self._stiffness = np.array(bodies.joints.stiffness)
        segment = np.array(bodies.joints.segment[0::2], dtype=np.int64)
        #: First element of each segment that bends, and the segments; the elements of a segment follow each other.
        self._first = np.flatnonzero(np.diff(segment, prepend=-1))
        self._bent = segment[self._first]
        #: Square of the bending stress by a unit of moment, of each element.
        self._square_per_moment = (4.0 / (math.pi * bodies.limbs.radius[segment] ** 3)) ** 2
        self._strength_pa = 1e6 * bodies.trees.wood_strength_mpa
        self._body_ids = np.array([model.body(name).id for name in bodies.body_names], dtype=np.int64)
        names = [fruit.name for fruit in bodies.fruits]
        self._fruit_ids = self._body_ids[len(joints) :]
        self._fruit_geoms = np.array([model.geom(f"fruit:{name}").id for name in names], dtype=np.int64)
        self._fruit_radius = np.array([fruit.radius for fruit in bodies.fruits])
        self._fruit_rows = {name: row for row, name in enumerate(names)}
        self._limb_rows = {name: row for row, name in enumerate(bodies.limbs.names)}
        self.measured = frozenset(bodies.obstacle_of.values())
        #: Position at rest of the body of each geometry.
        self._rest_of = {
            model.geom(name).id: np.array(data.xpos[model.geom(name).bodyid[0]]) for name in bodies.obstacle_of
        }
        self._pieces = self._pieces_of_bodies()
        #: Time until each kinematic tree sways as if the wind had blown before [s].
        self._lead_s = np.clip(_DECAYS * bodies.decay_s, *_SETTLES_IN_S)
        #: Speeds of the wind at multiples of `_GUST_S`; the first one is that of the earliest wind on a tree.
        self._wind_speeds, self._gust, self._is_new_gust = np.zeros(0), -1, False
        #: Kinematic tree of each position, and of each geometry of wood.
        sizes = np.where(model.jnt_type == int(mujoco.mjtJoint.mjJNT_BALL), 4, 1)
        self._tree_of_q = np.repeat(model.body_treeid[model.jnt_bodyid], sizes)
        self._tree_of = {model.geom(name).id: int(model.body_treeid[model.geom(name).bodyid[0]])
                         for name in bodies.obstacle_of}  # fmt: skip
        #: Time when the wind began to blow on each kinematic tree, NaN if it does not, and of the last contact [s].
        self._blows_since = np.full(model.ntree, -self._lead_s.max())
        self._touched_s = np.full(model.ntree, -math.inf)
        #: Trees and times that wind is limited to: numbers, begins and ends [s].
        self._spans: tuple[IntArray, FloatArray, FloatArray] | None = None
        self.touched_still = set[str]()
        self.max_stress_pa = np.zeros(len(bodies.limbs.names))
        self._stress = self.max_stress_pa.copy()
        self._last_contact_s = -math.inf
        #: (k, 3) forces of the stalks at rest, and their sizes [N].
        self._rest_forces = np.zeros((len(names), 3))
        # The arm is not placed yet, so it may touch fruit.
        flags, contact = int(model.opt.disableflags), int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.opt.disableflags = flags | contact
        mujoco.mj_forward(model, data)
        self._rest_forces = self._stalk_forces()
        model.opt.disableflags = flags
        self._weights = np.linalg.norm(self._rest_forces, axis=1)
        self._contacts: dict[tuple[str, str], _Extremes] = {}
        self._broken: dict[str, Damage] = {}
        self._knocked_off: dict[str, Damage] = {}
        #: Time, place and velocity of each fruit when it was released.
        self._released: dict[str, tuple[float, FloatArray, FloatArray]] = {}
        self._time, self._poses = list[float](), list[tuple[FloatArray, FloatArray, FloatArray]]()

    # Measurements.

    def note(self, contacts: Mapping[tuple[str, str], Sequence[int]]) -> None:
        """Record forces, deflections, stresses and damage in the current state.

        Args:
            contacts: Numbers of MuJoCo's contacts with limbs and hung fruit, by link and obstacle.
        """
        if contacts:
            self._last_contact_s = float(self._data.time)
        elif self._data.time > self._last_contact_s + _SETTLES_S and not self._is_new_gust:
            return
        self._is_new_gust = False
        self._note_stress()
        stalks = self._stalk_forces()
        for (link, obstacle), numbers in contacts.items():
            self._note_contact(link, obstacle, numbers, stalks)
        self._note_stalks(stalks)

    def _note_contact(self, link: str, obstacle: str, numbers: Sequence[int], stalks: FloatArray) -> None:
        model, data, time_s = self._model, self._data, float(self._data.time)
        force, wrench, deflection = 0.0, np.zeros(6), 0.0
        for number in numbers:
            self._mujoco.mj_contactForce(model, data, number, wrench)
            force += float(wrench[0])
            contact = data.contact[number]
            geom = next(int(geom) for geom in contact.geom if int(geom) in self._rest_of)
            tree = self._tree_of[geom]
            if self._spans is not None and math.isnan(self._blows_since[tree]):
                self.touched_still.add(obstacle)
            self._touched_s[tree] = time_s
            body = int(model.geom_bodyid[geom])
            local = data.xmat[body].reshape(3, 3).T @ (contact.pos - data.xpos[body])
            deflection = max(deflection, math.dist(contact.pos - local, self._rest_of[geom]))
        is_fruit = obstacle not in self._limb_rows
        if is_fruit:  # a blow on the fruit itself does not reach the stalk
            row = self._fruit_rows[obstacle]
            force = max(0.0, math.hypot(*stalks[row]) - float(self._weights[row]))
        path = () if is_fruit else self.bodies.limbs.path(self._limb_rows[obstacle])
        stress = 1e-6 * max((float(self._stress[row]) for row in path), default=0.0)
        known = self._contacts.setdefault((link, obstacle), _Extremes(time_s, is_fruit))
        known.end_s = time_s
        if force > known.force_n:
            known.force_n, known.force_s = force, time_s
        known.stress_mpa, known.deflection_m = max(stress, known.stress_mpa), max(deflection, known.deflection_m)

    def _note_stress(self) -> None:
        """Update the bending stress of each segment; record broken ones."""
        self._stress = self.bending_stress()
        np.maximum(self.max_stress_pa, self._stress, out=self.max_stress_pa)
        if self._stress.max(initial=0.0) <= self._strength_pa:
            return
        for row in np.flatnonzero(self._stress > self._strength_pa).tolist():
            name, stress = self.bodies.limbs.names[row], 1e-6 * float(self._stress[row])
            self._broken.setdefault(name, Damage(name, float(self._data.time), stress))

    def bending_stress(self) -> FloatArray:
        """(n,) largest bending stress of each limb in the current state [Pa]."""
        found = np.zeros(len(self.bodies.limbs.names))
        if len(self._bent):
            moment = self._stiffness[:, None] * self._data.qpos[self._q_at]
            first, second = moment[0::2], moment[1::2]
            at_start = first + _TO_START * (first - second)
            squares = [np.einsum("ij,ij->i", each, each) for each in (at_start, first, second)]
            largest = np.maximum(np.maximum(*squares[:2]), squares[2]) * self._square_per_moment
            found[self._bent] = np.sqrt(np.maximum.reduceat(largest, self._first))
        return found

    def _stalk_forces(self) -> FloatArray:
        """(k, 3) forces of the stalks on the fruit in the current state [N]."""
        if not len(self._fruit_ids):
            return np.zeros((0, 3))
        self._mujoco.mj_rnePostConstraint(self._model, self._data)
        found: FloatArray = self._data.cfrc_int[self._fruit_ids, 3:]
        asleep = self._data.body_awake[self._fruit_ids] == int(self._mujoco.mjtSleepState.mjS_ASLEEP)
        found[asleep] = self._rest_forces[asleep]
        return found

    def _note_stalks(self, stalks: FloatArray) -> None:
        """Release fruit whose stalk is loaded beyond its strength."""
        forces = np.sqrt(np.einsum("ij,ij->i", stalks, stalks))
        if len(self._released) == len(self._fruit_rows) or forces.max() <= self.bodies.trees.stalk_strength_n:
            return
        for row in np.flatnonzero(forces > self.bodies.trees.stalk_strength_n).tolist():
            name = self.bodies.fruits[row].name
            if name not in self._released:
                self._knocked_off[name] = Damage(name, float(self._data.time), float(forces[row]))
                self.release([name])

    def release(self, names: Collection[str]) -> None:
        """Take fruit off its stalk: it touches nothing any more, and does not load its limb.

        Names of anything else are ignored.
        """
        for name in names:
            row = self._fruit_rows.get(name)
            if row is None or name in self._released:
                continue
            body, geom, velocity = int(self._fruit_ids[row]), int(self._fruit_geoms[row]), np.zeros(6)
            kind = self._mujoco.mjtObj.mjOBJ_GEOM
            self._mujoco.mj_objectVelocity(self._model, self._data, kind, geom, velocity, 0)
            self._released[name] = float(self._data.time), np.array(self._data.geom_xpos[geom]), velocity[3:]
            self._model.geom_conaffinity[geom] = 0
            self._data.xfrc_applied[body] = 0.0
            remaining = 1e-4  # MuJoCo refuses bodies without mass
            self._model.body_mass[body] *= remaining
            self._model.body_inertia[body] *= remaining

    def move_only(self, times_s: Mapping[str, Sequence[tuple[float, float]]]) -> None:
        """Let wind move limbs and fruit only at given times; otherwise they rest, and cost little.

        Limbs that are connected move together. Wind begins to rise before each of the times, so that they sway then as
        if it had blown before, and moves them until `_AFTER_S` after it; soft limbs, on which wind has effects for
        longer than it blows before the motion, move all the time. Limbs that are touched while they rest bend, are
        listed in `touched_still`, and move in the wind as long as they are touched and `_AFTER_S` longer.

        Args:
            times_s: Begins and ends of the times when each limb or fruit moves, by name [s].
        """
        rows = sorted({
            self._span(tree, begin, end)
            for geom, tree in self._tree_of.items()
            for begin, end in times_s.get(self.bodies.obstacle_of[self._model.geom(geom).name], ())
        })  # fmt: skip
        table = np.array(rows).reshape(-1, 3)
        self._spans = table[:, 0].astype(np.int64), table[:, 1], table[:, 2]
        self._blows_since[:] = math.nan

    def change_step(self, step_s: float) -> float:
        """Change the time step; trees stay stable with any.

        Returns:
            The step until now [s].
        """
        model = self._model
        before_s, model.opt.timestep = float(model.opt.timestep), step_s
        # Stiffness times the step is part of the damping, which makes the method implicit.
        stiffness, damping = (table if table.ndim == 1 else table[:, 0]
                              for table in (model.jnt_stiffness, model.dof_damping))  # fmt: skip
        damping += (step_s - before_s) * stiffness[model.dof_jntid]
        return before_s

    def _span(self, tree: int, begin: float, end: float) -> tuple[int, float, float]:
        """Time when wind moves a kinematic tree for the sake of a shorter one [s]."""
        lead = float(self._lead_s[tree])
        return (tree, -lead, math.inf) if lead == _SETTLES_IN_S[1] else (tree, begin - lead, end + _AFTER_S)

    @property
    def settle_s(self) -> float:
        """Time for which wind has to blow before the first motion [s]."""
        if self.bodies.trees.wind is None:
            return 0.0
        return float(self._lead_s.max() if self._spans is None else -self._spans[1].min(initial=0.0))

    def _find_blown_on(self) -> None:
        """Begin to blow on trees, and put others to rest."""
        if self._spans is None:
            return
        time_s, is_blown_on = float(self._data.time), ~np.isnan(self._blows_since)
        moves = self._touched_s > time_s - _AFTER_S
        tree, begin, end = self._spans
        moves[tree[(begin <= time_s) & (time_s < end)]] = True
        self._blows_since[moves & ~is_blown_on] = time_s
        stop = is_blown_on & ~moves
        if stop.any():
            # MuJoCo lets limbs at rest sleep.
            self._blows_since[stop] = math.nan
            rows = stop[self._tree_of_q]
            self._data.qpos[rows] = self._model.qpos0[rows]
            self._data.qvel[stop[self._model.dof_treeid]] = 0.0

    def blow(self) -> None:
        """Apply the wind of the present time to limbs and fruit.

        Drag lasts as long as a speed of the wind: where limbs are at its start counts.
        """
        since_s = float(self._data.time) + float(self._lead_s.max())
        wind, row = self.bodies.trees.wind, int(since_s / _GUST_S + 1e-6)
        if wind is None or row == self._gust:
            return
        self._gust, self._is_new_gust = row, True
        self._find_blown_on()
        elapsed = np.nan_to_num(float(self._data.time) - self._blows_since, nan=0.0)
        rise = np.clip(elapsed / _RISE_S, 0.0, 1.0)
        rise = (rise**2 * (3.0 - 2.0 * rise))[self._model.body_treeid] ** 2  # of the drag on each body
        while row >= len(self._wind_speeds):
            self._wind_speeds = wind.speeds(max(10.0, 2.0 * len(self._wind_speeds) * _GUST_S), _GUST_S)
        speed = float(self._wind_speeds[row])
        body, local, axis, length, radius = self._pieces
        turns = self._data.xmat[body].reshape(-1, 3, 3)
        forces = wind.limb_drag(np.einsum("nij,nj->ni", turns, axis), length, radius, speed)
        levers = np.einsum("nij,nj->ni", turns, local) + self._data.xpos[body] - self._data.xipos[body]
        applied = self._data.xfrc_applied
        applied[self._body_ids] = 0.0
        np.add.at(applied, body, rise[body, None] * np.hstack([forces, np.cross(levers, forces)]))
        applied[self._fruit_ids, :3] = rise[self._fruit_ids, None] * wind.fruit_drag(self._fruit_radius, speed)
        released = [self._fruit_ids[self._fruit_rows[name]] for name in self._released]
        applied[released] = 0.0

    def _pieces_of_bodies(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Body, middle, axis, length and radius of each capsule that moves, relative to its body."""
        shapes = {body: shape for body, shape in self._shapes().items() if body > 0}
        fruit = set(self._fruit_ids.tolist())
        rows = [
            (body, start, end, radius)
            for body, (_, starts, ends, radii) in shapes.items()
            if body not in fruit
            for start, end, radius in zip(starts, ends, radii, strict=True)
        ]
        body = np.array([row[0] for row in rows], dtype=np.int64)
        start, end = (np.array([row[at] for row in rows]).reshape(-1, 3) for at in (1, 2))
        length = np.linalg.norm(end - start, axis=1)
        axis = (end - start) / np.maximum(length, 1e-12)[:, None]
        return body, 0.5 * (start + end), axis, length, np.array([row[3] for row in rows])

    # Motions.

    @property
    def fruit_places(self) -> FloatArray:
        """(f, 3) centres of the hung fruit [m].

        Released fruit is in free fall, or where it met the ground at the height 0.
        """
        found = np.array(self._data.geom_xpos[self._fruit_geoms])
        for name, (since, place, velocity) in self._released.items():
            row = self._fruit_rows[name]
            radius, elapsed = self.bodies.fruits[row].radius, float(self._data.time) - since
            height, rise = float(place[2]) - radius, float(velocity[2])
            landing = (rise + math.sqrt(max(rise**2 + 2.0 * GRAVITY * height, 0.0))) / GRAVITY
            elapsed = min(elapsed, max(landing, 0.0))
            found[row] = place + elapsed * velocity - [0.0, 0.0, 0.5 * GRAVITY * elapsed**2]
        return found

    def place_of(self, fruit: str) -> FloatArray | None:
        """(3,) centre of a hung fruit [m]; None for other fruit."""
        row = self._fruit_rows.get(fruit)
        found: FloatArray | None = None if row is None else self.fruit_places[row]
        return found

    def is_released(self, fruit: str) -> bool:
        """True if a fruit was knocked off or taken off its stalk."""
        return fruit in self._released

    def fruit_displacement_m(self) -> dict[str, float]:
        """Displacement of each fruit that still hangs, by name [m]."""
        rest = np.array([fruit.center for fruit in self.bodies.fruits]).reshape(-1, 3)
        moved = np.linalg.norm(self.fruit_places - rest, axis=1)
        return {name: float(moved[row]) for name, row in self._fruit_rows.items() if name not in self._released}

    def record(self) -> None:
        """Append the current poses to the recorded motion."""
        self._time.append(float(self._data.time))
        limb_ids = self._body_ids[: len(self._stiffness)]
        self._poses.append(
            (np.array(self._data.xpos[limb_ids]), np.array(self._data.xquat[limb_ids]), self.fruit_places)
        )

    def response(self, fruit_displacement_m: Mapping[str, float]) -> TreeResponse:
        """Return everything recorded until now.

        Args:
            fruit_displacement_m: Displacement of the fruit at the end of the motion [m].
        """
        return TreeResponse(
            wood=self.bodies.wood,
            contacts=tuple(
                LimbContact(
                    obstacle,
                    link,
                    one.begin_s,
                    one.end_s,
                    one.force_s,
                    one.force_n,
                    one.stress_mpa,
                    one.deflection_m,
                    one.is_fruit,
                )
                for (link, obstacle), one in self._contacts.items()
            ),
            broken=tuple(self._broken.values()),
            knocked_off=tuple(self._knocked_off.values()),
            hung=frozenset(self._fruit_rows),
            fruit_displacement_m=dict(fruit_displacement_m),
            motions=self._motions(),
        )

    def _motions(self) -> BodyMotions:
        """Recorded motions of the limbs and fruit that moved visibly; parts of these limbs that did not are at rest."""
        time = readonly(np.array(self._time))
        if not self._poses:
            return BodyMotions(time, (), ())
        # Bodies that moved less than this are drawn at rest [m].
        visible = 5e-4
        position, turn, fruit = (np.stack(parts, axis=1) for parts in zip(*self._poses, strict=True))
        shapes = self._shapes()
        origin, upright = np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])
        bodies = [BodyMotion(*shapes[0], origin, upright)] if 0 in shapes else []
        for row, body in enumerate(self._body_ids[: len(self._stiffness)].tolist()):
            start, end = shapes[body][1:3]
            ends = _transform(turn[row], np.concatenate([start, end])) + position[row][:, None]
            frames = slice(None if np.linalg.norm(ends - ends[0], axis=2).max() > visible else 1)
            bodies.append(BodyMotion(*shapes[body], position[row][frames], np.roll(turn[row][frames], -1, axis=1)))
        moved = {name for body in bodies for name in body.names if body.moves}
        limbs = tuple(part for body in bodies if (part := body.only(moved)).names)
        still = np.repeat(upright, len(time), axis=0)
        fruits = tuple(
            BodyMotion((item.name,), origin, origin, np.array([item.radius]), fruit[row], still)
            for row, item in enumerate(self.bodies.fruits)
            if np.linalg.norm(fruit[row] - fruit[row][0], axis=1).max() > visible
        )
        return BodyMotions(time, limbs, fruits)

    def _shapes(self) -> dict[int, tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]]:
        """Names, ends and radii of the capsules of each body of limbs."""
        found: dict[int, tuple[list[str], list[FloatArray], list[FloatArray], list[float]]] = {}
        for name, obstacle in self.bodies.obstacle_of.items():
            geom = self._model.geom(name)
            axis = np.zeros(9)
            self._mujoco.mju_quat2Mat(axis, geom.quat)
            half = geom.size[1] * axis.reshape(3, 3)[:, 2]
            parts = found.setdefault(int(geom.bodyid[0]), ([], [], [], []))
            for part, value in zip(parts, (obstacle, geom.pos - half, geom.pos + half, geom.size[0]), strict=True):
                part.append(value)  # type: ignore[attr-defined]
        return {
            body: (tuple(names), np.array(start), np.array(end), np.array(radius))
            for body, (names, start, end, radius) in found.items()
        }


def _transform(turns: FloatArray, points: FloatArray) -> FloatArray:
    """(k, n, 3) points rotated by (k, 4) quaternions w, x, y, z."""
    vector, scalar = turns[:, None, 1:], turns[:, None, :1]
    cross = np.cross(vector, points[None])
    found: FloatArray = points + 2.0 * (scalar * cross + np.cross(vector, cross))
    return found
