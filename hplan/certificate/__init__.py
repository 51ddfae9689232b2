"""The certificate: clearance in continuous time, limits between samples, torque bounds, digests.

`clearance_proof` bounds how far a point can move between two instants. No module here depends on how a motion was
found.
"""
