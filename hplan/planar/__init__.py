"""The planar chain in closed form: forward and inverse kinematics of links in a vertical plane, straight approaches.

May use `base`, `scene` and `robot`.
"""
