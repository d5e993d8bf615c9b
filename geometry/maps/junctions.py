"""The junctions of a map: list them, and choose one by name or place."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from functools import cache
from importlib.resources import files

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted, check_one_of
from ..files import load_toml
from ..junction import build_junction
from ..scene import Instance, Lane, Scene
from .georeferences import WGS84, transform
from .source_map import MapJunction, MapLane, SourceMap

_MAX_LISTED = 12
_NEAR_M = 100.0
_BESIDE_M = 15.0  # from the outline: signals and crosswalks of the arms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surveyed:
    """A junction of a map and the lanes that lead to it."""

    junction: MapJunction  # the junction itself
    arms: tuple[str, ...]  # names of its arms; empty if no lane ends at its outline
    n_lanes: int  # driving lanes into it and out of it
    n_driven: int  # arms from which a driving lane leads into it
    # (2,); its middle in the file's coordinate reference system: longitude and latitude, or metres
    position: FloatArray
    n_signals: int = 0  # poles with traffic lights inside it, or at most 15 m from its outline
    n_crossings: int = 0  # crosswalks whose middle lies inside it, or at most 15 m from its outline


def survey_junctions(source: SourceMap) -> tuple[Surveyed, ...]:
    """All junctions of a map, the largest first: by arms, driven arms, then lanes.

    Of equally large ones the one nearest to the middle of the map comes first.
    """
    by_junction: dict[str, list[MapLane]] = {junction.id: [] for junction in source.junctions}
    for lane in source.lanes:
        for name in {lane.from_junction, lane.to_junction} & by_junction.keys():
            by_junction[name].append(lane)
    lights = [pole.position_m[:2] for pole in source.poles if pole.kind == "traffic light"]
    signals = _count_near(source.junctions, np.array(lights).reshape(-1, 2))
    crossings = _count_near(source.junctions, source.crosswalks_m.mean(axis=1))
    found = [
        replace(
            _survey(source, one, by_junction[one.id]),
            n_signals=signals[index],
            n_crossings=crossings[index],
        )
        for index, one in enumerate(source.junctions)
    ]
    if not found:
        return ()
    middle = np.median([one.junction.position_m for one in found], axis=0)

    def rank(one: Surveyed) -> tuple[float, ...]:
        off_m = float(np.hypot(*(one.junction.position_m - middle)))
        return (-len(one.arms), -one.n_driven, -one.n_lanes, off_m)

    return tuple(sorted(found, key=rank))


def _count_near(junctions: Sequence[MapJunction], points_m: FloatArray) -> list[int]:
    """How many points lie inside each junction or next to it."""
    import shapely

    if not len(points_m):
        return [0] * len(junctions)
    areas = [shapely.make_valid(shapely.Polygon(one.outline_m)) for one in junctions]
    points = shapely.points(points_m)
    hit, _ = shapely.STRtree(areas).query(points, predicate="dwithin", distance=_BESIDE_M)[::-1]
    counts: list[int] = np.bincount(hit, minlength=len(junctions)).tolist()
    return counts


SORTS = ("arms", "lanes", "signals", "crossings", "name")


def sort_junctions(surveyed: Sequence[Surveyed], sort: str) -> tuple[Surveyed, ...]:
    """Junctions in another order: the most first, or names by the alphabet.

    `surveyed`: as :func:`survey_junctions` returns them; equal ones stay in this order. `sort`: one
    of ``SORTS``; "arms" is the order that they come in. Raises InputError: `sort` is none of them.
    """
    check_one_of("sort", sort, SORTS)
    if sort == "name":
        return tuple(sorted(surveyed, key=lambda one: one.junction.name.casefold()))
    if sort == "arms":
        return tuple(surveyed)
    return tuple(sorted(surveyed, key=lambda one: -int(getattr(one, f"n_{sort}"))))


def choose_junction(
    source: SourceMap,
    surveyed: Sequence[Surveyed],
    *,
    name: str = "",
    at: tuple[float, float] | None = None,
) -> Surveyed:
    """Choose a junction by name or point; by default the first.

    Raises InputError: the map has no junction, or none or several match.

    Parameters
    ----------
    source : SourceMap
        The map.
    surveyed : sequence of Surveyed
        Its junctions, as :func:`survey_junctions` returns them.
    name : str
        Id; or name, streets in any order: "Mannerheimintie / Kaivokatu", or some of them, also
        shortened (St, Ave, Str.); or a part of the name that no other junction has; or "latitude,
        longitude" within 100 m in degrees; empty: any.
    at : (float, float), optional
        A point within 100 m, in the file's coordinate reference system: longitude and latitude, or
        metres.
    """
    if not surveyed:
        raise InputError(source.name, Unquoted("no junction"), "a map in which roads meet")
    where = "at"
    if name:
        place = _LAT_LON.fullmatch(name)
        if place is None or any(one.junction.id == name for one in surveyed):
            return _by_name(surveyed, name)
        where, at = "junction", _from_degrees(source, (float(place[2]), float(place[1])), name)
    if at is None:
        return surveyed[0]
    point = _in_map(source, at)
    if not np.isfinite(point).all():
        raise InputError(where, Unquoted(f"{at[0]:g},{at[1]:g}"), f"a point in {source.source_crs}")
    distance = [float(np.hypot(*(one.junction.position_m - point))) for one in surveyed]
    nearest = int(np.argmin(distance))
    if not distance[nearest] <= _NEAR_M:
        got = name or f"{at[0]:.8g},{at[1]:.8g}"
        exchanged = _in_map(source, (at[1], at[0]))
        if min(np.hypot(*(one.junction.position_m - exchanged)) for one in surveyed) <= _NEAR_M:
            order = "longitude,latitude" if source.source_crs == "EPSG:4326" else "X,Y"
            order = "latitude,longitude" if name else order
            raise InputError(where, Unquoted(got), f"{order}: it is the other way round")
        place_of = ", ".join(f"{value:.8g}" for value in surveyed[nearest].position)
        raise InputError(
            where,
            Unquoted(got),
            f"a point within {_NEAR_M:g} m of a junction; the nearest one, "
            f"{surveyed[nearest].junction.id}, is at {place_of}",
        )
    return surveyed[nearest]


def _by_name(surveyed: Sequence[Surveyed], name: str) -> Surveyed:
    wanted = name.casefold()
    for matches in (
        [one for one in surveyed if one.junction.id == name],
        [one for one in surveyed if one.junction.name.casefold() == wanted],
        [one for one in surveyed if _streets(one.junction.name) == _streets(name)],
        [one for one in surveyed if _streets(one.junction.name) >= _streets(name)],
        [one for one in surveyed if _streets(one.junction.name) >= _streets(name, _BETWEEN)],
        [one for one in surveyed if wanted in one.junction.name.casefold()],
    ):
        if len(matches) == 1:
            return matches[0]
        if matches:
            raise InputError("junction", name, f"one of {_listed(matches)}")
    close = {
        one: SequenceMatcher(None, wanted, one.casefold()).ratio()
        for one in {other.junction.name for other in surveyed}
    }
    nearest = sorted(surveyed, key=lambda one: -close[one.junction.name])
    raise InputError("junction", name, f"one of {_listed(nearest)}")


_LAT_LON = re.compile(r"\s*([-+]?\d{1,2}(?:\.\d+)?)\s*,\s*([-+]?\d{1,3}(?:\.\d+)?)\s*")
_BETWEEN = re.compile(r"\s*[/&+;]\s*|\s+(?:and|und|at|x|@)\s+", re.IGNORECASE)


def _streets(name: str, between: re.Pattern[str] = re.compile("/")) -> frozenset[str]:
    """Names of streets that meet, in any order and case, with all their words shortened."""
    return frozenset(_shortened(part) for part in between.split(name))


def _shortened(street: str) -> str:
    words, endings = _short_forms()
    found = []
    for word in re.findall(r"[^\W_]+", street.casefold()):
        for long, short in endings.items():
            if word.endswith(long) and word != long:
                word = word.removesuffix(long) + short
        found.append(words.get(word, word))
    return " ".join(found)


@cache
def _short_forms() -> tuple[dict[str, str], dict[str, str]]:
    """Words of street names, and their endings, to how they are shortened."""
    table = load_toml(files(__package__) / "data" / "streets.toml")
    words, endings = (
        {long: short for short, longs in table[key].items() for long in longs}
        for key in ("words", "endings")
    )
    return words, endings


def _from_degrees(
    source: SourceMap, lon_lat_deg: tuple[float, float], name: str
) -> tuple[float, float]:
    """A point in the map's own coordinates, as ``at`` has it."""
    if not source.crs:
        raise InputError("junction", name, "an id or a name: the map does not say where it lies")
    x, y = transform(np.array(lon_lat_deg), WGS84, source.source_crs or source.crs)
    return float(x), float(y)


def _listed(surveyed: Sequence[Surveyed]) -> str:
    many = len({one.junction.name for one in surveyed}) < len(surveyed)  # names tell nothing apart
    words = []
    for one in surveyed[:_MAX_LISTED]:
        label = one.junction.name
        if many:
            label += " at " * bool(label) + ",".join(f"{value:.8g}" for value in one.position)
        words.append(f"{one.junction.id} ({label})" if label else one.junction.id)
    left = len(surveyed) - len(words)
    return ", ".join(words) + (f" and {left} more" if left else "")


def _in_map(source: SourceMap, at: tuple[float, float]) -> FloatArray:
    """A point in the map's coordinates; infinite if it is nowhere on earth."""
    if not source.crs or source.source_crs in ("", source.crs):
        return np.array(at)
    return transform(np.array(at), source.source_crs, source.crs)


def _survey(source: SourceMap, junction: MapJunction, lanes: Sequence[MapLane]) -> Surveyed:
    position = junction.position_m
    if source.crs and source.source_crs not in ("", source.crs):
        position = transform(position, source.crs, source.source_crs)
    # Near the origin, as build_junction's other users have it; nothing but the lanes counts.
    scene = Scene(
        name=junction.id,
        vertices_m=np.zeros((0, 3)),
        triangles=np.zeros((0, 3), dtype=np.int32),
        triangle_instance=np.zeros(0, dtype=np.int32),
        instances=(Instance(id="ground", class_name="ground"),),
        sites=(),
        outline_m=junction.outline_m - junction.position_m,
        lanes=tuple(_moved(lanes, junction.position_m)),
        crs="",
        keeps_left=source.keeps_left,
    )
    try:
        arms = build_junction(scene).arms
    except InputError:  # no lane ends at the outline
        arms = {}
    return Surveyed(
        junction=junction,
        arms=tuple(arms),
        n_lanes=sum(len(arm.entry_lanes) + len(arm.exit_lanes) for arm in arms.values()),
        n_driven=sum(bool(arm.entry_lanes) for arm in arms.values()),
        position=position,
    )


def _moved(lanes: Sequence[MapLane], origin_m: FloatArray) -> Iterator[Lane]:
    for lane in lanes:
        if lane.kind in ("driving", "parking"):
            yield Lane(
                id=lane.id,
                kind=lane.kind,
                width_m=lane.width_m,
                centreline_m=lane.centreline_m[:, :2] - origin_m,
            )
