"""From a grid path to a smooth curve worth executing: shortcuts, rounded corners, splines, least duration, repair.

Every change is shown clear of contact before it is taken. May use the rooms up to `timing`.
"""
