"""Trees of boxes around triangles, built by compiled code."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .sights import Tree, Vehicles

_LEAF_SIZE = 4
MAX_OPEN = 512  # nodes that wait for their turn: one per level


def build_tree(corners_m: FloatArray) -> Tree:
    """Tree of triangles (n, 3, 3)."""
    n = len(corners_m)
    n_nodes = max(0, 2 * n - 1)
    tree = Tree(
        corners_m=corners_m,
        low_m=np.full((n_nodes, 3), np.inf),
        high_m=np.full((n_nodes, 3), -np.inf),
        second=np.full(n_nodes, -1, dtype=np.int64),
        start=np.zeros(n_nodes, dtype=np.int64),
        end=np.zeros(n_nodes, dtype=np.int64),
    )
    order = np.arange(n)
    centres_m = 0.5 * (corners_m.min(axis=1) + corners_m.max(axis=1))
    n_used = _fill(tree, order, centres_m)
    return Tree(
        corners_m=corners_m[order],
        low_m=tree.low_m[:n_used].copy(),
        high_m=tree.high_m[:n_used].copy(),
        second=tree.second[:n_used].copy(),
        start=tree.start[:n_used].copy(),
        end=tree.end[:n_used].copy(),
    )


def join_vehicles(trees: Sequence[Tree], reach_m: FloatArray) -> Vehicles:
    """Trees of bodies, one after the other, each of which reaches so far from its origin."""
    roots = np.cumsum([0, *(len(tree.second) for tree in trees)])[:-1]
    firsts = np.cumsum([0, *(len(tree.corners_m) for tree in trees)])[:-1]
    moved = [
        tree._replace(
            second=np.where(tree.second < 0, -1, tree.second + root),
            start=tree.start + first,
            end=tree.end + first,
        )
        for tree, root, first in zip(trees, roots, firsts, strict=True)
    ]
    return Vehicles(
        tree=Tree(*(np.concatenate(parts) for parts in zip(*moved, strict=True))),
        roots=roots,
        reach_m=reach_m,
    )


@kernel
def _fill(tree: Tree, order: IntArray, centres_m: FloatArray) -> int:
    """Fill a tree and the order of its triangles; gives the number of nodes.

    A node is split in the middle of its triangles' centres along their largest extent; in number
    where that would leave a side empty, or the tree grow too deep.
    """
    begins, ends = np.empty(MAX_OPEN, dtype=np.int64), np.empty(MAX_OPEN, dtype=np.int64)
    parents = np.empty(MAX_OPEN, dtype=np.int64)  # whose second child it is; -1: a first child
    begins[0], ends[0], parents[0] = 0, len(order), -1
    n_open = 1 if len(order) else 0
    n_used = 0
    while n_open:
        n_open -= 1
        begin, stop, parent = begins[n_open], ends[n_open], parents[n_open]
        node = n_used
        n_used += 1
        if parent >= 0:
            tree.second[parent] = node
        tree.start[node], tree.end[node] = begin, stop
        along, largest_m, middle_m = 0, -1.0, 0.0
        for axis in range(3):
            least, most = np.inf, -np.inf
            for place in range(begin, stop):
                row = order[place]
                for corner in range(3):
                    value = tree.corners_m[row, corner, axis]
                    tree.low_m[node, axis] = min(tree.low_m[node, axis], value)
                    tree.high_m[node, axis] = max(tree.high_m[node, axis], value)
                least, most = min(least, centres_m[row, axis]), max(most, centres_m[row, axis])
            if most - least > largest_m:
                along, largest_m, middle_m = axis, most - least, 0.5 * (least + most)
        if stop - begin <= _LEAF_SIZE:
            continue
        split = begin
        for place in range(begin, stop):
            row = order[place]
            if centres_m[row, along] < middle_m:
                order[place] = order[split]
                order[split] = row
                split += 1
        if split in (begin, stop) or n_open > MAX_OPEN // 2:
            split = (begin + stop) // 2
        begins[n_open], ends[n_open], parents[n_open] = split, stop, node
        begins[n_open + 1], ends[n_open + 1], parents[n_open + 1] = begin, split, -1
        n_open += 2
    return n_used
