"""New members of the harvester family: a specification of links and limits in, URDF and limits file out.

May use `base`, `scene` and `robot`.
"""

from hplan.robot_family.members import CrossCheck, cross_check, write_robot
from hplan.robot_family.spec import HARVESTER, ArmSpec

__all__ = ["HARVESTER", "ArmSpec", "CrossCheck", "cross_check", "write_robot"]
