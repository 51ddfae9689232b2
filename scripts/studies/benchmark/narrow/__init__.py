"""Windows in walls, traps with one opening, and pinches, for arms of three kinds."""
