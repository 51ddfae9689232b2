"""Collision bodies of any robot and their distances.

Both back ends read the convex bodies of `collision_bodies`, the self-collision pairs of `self_pairs` and `self_folds`,
the `motion_coefficients` that bound how far joints move bodies, and the contacts permitted by `compliant_solids`.

Two back ends answer the questions of `distance_checker`:

- `compiled_*`: numba kernels for the planner. `compiled_field` is the entry.
- `coal_*`: coal through Pinocchio for the certificate. `coal_scene` is the entry.
"""
