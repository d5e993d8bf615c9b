"""Poles: one for all that hangs at the same place."""

from collections.abc import Sequence

import numpy as np

from ..model import Pole
from .tables import load_facts

_CELL_M = 0.05
_KIND_ORDER = ("traffic light", "lamp post", "sign", "pole")  # what a pole with several is


def merge_poles(poles: Sequence[Pole]) -> list[Pole]:
    """One pole for all that hangs at the same place.

    Parameters
    ----------
    poles : sequence of Pole
        One per signal, lamp or pole.

    Returns
    -------
    poles : list of Pole
        Those within half a metre of one another as one: as high as the highest, of the kind that
        says most, where the pole itself stands if the file has it, else where the first hangs.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(poles) < 2:
        return list(poles)
    positions = np.array([pole.position_m[:2] for pole in poles])
    # First those at the very same place: of thousands there, every pair would count.
    _, first, cell = np.unique(
        np.round(positions / _CELL_M), axis=0, return_index=True, return_inverse=True
    )
    tree = cKDTree(positions[first])
    pairs = tree.query_pairs(load_facts()["signals"]["same_pole_m"], output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(first),) * 2)
    _, labels = connected_components(links, directed=False)
    groups: dict[int, list[Pole]] = {}
    for pole, label in zip(poles, labels[cell.reshape(-1)], strict=True):
        groups.setdefault(int(label), []).append(pole)
    return [_merge(group) for group in groups.values()]


def _merge(group: Sequence[Pole]) -> Pole:
    kind = min((pole.kind for pole in group), key=_KIND_ORDER.index)
    stands = next((pole for pole in group if pole.kind in ("pole", "lamp post")), group[0])
    heights = [pole.height_m for pole in group if pole.height_m is not None]
    return Pole(
        id=stands.id,
        kind=kind,
        position_m=stands.position_m,
        height_m=max(heights, default=None),
    )
