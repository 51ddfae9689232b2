"""What `scripts/reproduce_paper.py` does: the paper's numbers measured again, its figures, random planar scenes.

`measure` takes the numbers (`results`) with the help of `plain` (the paper's method to the letter), `variants` (what
its text leaves open), `ties`, `slip` and `demonstration`; `tables` shows them, `figures` draws the paper's figures by
its own numbers, each in the module of its subject. `random_scenes` compares two-level and dense search on scenes that
the paper does not have; `output` writes the files.
"""
