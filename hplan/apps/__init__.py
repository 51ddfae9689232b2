"""What stands on top of the planner: the `hplan` command, the animated page, ROS 2 messages, a simulated arm.

Nothing below imports it, and no part of it is imported before it is used.
"""
