"""The six faces of a box, of which maps and meshes of tests make houses."""

BOX_FACES = [
    [0, 1, 3, 2],
    [4, 6, 7, 5],
    [0, 4, 5, 1],
    [2, 3, 7, 6],
    [0, 2, 6, 4],
    [1, 5, 7, 3],
]
"""Corners of each, counter-clockwise as seen from outside.

Corners are numbered as `itertools.product` has them: z changes first, x last.
"""
