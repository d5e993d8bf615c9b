"""Areas of a map: closed ways, and rings joined from the ways of multipolygons."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from shapely import Polygon, STRtree, make_valid

from ...arrays import FloatArray
from .elements import Elements, Relation, Tags, Way
from .notes import Notes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Area:
    """An area with its courtyards.

    Attributes
    ----------
    id : str
        "w5", or of a multipolygon's second ring "r7.1".
    tags : dict
        What is known of it.
    outer_m : (n, 2) float
        Closed. [m]
    holes_m : tuple of (k, 2) float
        [m]
    """

    id: str
    tags: Tags
    outer_m: FloatArray
    holes_m: tuple[FloatArray, ...] = ()

    @property
    def polygon(self) -> Polygon:
        """The same for shapely; not always a valid one."""
        return Polygon(self.outer_m, self.holes_m)


def find_areas(
    elements: Elements, positions_m: FloatArray, keys: Sequence[str], notes: Notes
) -> Iterator[Area]:
    """Areas that have one of some tags.

    Parameters
    ----------
    elements : Elements
        What the file has.
    positions_m : (n, 2) float
        Of its nodes. [m]
    keys : sequence of str
        One of them must be there: "building".
    notes : Notes
        Told of outlines that are not whole.

    Yields
    ------
    area : Area
    """
    by_id = {way.id: way for way in elements.ways}
    used: set[int] = set()
    for relation in elements.relations:
        if relation.tags.get("type") != "multipolygon":
            continue
        outers = [by_id[ref] for ref, role in relation.members if role != "inner" and ref in by_id]
        tags = relation.tags
        if not any(key in tags for key in keys):
            # As it used to be: the outer way has the tags.
            tags = next((way.tags for way in outers if any(k in way.tags for k in keys)), {})
        if tags:
            used.update(way.id for way in outers if any(key in way.tags for key in keys))
            yield from _multipolygon(relation, tags, by_id, positions_m, notes)
    for way in elements.ways:
        if way.id in used or not any(key in way.tags for key in keys):
            continue
        if not way.is_closed or (way.rows < 0).any():
            notes.add("outlines", f"way {way.id}", "an outline that is not whole")
            continue
        yield Area(id=f"w{way.id}", tags=way.tags, outer_m=positions_m[way.rows])


def _multipolygon(
    relation: Relation,
    tags: Tags,
    by_id: Mapping[int, Way],
    positions_m: FloatArray,
    notes: Notes,
) -> Iterator[Area]:
    rings: dict[bool, list[FloatArray]] = {}
    for is_inner in (False, True):
        members = [
            by_id.get(ref) for ref, role in relation.members if (role == "inner") == is_inner
        ]
        ways = [way for way in members if way is not None]
        rows, is_whole = join_rings(ways)
        rings[is_inner] = [positions_m[ring] for ring in rows]
        if len(ways) < len(members) or not is_whole:
            notes.add("outlines", f"relation {relation.id}", "an outline that is not whole")
    holes: dict[int, list[FloatArray]] = defaultdict(list)
    outers = [make_valid(Polygon(ring)) for ring in rings[False]]
    if outers and rings[True]:
        tree = STRtree(outers)
        for ring in rings[True]:
            found = tree.query(Polygon(ring).representative_point(), predicate="within")
            if len(found):
                holes[int(found[0])].append(ring)
    for number, ring in enumerate(rings[False]):
        name = f"r{relation.id}.{number}" if number else f"r{relation.id}"
        yield Area(id=name, tags=tags, outer_m=ring, holes_m=tuple(holes[number]))


def join_rings(ways: Sequence[Way]) -> tuple[list[np.ndarray], bool]:
    """Rings of node rows from ways that may each be a part of one.

    Parameters
    ----------
    ways : sequence of Way
        In any order and direction.

    Returns
    -------
    rings : list of (n,) int
        Closed ones.
    is_whole : bool
        Every way is part of one.
    """
    rings, is_whole = [], True
    open_ways: dict[int, Way] = {}
    at_end: dict[int, list[int]] = defaultdict(list)
    for number, way in enumerate(ways):
        if len(way.rows) < 2 or (way.rows < 0).any():
            is_whole = False
        elif way.is_closed:
            rings.append(way.rows)
        else:
            open_ways[number] = way
            at_end[int(way.rows[0])].append(number)
            at_end[int(way.rows[-1])].append(number)
    while open_ways:
        _, way = open_ways.popitem()
        parts = [way.rows]
        begin, tip = int(way.rows[0]), int(way.rows[-1])
        while tip != begin:
            following = next((one for one in at_end[tip] if one in open_ways), None)
            if following is None:
                break
            rows = open_ways.pop(following).rows
            rows = rows if rows[0] == tip else rows[::-1]
            parts.append(rows[1:])
            tip = int(rows[-1])
        ring = np.concatenate(parts)
        if tip == begin and len(ring) >= 4:
            rings.append(ring)
        else:
            is_whole = False
    return rings, is_whole
