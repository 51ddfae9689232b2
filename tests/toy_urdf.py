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
