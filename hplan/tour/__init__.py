"""Picking tours: motions between fruits and the fastest picking order."""
