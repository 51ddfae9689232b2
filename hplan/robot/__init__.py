"""Robots: URDF and limits read strictly, Pinocchio's model, dynamics, collision bodies, self-contact, tracking error.

Knows nothing of joint grids; `family` makes new members of the harvester family.
"""
