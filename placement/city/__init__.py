"""Many junctions under one budget.

Each has a front, of which one point is chosen.
"""
