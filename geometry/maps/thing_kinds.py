"""Kinds of things and poles: names, sizes where a file gives none, capacities of poles."""

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, float_array
from ..files import load_toml, pick, take, take_list, take_number, take_text
from ..scene import CLASS_NAMES
from .source_map import Pole

# ---------- what things are called


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
    name = "things.toml"
    table = load_toml(files(__package__) / "data" / name)
    kinds = []
    for index, entry in enumerate(take_list(table, "kinds", name)):
        where = f"{name}: kinds[{index}]"
        kind = ThingKind(
            kind=take_text(entry, "kind", where),
            class_name=take_text(entry, "class_name", where),
            words=tuple(take_list(entry, "words", where)),
            height_m=take_number(entry, "height_m", where),
            thickness_m=take_number(entry, "thickness_m", where),
        )
        pick(dict.fromkeys(CLASS_NAMES), kind.class_name, f"{where}.class_name")
        kinds.append(kind)
    return ThingDefaults(
        storey_height_m=take_number(table, "storey_height_m", name),
        max_height_m=take_number(table, "max_height_m", name),
        max_storeys=int(take_number(table, "max_storeys", name)),
        kinds=tuple(kinds),
    )


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


_MAX_NAME = 200  # characters of a name that are looked at


# ---------- what poles of a map look like to a ray


_SECTIONS = 10
_CLASSES = {"lamp post": "lamp post"}  # all others look like a signal's pole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoleKind:
    """A kind of pole, for poles of which the map gives no more."""

    height_m: float
    radius_m: float
    height_range_m: FloatArray  # lowest and highest mount above the road
    capacity_units: int  # sensors that it can carry


@cache
def load_pole_kinds() -> dict[str, PoleKind]:
    """All kinds of poles by name, from ``data/sites.toml``."""
    table = load_toml(files(__package__) / "data" / "sites.toml")
    kinds = {}
    for index, entry in enumerate(take_list(table, "kinds", "sites.toml")):
        where = f"sites.toml: kinds[{index}]"
        kinds[take_text(entry, "kind", where)] = PoleKind(
            height_m=take_number(entry, "height_m", where),
            radius_m=take_number(entry, "radius_m", where),
            height_range_m=float_array(
                take_list(entry, "height_range_m", where), (2,), f"{where}.height_range_m"
            ),
            capacity_units=take(entry, "capacity_units", where),
        )
    return kinds


def build_pole_body(pole: Pole) -> tuple[str, FloatArray, NDArray[np.int32]]:
    """Class, vertices (n, 3) and triangles (m, 3) of a pole that stands on the road plane."""
    import trimesh

    kind = load_pole_kinds()[pole.kind]
    height_m = pole.height_m or kind.height_m
    foot = np.append(pole.position_m[:2], 0.0)
    body = trimesh.creation.cylinder(
        radius=kind.radius_m, segment=[foot, foot + [0.0, 0.0, height_m]], sections=_SECTIONS
    )
    class_name = _CLASSES.get(pole.kind, "traffic light")
    return class_name, np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32)


def mount_range_m(pole: Pole) -> FloatArray:
    """Lowest and highest mount on a pole, (2,) in metres: a low pole carries sensors at its top."""
    kind = load_pole_kinds()[pole.kind]
    if pole.height_m is None:
        return kind.height_range_m
    low, high = kind.height_range_m
    top = min(max(high, low), max(pole.height_m, 1.0))
    return np.array([min(low, top), top])
