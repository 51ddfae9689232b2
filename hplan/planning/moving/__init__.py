"""Motions among obstacles that move: where on a path it is clear when, and the quickest timing through that.

Nothing here is a proof: the certificate is.
"""
