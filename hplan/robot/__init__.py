"""Robots: URDF and limits read strictly, Pinocchio's model, dynamics, collision bodies, self-contact, tracking error.

May use `base` and `scene` (solids). Knows nothing of joint grids or of the planar kinematics of the family.
"""
