"""The certificate: clearance in continuous time, limits between rows, torque bounds, digests.

`clearance_proof` has the bound on how far a point can move between two instants. May use the rooms up to `timing`.
"""
