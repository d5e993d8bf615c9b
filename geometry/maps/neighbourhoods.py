"""Many junctions out of maps that are read once: what lies around each, as small maps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ..arrays import FloatArray, IntArray
from ..notes import assumptions
from .cut import LANES_BEYOND_M
from .georeferences import transform
from .source_map import MapJunction, SourceMap

_T = TypeVar("_T")

_MORE_M = 80.0  # beyond what is cut out: the ground is levelled with what lies around it
_THINGS_MORE_M = 30.0
_BLOCK = 256  # points of the ground that are looked up together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Indexed:
    """A map, and trees of the boxes around what it has."""

    source: SourceMap
    lanes: Any
    connections: Any
    junctions: Any
    things: Any
    poles: Any
    crosswalks: Any  # by their middles
    ground: Any  # of blocks of points


def _indexed(source: SourceMap) -> _Indexed:
    ground = source.ground_m
    middles = source.crosswalks_m.mean(axis=1)
    return _Indexed(
        source=source,
        lanes=_tree([lane.centreline_m for lane in source.lanes]),
        connections=_tree([lane.centreline_m for lane in source.connections]),
        junctions=_tree([junction.outline_m for junction in source.junctions]),
        things=_tree([thing.vertices_m for thing in source.things]),
        poles=_tree([pole.position_m[None] for pole in source.poles]),
        crosswalks=_tree([middle[None] for middle in middles]),
        ground=_tree([ground[at : at + _BLOCK] for at in range(0, len(ground), _BLOCK)]),
    )


def _tree(lines: Sequence[FloatArray]) -> Any:
    """A tree of the boxes around lines (n, 2 or more); those without points are nowhere."""
    import shapely

    return shapely.STRtree(
        [
            shapely.box(*line[:, :2].min(axis=0), *line[:, :2].max(axis=0)) if len(line) else None
            for line in lines
        ]
    )


class Neighbourhoods:
    """Maps from which what lies around a junction is taken again and again.

    Parameters
    ----------
    maps : sequence of SourceMap
        The one with the roads first.
    radius_m : float
        Of what will be cut out, see :func:`geometry.maps.cut.cut_out`. [m]
    """

    def __init__(self, maps: Sequence[SourceMap], *, radius_m: float) -> None:
        self._half_m = radius_m + LANES_BEYOND_M + _MORE_M
        self._share = (radius_m + _THINGS_MORE_M) / self._half_m  # of the square that has things
        self._maps = [_indexed(source) for source in maps]

    def around(self, junction: MapJunction) -> tuple[SourceMap, ...]:
        """What the maps have around a junction of the first one.

        The scene that is cut out of these is the one that is cut out of the whole maps; what was
        left out when the maps were read is not repeated. A map that has nothing there is left out.
        """
        roads = self._maps[0].source
        middle = junction.position_m
        corners = middle + self._half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        parts = []
        for indexed in self._maps:
            source = indexed.source
            here = corners
            if source.crs and roads.crs and source.crs != roads.crs:
                here = transform(corners, roads.crs, source.crs)
            low, high = here.min(axis=0), here.max(axis=0)
            less = 0.5 * (1.0 - self._share) * (high - low)
            part = _within(indexed, (low, high), near=(low + less, high - less))
            has_any = part.things or part.poles or len(part.crosswalks_m) or len(part.ground_m)
            if source is roads or has_any:
                parts.append(part)
        return tuple(parts)


_Square = tuple[FloatArray, FloatArray]  # lowest and highest x and y


def _within(indexed: _Indexed, square: _Square, *, near: _Square) -> SourceMap:
    """Lanes and ground of a square, and of a smaller one what stands and is painted there."""
    source = indexed.source
    low, high = square
    blocks = _meeting(indexed.ground, square) * _BLOCK
    rows = (blocks[:, None] + np.arange(_BLOCK)).ravel()
    ground = source.ground_m[rows[rows < len(source.ground_m)]]
    is_inside = ((ground[:, :2] >= low) & (ground[:, :2] <= high)).all(axis=1)
    return replace(
        source,
        lanes=_some(source.lanes, indexed.lanes, square),
        connections=_some(source.connections, indexed.connections, square),
        junctions=_some(source.junctions, indexed.junctions, near),
        things=_some(source.things, indexed.things, near),
        poles=_some(source.poles, indexed.poles, near),
        crosswalks_m=source.crosswalks_m[_meeting(indexed.crosswalks, near)],
        ground_m=ground[is_inside],
        skipped=assumptions(source.skipped),
    )


def _some(items: Sequence[_T], tree: Any, square: _Square) -> tuple[_T, ...]:
    return tuple(items[index] for index in _meeting(tree, square).tolist())


def _meeting(tree: Any, square: _Square) -> IntArray:
    """Indices of the boxes that meet a rectangle, ascending, (n,)."""
    import shapely

    found: IntArray = np.sort(tree.query(shapely.box(*square[0], *square[1])))
    return found
