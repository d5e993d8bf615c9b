"""Objects and signals along OpenDRIVE roads.

Objects become things, poles, crosswalks and parking lanes; signals become
poles and crosswalks.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...arrays import FloatArray
from ...errors import InputError, refuse
from ..source_map import POLE_KINDS, MapLane, Omissions, Pole, Thing, has_word, words_of
from .lanes import SampledSection, lane_kind
from .object_shapes import (
    Outline,
    Spot,
    box_corners,
    build_body,
    is_on,
    place,
    read_outlines,
    read_places,
)
from .roads import (
    Road,
    RoadElement,
    load_facts,
    take_number,
    take_number_or,
    take_size,
)

# Of two sides: below it, people cross more nearly across the road.
_CLEARLY_LONGER = 1.3
_MIN_LENGTH_M = 0.5
_SAME_ROW_T_M = 1.0
_SAME_ROW_GAP_M = 1.5
_STEP_M = 2.0
_MIN_SIZE_M = 0.5
# Of all objects of a file.
_MAX_PLACES = 100_000
_MAX_VERTICES = 5_000_000
_CLASSES = {"tree": "vegetation", "obstacle": "wall"}
_NO_SIZE = "it has no outline, length, width or radius"
_PAINT = "paint on the road, or nothing above it"
_CELL_M = 0.05
# The kind of a pole with several signals is the first of these.
_KIND_ORDER = ("traffic light", "lamp post", "sign", "pole")


def object_kind(element: Element) -> str | None:
    """Kind of an object from its type and name; None: none that matters.

    "crosswalk", "parking space", "tree", "vegetation", "building", "wall",
    "parked vehicle", one of ``POLE_KINDS``, or "obstacle" if the standard's
    type says no more than that.

    Parameters
    ----------
    element : Element
        The <object>.

    Returns
    -------
    kind : str or None
        The words are those of ``data/opendrive.toml``.
    """
    object_type = element.get("type", "")
    name = element.get("name", "")
    subtype = element.get("subtype", "")
    if has_word(
        (object_type, name, subtype), load_facts()["object_words"]["crosswalk"]
    ):
        # Some write them as road marks.
        return "crosswalk"
    if has_word((object_type, name), load_facts()["flat"]["words"]):
        return None
    if element.find("parkingSpace") is not None:
        return "parking space"
    plain = "".join(words_of(object_type))
    for kind, types in load_facts()["object_types"].items():
        if plain in types and element.get("dynamic", "no") != "yes":
            return str(kind)
    # The type decides, unless it is one that says nothing.
    texts: tuple[str, ...] = (object_type,)
    if plain in load_facts()["says_nothing"]:
        texts = (name, subtype)
    for text in texts:
        for kind, listed in load_facts()["object_words"].items():
            if has_word((text,), listed):
                return str(kind)
    if plain == "obstacle":
        return "obstacle"
    return None


def signal_kind(element: Element) -> str | None:
    """Kind of a signal from its name and types; None: other paint.

    What the file calls static is no traffic light, whatever its name.

    Parameters
    ----------
    element : Element
        The <signal>.

    Returns
    -------
    kind : {"traffic light", "crosswalk", "sign"} or None
        A crosswalk is painted on the road.
    """
    facts = load_facts()["signals"]
    texts = (
        element.get("name", ""),
        element.get("type", ""),
        element.get("subtype", ""),
    )
    number = element.get("type", "").strip()
    dynamic = element.get("dynamic", "").strip().lower()
    is_dynamic = dynamic in ("yes", "true", "1")
    is_static = dynamic in ("no", "false", "0")
    if number in facts["crosswalk_types"] and not is_dynamic:
        return "crosswalk"
    if has_word(texts, facts["painted_words"]):
        return None
    if is_dynamic and number in facts["light_types"]:
        return "traffic light"
    if not is_static and has_word(texts, facts["light_words"]):
        return "traffic light"
    return "sign"


# ---------- crosswalks
def crosswalk_line(
    road: Road,
    spot: Spot,
    outlines: Sequence[Outline],
    turn_rad: float,
) -> FloatArray | None:
    """Line on which pedestrians cross; None: the object has no extent.

    It runs the long way through the smallest box around the outline, or across
    the road if that box is nearly square.

    Parameters
    ----------
    road : Road
        The road.
    spot : Spot
        Place of the object.
    outlines : sequence of Outline
        Outlines of the object at this place; empty: its sizes count.
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]

    Returns
    -------
    line_m : (2, 2) float or None
        Begin and end. [m]
    """
    found = _corners(road, spot, outlines, turn_rad)
    if found is None:
        return None
    corners, _ = found
    if len(corners) == 2:
        if np.hypot(*(corners[1] - corners[0])) > _MIN_LENGTH_M:
            return corners
        return None
    if not len(corners):
        return None
    # Flags that GEOS leaves behind.
    with np.errstate(divide="ignore", invalid="ignore"):
        box = shapely.MultiPoint(corners).minimum_rotated_rectangle
    if box.geom_type != "Polygon":
        return None
    # The long way, unless the sides are nearly equal: then the way across the road.
    ring = np.asarray(box.exterior.coords)[:4]
    sides = np.array([ring[1] - ring[0], ring[2] - ring[1]])
    lengths = np.hypot(*sides.T)
    longer = int(lengths.argmax())
    if lengths[longer] < _CLEARLY_LONGER * lengths[1 - longer]:
        _, heading = place(road, spot)
        across_road = np.array([-np.sin(heading), np.cos(heading)])
        longer = int(np.abs(sides @ across_road / lengths).argmax())
    if lengths[longer] < _MIN_LENGTH_M:
        return None
    half = 0.5 * np.array([[-1.0], [1.0]]) * sides[longer]
    return np.asarray(ring.mean(axis=0) + half)


def _corners(
    road: Road,
    spot: Spot,
    outlines: Sequence[Outline],
    turn_rad: float,
) -> tuple[FloatArray, FloatArray] | None:
    """Corners of an object's outline or box; None: it has no extent.

    Parameters
    ----------
    road : Road
        The road.
    spot : Spot
        Place of the object.
    outlines : sequence of Outline
        Outlines of the object at this place; empty: its sizes count.
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]

    Returns
    -------
    points_m : (n, 2) float
        On the map. [m]
    road_m : (n, 2) float
        The same as s and t. [m]
    """
    if outlines:
        return outlines[0].points_m, outlines[0].road_m
    if spot.length_m is None or spot.width_m is None:
        return None
    box = box_corners(spot, spot.length_m, spot.width_m, turn_rad)
    return road.place(*box.T)[0][:, :2], box


# ---------- parking spaces
@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """Parking space as a box along its road.

    Attributes
    ----------
    first_m : float
        First station. [m]
    last_m : float
        Last station. [m]
    right_m : float
        T of its right side. [m]
    left_m : float
        T of its left side. [m]
    """

    first_m: float
    last_m: float
    right_m: float
    left_m: float

    @property
    def t_m(self) -> float:
        """Position of its middle to the left of the reference line, in metres."""
        return 0.5 * (self.right_m + self.left_m)


def read_space(
    road: Road,
    spot: Spot,
    outlines: Sequence[Outline],
    turn_rad: float,
) -> Space | None:
    """One parking space, or a strip of them; None if it has no extent.

    Parameters
    ----------
    road : Road
        The road.
    spot : Spot
        Place of the object.
    outlines : sequence of Outline
        Outlines of the object at this place; empty: its sizes count.
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]

    Returns
    -------
    space : Space or None
        In stations and offsets of its road.
    """
    if spot.end is not None:
        if spot.width_m is None:
            return None
        t_m = 0.5 * (spot.t_m + spot.end.t_m)
        half_m = 0.5 * spot.width_m
        corners = np.array([[spot.s_m, t_m - half_m], [spot.end.s_m, t_m + half_m]])
    else:
        found = _corners(road, spot, outlines, turn_rad)
        if found is None:
            return None
        _, corners = found
    first_m, right_m = corners.min(axis=0).tolist()
    last_m, left_m = corners.max(axis=0).tolist()
    if min(last_m - first_m, left_m - right_m) < _MIN_SIZE_M:
        return None
    return Space(first_m=first_m, last_m=last_m, right_m=right_m, left_m=left_m)


def build_rows(road: Road, spaces: Sequence[Space]) -> Iterator[MapLane]:
    """Parking lanes of a road: spaces in a row become one lane.

    A lane is as wide as its spaces are on average, and runs in the direction of
    traffic on its side.

    Parameters
    ----------
    road : Road
        The road.
    spaces : sequence of Space
        Parking spaces along the road, in any order.

    Yields
    ------
    lane : MapLane
        Of the kind "parking".
    """
    # Append each space to the row that it continues, or begin a new row.
    rows: list[list[Space]] = []
    # Those that may still go on.
    open_rows: list[list[Space]] = []
    for space in sorted(spaces, key=lambda space: space.first_m):
        reach_m = space.first_m - _SAME_ROW_GAP_M
        open_rows = [row for row in open_rows if row[-1].last_m >= reach_m]
        for row in open_rows:
            if abs(row[-1].t_m - space.t_m) <= _SAME_ROW_T_M:
                row.append(space)
                break
        else:
            rows.append([space])
            open_rows.append(rows[-1])
    # One lane along the middles of the spaces of each row.
    for at, row in enumerate(rows, start=1):
        first_m = max(min(space.first_m for space in row), 0.0)
        last_m = min(max(space.last_m for space in row), road.length_m)
        if last_m - first_m < _MIN_SIZE_M:
            continue
        s_m = np.linspace(
            first_m,
            last_m,
            max(2, int(np.ceil((last_m - first_m) / _STEP_M)) + 1),
        )
        middles = np.array([0.5 * (space.first_m + space.last_m) for space in row])
        order = np.argsort(middles)
        t_m = np.interp(
            s_m,
            middles[order],
            np.array([space.t_m for space in row])[order],
        )
        points, _ = road.place(s_m, t_m)
        follows = (float(t_m.mean()) < 0.0) != road.keeps_left
        name = f"{road.id}/parking {at}"
        line_m = points
        if not follows:
            line_m = points[::-1]
        width_m = float(np.mean([space.left_m - space.right_m for space in row]))
        yield MapLane(id=name, kind="parking", width_m=width_m, centreline_m=line_m)


# ---------- all objects
@dataclass(frozen=True, slots=True)
class FoundObjects:
    """Objects along the roads.

    Attributes
    ----------
    things : list of Thing
        Solids that can hide somebody.
    poles : list of Pole
        Poles that could carry sensors.
    crosswalks_m : list of (2, 2) float
        Lines on which pedestrians cross. [m]
    spaces : dict[str, list[Space]]
        Parking spaces by id of the road.
    """

    things: list[Thing] = field(default_factory=list)
    poles: list[Pole] = field(default_factory=list)
    crosswalks_m: list[FloatArray] = field(default_factory=list)
    spaces: dict[str, list[Space]] = field(default_factory=dict)


def read_objects(roads: Mapping[str, Road], omissions: Omissions) -> FoundObjects:
    """Objects of all roads; what is left out is noted.

    Parameters
    ----------
    roads : Mapping[str, Road]
        Roads of the file, by id.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    found : FoundObjects
        In the coordinates of the map.

    Raises
    ------
    InputError
        A number is missing or not finite, or there are too many objects or
        corners.
    """
    found = FoundObjects()
    n_places = 0
    n_vertices = 0
    n_counted = 0

    def refuse_many(n: int, most: int, noun: str, where: str) -> None:
        if n > most:
            got = f"more than {most:,} {noun} up to here"
            refuse(where, got, "a smaller file: cut it out first")

    for kind, one in list(_taken_objects(roads, omissions)):
        places = list(
            islice(read_places(one.element, one.road, one.where), _MAX_PLACES + 1)
        )
        n_places += len(places)
        if not places:
            omissions.add(
                "objects beyond their road's end",
                one.name,
                "beyond its road's end",
            )
        refuse_many(n_places, _MAX_PLACES, "objects", one.where)
        for index, spot in enumerate(places):
            name = one.name
            if len(places) > 1:
                name = f"{one.name}/{index}"
            if not _take(kind, one, spot, name, found):
                omissions.add(f"objects ({kind}) without size", name, _NO_SIZE)
            n_vertices += sum(
                len(thing.vertices_m) for thing in found.things[n_counted:]
            )
            n_counted = len(found.things)
            refuse_many(n_vertices, _MAX_VERTICES, "corners", one.where)
    return found


def _taken_objects(
    roads: Mapping[str, Road],
    omissions: Omissions,
) -> Iterator[tuple[str, RoadElement]]:
    """Objects of a kind that matters; the others are noted.

    Parameters
    ----------
    roads : Mapping[str, Road]
        Roads of the file, by id.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Yields
    ------
    taken : (str, RoadElement)
        Kind and object.
    """
    names: Counter[str] = Counter()
    for road in roads.values():
        for tag, why in load_facts()["not_taken"].items():
            for element in road.element.findall(f"objects/{tag}"):
                name = f"road {road.id} {tag} {element.get('id', '')[:60]}".strip()
                omissions.add(f"{tag}s", name, why)
        if road.element.find("railroad/switch") is not None:
            omissions.add(
                "railroads",
                f"road {road.id} railroad",
                "no road users go there",
            )
        for one in road.listed("object", names):
            kind = object_kind(one.element)
            if kind is not None:
                yield kind, one
                continue
            said = (
                one.element.get("type", "") or one.element.get("name", "") or "no type"
            )
            why = "its kind hides nothing and carries nothing"
            omissions.add(f"objects ({said[:40]})", one.name, why)


def _take(
    kind: str, one: RoadElement, spot: Spot, name: str, found: FoundObjects
) -> bool:
    """Add an object at one of its places; False: it has no size.

    Parameters
    ----------
    kind : str
        See :func:`object_kind`.
    one : RoadElement
        The object.
    spot : Spot
        Place of the object.
    name : str
        Id of the thing, unique in the map.
    found : FoundObjects
        Objects found so far; extended.

    Returns
    -------
    has_size : bool
        False: nothing was added.
    """
    if kind in POLE_KINDS:
        top_m = 0.0
        if spot.height_m is not None:
            top_m = spot.z_m + spot.height_m
        height_m = None
        if top_m > 0.0:
            height_m = top_m
        foot_m, _ = place(one.road, spot)
        found.poles.append(
            Pole(id=name, kind=kind, position_m=foot_m, height_m=height_m)
        )
        return True
    outlines: list[Outline] = []
    if spot.end is None:
        outlines += read_outlines(one.element, one.road, spot, one.where)
    turn_rad = take_number_or(one.element, "hdg", one.where, 0.0)
    if kind == "crosswalk":
        line = crosswalk_line(one.road, spot, outlines, turn_rad)
        if line is not None:
            found.crosswalks_m.append(line)
        return line is not None
    if kind == "parking space":
        space = read_space(one.road, spot, outlines, turn_rad)
        if space is not None:
            found.spaces.setdefault(one.road.id, []).append(space)
        return space is not None
    try:
        # Flags that GEOS leaves behind.
        with np.errstate(divide="ignore", invalid="ignore"):
            body = build_body(
                one.road,
                kind,
                spot,
                outlines,
                turn_rad=turn_rad,
                where=one.where,
            )
    except InputError:
        # Its outline surrounds nothing.
        return False
    if body is None:
        return False
    mesh, is_assumed = body
    class_name = _CLASSES.get(kind, kind)
    found.things.append(Thing.of(name, class_name, mesh, is_height_assumed=is_assumed))
    return True


# ---------- signals
def read_signals(
    roads: Mapping[str, Road],
    sampled: Mapping[str, Sequence[SampledSection]],
    omissions: Omissions,
) -> tuple[list[Pole], list[FloatArray]]:
    """Poles of signals, and crosswalks that are written as signals.

    There is one pole for each signal, but none for those that hang over a
    driving lane.

    Parameters
    ----------
    roads : Mapping[str, Road]
        Roads of the file, by id.
    sampled : Mapping[str, Sequence[SampledSection]]
        Sampled lane sections of each road, by its id.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    poles : list of Pole
        With the height of the signal's top.
    crosswalks_m : list of (2, 2) float
        Lines on which pedestrians cross. [m]

    Raises
    ------
    InputError
        A number is missing or not finite.
    """
    facts = load_facts()["signals"]
    poles: list[Pole] = []
    crosswalks: list[FloatArray] = []
    names: Counter[str] = Counter()
    for one in (one for road in roads.values() for one in road.listed("signal", names)):
        s_m, t_m = (take_number(one.element, key, one.where) for key in "st")
        kind = signal_kind(one.element)
        if not is_on(one.road, s_m):
            omissions.add(
                "signals beyond their road's end",
                one.name,
                "beyond its road's end",
            )
        elif kind == "crosswalk":
            line = _painted_line(
                one,
                s_m,
                t_m,
                _driving_edges(sampled[one.road.id], s_m),
            )
            if line is not None:
                crosswalks.append(line)
        elif kind is None:
            omissions.add("painted signals", one.name, _PAINT)
        else:
            foot_m = one.road.place(np.array([s_m]), np.array([t_m]))[0][0]
            top_m = take_size(one.element, "height", one.where) or 0.0
            top_m += take_number_or(one.element, "zOffset", one.where, 0.0)
            is_light = kind == "traffic light"
            edges = _driving_edges(sampled[one.road.id], s_m)
            if not is_light and top_m < facts["min_sign_top_m"]:
                omissions.add(f"signals ({kind})", one.name, _PAINT)
            elif any(right < t_m < left for right, left in edges):
                why = "it hangs over a lane: there is no pole below it"
                omissions.add(f"signals ({kind})", one.name, why)
            else:
                least_m = facts["min_sign_top_m"]
                if is_light:
                    least_m = facts["min_light_top_m"]
                height_m = None
                if top_m >= least_m:
                    height_m = top_m
                poles.append(
                    Pole(id=one.name, kind=kind, position_m=foot_m, height_m=height_m)
                )
    return poles, crosswalks


def _painted_line(
    one: RoadElement,
    s_m: float,
    t_m: float,
    edges: Sequence[tuple[float, float]],
) -> FloatArray | None:
    """Line of a painted crosswalk; None: its length is not known.

    Parameters
    ----------
    one : RoadElement
        The signal.
    s_m : float
        Where it lies along the road. [m]
    t_m : float
        To the left of the reference line. [m]
    edges : Sequence[tuple[float, float]]
        Edges (right, left) of the driving lanes there. [m]

    Returns
    -------
    line_m : (2, 2) float or None
        As long as the signal says, or across all driving lanes. [m]
    """
    length_m = take_size(one.element, "width", one.where)
    if not length_m and edges:
        length_m = max(left for _, left in edges) - min(right for right, _ in edges)
    if not length_m:
        return None
    points, heading = one.road.place(np.array([s_m]), np.array([t_m]))
    # Around the other way is the same line: whole and half turns are of no matter.
    angle = heading[0] + take_number_or(one.element, "hOffset", one.where, 0.0)
    angle += 0.5 * np.pi
    across = np.array([np.cos(angle), np.sin(angle)])
    half = 0.5 * length_m * np.array([[-1.0], [1.0]]) * across
    return np.asarray(points[0, :2] + half)


def _driving_edges(
    sections: Sequence[SampledSection],
    s_m: float,
) -> list[tuple[float, float]]:
    """Edges (right, left) of lanes for cars and buses at a station, in metres."""
    index = bisect_left(sections, s_m, key=lambda one: float(one.s_m[-1]))
    section = sections[min(index, len(sections) - 1)]
    edges = []
    for lane in section.lanes.values():
        if lane_kind(lane.record.type) in ("driving", "bus"):
            sides = (lane.inner_m, lane.outer_m)
            right, left = sorted(
                float(np.interp(s_m, section.s_m, side)) for side in sides
            )
            edges.append((right, left))
    return edges


# ---------- poles
def merge_poles(poles: Sequence[Pole]) -> list[Pole]:
    """Poles, where those within half a metre of one another are joined.

    A joined pole is as high as the highest and of the most telling kind; it
    stands where the file has the pole itself, or else where the first signal
    hangs.

    Parameters
    ----------
    poles : sequence of Pole
        Poles of signals and objects.

    Returns
    -------
    joined : list of Pole
        In the order of the first pole of each group.
    """
    if len(poles) < 2:
        return list(poles)
    positions = np.array([pole.position_m[:2] for pole in poles])
    # First those at the very same place: of thousands there, every pair would count.
    cells = np.round(positions / _CELL_M)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    tree = cKDTree(positions[first])
    pairs = tree.query_pairs(
        load_facts()["signals"]["same_pole_m"],
        output_type="ndarray",
    )
    links = coo_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])),
        shape=(len(first),) * 2,
    )
    _, labels = connected_components(links, directed=False)
    groups: dict[int, list[Pole]] = {}
    for pole, label in zip(poles, labels[cell.reshape(-1)], strict=True):
        groups.setdefault(int(label), []).append(pole)
    # One pole of each group stands for all of them.
    joined = []
    for group in groups.values():
        stands = next(
            (pole for pole in group if pole.kind in ("pole", "lamp post")), group[0]
        )
        heights_m = [pole.height_m for pole in group if pole.height_m is not None]
        kind = min((pole.kind for pole in group), key=_KIND_ORDER.index)
        joined.append(replace(stands, kind=kind, height_m=max(heights_m, default=None)))
    return joined
