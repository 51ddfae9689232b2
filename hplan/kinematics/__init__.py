"""Inverse kinematics of any robot: configurations with a frame at a pose, sought from many starts.

That of the planar family, in closed form and complete, is in `hplan.planar`.
"""
