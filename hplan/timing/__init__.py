"""Time along a path: velocity, acceleration, torque and jerk limits, toppra's passes, trajectories and their CSV.

May use the rooms up to `collision`.
"""
