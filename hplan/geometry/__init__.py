"""Convex hulls, ball clouds, polygons and polylines, and their distances.

Knows no robot and no scene. Compiled: `convex_distance` (GJK), `penetration` (EPA), `segment_distance`, `vectors`,
`cloud_tree`; the rest is NumPy, and `coal_hull` for coal.
"""
