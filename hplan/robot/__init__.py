"""Robots: URDF, limits, kinematics, dynamics, collision bodies, self-contact and tracking error.

Files are read strictly. `family` generates members of the harvester family.
"""
