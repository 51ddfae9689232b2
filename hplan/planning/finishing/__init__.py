"""Paths that others have planned: checked, and made into certified motions."""
