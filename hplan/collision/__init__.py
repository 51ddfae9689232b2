"""Collision bodies of any robot and their distances.

Compiled kernels compute distances for the planner, coal computes them for the certificate. `collision_bodies` are
convex cores with a radius; `reach` and `twists` bound how far and how fast joints move them; `arm_pairs` and
`geometry_pairs` select the pairs to check.
"""
