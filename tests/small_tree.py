"""A small tree with a few fruits, as a file of measured trees has one."""

from __future__ import annotations

TREE = """kind,x1,y1,z1,x2,y2,z2,radius
trunk,0,0,0,0,0,1.9,0.03
branch,0,0,0.8,-0.1,0.5,1.1,0.012
branch,0,0,1.2,0.1,-0.5,1.5,0.010
shoot,-0.1,0.5,1.1,-0.3,0.6,1.2,0.004
fruit,-0.12,0.5,1.0,-0.12,0.5,1.0,0.035
fruit,-0.31,0.62,1.14,-0.31,0.62,1.14,0.035
fruit,0.1,-0.5,1.4,0.1,-0.5,1.4,0.035
fruit,0.0,0.1,9.0,0.0,0.1,9.0,0.035
"""
