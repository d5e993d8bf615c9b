"""The CarlaNCAP study.

Its layout of 12 cameras, its published figures, and ours beside them.
"""
