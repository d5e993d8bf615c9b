"""Kinds of things and poles: names, sizes where a file gives none, capacities of poles."""

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import msgspec
import numpy as np

from ..files import load_toml, pick
from .solids import Mesh
from .source_map import Pole

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
    kind: ThingKind = pick(known, class_name, "class_name")
    return kind


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
    """What is a site where nothing else is asked for: ``[auto]`` of ``data/sites.toml``."""

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
