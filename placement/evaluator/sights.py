"""Inputs and outputs of the drawing of many frames, as tuples for compiled code."""

from typing import NamedTuple

from geometry.arrays import FloatArray, IntArray


class Tree(NamedTuple):
    """Boxes around ever fewer triangles: a parent is followed by its first child.

    Attributes
    ----------
    corners_m : (n_triangles, 3, 3) float
        Corners, leaf by leaf.
    low_m, high_m : (n_nodes, 3) float
        Box of each node. Without triangles there is no node.
    second : (n_nodes,) int
        The second child; -1 for a leaf.
    start, end : (n_nodes,) int
        Triangles of a node.
    """

    corners_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    second: IntArray
    start: IntArray
    end: IntArray


class Vehicles(NamedTuple):
    """Trees of all kinds of bodies that move."""

    tree: Tree  # one after the other
    roots: IntArray  # (n_kinds,): the node at which each begins
    reach_m: FloatArray  # (n_kinds,): all of it is so near its origin


class Skin(NamedTuple):
    """Triangles to draw, in an order without order: neighbours do not follow one another.

    Attributes
    ----------
    vertices_m : (n_vertices, 3) float
        In the body frame, without order, too.
    triangles : (n_triangles, 3) int
        Rows of vertices.
    fan_start, fans : (n_vertices + 1,), (3 * n_triangles,) int
        Rows of the triangles at each vertex, one vertex after the other.
    """

    vertices_m: FloatArray
    triangles: IntArray
    fan_start: IntArray
    fans: IntArray


class Placed(NamedTuple):
    """Where bodies are, seen from a camera: ``turn @ point + shift`` is right, down, ahead."""

    turn: FloatArray  # (n, 3, 3)
    shift: FloatArray  # (n, 3). [m]
    up_m: FloatArray  # (n,): height of their origins in the frame in which the camera stands. [m]

    def take(self, rows: slice) -> "Placed":
        """Some of them."""
        return Placed(self.turn[rows], self.shift[rows], self.up_m[rows])


class Sights(NamedTuple):
    """Where everything is in frames that differ in more than the vehicles that move."""

    vru: Placed
    static: Placed
    frame_start: IntArray  # (n + 1,): frames of each sight, one after the other
    vehicles: Placed  # of every frame, one frame after the other
    vehicle_kind: IntArray  # (n_vehicles,): which body each of them is
    vehicle_start: IntArray  # (n_frames + 1,): into them


class Seen(NamedTuple):
    """What is found; boxes in pixels, zeros where there is none."""

    amodal_px: FloatArray  # (n, 4): of each sight
    inside_share: FloatArray  # (n,): of the VRU's box, what the image's edges do not cut off
    visible_px: FloatArray  # (n, 4): of each sight, were no vehicles there
    visible_share: FloatArray  # (n,): by pixels; 1 where the VRU covers none
    frame_visible_px: FloatArray  # (n_frames, 4): with vehicles
    frame_visible_share: FloatArray  # (n_frames,)

    def take(self, sights: slice, frames: slice) -> "Seen":
        """Parts of the same arrays."""
        return Seen(*(part[sights] for part in self[:4]), *(part[frames] for part in self[4:]))
