"""Paths of other planners: checked, and made into certified motions."""
