"""A picking tube at the end of an arm whose file ends at the flange."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.errors import RobotFileError
from hplan.robot.faults import Faults
from hplan.robot.tool_axis import find_tool_axis
from hplan.robot.urdf_adaptation import AdaptedUrdf, set_origin
from hplan.robot.urdf_check import frame_number
from hplan.robot.urdf_file import read_urdf

#: Name of the tube, its link, and of the frame at its mouth, which becomes the tool frame.
TUBE: Final = "tool_tube"
TUBE_END: Final = "tool_tube_end"


def add_tool_tube(path: Path, root: ET.Element, adapted: AdaptedUrdf, length_m: float) -> AdaptedUrdf:
    """Return an adapted URDF with a tube at its tool frame, along the tool axis.

    The tube's radius is a ninth of its length, at most 20 mm; its mass is 1 kg for each metre. The tool frame is moved
    to its mouth, with z along the tube.

    Args:
        path: The file, for messages.
        root: Root element of the adapted URDF; modified in place.
        adapted: The adapted URDF.
        length_m: Length of the tube [m].

    Raises:
        RobotFileError: The arm has a link of that name, or Pinocchio refuses the file.
    """
    urdf, frame = adapted.urdf, adapted.tool_frame
    taken = [name for name in (TUBE, TUBE_END) if name in urdf.links or name in urdf.joints]
    if taken:
        raise RobotFileError(path, f"it has a part {taken[0]!r} already: load it without tool_tube_m (--tool-tube)")
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise RobotFileError(path, f"Pinocchio refuses it: {error}") from error
    axis = find_tool_axis(model, frame_number(model, frame))
    along = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(axis)).toRotationMatrix()
    radius = min(0.02, length_m / 9.0)
    lean, across = length_m**3 / 12.0, 0.5 * length_m * radius**2
    cylinder = f'<cylinder radius="{radius!r}" length="{length_m!r}"/>'
    shape = f'<origin xyz="0 0 {0.5 * length_m!r}"/><geometry>{cylinder}</geometry>'
    tube = ET.fromstring(
        f'<link name="{TUBE}"><inertial><origin xyz="0 0 {0.5 * length_m!r}"/><mass value="{length_m!r}"/>'
        f'<inertia ixx="{lean!r}" iyy="{lean!r}" izz="{across!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<visual>{shape}</visual><collision>{shape}</collision></link>"
    )
    carrier = urdf.joints[frame].child if frame in urdf.joints and frame not in urdf.links else frame
    root.append(tube)
    ET.SubElement(root, "link", name=TUBE_END)
    mouth = pin.SE3(np.eye(3), np.array([0.0, 0.0, length_m]))
    for parent, child, place in ((carrier, TUBE, pin.SE3(along, np.zeros(3))), (TUBE, TUBE_END, mouth)):
        joint = ET.SubElement(root, "joint", name=f"{child}_joint", type="fixed")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        set_origin(joint, place)
    faults = Faults(path)
    changed = read_urdf(path, root, faults=faults)
    faults.check()
    text = ET.tostring(root, encoding="unicode")
    return replace(adapted, urdf=changed, text=text, tool_frame=TUBE_END)
