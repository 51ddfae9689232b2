"""Sampling-based planning: RRT-Connect with edges verified over continuous time."""
