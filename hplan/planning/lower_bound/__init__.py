"""Lower bounds of the duration of a motion: proofs that no motion between two configurations is faster.

`joint_tubes` bounds where each joint can be when, `occupied_cells` and `reachability` what the arm can pass in that
time, `duration_bound` searches the longest duration that is shown to be too short. The proof is in `docs/proof.md`.
"""
