"""Applications: the `hplan` command, the animated page, ROS 2 messages, simulation.

No other room imports this one, and each part of it is imported on first use.
"""
