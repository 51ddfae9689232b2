"""Inverse kinematics from many starts, and straight tool motions."""
