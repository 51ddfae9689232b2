"""URDFs of small chains, of joints of any type."""

from __future__ import annotations

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


#: Joints as of a UR5, with their places and axes: a yaw, three parallel ones beside the plane, and two more across.
_SIX_AXES = (
    ("shoulder_pan", "0 0 0.089", "0 0 1"),
    ("shoulder_lift", "0 0.136 0", "0 1 0"),
    ("elbow", "0 -0.12 0.425", "0 1 0"),
    ("wrist_1", "0 0 0.392", "0 1 0"),
    ("wrist_2", "0 0.093 0", "0 0 1"),
    ("wrist_3", "0 0 0.095", "0 1 0"),
)

#: Shapes of their links, as the content of `<geometry>`, and where they are.
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
