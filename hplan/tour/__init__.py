"""Picking tours: motions between fruits and the order of the fruits that takes the least time."""
