"""The parts of `scripts/reproduce_paper.py`: the paper's numbers and figures.

`measure` takes the numbers with the help of `plain` (the paper's method to the letter) and reports them; `figures`
draws the paper's figures with its own numbers.
"""
