"""Nodes, ways, relations, areas and tags of a file of OpenStreetMap data."""

import math
import re
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import osmium
from shapely import Polygon, STRtree, make_valid

from ...arrays import FloatArray, IntArray
from ...errors import InputError, refuse
from ...opening import MAX_FILE_BYTES, open_file, reading
from ...pbf import check_pbf
from ...text_formats import float_of, load_data
from ...xml_files import read_xml_children
from ..source_map import Omissions, parse_length_m

DEFAULTS: dict[str, Any] = load_data("geometry.maps", "openstreetmap.toml")
"""Sizes where a tag is missing or makes no sense, each with its source in the file."""
WORDS: dict[str, Any] = DEFAULTS["words"]
Tags = dict[str, str]
# Says that a tag of the way at hand is not followed, and why.
TagNote = Callable[[str], None]
# Ways run out of a cut-out.
_BOX_MARGIN_DEG = 1.0
_EXPECTED = "OpenStreetMap data, XML or PBF"
_BROKEN = "its outline is not closed, or misses nodes"
_ELEMENTS = ("node", "way", "relation")
OPPOSITE = {
    "left": "right",
    "right": "left",
    "forward": "backward",
    "backward": "forward",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """Line of nodes.

    Attributes
    ----------
    id : int
        Id in OpenStreetMap.
    rows : (n,) int
        Its nodes as rows of Elements; -1: not in the file.
    tags : Tags
        Tags, by key.
    """

    id: int
    rows: IntArray
    tags: Tags

    @property
    def is_closed(self) -> bool:
        """True if it ends where it begins, and surrounds something."""
        return len(self.rows) >= 4 and self.rows[0] == self.rows[-1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relation:
    """Ways that belong together.

    Attributes
    ----------
    id : int
        Id in OpenStreetMap.
    members : tuple of (int, str)
        Ids and roles of the member ways.
    tags : Tags
        Tags, by key.
    """

    id: int
    members: tuple[tuple[int, str], ...]
    tags: Tags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Elements:
    """Elements of a file, where its nodes lie, and what is left out.

    Attributes
    ----------
    node_ids : (n,) int
        Ascending.
    lon_lat_deg : (n, 2) float
        WGS 84. [deg]
    node_tags : dict[int, Tags]
        By row, for nodes with tags.
    ways : tuple of Way
        Ways, in the order of the file.
    relations : tuple of Relation
        Relations, in the order of the file.
    positions_m : (n, 2) float
        Of the nodes, around the middle of the roads. [m]
    omissions : Omissions
        Record of what is left out.
    """

    node_ids: IntArray
    lon_lat_deg: FloatArray
    node_tags: dict[int, Tags]
    ways: tuple[Way, ...]
    relations: tuple[Relation, ...]
    positions_m: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    omissions: Omissions = field(default_factory=Omissions)


def read_elements(path: Path) -> Elements:
    """Read a file of OpenStreetMap data: XML, packed or not, or PBF.

    Archives are those of gzip and bzip2.

    The first bytes show the format. Deleted elements are left out; of several
    versions the last one counts.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    elements : Elements
        Positions in metres are not set yet.

    Raises
    ------
    InputError
        The file cannot be read, has another format, is damaged or too large, or
        a node lies nowhere on earth.
    """
    with reading(
        path,
        _EXPECTED,
        RuntimeError,
        ValueError,
        osmium.InvalidLocationError,
    ):
        return _collect(path, _file_format(path))


def read_loose_elements(path: Path) -> Elements:
    """Read OpenStreetMap XML as programs for other maps write it.

    Its root may lack a version, unknown elements are passed over, and nodes may
    lack latitude and longitude, as those of Lanelet2 maps in local metres.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    elements : Elements
        Positions in metres are not set yet. Longitude and latitude are NaN where
        the file has none.

    Raises
    ------
    InputError
        The file cannot be read, is damaged or too large, or a node lies nowhere
        on earth.
    """
    ids = array("q")
    places = array("d")
    tags_by_id: dict[int, Tags] = {}
    ways: dict[int, tuple[list[int], Tags]] = {}
    relations: dict[int, Relation] = {}
    n_left = int(DEFAULTS["reading"]["max_nodes"])
    for element in read_xml_children(path, expected=_EXPECTED, root="osm"):
        is_deleted = element.get("action") == "delete"
        if element.tag not in _ELEMENTS or is_deleted:
            continue
        if element.get("visible") == "false":
            continue
        where = f"{path}: {element.tag}"
        element_id = _whole(element.get("id"), f"{where}: id")
        tags = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        n_left -= 1 + len(element) // 10
        if n_left < 0:
            got = f"more than {DEFAULTS['reading']['max_nodes']:,} elements"
            refuse(str(path), got, "fewer; cut it out first")
        if element.tag == "node":
            ids.append(element_id)
            places.extend(_place_deg(element, f"{where} {element_id}"))
            if tags:
                tags_by_id[element_id] = tags
        elif element.tag == "way":
            nodes = [
                _whole(one.get("ref"), f"{where} {element_id}: nd")
                for one in element.iter("nd")
            ]
            ways[element_id] = (nodes, tags)
        else:
            members = [
                (
                    _whole(one.get("ref"), f"{where} {element_id}: member"),
                    one.get("role", ""),
                )
                for one in element.iter("member")
                if one.get("type") == "way"
            ]
            relations[element_id] = Relation(
                id=element_id, members=tuple(members), tags=tags
            )
    return _assemble(ids, places, tags_by_id, ways, relations.values())


def _whole(text: str | None, where: str) -> int:
    """An id that an attribute states; InputError names the place of another text."""
    if text is None or not re.fullmatch(r"-?[0-9]{1,18}", text.strip()):
        raise InputError(where, text, "a whole number")
    return int(text)


def _place_deg(node: Element, where: str) -> tuple[float, float]:
    """Longitude and latitude of a node in degrees; NaN where it has none."""
    found = []
    for key, most_deg in (("lon", 180.0), ("lat", 90.0)):
        text = (node.get(key) or "").strip()
        if not text:
            found.append(math.nan)
            continue
        value = float_of(text)
        if not abs(value) <= most_deg:
            raise InputError(
                f"{where}: {key}", text, f"-{most_deg:g} to {most_deg:g} degrees"
            )
        found.append(value)
    lon_deg, lat_deg = found
    return lon_deg, lat_deg


def _file_format(path: Path) -> str:
    """Format of a file by its first bytes, as osmium names it.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    name : {"osm", "pbf"}
        PBF files are checked for their unpacked size.
    """
    with open_file(path, max_bytes=MAX_FILE_BYTES) as file:
        begin = file.read(64)
    if begin[4:15] == b"\x0a\x09OSMHeader":
        limit = int(DEFAULTS["reading"]["max_unpacked_bytes"])
        check_pbf(path, max_unpacked_bytes=limit, expected=_EXPECTED)
        return "pbf"
    if begin.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(
        (b"<", b"\xff\xfe", b"\xfe\xff")
    ):
        return "osm"
    refuse(str(path), "something else", _EXPECTED)


def _collect(path: Path, file_format: str) -> Elements:
    """Read nodes, ways and relations of a file with osmium.

    Parameters
    ----------
    path : Path
        File to read.
    file_format : str
        As :func:`_file_format` returns it.

    Returns
    -------
    elements : Elements
        The last of several versions of an element counts.

    Raises
    ------
    InputError
        A node lies nowhere on earth, or there are too many elements.
    """
    ids = array("q")
    places = array("d")
    tags_by_id: dict[int, Tags] = {}
    ways: dict[int, tuple[list[int], Tags]] = {}
    relations: dict[int, Relation] = {}
    n_left = int(DEFAULTS["reading"]["max_nodes"])
    bits = osmium.osm.NODE | osmium.osm.WAY | osmium.osm.RELATION
    processor = osmium.FileProcessor(osmium.io.File(str(path), file_format), bits)
    box = processor.header.box()
    for item in processor:
        element: Any = item
        if element.deleted:
            continue
        tags: Tags = {}
        if len(element.tags):
            tags = {tag.k: tag.v for tag in element.tags}
        n_left -= 1
        if element.is_node():
            location = element.location
            ids.append(element.id)
            lon_deg = location.lon_without_check()
            lat_deg = location.lat_without_check()
            places.extend((lon_deg, lat_deg))
            if not location.valid():
                # osmium's value for it.
                is_missing = max(abs(lat_deg), abs(lon_deg)) > 214.0
                if is_missing:
                    got = "no coordinates"
                else:
                    got = f"latitude {lat_deg}, longitude {lon_deg}"
                expected = "latitude -90..90 and longitude -180..180"
                refuse(f"{path}: node {element.id}", got, expected)
            if tags:
                tags_by_id[element.id] = tags
        elif element.is_way():
            ways[element.id] = ([node.ref for node in element.nodes], tags)
            n_left -= len(element.nodes) // 10
        else:
            members = tuple(
                (one.ref, one.role) for one in element.members if one.type == "w"
            )
            # Long ways and large relations count for more than one element.
            relations[element.id] = Relation(id=element.id, members=members, tags=tags)
            n_left -= len(members) // 10
        if n_left < 0:
            got = f"more than {DEFAULTS['reading']['max_nodes']:,} elements"
            refuse(str(path), got, "fewer; cut it out first")
    if box.valid():
        corners = [
            [corner.lon, corner.lat] for corner in (box.bottom_left, box.top_right)
        ]
        _check_order(path, np.array(places).reshape(-1, 2), np.array(corners))
    return _assemble(ids, places, tags_by_id, ways, relations.values())


def _check_order(path: Path, lon_lat_deg: FloatArray, box_deg: FloatArray) -> None:
    """Refuse coordinates that fit the file's bounds only when swapped."""
    if not len(lon_lat_deg):
        return
    middle = np.median(lon_lat_deg, axis=0)
    low = box_deg[0] - _BOX_MARGIN_DEG
    high = box_deg[1] + _BOX_MARGIN_DEG

    def lies_within(point: FloatArray) -> bool:
        """True if a point lies in the file's bounds, or near them."""
        return bool(((point >= low) & (point <= high)).all())

    is_inside = lies_within(middle)
    is_inside_exchanged = lies_within(middle[::-1])
    if is_inside_exchanged and not is_inside:
        expected = (
            "nodes within the file's bounds: latitude and longitude are exchanged"
        )
        refuse(
            str(path),
            f"nodes around latitude {middle[1]:g}, longitude {middle[0]:g}",
            expected,
        )


def _assemble(
    ids: Sequence[int],
    places: Sequence[float],
    tags_by_id: dict[int, Tags],
    ways: dict[int, tuple[list[int], Tags]],
    relations: Iterable[Relation],
) -> Elements:
    """Elements from what was collected, with nodes sorted by their ids.

    Parameters
    ----------
    ids : sequence of int
        Ids of nodes, in the order of the file.
    places : sequence of float
        Longitude and latitude of each node, one after the other. [deg]
    tags_by_id : dict[int, Tags]
        Tags of the nodes that have some.
    ways : dict[int, tuple[list[int], Tags]]
        Nodes and tags of ways, by their ids.
    relations : iterable of Relation
        Relations.

    Returns
    -------
    elements : Elements
        Ways refer to nodes by row.
    """
    all_ids = np.array(ids, dtype=np.int64)
    # Of a node that comes twice the last one counts.
    node_ids, last = np.unique(all_ids[::-1], return_index=True)
    lon_lat_deg = np.array(places, dtype=np.float64).reshape(-1, 2)[::-1][last]
    references = np.fromiter(
        (one for nodes, _ in ways.values() for one in nodes),
        dtype=np.int64,
    )
    ends = np.cumsum([len(nodes) for nodes, _ in ways.values()], dtype=np.int64)
    rows = np.split(_rows(node_ids, references), ends)[:-1]
    tagged = np.fromiter(tags_by_id, dtype=np.int64)
    return Elements(
        node_ids=node_ids,
        lon_lat_deg=lon_lat_deg,
        node_tags=dict(
            zip(_rows(node_ids, tagged).tolist(), tags_by_id.values(), strict=True)
        ),
        ways=tuple(
            Way(id=way_id, rows=part, tags=tags)
            for (way_id, (_, tags)), part in zip(ways.items(), rows, strict=True)
        ),
        relations=tuple(relations),
    )


def _rows(node_ids: IntArray, wanted: IntArray) -> IntArray:
    """Rows of nodes by their ids, -1 where there is none, (n,)."""
    if not len(node_ids):
        return np.full(len(wanted), -1, dtype=np.int64)
    found = np.minimum(np.searchsorted(node_ids, wanted), len(node_ids) - 1)
    return np.where(node_ids[found] == wanted, found, -1).astype(np.int64)


# ---------- areas
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MappedArea:
    """Area with its courtyards.

    Attributes
    ----------
    id : str
        "w5", or of a multipolygon's second ring "r7.1".
    tags : Tags
        Tags of the way or relation.
    polygon : Polygon
        May be invalid.
    """

    id: str
    tags: Tags
    polygon: Polygon


def find_areas(elements: Elements, keys: Sequence[str]) -> Iterator[MappedArea]:
    """Closed ways and rings of multipolygons that have one of some tags.

    Broken outlines are noted.

    Parameters
    ----------
    elements : Elements
        Elements of the file.
    keys : sequence of str
        Keys of the tags, one of which an area must have.

    Yields
    ------
    area : MappedArea
        First those of relations, then those of ways.
    """
    by_id = {way.id: way for way in elements.ways}
    used: set[int] = set()

    def is_meant(tags: Tags) -> bool:
        """True if the tags have one of the keys."""
        return any(key in tags for key in keys)

    for relation in elements.relations:
        if relation.tags.get("type") != "multipolygon":
            continue
        outers = [
            by_id[ref]
            for ref, role in relation.members
            if role != "inner" and ref in by_id
        ]
        tags = relation.tags
        # As it used to be: the outer way has the tags.
        if not is_meant(tags):
            tags = next((way.tags for way in outers if is_meant(way.tags)), {})
        if tags:
            used.update(way.id for way in outers if is_meant(way.tags))
            yield from _multipolygon(elements, relation, tags, by_id)
    for way in elements.ways:
        if way.id in used or not is_meant(way.tags):
            continue
        if not way.is_closed or (way.rows < 0).any():
            elements.omissions.add("outlines", f"way {way.id}", _BROKEN)
        else:
            yield MappedArea(
                id=f"w{way.id}",
                tags=way.tags,
                polygon=Polygon(elements.positions_m[way.rows]),
            )


def _multipolygon(
    elements: Elements,
    relation: Relation,
    tags: Tags,
    by_id: Mapping[int, Way],
) -> Iterator[MappedArea]:
    """Areas of a multipolygon, one for each outer ring.

    Parameters
    ----------
    elements : Elements
        Elements of the file.
    relation : Relation
        The multipolygon.
    tags : Tags
        Tags of the element, by key.
    by_id : Mapping[int, Way]
        Ways by their ids.

    Yields
    ------
    area : MappedArea
        With the inner rings that lie in it as holes.
    """
    rings: dict[bool, list[FloatArray]] = {}
    for is_inner in (False, True):
        refs = [ref for ref, role in relation.members if (role == "inner") == is_inner]
        ways = [by_id[ref] for ref in refs if ref in by_id]
        found, is_whole = join_rings(ways)
        rings[is_inner] = [elements.positions_m[ring] for ring in found]
        if len(ways) < len(refs) or not is_whole:
            elements.omissions.add("outlines", f"relation {relation.id}", _BROKEN)
    holes: dict[int, list[FloatArray]] = defaultdict(list)
    outers = [make_valid(Polygon(ring)) for ring in rings[False]]
    if outers and rings[True]:
        tree = STRtree(outers)
        for ring in rings[True]:
            inside = tree.query(
                Polygon(ring).representative_point(),
                predicate="within",
            )
            if len(inside):
                holes[int(inside[0])].append(ring)
    for number, ring in enumerate(rings[False]):
        name = numbered(f"r{relation.id}", number)
        yield MappedArea(id=name, tags=tags, polygon=Polygon(ring, holes[number]))


def numbered(name: str, number: int, between: str = ".") -> str:
    """Name of one of several parts; the first, 0, has no number."""
    if number:
        return f"{name}{between}{number}"
    return name


def join_rings(ways: Sequence[Way]) -> tuple[list[np.ndarray], bool]:
    """Closed rings of ways in any order, and whether all ways are used.

    Parameters
    ----------
    ways : sequence of Way
        Pieces of rings, in any order and direction.

    Returns
    -------
    rings : list of (n,) int
        Rows of nodes; the first comes again as the last.
    is_whole : bool
        Every way is part of a ring.
    """
    rings = []
    is_whole = True
    open_ways: dict[int, Way] = {}
    at_end: dict[int, list[int]] = defaultdict(list)
    # Closed ways are rings already; the others are found by the nodes at their ends.
    for number, way in enumerate(ways):
        if len(way.rows) < 2 or (way.rows < 0).any():
            is_whole = False
        elif way.is_closed:
            rings.append(way.rows)
        else:
            open_ways[number] = way
            at_end[int(way.rows[0])].append(number)
            at_end[int(way.rows[-1])].append(number)
    # Follow open ways from end to end until they come back to where they began.
    while open_ways:
        _, way = open_ways.popitem()
        parts = [way.rows]
        begin = int(way.rows[0])
        tip = int(way.rows[-1])
        while tip != begin:
            following = next((one for one in at_end[tip] if one in open_ways), None)
            if following is None:
                break
            rows = open_ways.pop(following).rows
            if rows[0] != tip:
                rows = rows[::-1]
            parts.append(rows[1:])
            tip = int(rows[-1])
        ring = np.concatenate(parts)
        if tip == begin and len(ring) >= 4:
            rings.append(ring)
        else:
            is_whole = False
    return rings, is_whole


# ---------- values of tags
def tagged_length_m(
    tags: Tags,
    keys: Iterable[str],
    bounds_m: tuple[float, float],
    note: TagNote,
    instead: str = "the usual one",
) -> float | None:
    """First length of some tags within bounds; the others are noted.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    keys : iterable of str
        Keys, the most telling first.
    bounds_m : (float, float)
        Smallest and largest length that makes sense. [m]
    note : TagNote
        Called with the reason where a tag is not followed.
    instead : str
        What is taken instead of a senseless one, in words.

    Returns
    -------
    length_m : float or None
        None: no tag has a length that makes sense. [m]
    """
    for key in keys:
        if key not in tags:
            continue
        length_m = parse_length_m(tags[key])
        if length_m is not None and bounds_m[0] <= length_m <= bounds_m[1]:
            return length_m
        note(f"{key} makes no sense; {instead} taken")
    return None


def parse_count(text: str, *, highest: int) -> int | None:
    """A whole number from 1 to `highest`, or None."""
    number = parse_number(text, highest=highest)
    if number and number == int(number):
        return int(number)
    return None


def parse_number(text: str, *, highest: float) -> float | None:
    """A number from 0 to `highest`, or None."""
    text = text.strip().replace(",", ".")
    if not re.fullmatch(r"[0-9]{1,6}(\.[0-9]{1,9})?", text):
        return None
    number = float(text)
    if number <= highest:
        return number
    return None


def is_yes(text: str | None) -> bool:
    """True if a tag is there and does not say no."""
    if text is None:
        return False
    word = text.strip().lower()
    return word not in ("", "no", "0", "false", "none")


def side_value(tags: Tags, key: str, side: str) -> str | None:
    """Value of a tag for one side: ``key:side``, or else ``key:both``."""
    return tags.get(f"{key}:{side}", tags.get(f"{key}:both"))


def reversed_tags(tags: Tags) -> Tags:
    """Tags of the same line with its nodes in the opposite order.

    >>> reversed_tags({"sidewalk": "left", "lanes:forward": "2"})
    {'sidewalk': 'right', 'lanes:backward': '2'}
    """
    turned: Tags = {}
    for key, value in tags.items():
        words = [OPPOSITE.get(word, word) for word in key.split(":")]
        # The plain tag names the side in its value.
        if key == "sidewalk":
            value = OPPOSITE.get(value, value)
        turned[":".join(words)] = value
    return turned
