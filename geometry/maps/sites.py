"""Sites of a scene: poles of the map, a planner's list, or kerbs.

Sites are moved next to the road and out of walls, and dropped where that
would be too far.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Polygon

from ..arrays import BoolArray, FloatArray, float_array
from ..errors import InputError
from ..junction import CARRIAGEWAY_KINDS, compass_point
from ..lines import along_m, apart, length_m, points_at, steps_m
from ..notes import Note
from ..phrases import Phrase
from ..scene import HANGING_KINDS, Lane, Site, area_of, covered_area, flat_union
from ..terrain import HEADROOM_M, headroom_m
from ..text_formats import float_of, load_data
from .cut import CutSurroundings
from .place_lists import SUFFIXES, SiteWish, read_site_rows, sites_of
from .site_crs import find_sites_crs
from .source_map import (
    MIN_POLE_M,
    Pole,
    PoleKind,
    SourceMap,
    Thing,
    load_pole_kinds,
    mount_range_m,
    plain_id,
    unique_id,
)

_REACH_M = 60.0
_AT_OUTLINE_M = 1.5
_JOINED_M = 0.5
# Between carriageways: a narrower gap is a median, no roadside.
_MEDIAN_M = 8.0
_PARALLEL = np.cos(np.deg2rad(20.0))
_STEP_M = 0.25
# The outline is not square to every lane.
_LONGER_M = 1.0
# A sensor and its bracket.
_BELOW_ROOF_M = 0.3
AUTO = "auto"
MAP = "map"
KERB = "kerb:"
_AUTO: dict[str, float] = load_data("geometry.maps", "sites.toml")["auto"]
_SPACINGS_M = (2.0, 100.0)
# Of a pole's middle from the kerb; assumption: the usual clearance of a carriageway.
SETBACK_M = 0.5
# Between a way of people or cyclists and what stands beside it; ERA: safety distance.
_BESIDE_PATH_M = 0.25
# From a lane or the middle of a junction to the kerb.
_MAX_MOVE_M = 15.0
# Farther inside, it hangs on the building.
_MAX_MOVE_FROM_WALL_M = 2.0
_FROM_WALL_M = 0.3
# From what hangs over the road to the foot of its pole.
_MAST_ARM_M = 12.0
# Smaller gaps between lanes are no place to stand.
_ISLAND_M2 = 4.0


def kerb_sites(
    lanes: Sequence[Lane],
    outline_m: ArrayLike,
    spacing_m: float,
) -> tuple[SiteWish, ...]:
    """Sites along the outer kerbs of a junction's arms, 60 m outwards.

    Parameters
    ----------
    lanes : sequence of Lane
        Lanes of the scene.
    outline_m : (n, 2) float
        Outline of the junction's road surface. [m]
    spacing_m : float
        Least distance along each kerb. [m]

    Returns
    -------
    sites : tuple of SiteWish
        Half a metre behind the kerbs.

    Raises
    ------
    InputError
        The spacing is below 0.5 m, or the outline has no area.
    """
    if not (np.isfinite(spacing_m) and spacing_m >= 0.5):
        raise InputError("spacing_m", spacing_m, "metres, at least 0.5")
    outline = float_array(outline_m, (-1, 2), "outline_m")
    if len(outline) < 3:
        raise InputError("outline_m", len(outline), "at least three points")
    inside = area_of(outline)
    ring = shapely.LinearRing(outline)
    roads = [lane for lane in lanes if lane.kind in CARRIAGEWAY_KINDS]
    # Lanes from the outline outwards, and the ground beside them.
    arms = [(lane, line) for lane in roads for line in _outward(lane, roads, ring)]
    strips = shapely.STRtree(
        [_strip(lane, line, beside_m=SETBACK_M - 0.05) for lane, line in arms]
    )
    # Both sides of each arm, where they are free: not in the junction, on a lane or
    # on a median, and at most 60 m away.
    sites: dict[str, SiteWish] = {}
    for lane, line in arms:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            along, points, outwards = _offset(
                line, sign * (0.5 * lane.width_m + SETBACK_M)
            )
            shapes = shapely.points(points)
            free = shapely.distance(shapes, inside) > 0.5 * SETBACK_M
            free &= shapely.distance(shapes, ring) <= _REACH_M
            free[np.unique(strips.query(shapes, predicate="within")[0])] = False
            free[free] = ~_is_median(points[free], outwards[free], arms)
            next_m = -np.inf
            for place in np.flatnonzero(free):
                if along[place] >= next_m - 1e-9:
                    next_m = along[place] + spacing_m
                    name = f"kerb {lane.id} {side} {along[place]:.0f} m"
                    position = np.round(points[place], 3)
                    sites.setdefault(
                        name, SiteWish(id=name, kind="kerb", position_m=position)
                    )
    return tuple(sites.values())


def _outward(lane: Lane, lanes: Sequence[Lane], outline: Any) -> list[FloatArray]:
    """Centrelines of a lane that touches the outline, outwards, (n, 2) each.

    Lanes that continue it are joined to it.

    Parameters
    ----------
    lane : Lane
        The lane.
    lanes : sequence of Lane
        All lanes of roads.
    outline : Any
        Outline of the junction, a shapely ring.

    Returns
    -------
    lines_m : list of (n, 2) float
        From the outline outwards. [m]
    """
    lines = []
    for line in (lane.centreline_m, lane.centreline_m[::-1]):
        start_m, end_m = shapely.distance(shapely.points(line[[0, -1]]), outline)
        # Its far end is at the outline, too.
        is_stub = length_m(line) < 2.0 * _AT_OUTLINE_M
        if start_m > _AT_OUTLINE_M or (is_stub and end_m < start_m):
            continue
        # Add lanes that begin where the line ends, until it is long enough.
        joined = [line]
        used = {lane.id}
        while length_m(np.concatenate(joined)) < _REACH_M + 10.0:
            following = (
                (other.id, points)
                for other in lanes
                if other.id not in used and other.kind == lane.kind
                for points in (other.centreline_m, other.centreline_m[::-1])
                if np.hypot(*(points[0] - joined[-1][-1])) <= _JOINED_M
            )
            after, points = next(following, ("", line))
            if not after:
                break
            used.add(after)
            if len(points) > 2:
                points = points[1:]
            joined.append(points)
        whole = apart(np.concatenate(joined), 1e-6)
        if len(whole) >= 2:
            lines.append(whole)
    return lines


def _strip(lane: Lane, line: FloatArray, *, beside_m: float) -> Polygon:
    """Surface of a lane with a strip on either side, a metre longer."""
    ends = line[[0, -1]]
    ways = ends - line[[1, -2]]
    ends = ends + _LONGER_M * ways / np.hypot(*ways.T)[:, None]
    longer = shapely.LineString(np.concatenate([ends[:1], line, ends[1:]]))
    return longer.buffer(0.5 * lane.width_m + beside_m, cap_style="flat")


def _offset(
    line: FloatArray,
    offset_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points beside a line, every 0.25 m.

    Parameters
    ----------
    line : (n, 2) float
        The line. [m]
    offset_m : float
        To the left of the line. [m]

    Returns
    -------
    along_m : (k,) float
        Distances along the line. [m]
    points_m : (k, 2) float
        Positions. [m]
    outwards : (k, 2) float
        Unit vectors away from the line.
    """
    # Every 0.25 m, the segment of the line and its left side.
    pieces = steps_m(line)
    at = along_m(line)
    along: FloatArray = np.arange(0.0, min(at[-1], 500.0), _STEP_M)
    piece = np.clip(np.searchsorted(at, along, side="right") - 1, 0, len(pieces) - 1)
    ahead = np.diff(line, axis=0)[piece] / pieces[piece, None]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    return along, points_at(line, along) + offset_m * left, np.sign(offset_m) * left


def _is_median(
    points: FloatArray,
    outwards: FloatArray,
    arms: Sequence[tuple[Lane, FloatArray]],
) -> BoolArray:
    """True for points beyond which another lane runs parallel, (n,)."""
    is_median: BoolArray = np.zeros(len(points), dtype=np.bool_)
    if not len(points):
        return is_median
    # Look outwards from each point: a parallel lane means a median.
    rays = shapely.linestrings(
        np.stack([points, points + _MEDIAN_M * outwards], axis=1)
    )
    for lane, line in arms:
        strip = _strip(lane, line, beside_m=0.0)
        for index in np.flatnonzero(shapely.intersects(rays, strip) & ~is_median):
            nearest = int(np.argmin(np.hypot(*(line[:-1] - points[index]).T)))
            ahead = line[nearest + 1] - line[nearest]
            across = abs(float(ahead @ outwards[index])) / float(np.hypot(*ahead))
            is_median[index] = across < np.sqrt(1.0 - _PARALLEL**2)
    return is_median


# Sites within this distance are one.
_SNAP_M = 1.0


def tidy_sites(
    sites: Sequence[SiteWish],
    *,
    things: Sequence[Thing] = (),
) -> tuple[tuple[SiteWish, ...], tuple[Note, ...]]:
    """Sites outside buildings and apart from each other, and notes.

    Of close ones the site with more details is kept, then the earlier one.

    Parameters
    ----------
    sites : sequence of SiteWish
        Sites, in any order.
    things : sequence of Thing
        Things in the same coordinates.

    Returns
    -------
    kept : tuple of SiteWish
        In the given order.
    notes : tuple of Note
        The others, with the reason.
    """
    # Sites in a building go first, then the close ones.
    positions = np.array([site.position_m for site in sites]).reshape(-1, 2)
    buildings = [thing for thing in things if thing.class_name == "building"]
    around = _things_over(positions, buildings)
    reasons = {
        at: f"inside {thing.class_name} {thing.id}" for at, thing in around.items()
    }
    left = [index for index in range(len(sites)) if index not in reasons]
    kept: list[int] = []
    for index in sorted(left, key=lambda index: (-sites[index].n_said, index)):
        apart_m = np.hypot(*(positions[kept] - positions[index]).T)
        if kept and apart_m.min() <= _SNAP_M:
            beside = sites[kept[int(apart_m.argmin())]]
            reasons[index] = f"{apart_m.min():.1f} m beside {beside.id}"
        else:
            kept.append(index)
    notes = [
        Note(f"site {sites[index].id}", reasons[index]) for index in sorted(reasons)
    ]
    return tuple(sites[index] for index in sorted(kept)), tuple(notes)


def _things_over(positions: FloatArray, things: Sequence[Thing]) -> dict[int, Thing]:
    """First thing in whose footprint a point lies, by index of the point."""
    found: dict[int, Thing] = {}
    for thing in things:
        if len(thing.triangles):
            for hit in np.flatnonzero(is_under(positions, thing)):
                found.setdefault(int(hit), thing)
    return found


# ---------- the sites of a scene
def check_sites(
    where: str, roads: SourceMap, *, sites_crs: str
) -> tuple[str, tuple[Note, ...]]:
    """Check where sites come from, before a junction of a map is chosen.

    Parameters
    ----------
    where : str
        See :func:`choose_sites`.
    roads : SourceMap
        Map with the roads, whole.
    sites_crs : str
        See :func:`choose_sites`.

    Returns
    -------
    sites_crs : str
        That of x and y of a list, so that no junction has to find it by the lanes
        around it; empty: the list declares its own, or there is none.
    notes : tuple of Note
        Tells a reference system that was found.

    Raises
    ------
    InputError
        `where` cannot be read, or the reference system of a list is not clear.
    """
    if not _is_list(where):
        _refuse_crs_of_no_list(where, sites_crs)
        if where.startswith(KERB):
            _spacing_m(where)
        return "", ()
    listed = read_site_rows(Path(where))
    notes: tuple[Note, ...] = ()
    if not sites_crs:
        sites_crs, notes = find_sites_crs(listed, roads)
    sites_of(listed, crs=roads.crs, sites_crs=sites_crs)
    if not listed.crs:
        sites_crs = sites_crs or roads.crs
    return sites_crs, notes


def _refuse_crs_of_no_list(where: str, sites_crs: str) -> None:
    """Refuse the reference system of a list where none is given."""
    if sites_crs:
        raise InputError("sites_crs", sites_crs, f"`sites` with a list, not {where}")


def _is_list(where: str) -> bool:
    """True if sites are listed in a file; InputError: it is no word either."""
    if where in (AUTO, MAP) or where.startswith(KERB):
        return False
    if Path(where).suffix.lower() in SUFFIXES:
        return True
    raise InputError(
        "sites",
        where,
        "auto, map, kerb:SPACING, or a list: a file " + ", ".join(SUFFIXES),
    )


def choose_sites(
    where: str,
    surroundings: CutSurroundings,
    roads: SourceMap,
    *,
    radius_m: float,
    sites_crs: str = "",
) -> tuple[tuple[Site, ...], tuple[Note, ...]]:
    """Sites of a scene, at least one, and notes on what was left out.

    Parameters
    ----------
    where : str
        "map": the poles of the map; "kerb:SPACING"; a list, as
        :func:`.place_lists.read_sites` reads it; or "auto": the poles of the map
        but for low sign posts and what belongs to another junction, and masts
        along the kerbs where none of them is near the middle, see
        ``data/sites.toml``.
    surroundings : CutSurroundings
        Surroundings of the junction.
    roads : SourceMap
        Map with the roads.
    radius_m : float
        Radius around the middle of the junction. [m]
    sites_crs : str
        Reference system of x and y in a list that does not say; empty: see
        :func:`.site_crs.find_sites_crs`.

    Returns
    -------
    sites : tuple of Site
        Their ids are unique, and a comma-separated list can name them.
    notes : tuple of Note
        What was moved, added or left out.

    Raises
    ------
    InputError
        `where` cannot be read, or no site is left within `radius_m`.
    """
    notes: list[Note] = []
    is_list = _is_list(where)
    if not is_list:
        _refuse_crs_of_no_list(where, sites_crs)
    if is_list:
        listed = read_site_rows(Path(where))
        if not sites_crs:
            sites_crs, found = find_sites_crs(listed, roads)
            notes += found
        every = sites_of(listed, crs=roads.crs, sites_crs=sites_crs)
        wishes = _listed(every, Path(where).name, surroundings, roads, radius_m, notes)
    elif where in (AUTO, MAP):
        wishes = _poles(surroundings, notes)
        if where == AUTO:
            wishes = _own_poles(wishes, surroundings, notes)
            wishes = [*wishes, *_masts(wishes, surroundings, radius_m, notes)]
    else:
        wishes = _kerbs(surroundings, _spacing_m(where), radius_m)
    is_asked_for = not where.startswith(KERB) and where != AUTO
    # Ids that a comma-separated list can name.
    taken: Counter[str] = Counter()
    ids = [unique_id(plain_id(wish.id) or "site", taken) for wish in wishes]
    wishes = [replace(wish, id=name) for wish, name in zip(wishes, ids, strict=True)]
    # Move them off the road, out of walls, and below roofs.
    told: list[Note] = []
    if is_asked_for:
        told = notes
    placed = _settled(wishes, surroundings, told, is_surveyed=is_list)
    kept, dropped = tidy_sites(placed, things=standing_things(surroundings))
    left_out = [*dropped]
    sites = tuple(_site(wish) for wish in _below_roofs(kept, surroundings, left_out))
    if not sites:
        free = f"a site within {radius_m:g} m that stands free ({len(left_out)} do not)"
        raise InputError("sites", where, f"{free}: kerb:15, or a list of your own")
    return sites, (*notes, *left_out)


def _settled(
    wishes: Sequence[SiteWish],
    surroundings: CutSurroundings,
    notes: list[Note],
    *,
    is_surveyed: bool,
) -> list[SiteWish]:
    """Sites next to the road and out of walls; hanging ones stay.

    Sites in buildings stay for :func:`tidy_sites`. Surveyed ones stay on the road,
    where the map is not as exact, and keep their coordinates if they are moved out of
    a wall.

    Parameters
    ----------
    wishes : sequence of SiteWish
        Sites as they were asked for.
    surroundings : CutSurroundings
        Surroundings of the junction.
    notes : list of Note
        Notes on what was changed or left out; entries are added.
    is_surveyed : bool
        The sites are those of a list.

    Returns
    -------
    kept : list of SiteWish
        Those that are too far from a place are noted.
    """
    kept = []
    # Nothing is known to stand at kerbs: nobody walks or rides there either.
    is_free = [wish.kind == "kerb" for wish in wishes]
    positions = [wish.position_m for wish in wishes]
    places = find_places(positions, surroundings, off_paths=is_free)
    for wish, place in zip(wishes, places, strict=True):
        what = Phrase("site {name}", name=wish.id)
        if not place.why or wish.kind in HANGING_KINDS:
            kept.append(wish)
        elif is_surveyed and not place.is_in_wall:
            kept.append(wish)
            why = Phrase(
                "it stands on a lane or in the junction of the map, which may be less"
                " exact: kept where it was surveyed"
            )
            notes.append(Note(what, why, kind="sites"))
        elif place.position_m is None:
            notes.append(Note(f"site {wish.id}", place.why))
        elif is_surveyed:
            moved = replace(
                wish, position_m=place.position_m, surveyed_m=wish.position_m
            )
            kept.append(moved)
            why = Phrase("{why}; its coordinates stay as surveyed", why=place.why)
            notes.append(Note(what, why, kind="sites"))
        else:
            kept.append(replace(wish, position_m=place.position_m))
            notes.append(Note(what, place.why, kind="sites", site_ids=(wish.id,)))
    return kept


def _own_poles(
    wishes: Sequence[SiteWish],
    surroundings: CutSurroundings,
    notes: list[Note],
) -> list[SiteWish]:
    """Poles that are sites by default.

    Low sign posts, and poles that belong to another junction, are noted.

    Parameters
    ----------
    wishes : sequence of SiteWish
        Poles of the map.
    surroundings : CutSurroundings
        Surroundings of the junction.
    notes : list of Note
        Notes on what was changed or left out; entries are added.

    Returns
    -------
    kept : list of SiteWish
        In the same order.
    """
    # Distance of each pole from this junction, and from the others.
    feet = shapely.points(np.array([wish.position_m for wish in wishes]).reshape(-1, 2))
    own_m = shapely.distance(feet, area_of(surroundings.outline_m))
    other_m = np.full(len(wishes), np.inf)
    for outline in surroundings.neighbours_m:
        other_m = np.minimum(other_m, shapely.distance(feet, area_of(outline)))
    heights_m = {pole.id: pole.height_m for pole in surroundings.poles}
    sign_m = load_pole_kinds()["sign"].height_m
    is_other = (other_m <= _AUTO["neighbour_m"]) & (other_m < own_m)
    kept: list[SiteWish] = []
    low: list[SiteWish] = []
    far: list[SiteWish] = []
    for wish, is_far in zip(wishes, is_other.tolist(), strict=True):
        is_low = (
            wish.kind == "sign" and (heights_m[wish.id] or sign_m) < _AUTO["min_sign_m"]
        )
        if is_far:
            far.append(wish)
        elif is_low:
            low.append(wish)
        else:
            kept.append(wish)
    for group, noun, why in (
        (
            far,
            "poles",
            f"within {_AUTO['neighbour_m']:g} m of another junction, nearer than here",
        ),
        (low, "sign posts", f"lower than {_AUTO['min_sign_m']:g} m"),
    ):
        if group:
            what = f"{group[0].kind} {group[0].id}"
            if len(group) > 1:
                what = f"{len(group)} {noun}, such as {group[0].id}"
            notes.append(Note(what, f"{why}: no site unless asked for"))
    return kept


def _masts(
    poles: Sequence[SiteWish],
    surroundings: CutSurroundings,
    radius_m: float,
    notes: list[Note],
) -> list[SiteWish]:
    """Masts along the kerbs where no pole is near the junction's middle.

    Parameters
    ----------
    poles : sequence of SiteWish
        Poles of the map.
    surroundings : CutSurroundings
        Surroundings of the junction.
    radius_m : float
        Radius around the middle of the junction. [m]
    notes : list of Note
        Notes on what was changed or left out; entries are added.

    Returns
    -------
    masts : list of SiteWish
        Empty if a pole is near.
    """
    nearest_m = min(
        (float(np.hypot(*pole.position_m)) for pole in poles),
        default=np.inf,
    )
    if nearest_m <= _AUTO["near_m"]:
        return []
    where = f"none within {radius_m:g} m"
    if poles:
        where = f"the nearest one stands {nearest_m:.0f} m from the junction's middle"
    why = f"{where}: masts every {_AUTO['spacing_m']:g} m along the kerbs were added"
    notes.append(Note("poles of the map", why))
    return _kerbs(surroundings, _AUTO["spacing_m"], radius_m)


def _below_roofs(
    wishes: Sequence[SiteWish],
    surroundings: CutSurroundings,
    notes: list[Note],
) -> list[SiteWish]:
    """Sites that carry sensors no higher than roofs above let them.

    Parameters
    ----------
    wishes : sequence of SiteWish
        Sites.
    surroundings : CutSurroundings
        Surroundings of the junction.
    notes : list of Note
        Notes on what was changed or left out; entries are added.

    Returns
    -------
    kept : list of SiteWish
        Sites where nothing fits below the roof are noted.
    """
    kept = []
    positions = np.array([wish.position_m for wish in wishes]).reshape(-1, 2)
    for wish, clear_m in zip(
        wishes,
        clear_heights_m(positions, surroundings),
        strict=True,
    ):
        most_m = round(float(clear_m) - _BELOW_ROOF_M, 3)
        (low_m, high_m) = _mounts_m(wish)
        if most_m >= high_m:
            kept.append(wish)
        elif most_m < MIN_POLE_M:
            why = f"below a roof {clear_m:g} m above the ground: too low for sensors"
            notes.append(Note(f"site {wish.id}", why))
        else:
            kept.append(
                replace(wish, min_height_m=min(low_m, most_m), max_height_m=most_m)
            )
    return kept


def _poles(surroundings: CutSurroundings, notes: list[Note]) -> list[SiteWish]:
    """Poles of the map as sites; those that are too low are noted."""
    wishes = []
    for pole in surroundings.poles:
        if pole.height_m is not None and pole.height_m < MIN_POLE_M:
            why = f"{pole.height_m:g} m high: too low for sensors"
            notes.append(Note(f"{pole.kind} {pole.id}", why))
            continue
        low_m, high_m = mount_range_m(pole)
        place = SiteWish(id=pole.id, kind=pole.kind, position_m=pole.position_m[:2])
        wishes.append(replace(place, min_height_m=low_m, max_height_m=high_m))
    return wishes


def _kerbs(
    surroundings: CutSurroundings,
    spacing_m: float,
    radius_m: float,
) -> list[SiteWish]:
    """Sites along the kerbs, named by where they lie.

    "kerb-ne-1" is the nearest one in the north-east.
    """
    count: Counter[str] = Counter()
    named = []
    wishes = kerb_sites(surroundings.lanes, surroundings.outline_m, spacing_m)
    for wish in sorted(wishes, key=lambda wish: float(np.hypot(*wish.position_m))):
        if np.hypot(*wish.position_m) <= radius_m:
            words = compass_point(wish.position_m).split("-")
            octant = "".join(word[0] for word in words)
            count[octant] += 1
            named.append(replace(wish, id=f"kerb-{octant}-{count[octant]}"))
    return named


def _listed(
    listed: Sequence[SiteWish],
    name: str,
    surroundings: CutSurroundings,
    roads: SourceMap,
    radius_m: float,
    notes: list[Note],
) -> list[SiteWish]:
    """Sites of a planner's list within the radius; the others are noted."""
    frame = surroundings.frame
    every = [
        replace(wish, position_m=frame.take(wish.position_m, roads)) for wish in listed
    ]
    wishes = [wish for wish in every if np.hypot(*wish.position_m) <= radius_m]
    n_far = len(every) - len(wishes)
    if n_far:
        why = f"farther than {radius_m:g} m from the junction"
        notes.append(Note(f"{n_far} sites in {name}", why))
    n_dark = sum(wish.has_power is False or wish.has_fibre is False for wish in wishes)
    if n_dark:
        why = "only what cost_eur states is counted"
        notes.append(Note(f"power or fibre that {n_dark} sites lack", why))
    return wishes


def _spacing_m(where: str) -> float:
    """Spacing in a text such as "kerb:15", in metres."""
    low, high = _SPACINGS_M
    spacing_m = float_of(where.removeprefix(KERB))
    if not low <= spacing_m <= high:
        raise InputError("sites", where, f"kerb:SPACING in metres, {low:g} to {high:g}")
    return spacing_m


def _kind_of(wish: SiteWish) -> PoleKind:
    """Kind of pole of a site; "pole" if its kind is unknown."""
    return load_pole_kinds().get(wish.kind, load_pole_kinds()["pole"])


def _mounts_m(wish: SiteWish) -> tuple[float, float]:
    """Lowest and highest mount above the road in metres.

    They are listed, or usual for the site's kind.
    """
    low_m, high_m = _kind_of(wish).height_range_m
    if wish.min_height_m is not None:
        low_m = wish.min_height_m
    if wish.max_height_m is None:
        high_m = max(high_m, low_m)
    else:
        high_m = wish.max_height_m
    return min(low_m, high_m), high_m


def _site(wish: SiteWish) -> Site:
    """Site of a scene; InputError: its lowest mount is not above the road."""
    low_m, high_m = _mounts_m(wish)
    if low_m <= 0.0:
        raise InputError(
            f"site {wish.id}: mount height",
            low_m,
            "metres above the road, > 0",
        )
    use = "free"
    if wish.is_forbidden:
        use = "forbidden"
    return Site(
        id=wish.id,
        position_m=np.append(wish.position_m, 0.0),
        kind=wish.kind or "pole",
        height_range_m=np.array([low_m, high_m]),
        capacity_units=wish.capacity_units or _kind_of(wish).capacity_units,
        cost_eur=wish.cost_eur or 0.0,
        use=use,
        surveyed_m=wish.surveyed_m,
    )


# ---------- where poles and sites can stand
class Place(NamedTuple):
    """Where something can stand, and why it is not where it was.

    Attributes
    ----------
    position_m : (2,) float or None
        None: nowhere near. [m]
    why : str
        Empty: it stays.
    is_in_wall : bool
        It was inside a wall or a building.
    is_beside_path : bool
        It would stand on a footway or a cycle track, and nowhere else amiss.
    """

    position_m: FloatArray | None
    why: str = ""
    is_in_wall: bool = False
    is_beside_path: bool = False


def find_places(
    positions_m: ArrayLike,
    surroundings: CutSurroundings,
    *,
    off_paths: Sequence[bool] = (),
) -> list[Place]:
    """Nearest places beside the road and outside walls.

    Parameters
    ----------
    positions_m : (n, 2) float
        Where things would stand, in the scene's frame. [m]
    surroundings : CutSurroundings
        Lanes, outline, paths and things around the junction.
    off_paths : sequence of bool
        Which of them may not stand on footways and cycle tracks either; empty: none.

    Returns
    -------
    places : list of Place
        What stands on a lane or in the junction is moved to the nearest kerb, half a
        metre behind it; what stands inside a building or wall is moved out of it. None:
        that would be farther than 15 m, or from inside a wall 2 m.
    """
    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 2)
    road = covered_area(
        surroundings.outline_m, surroundings.lanes, surroundings.islands_m
    )
    shapely.prepare(road)
    is_on_road = shapely.intersects_xy(road, *positions.T)
    is_on_path = np.zeros(len(positions), dtype=bool)
    paths = surroundings.paths
    if any(off_paths):
        paths = paths.buffer(_BESIDE_PATH_M, quad_segs=4)
        on_any = shapely.intersects_xy(paths, *positions.T)
        is_on_path = np.array(off_paths, dtype=bool) & on_any
    standing = [
        thing for thing in standing_things(surroundings) if len(thing.triangles)
    ]
    solid = [thing for thing in standing if thing.class_name in ("building", "wall")]
    walls = _things_over(positions, solid)
    # Boxes find the walls that are near a point.
    boxes = shapely.STRtree(
        [shapely.box(*low, *high) for low, high in map(_box, solid)]
    )
    off_road = _without_gaps(shapely.buffer(road, SETBACK_M, quad_segs=4))
    off_both = off_road
    if any(off_paths):
        off_both = _without_gaps(off_road.union(paths))
    places = []
    for index, position in enumerate(positions):
        wall = walls.get(index)
        if not is_on_road[index] and not is_on_path[index] and wall is None:
            places.append(Place(position))
            continue
        most_m = _MAX_MOVE_M
        if wall is not None:
            most_m = _MAX_MOVE_FROM_WALL_M
        # The edge of everything near that it may not stand on: road and walls.
        point = shapely.Point(position)
        close = np.sort(
            boxes.query(point, predicate="dwithin", distance=most_m + 1.0)
        ).tolist()
        near = [
            footprint(solid[at]).buffer(_FROM_WALL_M, join_style="mitre")
            for at in close
        ]
        around = shapely.box(*(position - most_m - 1.0), *(position + most_m + 1.0))
        blocked = off_road
        if index < len(off_paths) and off_paths[index]:
            blocked = off_both
        here = _without_gaps(shapely.union_all([blocked.intersection(around), *near]))
        edge = here.boundary.difference(around.boundary.buffer(0.01))
        if edge.is_empty or edge.distance(point) > most_m:
            where = "on a lane or in the junction"
            if is_on_path[index]:
                where = "on a footway or a cycle track"
            if wall is not None:
                where = f"inside {wall.class_name} {wall.id}"
            why = f"it stands {where}, farther than {most_m:g} m from where it could"
            places.append(Place(None, why, wall is not None))
            continue
        nearest = np.asarray(shapely.shortest_line(point, edge).coords)[1]
        away_m = float(np.hypot(*(nearest - position)))
        why = Phrase(
            "it stood on a lane or in the junction: moved {away:.1f} m to the nearest"
            " kerb",
            away=away_m,
        )
        is_beside_path = bool(is_on_path[index] and not is_on_road[index])
        if is_beside_path:
            why = Phrase(
                "it would stand on a footway or a cycle track: moved {away:.1f} m"
                " beside it",
                away=away_m,
            )
        if wall is not None:
            why = Phrase(
                "it stood inside {kind} {name}: moved {away:.1f} m out of it",
                kind=Phrase(wall.class_name),
                name=wall.id,
                away=away_m,
            )
            is_beside_path = False
        place = Place(
            np.round(nearest, 3),
            why,
            is_in_wall=wall is not None,
            is_beside_path=is_beside_path,
        )
        places.append(place)
    return places


def _without_gaps(area: Any) -> Any:
    """Area without small holes: gaps between lanes drawn a little apart."""
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    filled = []
    for part in parts:
        islands = [one for one in part.interiors if Polygon(one).area > _ISLAND_M2]
        filled.append(Polygon(part.exterior, islands))
    return shapely.union_all(filled)


def standing_things(surroundings: CutSurroundings) -> list[Thing]:
    """Things that stand on the ground; one can pass below the others."""
    return [
        thing
        for thing in surroundings.things
        if _headroom_m(thing, surroundings) < HEADROOM_M
    ]


def clear_heights_m(
    positions_m: FloatArray, surroundings: CutSurroundings
) -> FloatArray:
    """Height above the ground at which buildings begin over points, (n,).

    Parameters
    ----------
    positions_m : (n, 2) float
        Points. [m]
    surroundings : CutSurroundings
        Surroundings of the junction.

    Returns
    -------
    clear_m : (n,) float
        Infinite: none is above. [m]
    """
    clear: FloatArray = np.full(len(positions_m), np.inf)
    for thing in surroundings.things:
        above_m = _headroom_m(thing, surroundings)
        if (
            thing.class_name == "building"
            and len(thing.triangles)
            and above_m >= HEADROOM_M
        ):
            under = is_under(positions_m, thing)
            clear[under] = np.minimum(clear[under], above_m)
    return clear


def _headroom_m(thing: Thing, surroundings: CutSurroundings) -> float:
    """Height below a thing that is free, in metres; 0: it has no vertices."""
    if len(thing.vertices_m):
        return headroom_m(thing.vertices_m, surroundings.terrain)
    return 0.0


def footprint(thing: Thing) -> Any:
    """Ground that a thing covers, seen from above: shapely, in metres."""
    return flat_union(thing.vertices_m[thing.triangles])


def is_under(positions_m: FloatArray, thing: Thing) -> BoolArray:
    """True for points that lie within the footprint of a thing, (n,)."""
    # The box is quick; the exact footprint only counts inside it.
    low, high = _box(thing)
    result = np.asarray(
        ((positions_m > low) & (positions_m < high)).all(axis=1),
        dtype=bool,
    )
    if result.any():
        result[result] = shapely.intersects_xy(footprint(thing), *positions_m[result].T)
    return result


def _box(thing: Thing) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest x and y of a thing's vertices, (2,) each."""
    return thing.vertices_m[:, :2].min(axis=0), thing.vertices_m[:, :2].max(axis=0)


def settle_poles(
    surroundings: CutSurroundings,
) -> tuple[CutSurroundings, tuple[Note, ...]]:
    """Put the poles of a map where poles can stand.

    Parameters
    ----------
    surroundings : CutSurroundings
        Poles may lie where their signals hang.

    Returns
    -------
    settled : CutSurroundings
        A signal or sign over the road is left to the pole that the map has within 12 m;
        other poles on the road or inside walls are moved to the nearest place, see
        :func:`find_places`, or left out if there is none.
    told : tuple of Skipped
        Each that was moved or left out.
    """
    if not surroundings.poles:
        return surroundings, ()
    feet = np.array([pole.position_m[:2] for pole in surroundings.poles])
    is_assumed = [pole.assumed != "" for pole in surroundings.poles]
    places = find_places(feet, surroundings, off_paths=is_assumed)
    placed = [*zip(surroundings.poles, places, strict=True)]
    # Poles that stand beside the road already.
    masts = [pole for pole, place in placed if pole.kind == "pole" and not place.why]
    kept: list[Pole] = []
    notes: list[Note] = []
    for pole, place in placed:
        what = f"{pole.kind} {pole.id}"
        # A signal over the road is left to the nearest pole, if one is near enough.
        away_m: dict[str, float] = {}
        for mast in masts:
            offset_m = (mast.position_m - pole.position_m)[:2]
            away_m[mast.id] = float(np.hypot(*offset_m))
        nearest = min(away_m, key=away_m.__getitem__, default="")
        is_over = bool(place.why) and not place.is_beside_path
        hangs = is_over and pole.kind in ("traffic light", "sign")
        if hangs and nearest and away_m[nearest] <= _MAST_ARM_M:
            notes.append(Note(what, f"it hangs over the road: its pole is {nearest}"))
            continue
        if place.position_m is None:
            notes.append(Note(what, f"no site: {place.why}"))
            continue
        if place.why:
            what = Phrase("{kind} {name}", kind=Phrase(pole.kind), name=pole.id)
            notes.append(Note(what, place.why, kind="sites", site_ids=(pole.id,)))
            pole = replace(
                pole,
                position_m=np.append(place.position_m, pole.position_m[2]),
            )
        kept.append(pole)
    return replace(surroundings, poles=tuple(kept)), tuple(notes)
