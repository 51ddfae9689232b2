"""Execution of motions on an arm simulated in MuJoCo.

`simulation.execute` runs a whole motion; `SimulatedArm` advances by single control periods.
"""
