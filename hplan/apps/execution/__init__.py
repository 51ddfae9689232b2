"""Motions executed by a simulated arm (MuJoCo): a whole one, or one control period after the other."""
