"""URDFs of small chains, of joints of any type."""

from __future__ import annotations

import math

LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="60"/>'


def urdf(*joints: str, chain: tuple[str, ...] = ("a", "b")) -> str:
    """A chain of 1 kg links, 0.4 m apart along x, that turn about y."""
    joints = joints or tuple(f'<joint name="{name}" type="revolute">{LIMIT}' for name in chain)
    inertial = (
        '<inertial><origin xyz="0.2 0 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    parts = ['<robot name="toy"><link name="l0"/>']
    for i, joint in enumerate(joints):
        parts.append(f'<link name="l{i + 1}">{inertial}</link>{joint}<origin xyz="{0.4 * (i > 0)} 0 0"/>')
        parts.append(f'<axis xyz="0 -1 0"/><parent link="l{i}"/><child link="l{i + 1}"/></joint>')
    return "".join([*parts, "</robot>"])


#: Joints as in a UR5, with positions and axes: a yaw, three parallel joints with an offset from the plane, and two
#: across.
_SIX_AXES = (
    ("shoulder_pan", "0 0 0.089", "0 0 1"),
    ("shoulder_lift", "0 0.136 0", "0 1 0"),
    ("elbow", "0 -0.12 0.425", "0 1 0"),
    ("wrist_1", "0 0 0.392", "0 1 0"),
    ("wrist_2", "0 0.093 0", "0 0 1"),
    ("wrist_3", "0 0 0.095", "0 1 0"),
)

#: Shapes of their links, as the content of `<geometry>`, and their poses.
_SIX_SHAPES = (
    ('<sphere radius="0.07"/>', "0 0 0"),
    ('<cylinder radius="0.05" length="0.42"/>', "0 0 0.21"),
    ('<box size="0.07 0.07 0.38"/>', "0 0 0.2"),
    ('<cylinder radius="0.04" length="0.1"/>', "0 0.05 0"),
    ('<sphere radius="0.045"/>', "0 0 0.03"),
    ('<box size="0.06 0.08 0.06"/>', "0 0.04 0"),
)

SIX_AXIS_LIMITS = "format: hplan-limits/1\nacceleration_rad_s2: {" + ", ".join(f"{n}: 5" for n, *_ in _SIX_AXES) + "}\n"


def six_axis_arm() -> str:
    """An arm of the kind of a UR5, of spheres, cylinders and boxes, on a pedestal."""
    parts = [
        '<robot name="six_axes"><link name="base_link"><collision><origin xyz="0 0 -0.06"/>'
        '<geometry><cylinder radius="0.08" length="0.12"/></geometry></collision></link>'
    ]
    parent = "base_link"
    for (name, xyz, axis), (shape, place) in zip(_SIX_AXES, _SIX_SHAPES, strict=True):
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="3" effort="150"/></joint>'
            f'<link name="{name}_link"><inertial><origin xyz="{place}"/><mass value="2"/>'
            '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            f'<collision><origin xyz="{place}"/><geometry>{shape}</geometry></collision></link>'
        )
        parent = f"{name}_link"
    parts.append(
        f'<joint name="flange" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        '<origin xyz="0 0.08 0"/></joint><link name="tool0"/></robot>'
    )
    return "\n".join(parts)


def six_axis_picker() -> str:
    """The six axes with a tube of 15 cm at the flange, the tool frame at its end, along the last joint's axis."""
    tube = (
        '<link name="picker"><collision><origin xyz="0 0 0.075"/><geometry><cylinder radius="0.015" length="0.15"/>'
        '</geometry></collision></link><joint name="flange" type="fixed"><parent link="wrist_3_link"/><child '
        'link="picker"/><origin xyz="0 0.08 0" rpy="-1.5707963267948966 0 0"/></joint><joint name="tip" type="fixed">'
        '<parent link="picker"/><child link="tool0"/><origin xyz="0 0 0.15"/></joint><link name="tool0"/></robot>'
    )
    whole = six_axis_arm()
    return whole[: whole.index('<joint name="flange"')] + tube


#: Joints in the manner of a KUKA LBR iiwa 14, upright at 0: height above the joint before [m], axis, range [deg], speed
#: [deg/s], torque [N m], acceleration [rad/s^2]; mass of the link [kg], radius, length and center height of its
#: cylinder [m].
_SEVEN_AXES = (
    (0.1575, "0 0 1", 170, 85, 320, 8.57, 5.8, 0.09, 0.28, 0.12),
    (0.2025, "0 1 0", 120, 85, 320, 8.57, 6.4, 0.09, 0.26, 0.10),
    (0.2045, "0 0 1", 170, 100, 176, 8.74, 3.5, 0.08, 0.28, 0.12),
    (0.2155, "0 -1 0", 120, 75, 176, 11.36, 3.5, 0.08, 0.24, 0.09),
    (0.1845, "0 0 1", 170, 130, 110, 12.23, 3.5, 0.07, 0.26, 0.12),
    (0.2155, "0 1 0", 120, 135, 40, 15.72, 1.8, 0.065, 0.12, 0.03),
    (0.081, "0 0 1", 175, 135, 40, 15.72, 1.2, 0.045, 0.04, 0.025),
)


def seven_axis_arm() -> str:
    """An arm of the kind of an iiwa, of cylinders; a URDF of version 1.2, with accelerations."""

    def cylinder(radius: float, length: float, middle: float) -> str:
        return (
            f'<collision><origin xyz="0 0 {middle}"/><geometry><cylinder radius="{radius}" length="{length}"/>'
            "</geometry></collision>"
        )

    parts = [f'<robot name="seven_axes"><link name="base_link">{cylinder(0.12, 0.15, 0.075)}</link>']
    parent = "base_link"
    for number, (height, axis, turn, speed, torque, push, mass, *shape) in enumerate(_SEVEN_AXES, start=1):
        end, rate, inertia = math.radians(turn), math.radians(speed), 0.004 * mass
        parts.append(
            f'<joint name="joint_{number}" type="revolute"><parent link="{parent}"/><child link="link_{number}"/>'
            f'<origin xyz="0 0 {height}"/><axis xyz="{axis}"/><limit lower="{-end}" upper="{end}" velocity="{rate}" '
            f'effort="{torque}" acceleration="{push}"/></joint><link name="link_{number}"><inertial>'
            f'<origin xyz="0 0 {shape[2]}"/><mass value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" '
            f'izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>{cylinder(*shape)}</link>'
        )
        parent = f"link_{number}"
    parts.append(
        f'<joint name="flange" type="fixed"><parent link="{parent}"/><child link="tool0"/><origin xyz="0 0 0.045"/>'
        '</joint><link name="tool0"/></robot>'
    )
    return "\n".join(parts)
