"""Content of a map file in any format: lanes, junctions, crosswalks, things, poles; their kinds."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, freeze, set_arrays
from ..errors import InputError, check_one_of
from ..files import load_toml, pick
from ..notes import Note
from ..scene import LeadingRoad, Turn
from .solids import Mesh

LANE_KINDS = ("driving", "parking", "cycling", "walking")
POLE_KINDS = ("lamp post", "traffic light", "sign", "pole")
Heights = Literal["above ground", "absolute"]
MAX_TRIANGLES = 5_000_000  # of the things of a file
_MAX_ID = 120  # characters
_MAX_SKIPPED = 100  # entries


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapLane:
    """One lane between two junctions, or from one to where it ends."""

    id: str  # from the source; unique in the map
    kind: str  # one of ``LANE_KINDS``
    # mean full width; where it varies and the lane leads to a junction, that of the 30 m next to it
    width_m: float
    # (n, 3); at least two points in driving direction; lanes without one (walking, parking) have
    # that of the driving lane next to them
    centreline_m: FloatArray
    # ids of the junctions at its ends, where it stops at the outline; empty: none
    from_junction: str = ""
    to_junction: str = ""
    # where it leads into a junction, or else out of one; None: the source gives none
    speed_limit_kmh: float | None = None
    # where cars may drive from its end by its markings, see :class:`geometry.scene.Lane`
    turns: tuple[Turn, ...] = ()

    def __post_init__(self) -> None:
        where = f"lane {self.id}"
        check_one_of(f"{where}.kind", self.kind, LANE_KINDS)
        if not (np.isfinite(self.width_m) and self.width_m > 0.0):
            raise InputError(f"{where}.width_m", self.width_m, "metres, > 0")
        set_arrays(self, f"{where}.", centreline_m=(-1, 3))
        if len(self.centreline_m) < 2:
            raise InputError(f"{where}.centreline_m", len(self.centreline_m), "at least two points")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapJunction:
    """A junction of roads."""

    id: str  # from the source; unique in the map
    name: str  # for people, such as the streets that meet; may be empty
    # (n, 2); outline of its road surface, where the lanes of its arms begin and end
    outline_m: FloatArray
    height_m: float = 0.0  # height of the road in its middle, as the map counts heights
    # roads that lead to it, as the map's network has them: what its arms are compared with
    roads: tuple[LeadingRoad, ...] = ()

    def __post_init__(self) -> None:
        where = f"junction {self.id}."
        set_arrays(self, where, outline_m=(-1, 2))
        if len(self.outline_m) < 3:
            raise InputError(f"{where}outline_m", len(self.outline_m), "at least three points")

    @property
    def position_m(self) -> FloatArray:
        """Its middle, (2,): that of the box around the outline."""
        middle: FloatArray = 0.5 * (self.outline_m.min(axis=0) + self.outline_m.max(axis=0))
        return middle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A solid object."""

    id: str  # from the source; unique in the map
    class_name: str  # one of :data:`geometry.scene.CLASS_NAMES`
    vertices_m: FloatArray  # (n, 3); heights as the map counts them
    triangles: NDArray[np.int32]  # (m, 3); vertex indices, counter-clockwise seen from outside
    is_height_assumed: bool = False  # the source does not give its height

    def __post_init__(self) -> None:
        where = f"{self.class_name} {self.id}"
        set_arrays(self, f"{where}.", vertices_m=(-1, 3))
        n_vertices = len(self.vertices_m)
        triangles = freeze(np.array(self.triangles, dtype=np.int32).reshape(-1, 3))
        if len(triangles) and not (triangles.min() >= 0 and triangles.max() < n_vertices):
            expected = f"indices below {n_vertices}"
            raise InputError(f"{where}.triangles", int(triangles.max()), expected)
        object.__setattr__(self, "triangles", triangles)

    @classmethod
    def of(
        cls, thing_id: str, class_name: str, mesh: Mesh, *, is_height_assumed: bool = False
    ) -> "Thing":
        """Thing with the vertices and triangles of a mesh."""
        return cls(
            id=thing_id,
            class_name=class_name,
            vertices_m=mesh[0],
            triangles=mesh[1],
            is_height_assumed=is_height_assumed,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pole:
    """A pole that could carry sensors."""

    id: str  # from the source; unique in the map
    kind: str  # one of ``POLE_KINDS``
    position_m: FloatArray  # (3,); position of its foot
    height_m: float | None = None  # height of its top above its foot, if the source gives it
    assumed: str = ""  # why its position is not that of the source, in words; empty: it is

    def __post_init__(self) -> None:
        check_one_of(f"pole {self.id}.kind", self.kind, POLE_KINDS)
        set_arrays(self, f"pole {self.id}.", position_m=(3,))


@dataclass(frozen=True, slots=True)
class Omissions:
    """Parts of a file that are left out, by kind and reason so that the list stays short.

    ``found`` has the names by kind and reason.
    """

    found: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str, why: str) -> None:
        """Note that a thing was left out, or changed.

        `kind` is in the plural, "signals of other kinds", `name` the thing at hand: "road 5 signal
        12". Repetitions in a row count once.
        """
        names = self.found.setdefault((kind, why), [])
        if name not in names[-1:]:
            names.append(name)

    def listed(self) -> tuple[Note, ...]:
        """One entry per kind and reason."""
        entries = [
            Note(
                what=names[0]
                if len(names) == 1
                else f"{len(names)} {kind}, such as {names[0]} and {names[1]}",
                why=why,
            )
            for (kind, why), names in self.found.items()
        ]
        if len(entries) > _MAX_SKIPPED:
            n_more = len(entries) - _MAX_SKIPPED + 1
            entries = entries[: _MAX_SKIPPED - 1]
            entries.append(Note(what=f"{n_more} more kinds of things", why="see those above"))
        return tuple(entries)


def unique_id(wanted: str, taken: Counter[str]) -> str:
    """The wanted id, with a number if it is taken; `taken` then contains it."""
    wanted = wanted[:_MAX_ID] or "unnamed"
    candidate = wanted
    while candidate in taken:
        taken[wanted] += 1
        candidate = f"{wanted}-{taken[wanted]}"
    taken[candidate] += 1
    return candidate


def shortened(skipped: Sequence[Note], most: int = _MAX_SKIPPED) -> tuple[Note, ...]:
    """The first of many entries, and one that counts the rest."""
    if len(skipped) <= most:
        return tuple(skipped)
    n_more = len(skipped) - most
    return (*skipped[:most], Note(what=f"{n_more} more", why="for reasons like these"))


def counted(counts: Counter[str], why: str) -> list[Note]:
    """One entry per kind of thing: "3 Bridge"."""
    return [Note(what=f"{n} {kind}", why=why) for kind, n in sorted(counts.items())]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SourceMap:
    """The content of one map file."""

    name: str  # name of the file
    # projected coordinate reference system of all coordinates here, in metres, for pyproj; empty:
    # the file does not say where on earth it lies
    crs: str
    source_crs: str = ""  # the one that the file itself uses, such as "EPSG:4326"
    heights: Heights = "above ground"  # zero of the z axis
    lanes: tuple[MapLane, ...] = ()
    # lanes through junctions, each from the end of a lane to the start of another; both their
    # junctions are the one through which they lead. None: the map does not have them.
    connections: tuple[MapLane, ...] = ()
    junctions: tuple[MapJunction, ...] = ()
    things: tuple[Thing, ...] = ()
    poles: tuple[Pole, ...] = ()
    # (n, 2, 2); lines on which pedestrians cross, from end to end
    crosswalks_m: FloatArray = field(default_factory=lambda: np.empty((0, 2, 2)))
    # (n, 3); points of the ground: of roads' surfaces, nodes with a height, a scan's ground. Their
    # heights are absolute, whatever those of things are.
    ground_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    keeps_left: bool = False  # traffic keeps left
    skipped: tuple[Note, ...] = ()  # what was left out, and why

    def __post_init__(self) -> None:
        set_arrays(self, f"{self.name}: ", ground_m=(-1, 3), crosswalks_m=(-1, 2, 2))

    def __repr__(self) -> str:
        return (
            f"SourceMap({self.name!r}, {len(self.lanes)} lanes, {len(self.junctions)} junctions, "
            f"{len(self.things)} things, {len(self.poles)} poles)"
        )


# ---------- kinds of things and poles
_MAX_NAME = 200  # characters of a name that are looked at
_SECTIONS = 10  # of a pole's cylinder


@dataclass(frozen=True, slots=True, kw_only=True)
class ThingKind:
    """A kind of thing."""

    kind: str
    class_name: str  # one of geometry.scene.CLASS_NAMES
    words: tuple[str, ...]  # in names of such things, in lower case
    height_m: float  # assumed where nothing is stated, as is the thickness
    thickness_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ThingDefaults:
    """The content of ``data/things.toml``."""

    storey_height_m: float
    max_height_m: float  # larger values are not taken for heights
    max_storeys: int  # larger values are not taken for numbers of storeys
    kinds: tuple[ThingKind, ...]  # in the order in which names are searched for their words


@cache
def thing_defaults() -> ThingDefaults:
    """Read ``data/things.toml``."""
    table = load_toml(files(__package__) / "data" / "things.toml")
    return msgspec.convert(table, ThingDefaults)


def kind_from_name(name: str) -> ThingKind | None:
    """The first kind in ``data/things.toml`` one of whose words is in a name; None: no kind.

    Examples
    --------
    >>> kind_from_name("StreetLamp.003").class_name
    'lamp post'
    >>> kind_from_name("Wallace") is None
    True
    """
    apart = re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", " ", name[:_MAX_NAME]).lower()
    words = " ".join(re.findall(r"[a-zäöüß]+", apart))
    for kind in thing_defaults().kinds:
        if any(re.search(rf"\b{re.escape(word)}s?\b", words) for word in kind.words):
            return kind
    return None


def kind_of_class(class_name: str) -> ThingKind:
    """The defaults of a class: its last kind in ``data/things.toml``."""
    known = {kind.class_name: kind for kind in thing_defaults().kinds}
    return pick(known, class_name, "class_name")


MIN_POLE_M = 2.5
"""A lower pole is a bollard: sensors on it could be reached from the pavement."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoleKind:
    """A kind of pole, for poles of which the map gives no more."""

    kind: str
    height_m: float
    radius_m: float
    height_range_m: tuple[float, float]  # lowest and highest mount above the road
    capacity_units: int  # sensors that it can carry


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoSites:
    """Rules for sites where nothing else is asked for: ``[auto]`` of ``data/sites.toml``."""

    spacing_m: float  # between masts along the kerbs
    near_m: float  # they are assumed where no pole is as near to the middle
    neighbour_m: float  # poles as near to another junction are that one's
    min_sign_m: float  # lower sign posts are no sites


@cache
def load_auto_sites() -> AutoSites:
    """Read ``[auto]`` of ``data/sites.toml``."""
    return msgspec.convert(load_toml(files(__package__) / "data" / "sites.toml")["auto"], AutoSites)


@cache
def load_pole_kinds() -> dict[str, PoleKind]:
    """All kinds of poles by name, from ``data/sites.toml``."""
    table = load_toml(files(__package__) / "data" / "sites.toml")
    return {one.kind: one for one in msgspec.convert(table["kinds"], list[PoleKind])}


def build_pole_body(pole: Pole) -> tuple[str, Mesh]:
    """Class and mesh of a pole that stands on the road plane."""
    import trimesh

    kind = load_pole_kinds()[pole.kind]
    height_m = pole.height_m or kind.height_m
    foot = np.append(pole.position_m[:2], 0.0)
    body = trimesh.creation.cylinder(
        radius=kind.radius_m, segment=[foot, foot + [0.0, 0.0, height_m]], sections=_SECTIONS
    )
    class_name = "traffic light" if pole.kind == "traffic light" else "lamp post"
    return class_name, (np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32))


def mount_range_m(pole: Pole) -> tuple[float, float]:
    """Lowest and highest mount on a pole in metres: a low pole carries sensors at its top."""
    low, high = load_pole_kinds()[pole.kind].height_range_m
    if pole.height_m is None:
        return low, high
    top = min(max(high, low), max(pole.height_m, 1.0))
    return min(low, top), top
