"""Paths that others have planned: checked, and made into certified motions.

May use the rooms up to `planning`.
"""
