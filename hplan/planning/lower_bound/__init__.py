"""Lower bounds of the duration of all motions between two configurations.

`joint_tubes` bounds each joint's position over time, `cells` decides which cells the arm can pass in that time, and
`duration_bound` searches the longest duration that is proved infeasible. The proof is in `docs/proof.md`.
"""
