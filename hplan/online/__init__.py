"""Planning while a controller runs.

Camera frames arrive, the scene changes, the arm moves. `planner` replans when the scene changes, `splice` replans
during a motion. `frame` and `frame_check` process camera points: crop, thin, remove the arm and known objects, and
remember hidden points.
"""
