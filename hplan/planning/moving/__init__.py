"""Motions among moving obstacles: clear cells of path and time, fastest schedule.

Nothing here is a proof: the certificate is.
"""
