"""Faster motions: paths shortened and made smooth, then the timed motion itself by linear programs in sequence."""
