"""Collision bodies of any robot: convex cores with a radius, how far joints move them, which pairs may touch.

May use `base`, `scene` (solids) and `robot`. Knows nothing of obstacles, and nothing of the planar family.
"""
