"""Visualization of results: the animated page, the live view and the figures.

Each module is imported on first use.
"""
