"""Inverse kinematics: any robot's from many starts, the planar family's in closed form; straight lines of the tool."""
