"""How far motions are from the fastest known: 200 problems, the best duration ever found of each, and who found it.

`records` holds them (`best_known.json`), `problems` makes the problems, `draw` chose them, `measure` runs hplan with
each effort, and `peers` looks for quicker motions by other means. A motion counts only if hplan certifies its rows.
`bound` holds lower bounds, of other problems, against certified motions.
"""
