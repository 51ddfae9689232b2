"""Studies of arm designs: arms measured on tree rows, in parallel."""
