"""Where poles and sites can stand: beside the road, not on it, and not inside walls."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import BoolArray, FloatArray
from ..notes import Note
from ..scene import covered_area
from ..terrain import HEADROOM_M, headroom_m
from .cut import Surroundings
from .source_map import Pole, Thing

SETBACK_M = (
    0.5  # of a pole's middle from the kerb; assumption: the usual clearance of a carriageway
)
_MAX_MOVE_M = 15.0  # from a lane or the middle of a junction to the kerb
_MAX_MOVE_FROM_WALL_M = 2.0  # farther inside, it hangs on the building
_FROM_WALL_M = 0.3
_MAST_ARM_M = 12.0  # from what hangs over the road to the foot of its pole
_ISLAND_M2 = 4.0  # smaller gaps between lanes are no place to stand
_HANGING = ("traffic light", "sign")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Where something can stand: its place (2,) or None, and why it is not where it was."""

    position_m: FloatArray | None
    why: str = ""  # empty: it stays


def find_places(positions_m: ArrayLike, surroundings: Surroundings) -> list[Place]:
    """Nearest places beside the road and outside walls.

    Parameters
    ----------
    positions_m : (n, 2) float
        Where things would stand, in the scene's frame. [m]
    surroundings : Surroundings
        Lanes, outline and things around the junction.

    Returns
    -------
    places : list of Place
        What stands on a lane or in the junction is moved to the nearest kerb, half a metre behind
        it; what stands inside a building or wall is moved out of it. None: that would be farther
        than 15 m, or from inside a wall 2 m.
    """
    import shapely

    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 2)
    road = covered_area(surroundings.outline_m, surroundings.lanes)
    shapely.prepare(road)
    is_on_road = shapely.intersects_xy(road, *positions.T)
    solid = [
        thing
        for thing in standing_things(surroundings)
        if thing.class_name in ("building", "wall") and len(thing.triangles)
    ]
    walls: dict[int, Thing] = {}
    for thing in solid:
        for hit in np.flatnonzero(is_under(positions, thing)):
            walls.setdefault(int(hit), thing)
    blocked = _without_gaps(shapely.buffer(road, SETBACK_M, quad_segs=4))
    places = []
    for index, position in enumerate(positions):
        if not is_on_road[index] and index not in walls:
            places.append(Place(position_m=position))
            continue
        most_m = _MAX_MOVE_FROM_WALL_M if index in walls else _MAX_MOVE_M
        near = [
            footprint(thing).buffer(_FROM_WALL_M, join_style="mitre")
            for thing in solid
            if _is_near(thing, position, most_m)
        ]
        around = shapely.box(*(position - most_m - 1.0), *(position + most_m + 1.0))
        here = _without_gaps(shapely.union_all([blocked.intersection(around), *near]))
        edge = here.boundary.difference(around.boundary.buffer(0.01))
        if index in walls:
            wall = walls[index]
            why = f"inside {wall.class_name} {wall.id}"
        else:
            why = "on a lane or in the junction"
        places.append(_moved(position, edge, why, most_m))
    return places


def _moved(position: FloatArray, edge: Any, why: str, most_m: float) -> Place:
    import shapely

    point = shapely.Point(position)
    if edge.is_empty or edge.distance(point) > most_m:
        return Place(position_m=None, why=f"{why}, farther than {most_m:g} m from where it could")
    nearest = np.asarray(shapely.shortest_line(point, edge).coords)[1]
    away_m = float(np.hypot(*(nearest - position)))
    target = "to the nearest kerb" if why.startswith("on ") else "out of it"
    return Place(position_m=np.round(nearest, 3), why=f"{why}: moved {away_m:.1f} m {target}")


def _without_gaps(area: Any) -> Any:
    """An area without small holes: gaps between lanes that are drawn a little apart."""
    import shapely

    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return shapely.union_all(
        [
            shapely.Polygon(
                part.exterior,
                [ring for ring in part.interiors if shapely.Polygon(ring).area > _ISLAND_M2],
            )
            for part in parts
        ]
    )


def _is_near(thing: Thing, position: FloatArray, reach_m: float) -> bool:
    low, high = thing.vertices_m[:, :2].min(axis=0), thing.vertices_m[:, :2].max(axis=0)
    return bool(np.hypot(*(np.clip(position, low, high) - position)) <= reach_m + 1.0)


def standing_things(surroundings: Surroundings) -> list[Thing]:
    """Things that stand on the ground; roofs, bridges and the like are passed below."""
    return [thing for thing in surroundings.things if _headroom_m(thing, surroundings) < HEADROOM_M]


def clear_heights_m(positions_m: FloatArray, surroundings: Surroundings) -> FloatArray:
    """Height above the ground at which buildings begin over points (n, 2); infinite: none, (n,)."""
    clear: FloatArray = np.full(len(positions_m), np.inf)
    for thing in surroundings.things:
        if thing.class_name == "building" and len(thing.triangles):
            above_m = _headroom_m(thing, surroundings)
            if above_m >= HEADROOM_M:
                under = is_under(positions_m, thing)
                clear[under] = np.minimum(clear[under], above_m)
    return clear


def _headroom_m(thing: Thing, surroundings: Surroundings) -> float:
    return headroom_m(thing.vertices_m, surroundings.terrain) if len(thing.vertices_m) else 0.0


def footprint(thing: Thing) -> Any:
    """What a thing covers, seen from above: a shapely geometry in metres."""
    import shapely

    flat = thing.vertices_m[thing.triangles][..., :2]
    one, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    is_face = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) > 1e-6
    return shapely.union_all(shapely.polygons(flat[is_face]))


def is_under(positions_m: FloatArray, thing: Thing) -> BoolArray:
    """Which points lie in the footprint of a thing: below or above one of its triangles."""
    corners = thing.vertices_m[thing.triangles][:, :, :2]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    result: BoolArray = np.zeros(len(positions_m), dtype=np.bool_)
    for index in np.flatnonzero(((positions_m > low) & (positions_m < high)).all(axis=1)):
        a, b, c = np.swapaxes(corners - positions_m[index], 0, 1)
        turns = np.stack([_turn(a, b), _turn(b, c), _turn(c, a)])
        result[index] = ((turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)).any()
        if not result[index]:  # on the edge between two triangles
            area = turns.sum(axis=0)
            inside = ((turns >= 0.0).all(axis=0) & (area > 0.0)) | (
                (turns <= 0.0).all(axis=0) & (area < 0.0)
            )
            result[index] = inside.sum() > 2  # roof and floor, on both sides of the edge
    return result


def _turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Twice the signed area between two vectors, (n,)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def settle_poles(surroundings: Surroundings) -> tuple[Surroundings, tuple[Note, ...]]:
    """Put the poles of a map where poles can stand.

    Parameters
    ----------
    surroundings : Surroundings
        Poles may lie where their signals hang.

    Returns
    -------
    settled : Surroundings
        A signal or sign over the road is left to the pole that the map has within 12 m; other poles
        on the road or inside walls are moved to the nearest place, see :func:`find_places`, or left
        out if there is none.
    told : tuple of Note
        Each that was moved or left out.
    """
    if not surroundings.poles:
        return surroundings, ()
    places = find_places(
        np.array([pole.position_m[:2] for pole in surroundings.poles]), surroundings
    )
    masts = [
        pole
        for pole, place in zip(surroundings.poles, places, strict=True)
        if pole.kind == "pole" and not place.why
    ]
    kept: list[Pole] = []
    told: list[Note] = []
    for pole, place in zip(surroundings.poles, places, strict=True):
        what = f"{pole.kind} {pole.id}"
        mast = _mast_of(pole, masts) if place.why and pole.kind in _HANGING else None
        if mast is not None:
            why = f"it hangs over the road: its pole is {mast.id}"
            told.append(Note(what=what, why=why))
            continue
        if place.position_m is None:
            told.append(Note(what=what, why=f"no site: it stands {place.why}"))
            continue
        if place.why:
            why = f"it stood {place.why}"
            told.append(Note(what=what, why=why, kind="sites", site_ids=(pole.id,)))
            pole = replace(pole, position_m=np.append(place.position_m, pole.position_m[2]))
        kept.append(pole)
    return replace(surroundings, poles=tuple(kept)), tuple(told)


def _mast_of(pole: Pole, masts: Sequence[Pole]) -> Pole | None:
    """The nearest mast from which a signal can hang."""

    def away_m(mast: Pole) -> float:
        return float(np.hypot(*(mast.position_m - pole.position_m)[:2]))

    nearest = min(masts, key=away_m, default=None)
    return nearest if nearest is not None and away_m(nearest) <= _MAST_ARM_M else None
