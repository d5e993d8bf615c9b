"""How the surface of a road rises and falls across, beside its superelevation: ``<shape>``."""

from collections import defaultdict
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from .attributes import numbered, take_number
from .reference_line import PiecewiseCubic, build_cubics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrossSections:
    """Heights across a road at some stations; between two of them in proportion.

    Attributes
    ----------
    stations_m : (n,) float
        Ascending; none: the road is a line across. [m]
    profiles : tuple of PiecewiseCubic
        Height over the distance t to the left of the reference line, one for each station. [m]
    """

    stations_m: FloatArray
    profiles: tuple[PiecewiseCubic, ...]

    def at(self, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """Heights at stations, some metres to the left of the reference line, (k,)."""
        height = np.zeros(len(s_m))
        if not len(self.stations_m):
            return height
        place = np.interp(s_m, self.stations_m, np.arange(len(self.stations_m)))
        for index, profile in enumerate(self.profiles):
            share = np.maximum(1.0 - np.abs(place - index), 0.0)
            near = share > 0.0
            height[near] += share[near] * profile.at(np.maximum(t_m[near], profile.starts_m[0]))
        return height


def read_cross_sections(lateral: Element | None, where: str) -> CrossSections:
    """The shapes of a road's lateral profile; none if all of them are flat.

    Raises InputError if a number is missing or out of range.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.8, section on lateral profiles: road shape.
    """
    rows: dict[float, list[tuple[float, ...]]] = defaultdict(list)
    for piece, here in numbered(lateral, "shape", where):
        row = tuple(take_number(piece, key, here) for key in ("t", *"abcd"))
        rows[take_number(piece, "s", here)].append(row)
    if not any(value for pieces in rows.values() for row in pieces for value in row[1:]):
        rows.clear()
    stations = sorted(rows)
    return CrossSections(
        stations_m=np.array(stations, dtype=np.float64),
        profiles=tuple(build_cubics(rows[station]) for station in stations),
    )
