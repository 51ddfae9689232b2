"""Studies of designs: many arms before many trees, on one machine or on a cluster, one row of numbers for each."""
