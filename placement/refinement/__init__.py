"""Poses between those of a grid, see :mod:`placement.refinement.refine`."""
