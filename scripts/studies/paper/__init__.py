"""What `scripts/reproduce_paper.py` does: the paper's numbers measured again, and its figures.

`measure` takes the numbers with the help of `plain` (the paper's method to the letter) and tells them; `figures` draws
the paper's figures by its own numbers.
"""
