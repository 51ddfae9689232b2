"""Motions among obstacles that move: where on a path it is clear when, and the quickest timing through that.

May use what is before `planning` in the table of rooms. Nothing here is a proof: the certificate is.
"""
