"""What `scripts/reproduce_paper.py` does: the paper's numbers measured again, its figures, random planar scenes.

`measure` takes the numbers with the help of `plain` (the paper's method to the letter) and tells them; `figures` draws
the paper's figures by its own numbers. `random_scenes` compares two-level and dense search on scenes that the paper
does not have.
"""
