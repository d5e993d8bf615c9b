"""Very short roads at the mouth of a junction: their lanes become part of those that go on.

Both ends of such a lane lie at the junction's outline, so that it could lead in as well as out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ..model import MapLane

_STUB_M = 5.0
_SAME_POINT_M = 0.5
_MAX_IN_A_ROW = 8


def join_stubs(lanes: Sequence[MapLane]) -> list[MapLane]:
    """Join lanes that are very short, and lead to a junction at one end, to the ones beyond.

    Parameters
    ----------
    lanes : sequence of MapLane
        Of all roads.

    Returns
    -------
    lanes : list of MapLane
        A stub's points and junction go over to the lane of its kind that goes on within half a
        metre, which keeps its id.
    """
    joined = list(lanes)
    for _ in range(_MAX_IN_A_ROW):
        n_before = len(joined)
        joined = _join_once(joined)
        if len(joined) == n_before:
            break
    return joined


def _join_once(lanes: Sequence[MapLane]) -> list[MapLane]:
    from scipy.spatial import cKDTree

    stubs = [
        index
        for index, lane in enumerate(lanes)
        if bool(lane.from_junction) != bool(lane.to_junction) and _length_m(lane) < _STUB_M
    ]
    if not stubs:
        return list(lanes)
    trees = [cKDTree(np.array([lane.centreline_m[end] for lane in lanes])) for end in (0, -1)]
    result: dict[int, MapLane] = dict(enumerate(lanes))
    touched: set[int] = set()
    for index in stubs:
        stub = lanes[index]
        leads_out = bool(stub.from_junction)
        tip = stub.centreline_m[-1 if leads_out else 0]
        distance_m, near = trees[0 if leads_out else 1].query(tip, k=min(4, len(lanes)))
        for gap_m, other in zip(np.atleast_1d(distance_m), np.atleast_1d(near), strict=True):
            lane = lanes[int(other)]
            is_free = not (lane.from_junction if leads_out else lane.to_junction)
            if gap_m > _SAME_POINT_M or other == index or lane.kind != stub.kind or not is_free:
                continue
            if touched & {index, int(other)}:
                break  # the next round comes to it
            pieces = [stub, lane] if leads_out else [lane, stub]
            result[int(other)] = _joined(lane, pieces)
            del result[index]
            touched |= {index, int(other)}
            break
    return list(result.values())


def _joined(lane: MapLane, pieces: Sequence[MapLane]) -> MapLane:
    lengths = [_length_m(piece) for piece in pieces]
    return replace(
        lane,
        width_m=float(np.average([piece.width_m for piece in pieces], weights=lengths)),
        centreline_m=_chain(pieces[0].centreline_m, pieces[1].centreline_m),
        from_junction=pieces[0].from_junction,
        to_junction=pieces[1].to_junction,
    )


def _chain(first_m: FloatArray, second_m: FloatArray) -> FloatArray:
    """Both lines as one; of the two points at the joint the second line's stays."""
    chained: FloatArray = np.concatenate([first_m[:-1], second_m])
    return chained


def _length_m(lane: MapLane) -> float:
    return float(np.hypot(*np.diff(lane.centreline_m[:, :2], axis=0).T).sum())
