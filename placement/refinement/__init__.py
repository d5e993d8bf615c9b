"""Poses between those of a grid: what :mod:`placement.refinement.refine` is made of.

``stage_values`` says what a set of poses is worth in the order of the problem's stages, ``rows``
makes detection rows of new poses on rays that are cast once per mount position, ``bench`` holds the
promising poses and the problem on them, ``weak_spots`` finds when and where a layout sees too
little, ``proposals`` makes new poses around the chosen ones and aimed at weak spots, ``directions``
turns the chosen ones step by step.
"""
