"""What `scripts/benchmark.py` measures: hplan beside its peers, on one machine, in one run.

Each module measures one set and returns plain numbers (`reference`, `clutter`, `orchards`, `narrow`, `fastest` with its
lower bounds, `recheck`, `growth`); `tables` and `figures` show them.
"""
