"""Inverse kinematics: numerical, closed-form for planar arms, straight tool motions."""
