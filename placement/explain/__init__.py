"""Explanations of a layout: what its units contribute, what it misses, what else would do."""
