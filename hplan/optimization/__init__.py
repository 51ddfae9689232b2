"""Path shortcutting and smoothing, then time optimization by sequential linear programming."""
