"""Paths by sampling, by RRT-Connect, with edges verified collision-free over continuous time."""
