"""Planning while a controller runs: frames of a depth camera come in, the scene changes, the arm moves.

`planner` plans again when the scene changes, `splice` while a motion runs; `frame` and `scene_cloud` are the camera's
points: cropped, thinned, without the arm and what is known, remembered where hidden.
"""
