"""Direction in which a tool points.

It is along the z axis of its frame, or along the last link.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, readonly
from hplan.robot.dynamics import joint_axis

#: Offsets below this count as zero [m], and sines below this as parallel.
_TOLERANCE = 1e-6


def find_tool_axis(model: pin.Model, frame: int) -> FloatArray:
    """Return the (3,) pointing direction of a tool frame, in the frame.

    By convention a tool points along the z axis of its frame. Some frames have another convention, with x forward: z is
    then perpendicular both to the last joint's axis and to the last link, the line from that axis to the tool. Such a
    tool points along the last link. So does one whose arm cannot move it along z at all, because all joints turn about
    axes parallel to z.

    Args:
        model: The kinematic model.
        frame: Number of the tool frame.
    """
    placement = model.frames[frame].placement
    joint, z = int(model.frames[frame].parentJoint), placement.rotation[:, 2]
    along_z = readonly([0.0, 0.0, 1.0])
    axis, slides = joint_axis(model, joint) if joint else (z, True)
    if slides:
        return along_z
    link = placement.translation - (placement.translation @ axis) * axis
    length = float(np.linalg.norm(link))
    if length <= _TOLERANCE:
        return along_z
    link /= length
    if _moves_along(model, joint, z) and max(abs(z @ axis), abs(z @ link)) > _TOLERANCE:
        return along_z
    return readonly(placement.rotation.T @ link)


def _moves_along(model: pin.Model, joint: int, z: FloatArray) -> bool:
    """True if a joint can move bodies along z.

    A joint up to the given one slides, or turns about an axis that is not parallel to z.
    """
    direction = z  # in the frame of `joint`, with all joints at 0
    while joint:
        axis, slides = joint_axis(model, joint)
        if slides or np.linalg.norm(np.cross(axis, direction)) > _TOLERANCE:
            return True
        direction, joint = model.jointPlacements[joint].rotation @ direction, int(model.parents[joint])
    return False
