"""Many junctions out of maps that are read once: what lies around each, as small maps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import TypeVar

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..notes import assumptions
from .cut import LANES_BEYOND_M
from .georeferences import transform
from .source_map import MapJunction, SourceMap

_T = TypeVar("_T")

_MORE_M = 80.0  # beyond what is cut out: the ground is levelled with what lies around it
_THINGS_MORE_M = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Boxes:
    """A map, and the boxes (n, 4) around what it has: lowest x and y, highest x and y."""

    source: SourceMap
    lanes: FloatArray
    things: FloatArray


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
        self._maps = [
            _Boxes(
                source=source,
                lanes=_boxes([lane.centreline_m for lane in source.lanes]),
                things=_boxes([thing.vertices_m for thing in source.things]),
            )
            for source in maps
        ]

    def around(self, junction: MapJunction) -> tuple[SourceMap, ...]:
        """What the maps have around a junction of the first one.

        The scene that is cut out of these is the one that is cut out of the whole maps; what was
        left out when the maps were read is not told again. A map that has nothing there is left
        out.
        """
        roads = self._maps[0].source
        middle = junction.position_m
        corners = middle + self._half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        parts = []
        for boxes in self._maps:
            source = boxes.source
            here = corners
            if source.crs and roads.crs and source.crs != roads.crs:
                here = transform(corners, roads.crs, source.crs)
            low, high = here.min(axis=0), here.max(axis=0)
            less = 0.5 * (1.0 - self._share) * (high - low)
            part = _within(boxes, (low, high), near=(low + less, high - less))
            if source is roads:
                parts.append(replace(part, junctions=(junction,)))
            elif part.things or part.poles or len(part.crosswalks_m) or len(part.ground_m):
                parts.append(part)
        return tuple(parts)


def _boxes(lines: Sequence[FloatArray]) -> FloatArray:
    return np.array(
        [
            [*line[:, :2].min(axis=0), *line[:, :2].max(axis=0)] if len(line) else [np.inf] * 4
            for line in lines
        ]
    ).reshape(-1, 4)


_Square = tuple[FloatArray, FloatArray]  # lowest and highest x and y


def _within(boxes: _Boxes, square: _Square, *, near: _Square) -> SourceMap:
    """Lanes and ground of a square, and of a smaller one what stands and is painted there."""
    source = boxes.source
    poles = np.array([pole.position_m[:2] for pole in source.poles]).reshape(-1, 2)
    crosswalks = source.crosswalks_m.mean(axis=1)
    return replace(
        source,
        lanes=_some(source.lanes, _meet(boxes.lanes, *square)),
        junctions=(),
        things=_some(source.things, _meet(boxes.things, *near)),
        poles=_some(source.poles, _inside(poles, *near)),
        crosswalks_m=source.crosswalks_m[_inside(crosswalks, *near)],
        ground_m=source.ground_m[_inside(source.ground_m[:, :2], *square)],
        skipped=assumptions(source.skipped),
    )


def _some(items: Sequence[_T], mask: BoolArray) -> tuple[_T, ...]:
    return tuple(compress(items, mask.tolist()))


def _meet(boxes: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Which boxes meet a rectangle."""
    meets: BoolArray = np.all((boxes[:, :2] <= high) & (boxes[:, 2:] >= low), axis=1)
    return meets


def _inside(points: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    inside: BoolArray = np.all((points >= low) & (points <= high), axis=1)
    return inside
