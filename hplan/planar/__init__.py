"""Planar arms: an optional yaw joint, then parallel revolute joints.

The room adds the published method to planning: the analytic C-space, two-level A* on its grid, proofs that no path
exists, closed-form inverse kinematics, and pages of the C-space. `extension` registers them; no other room imports this
one. `grid` holds the C-space and its searches, `pages` the pictures.
"""
