"""Reads a MuJoCo model (MJCF) as a URDF.

MuJoCo parses and compiles the file (extra `execution`): includes, defaults, frames and inertias from geoms are resolved
as in the simulator. The compiled bodies, joints, geoms, sites and actuators are written as the elements of a URDF,
which is then read like any other one.

| MJCF | URDF |
|---|---|
| body | link; several joints of a body, and joints off its origin, have links of their own |
| hinge, slide | `revolute` (`continuous` without a range), `prismatic`; 0 is where MuJoCo has 0, at `ref` too |
| free and ball joints | `floating`: held as they are, if the arm's chain does not need them |
| joint equality | `mimic`; other equality constraints have no effect |
| geoms that collide | `<collision>`; capsules are exact, ellipsoids boxes; planes and height fields are left out |
| other geoms | `<visual>` |
| sites | links without a body, for tool frames |
| actuator force ranges | efforts, transmitted to the joint, of the weaker direction; those of the joint itself first |
| armature | rotor inertia |

MJCF has no velocity limits: `VELOCITY_GUESS` is assumed. Springs, damping, friction and tendons are ignored;
so is `option gravity`, with a warning if it is not 9.81 m/s^2 along -z.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.base.lazy_import import extra
from hplan.errors import RobotFileError
from hplan.robot.xml_element import Element

#: Offsets of a joint from its body's origin below this count as none [m].
_AT_ORIGIN: Final = 1e-9

#: Velocities assumed without a velocity limit, of revolute and of prismatic joints [rad/s, m/s].
VELOCITY_GUESS: Final = (1.0, 0.1)

#: Gravity of hplan's models, and the difference from it that counts as none [m/s^2].
_GRAVITY: Final = (0.0, 0.0, -9.81)
_GRAVITY_OFF: Final = 0.02

#: Suffixes of mesh files that Pinocchio reads.
_MESHES: Final = (".stl", ".obj", ".dae", ".ply")


def urdf_of_mjcf(path: Path, text: str | None = None) -> Element:
    """Return the root element of a URDF with the content of an MJCF file.

    Args:
        path: The file.
        text: The content, without other files; None to read the file.

    Raises:
        RobotFileError: MuJoCo refuses the file, or a mesh has no file of a known kind.
        InputError: `mujoco` is not installed.
    """
    with extra("execution", f"robot file {path}: MJCF needs mujoco", path=str(path)):
        import mujoco
    try:
        spec = mujoco.MjSpec.from_file(str(path)) if text is None else mujoco.MjSpec.from_string(text)
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise RobotFileError(path, f"MuJoCo refuses it: {error}") from error
    return _Writer(path, spec, model, mujoco).write()


class _Writer:
    """Writes the elements of one compiled model."""

    def __init__(self, path: Path, spec: Any, model: Any, mujoco: Any) -> None:
        self._path = path
        self._spec = spec
        self._model = model
        self._mujoco = mujoco
        self._root = Element("robot", {"name": spec.modelname or path.stem})
        self._root.is_made = True
        self._assumed: dict[str, list[str]] = {}
        self._names: set[str] = set()
        self._links = [self._name("BODY", body) for body in range(model.nbody)]
        self._joints = [self._name("JOINT", joint) for joint in range(model.njnt)]

    def write(self) -> Element:
        """Return the root element."""
        for body in range(self._model.nbody):
            self._body(body)
        for site in range(self._model.nsite):
            link = Element("link", {"name": self._name("SITE", site)})
            self._root.append(link)
            place = _placement(self._model.site_pos[site], self._model.site_quat[site])
            self._fixed(self._links[self._model.site_bodyid[site]], str(link.get("name")), place)
        self._root.assumed = self._assumed
        gravity = self._model.opt.gravity
        if not np.allclose(gravity, _GRAVITY, atol=_GRAVITY_OFF):
            given = " ".join(f"{value:g}" for value in gravity)
            self._root.ignored = (f"option gravity {given} is not taken over: expected 0 0 {_GRAVITY[2]:g} m/s^2",)
        return self._root

    def _name(self, kind: str, number: int) -> str:
        """Name of a body, joint or site; unnamed ones are numbered, sites called like bodies marked."""
        found = self._mujoco.mj_id2name(self._model, getattr(self._mujoco.mjtObj, f"mjOBJ_{kind}"), number)
        name = found or f"{kind.lower()}_{number}"
        if kind != "JOINT":
            while name in self._names:
                name += f"_{kind.lower()}"
            self._names.add(name)
        return name

    def _body(self, body: int) -> None:
        """Write a body: its link, and the joints that move it."""
        model, name = self._model, self._links[body]
        link = Element("link", {"name": name})
        self._root.append(link)
        if model.body_mass[body] > 0.0:
            self._inertial(link, body)
        for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
            self._geom(link, geom)
        if body == 0:
            return
        parent = self._links[model.body_parentid[body]]
        place = _placement(model.body_pos[body], model.body_quat[body])
        at = np.zeros(3)  # where the present link is in the body's frame
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            anchor = np.array(model.jnt_pos[joint])
            is_last = joint == first + model.body_jntnum[body] - 1 and np.linalg.norm(anchor) <= _AT_ORIGIN
            child = name if is_last else f"{name}_at_{self._joints[joint]}"
            if not is_last:
                self._root.append(Element("link", {"name": child}))
            self._joint(joint, parent, child, place * pin.SE3(np.eye(3), anchor - at))
            parent, place, at = child, pin.SE3.Identity(), anchor
            if is_last:
                return
        self._fixed(parent, name, place * pin.SE3(np.eye(3), -at))

    def _inertial(self, link: Element, body: int) -> None:
        model = self._model
        inertial = ET.SubElement(link, "inertial")
        place = _placement(model.body_ipos[body], model.body_iquat[body])
        _set_origin(inertial, pin.SE3(np.eye(3), place.translation))
        ET.SubElement(inertial, "mass", {"value": repr(float(model.body_mass[body]))})
        matrix = place.rotation @ np.diag(model.body_inertia[body]) @ place.rotation.T
        rows = {
            f"i{a}{b}": repr(float(matrix["xyz".index(a), "xyz".index(b)]))
            for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        }
        ET.SubElement(inertial, "inertia", rows)

    def _joint(self, joint: int, parent: str, child: str, place: pin.SE3) -> None:
        model, kinds = self._model, self._mujoco.mjtJoint
        kind, axis, limit = int(model.jnt_type[joint]), np.array(model.jnt_axis[joint]), dict[str, float]()
        is_limited, zero = bool(model.jnt_limited[joint]), float(model.qpos0[model.jnt_qposadr[joint]])
        if kind == int(kinds.mjJNT_SLIDE):
            named, place = "prismatic", place * pin.SE3(np.eye(3), -zero * axis)
        elif kind == int(kinds.mjJNT_HINGE):
            named = "revolute" if is_limited else "continuous"
            place = place * pin.SE3(pin.AngleAxis(-zero, axis).toRotationMatrix(), np.zeros(3))
        else:
            named = "floating"
        element = Element("joint", {"name": self._joints[joint], "type": named})
        self._root.append(element)
        _set_origin(element, place)
        ET.SubElement(element, "parent", {"link": parent})
        ET.SubElement(element, "child", {"link": child})
        if named == "floating":
            return
        ET.SubElement(element, "axis", {"xyz": _text(axis)})
        if is_limited:
            limit |= {"lower": model.jnt_range[joint][0], "upper": model.jnt_range[joint][1]}
        effort, speed = self._effort(joint), VELOCITY_GUESS[named == "prismatic"]
        limit |= {"velocity": speed, "effort": 1.0 if effort is None else effort}
        self._assumed[self._joints[joint]] = ["velocity"] + ["effort"] * (effort is None)
        ET.SubElement(element, "limit", {key: repr(float(value)) for key, value in limit.items()})
        armature = float(model.dof_armature[model.jnt_dofadr[joint]])
        if armature:
            ET.SubElement(element, "dynamics", {"damping": "0.0", "friction": "0.0", "armature": repr(armature)})
        mimic = self._mimic(joint)
        if mimic is not None:
            ET.SubElement(element, "mimic", mimic)

    def _effort(self, joint: int) -> float | None:
        """Maximum torque or force at a joint [N m, N]; None if nothing gives it."""
        model = self._model
        if model.jnt_actfrclimited[joint]:
            return _both_ways(model.jnt_actfrcrange[joint])
        total, found = 0.0, False
        kinds, no_bias = self._mujoco.mjtTrn, int(self._mujoco.mjtBias.mjBIAS_NONE)
        transmitted = int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)
        for actuator in range(model.nu):
            if int(model.actuator_trntype[actuator]) not in transmitted or model.actuator_trnid[actuator][0] != joint:
                continue
            gear = abs(float(model.actuator_gear[actuator][0]))
            is_motor = int(model.actuator_biastype[actuator]) == no_bias
            if model.actuator_forcelimited[actuator]:
                force = _both_ways(model.actuator_forcerange[actuator])
            elif is_motor and model.actuator_ctrllimited[actuator]:
                gain = float(model.actuator_gainprm[actuator][0])
                force = _both_ways(gain * model.actuator_ctrlrange[actuator])
            else:
                force = None
            if force is None:
                return None
            total, found = total + gear * force, True
        return total if found else None

    def _mimic(self, joint: int) -> dict[str, str] | None:
        """The joint that another one follows by a linear equality, or None."""
        model = self._model
        for equality in range(model.neq):
            one, other = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            is_joint = int(model.eq_type[equality]) == int(self._mujoco.mjtEq.mjEQ_JOINT)
            if not (is_joint and model.eq_active0[equality] and one == joint and other >= 0):
                continue
            offset, ratio, *curved = model.eq_data[equality][:5].tolist()
            if any(curved):
                continue
            zero, leading = (float(model.qpos0[model.jnt_qposadr[each]]) for each in (one, other))
            offset += zero - ratio * leading
            return {"joint": self._joints[other], "multiplier": repr(ratio), "offset": repr(offset)}
        return None

    def _geom(self, link: Element, geom: int) -> None:
        model = self._model
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        place, kind = _placement(model.geom_pos[geom], model.geom_quat[geom]), "collision" if collides else "visual"
        for shape, at in self._shapes(geom, place):
            element = ET.SubElement(link, kind)
            _set_origin(element, at)
            ET.SubElement(element, "geometry").append(shape)

    def _shapes(self, geom: int, place: pin.SE3) -> Iterator[tuple[Element, pin.SE3]]:
        """Shapes of a geom, each with its placement."""
        model, kinds = self._model, self._mujoco.mjtGeom
        kind, size = int(model.geom_type[geom]), model.geom_size[geom].tolist()
        if kind == int(kinds.mjGEOM_SPHERE):
            yield Element("sphere", {"radius": repr(size[0])}), place
        elif kind == int(kinds.mjGEOM_BOX) or kind == int(kinds.mjGEOM_ELLIPSOID):
            yield Element("box", {"size": _text(2.0 * np.array(size))}), place
        elif kind == int(kinds.mjGEOM_CYLINDER) or kind == int(kinds.mjGEOM_CAPSULE):
            yield Element("cylinder", {"radius": repr(size[0]), "length": repr(2.0 * size[1])}), place
            for end in (-size[1], size[1]) if kind == int(kinds.mjGEOM_CAPSULE) else ():
                at = place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))
                yield Element("sphere", {"radius": repr(size[0])}), at
        elif kind == int(kinds.mjGEOM_MESH):
            mesh = int(model.geom_dataid[geom])
            file = self._mesh_file(mesh)
            # MuJoCo moves the vertices to the mesh's centre of mass and principal axes.
            moved = _placement(model.mesh_pos[mesh], model.mesh_quat[mesh])
            scale = _text(model.mesh_scale[mesh])
            yield Element("mesh", {"filename": str(file), "scale": scale}), place * moved.inverse()
        elif kind == int(kinds.mjGEOM_SDF) and (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            name = self._mujoco.mj_id2name(model, self._mujoco.mjtObj.mjOBJ_GEOM, geom) or f"number {geom}"
            raise RobotFileError(self._path, f"geom {name!r} is an sdf; expected primitives or a mesh for contacts")

    def _mesh_file(self, mesh: int) -> Path:
        """File of a mesh.

        Raises:
            RobotFileError: It has no file, or one that Pinocchio does not read, or has its own reference frame.
        """
        name = self._mujoco.mj_id2name(self._model, self._mujoco.mjtObj.mjOBJ_MESH, mesh)
        source = self._spec.mesh(name)
        file = Path(source.file)
        if source.file and not file.is_absolute():
            file = (Path(self._spec.modelfiledir) / self._spec.meshdir / file).absolute()
        if not source.file or file.suffix.lower() not in _MESHES:
            given = source.file or "none"
            raise RobotFileError(
                self._path, f"mesh {name!r} has the file {given}; expected one of {', '.join(_MESHES)}"
            )
        if np.any(source.refpos) or not np.allclose(np.abs(source.refquat), (1.0, 0.0, 0.0, 0.0)):
            raise RobotFileError(self._path, f"mesh {name!r} has refpos or refquat; move the geom instead")
        return file

    def _fixed(self, parent: str, child: str, place: pin.SE3) -> None:
        """Attach a link to another one."""
        element = Element("joint", {"name": f"{child}_fixed", "type": "fixed"})
        self._root.append(element)
        _set_origin(element, place)
        ET.SubElement(element, "parent", {"link": parent})
        ET.SubElement(element, "child", {"link": child})


def _both_ways(span: FloatArray) -> float | None:
    """Maximum force in either direction within a range; None if there is none in one of them."""
    most = min(-float(span.min()), float(span.max()))
    return most if most > 0.0 else None


def _placement(position: FloatArray, quaternion_wxyz: FloatArray) -> pin.SE3:
    w, x, y, z = quaternion_wxyz.tolist()
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(position))


def _set_origin(element: ET.Element, place: pin.SE3) -> None:
    roll, pitch, yaw = pin.rpy.matrixToRpy(place.rotation).tolist()
    angles = [0.0 if math.isnan(angle) else angle for angle in (roll, pitch, yaw)]
    ET.SubElement(element, "origin", {"xyz": _text(place.translation), "rpy": _text(np.array(angles))})


def _text(numbers: FloatArray) -> str:
    return " ".join(repr(float(number)) for number in numbers)
