"""Explanations of a layout.

They say what its units contribute, what it misses, and what else would do.
"""
