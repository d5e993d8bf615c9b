"""Surroundings of a junction, cut out of maps, and the scene built of them."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from ..arrays import FloatArray
from ..frames import transform
from ..junction import (
    ASSUMED,
    CONNECTING,
    build_junction,
    curve_between,
    distance_to_outline_m,
    lane_beside,
    lane_line,
)
from ..lines import steps_m, true_runs, unit
from ..notes import Note, assumptions
from ..phrases import Phrase
from ..scene import (
    Body,
    Instance,
    Lane,
    LeadingRoad,
    Scene,
    Site,
    is_lane_width,
    join_bodies,
)
from ..sensors import load_limits
from ..terrain import GROUND, Terrain, houses_of, on_ground
from .georeferences import LocalFrame, frame_at
from .relief import Relief, find_relief
from .source_map import (
    MapJunction,
    MapLane,
    Pole,
    SourceMap,
    Thing,
    build_pole_body,
    counted,
    plain_id,
    unique_id,
)

# Cars come from farther away than anything that could hide somebody.
LANES_BEYOND_M = 70.0
_SAME_LEVEL_M = 3.0
# Other roads that end here would look like an arm.
_AT_OUTLINE_M = 2.0
_CROSSWALK_WITHIN_M = 25.0
# On beyond the map.
_ASSUMED_M = 60.0
_BENDS_PER_M = (
    0.0,
    *(
        sign / radius_m
        for radius_m in (400.0, 200.0, 100.0, 60.0, 40.0, 25.0)
        for sign in (1, -1)
    ),
)
# Between such a lane and houses.
_BESIDE_HOUSES_M = 0.3
_LEAST_ASSUMED_M = 5.0
# Of a lane next to a junction, whose direction counts there.
_MOUTH_M = 4.0
# Between the way through a junction and the lanes at its ends.
_STRAIGHT_ON_DEG = 25.0
_DIGITS_M = 0.002
_NEIGHBOURS_BEYOND_M = 20.0
# Lower things hide nobody.
_LOWEST_M = 0.2
# Beyond what is cut out: the ground is levelled with what lies around it.
_MORE_M = 80.0
_THINGS_MORE_M = 30.0
_FAR_FIELDS = ("lanes", "connections")
_LINES = "crosswalks_m"
# Lowest and highest x and y.
_Square = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CutSurroundings:
    """Surroundings of a junction in the scene's own frame, without sites.

    Attributes
    ----------
    frame : LocalFrame
        Frame of the scene; the middle of the junction is near its origin.
    lanes : tuple of Lane
        Lanes to drive, park and cycle on.
    outline_m : (n, 2) float
        Outline of the junction's road surface. [m]
    crosswalks_m : (n, 2, 2) float
        Crosswalks of the junction's arms. [m]
    things : tuple of Thing
        Z counts from the road in the junction's middle; ids are unique.
    poles : tuple of Pole
        Feet at z = 0, whatever the ground; ids are unique.
    paths : Any
        Ground of ways beside the lanes, a shapely geometry. [m]
    keeps_left : bool
        Traffic keeps left.
    skipped : tuple of Note
        What was left out or assumed, and why.
    roads : tuple of LeadingRoad
        Roads that lead to the junction.
    terrain : Terrain or None
        The ground, 0 in the junction's middle; None: a plane.
    zero_height_m : float or None
        Height of the junction's middle, as the map counts heights. [m]
    neighbours_m : tuple of (n, 2) float
        Outlines of the junctions around it. [m]
    islands_m : tuple of (n, 2) float
        Outlines of the islands that a roundabout leads around. [m]
    """

    frame: LocalFrame
    lanes: tuple[Lane, ...]
    outline_m: FloatArray
    crosswalks_m: FloatArray
    things: tuple[Thing, ...]
    poles: tuple[Pole, ...]
    keeps_left: bool
    skipped: tuple[Note, ...]
    roads: tuple[LeadingRoad, ...] = ()
    terrain: Terrain | None = None
    zero_height_m: float | None = None
    neighbours_m: tuple[FloatArray, ...] = ()
    paths: Any = field(default_factory=shapely.Polygon)
    islands_m: tuple[FloatArray, ...] = ()


def cut_out(
    maps: Sequence[SourceMap],
    junction: MapJunction,
    *,
    radius_m: float,
) -> CutSurroundings:
    """Surroundings of a junction of the first map, with things of the others.

    Lanes are followed 70 m beyond `radius_m`. The ground is that of
    :func:`geometry.maps.relief.find_relief`.

    Parameters
    ----------
    maps : sequence of SourceMap
        Maps, the one with the roads first.
    junction : MapJunction
        A junction of the first map.
    radius_m : float
        Radius within which things and poles are kept. [m]

    Returns
    -------
    surroundings : CutSurroundings
        In a frame around the junction.

    Raises
    ------
    InputError
        The coordinates of the maps do not fit together.
    """
    roads = maps[0]
    # The scene's frame, and the ground in it.
    frame = frame_at(maps[0], junction.position_m)
    outline = frame.take(junction.outline_m, roads)
    skipped = [skip for source in maps for skip in source.skipped]
    half_m = radius_m + LANES_BEYOND_M
    relief = find_relief(maps, junction, frame, half_m=half_m)
    skipped += relief.notes
    things: list[Thing] = []
    poles: list[Pole] = []
    taken = Counter([GROUND])
    # Things and poles of every map, under ids that are unique in the scene.
    for source in maps:
        height_m = None
        if source is roads and source.heights == "absolute":
            height_m = junction.height_m
        near = _near_things(source, frame, radius_m, skipped)
        for thing, vertices in _lowered(source, near, relief, height_m, skipped):
            thing_id = _unique(thing.id, source, taken)
            things.append(replace(thing, id=thing_id, vertices_m=vertices))
        feet = np.array([pole.position_m for pole in source.poles]).reshape(-1, 3)
        for pole, foot in zip(source.poles, frame.take(feet, source), strict=True):
            if np.hypot(*foot[:2]) <= radius_m:
                pole_id = _unique(pole.id, source, taken)
                poles.append(
                    replace(pole, id=pole_id, position_m=np.append(foot[:2], 0.0))
                )
    # Lanes of the map with the roads, and the junctions around.
    lanes, through = _lanes(roads, junction, frame, outline, half_m)
    skipped += _odd_lanes(roads, junction)
    others = [
        frame.take(one.outline_m, roads)
        for one in roads.junctions
        if one.id != junction.id
    ]
    if through:
        what = Phrase("other junctions around it")
        why = Phrase("assumed: lanes run straight on through them on smooth curves")
        skipped.append(Note(what, why, kind="roads"))
    zero_height_m = None
    if relief.terrain is not None:
        zero_height_m = round(relief.zero_m, 3)
    return CutSurroundings(
        frame=frame,
        lanes=(*lanes, *through),
        outline_m=outline,
        crosswalks_m=_crosswalks(maps, frame, outline),
        things=tuple(things),
        poles=tuple(poles),
        paths=_paths(maps, frame, radius_m),
        keeps_left=roads.keeps_left,
        skipped=tuple(skipped),
        roads=tuple(_moved(road, frame, roads) for road in junction.roads),
        terrain=relief.terrain,
        zero_height_m=zero_height_m,
        neighbours_m=tuple(
            one for one in others if _off_m(one) <= radius_m + _NEIGHBOURS_BEYOND_M
        ),
        islands_m=tuple(frame.take(one, roads) for one in junction.islands_m),
    )


def _lowered(
    source: SourceMap,
    near: Sequence[Thing],
    relief: Relief,
    height_m: float | None,
    skipped: list[Note],
) -> Iterator[tuple[Thing, FloatArray]]:
    """Things that rise above the road, with heights counted from it.

    The others are noted.

    Parameters
    ----------
    source : SourceMap
        The map.
    near : sequence of Thing
        Things near the junction.
    relief : Relief
        Ground around the junction.
    height_m : float or None
        Height of the road in the junction's middle, as the map counts heights;
        None: see :meth:`~.relief.Relief.lower`. [m]
    skipped : list of Note
        Notes on what was left out; entries are added.

    Yields
    ------
    thing : (Thing, (n, 3) float)
        Thing and its vertices. [m]
    """
    # Ground of a model is left out: the roads give it.
    solid = [thing for thing in near if thing.class_name != "ground"]
    why = "the ground of a scene is that of its roads"
    skipped += [
        Note(f"ground {one.id}", why) for one in near if one.class_name == "ground"
    ]
    is_low: Counter[str] = Counter()
    n_floating = 0
    for thing, lowered in zip(
        solid,
        relief.lower(source, solid, height_m),
        strict=True,
    ):
        vertices, is_set_down = lowered
        n_floating += is_set_down
        if relief.above_m(vertices).max() < _LOWEST_M:
            is_low[thing.class_name] += 1
        else:
            yield thing, vertices
    if n_floating:
        what = Phrase("{n} buildings in {name}", n=n_floating, name=source.name)
        why = Phrase("they would float above the ground: lowered onto it")
        skipped.append(Note(what, why, kind="heights"))
    for name, count in is_low.items():
        skipped.append(Note(f"{count} x {name} in {source.name}", "not above the road"))


def _moved(road: LeadingRoad, frame: LocalFrame, source: SourceMap) -> LeadingRoad:
    """Road that leads to a junction, in the frame of the scene."""
    begin, ahead = frame.take(
        np.stack([road.point_m, road.point_m + road.direction]), source
    )
    step = ahead - begin
    return replace(road, point_m=begin, direction=step / np.hypot(*step))


def build_scene(
    surroundings: CutSurroundings,
    *,
    name: str,
    source_crs: str,
    sites: Sequence[Site],
    radius_m: float,
) -> Scene:
    """Scene of the surroundings with a ground, bodies of poles, and sites.

    Poles and sites stand on the ground.

    Parameters
    ----------
    surroundings : CutSurroundings
        Surroundings of the junction.
    name : str
        Name of the scene.
    source_crs : str
        Reference system for results; empty: unknown.
    sites : sequence of Site
        Where sensors can be mounted.
    radius_m : float
        Radius that was cut out. [m]

    Returns
    -------
    scene : Scene
        With lanes assumed beyond the map where it ends.
    """
    terrain = surroundings.terrain
    half = radius_m + LANES_BEYOND_M
    corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    plane = (np.column_stack([corners, np.zeros(4)]), faces)
    ground = plane
    if terrain is not None:
        ground = terrain.mesh()
    # The ground comes first, then things, then poles.
    bodies: list[Body] = [(Instance(id=GROUND, class_name=GROUND), *ground)]
    for thing in surroundings.things:
        instance = Instance(
            id=thing.id,
            class_name=thing.class_name,
            is_height_assumed=thing.is_height_assumed,
        )
        bodies.append((instance, thing.vertices_m, thing.triangles))
    for pole in surroundings.poles:
        class_name, (vertices, triangles) = build_pole_body(pole)
        foot = on_ground(pole.position_m[:2], terrain)
        instance = Instance(id=pole.id, class_name=class_name)
        bodies.append((instance, vertices + [0.0, 0.0, foot[2]], triangles))
    scene = Scene(
        name=name,
        **join_bodies(bodies),
        sites=tuple(
            replace(one, position_m=on_ground(one.position_m[:2], terrain))
            for one in sites
        ),
        outline_m=surroundings.outline_m,
        lanes=surroundings.lanes,
        crs=surroundings.frame.crs,
        crosswalks_m=surroundings.crosswalks_m,
        keeps_left=surroundings.keeps_left,
        source_crs=source_crs,
        source_origin_m=surroundings.frame.origin_m,
        zero_height_m=surroundings.zero_height_m,
        roads=surroundings.roads,
        islands_m=surroundings.islands_m,
    )
    return replace(scene, lanes=(*scene.lanes, *_lead_on(scene, reach_m=half)))


def _lead_on(scene: Scene, *, reach_m: float) -> Iterator[Lane]:
    """Lanes to the begins of entry lanes where the map has none.

    To a lane that begins beside another one, that one leads. Others lead straight
    on, or where a building stands there round the gentlest bend past it, the same for
    all lanes of an arm; where none does, straight up to it.

    Parameters
    ----------
    scene : Scene
        Scene of the junction.
    reach_m : float
        Radius of the circle around the origin within which lanes are kept. [m]

    Yields
    ------
    lane : Lane
        Of the kind ``ASSUMED``.
    """
    # The lanes behind which the map does not go on.
    arms = [
        [
            lane
            for lane in arm.entry_lanes
            if np.hypot(*lane.centreline_m[0]) < reach_m - 1.0
        ]
        for arm in build_junction(scene).arms.values()
    ]
    houses = None
    if any(arms):
        houses = houses_of(scene)
    for ending in arms:
        lanes = []
        for lane in ending:
            beside = lane_beside(lane, scene.lanes)
            if beside is None:
                lanes.append(lane)
                continue
            yield Lane(
                id=f"{lane.id} from beside it",
                kind=ASSUMED,
                width_m=lane.width_m,
                centreline_m=_reaching(beside, reach_m, from_end=True),
            )
        if not lanes:
            continue
        # The gentlest bend that is free for all lanes of the arm, or else straight on.
        for bend_per_m in (*_BENDS_PER_M, 0.0):
            chains = [_beyond(lane, bend_per_m, reach_m) for lane in lanes]
            pairs = [*zip(lanes, chains, strict=True)]
            free = [_free_m(chain, lane.width_m, houses) for lane, chain in pairs]
            if min(free) == np.inf:
                break
        for (lane, chain), free_m in zip(pairs, free, strict=True):
            if free_m < np.inf:
                step = chain[1] - chain[0]
                free_end = chain[0] + free_m * step / np.hypot(*step)
                chain = np.array([chain[0], free_end])
            if free_m > _LEAST_ASSUMED_M:
                lane_id = f"{lane.id} beyond the map"
                line_m = chain[::-1]
                yield Lane(
                    id=lane_id,
                    kind=ASSUMED,
                    width_m=lane.width_m,
                    centreline_m=line_m,
                )


def _beyond(lane: Lane, bend_per_m: float, reach_m: float) -> FloatArray:
    """Points of a circle away from a lane's start, (n, 2).

    Parameters
    ----------
    lane : Lane
        The lane.
    bend_per_m : float
        Curvature, to the left of the way there. [1/m]
    reach_m : float
        Radius of the circle around the origin within which lanes are kept. [m]

    Returns
    -------
    points_m : (n, 2) float
        From the lane's start outwards. [m]
    """
    away = -complex(*lane_line(lane, is_in=False, length_m=_MOUTH_M)[0].direction)
    along = np.array([0.0, _ASSUMED_M])
    if bend_per_m == 0.0:
        places = along * away
    else:
        along = np.linspace(0.0, _ASSUMED_M, 31)
        places = away * np.expm1(1j * bend_per_m * along) / (1j * bend_per_m)
    points = lane.centreline_m[0] + np.stack([places.real, places.imag], axis=1)
    return _reaching(points, reach_m, from_end=False)


def _free_m(chain_m: FloatArray, width_m: float, houses: Any) -> float:
    """How far a lane leads before it comes close to houses, in metres.

    Parameters
    ----------
    chain_m : (n, 2) float
        Its centreline. [m]
    width_m : float
        Its width. [m]
    houses : Any
        Ground that houses cover.

    Returns
    -------
    free_m : float
        Infinite: all of it is clear. [m]
    """
    line = shapely.LineString(chain_m)
    strip = line.buffer(0.5 * width_m + _BESIDE_HOUSES_M, cap_style="flat")
    hits = shapely.get_coordinates(houses.intersection(strip))
    first_m = min((line.project(shapely.Point(hit)) for hit in hits), default=np.inf)
    return float(max(first_m - _BESIDE_HOUSES_M, 0.0))


def _lanes(
    roads: SourceMap,
    junction: MapJunction,
    frame: LocalFrame,
    outline_m: FloatArray,
    reach_m: float,
) -> tuple[list[Lane], list[Lane]]:
    """Lanes around a junction, and those assumed through other junctions.

    Of the map's own lanes through other junctions, only those count that lead
    about straight on.

    Parameters
    ----------
    roads : SourceMap
        Map with the roads.
    junction : MapJunction
        The junction.
    frame : LocalFrame
        Frame of the scene.
    outline_m : (n, 2) float
        Outline of the junction's road surface. [m]
    reach_m : float
        Radius of the circle around the origin within which lanes are kept. [m]

    Returns
    -------
    found : list of Lane
        Lanes of the map.
    through : list of Lane
        Lanes that are assumed.
    """
    found: list[Lane] = []
    # By the junction into which they lead.
    ends: dict[str, list[Lane]] = defaultdict(list)
    begins: dict[str, list[Lane]] = defaultdict(list)
    for lane in (lane for lane in roads.lanes if lane.kind != "walking"):
        whole = frame.take(lane.centreline_m[:, :2], roads)
        if junction.id in (lane.to_junction, lane.from_junction):
            points = _reaching(whole, reach_m, from_end=junction.id == lane.to_junction)
        elif _is_elsewhere(whole, lane, junction, outline_m, reach_m):
            continue
        else:
            points = _longest_within(whole, reach_m)
        points = _apart(points)
        if len(points) < 2 or not is_lane_width(lane.width_m):
            continue
        cut = Lane(
            id=lane.id,
            kind=lane.kind,
            width_m=lane.width_m,
            centreline_m=points,
        )
        found.append(
            replace(
                cut,
                speed_limit_kmh=lane.speed_limit_kmh,
                turns=lane.turns,
                closed_to=lane.closed_to,
            )
        )
        if lane.kind == "driving":
            for others, at, name in (
                (ends, -1, lane.to_junction),
                (begins, 0, lane.from_junction),
            ):
                if name not in ("", junction.id) and (points[at] == whole[at]).all():
                    others[name].append(found[-1])
    # The map's own lanes through junctions.
    mapped = {lane.from_junction for lane in roads.connections}
    for lane in roads.connections:
        whole = frame.take(lane.centreline_m[:, :2], roads)
        is_taken = lane.from_junction == junction.id or (
            not _is_elsewhere(whole, lane, junction, outline_m, reach_m)
            and np.hypot(*whole.T).max() <= reach_m
            and _leads_straight_on(whole)
        )
        points = _apart(whole)
        if is_taken and len(points) > 1 and is_lane_width(lane.width_m):
            width_m = lane.width_m
            found.append(
                Lane(id=lane.id, kind=CONNECTING, width_m=width_m, centreline_m=points)
            )
    # Lanes through the junctions for which the map has none.
    through: list[Lane] = []
    for name in sorted((ends.keys() & begins.keys()) - mapped):
        through += _straight_on(ends[name], begins[name])
    return found, through


def _odd_lanes(roads: SourceMap, junction: MapJunction) -> list[Note]:
    """A note of how many lanes are left out for their widths, if any."""
    own = [
        lane
        for lane in (*roads.lanes, *roads.connections)
        if junction.id in (lane.to_junction, lane.from_junction)
        and lane.kind != "walking"
    ]
    n_odd = sum(not is_lane_width(lane.width_m) for lane in own)
    low_m, high_m = load_limits().lane_width_m
    why = f"narrower than {low_m:g} m or wider than {high_m:g} m"
    return counted(Counter({"lanes": n_odd} if n_odd else {}), why)


def _leads_straight_on(points_m: FloatArray) -> bool:
    """True if a lane through a junction is about as straight as assumed ones."""
    way = points_m[-1] - points_m[0]
    ends = np.stack([points_m[1] - points_m[0], points_m[-1] - points_m[-2]])
    length_m = np.hypot(*way) * np.hypot(*ends.T)
    return bool((ends @ way >= np.cos(np.radians(_STRAIGHT_ON_DEG)) * length_m).all())


def _straight_on(ends: Sequence[Lane], begins: Sequence[Lane]) -> Iterator[Lane]:
    """Lanes through a junction, for each lane into it and out of it.

    They lead as straight on as there is a lane; lanes that only turn there have
    none.

    Parameters
    ----------
    ends : sequence of Lane
        Lanes that lead into the junction.
    begins : sequence of Lane
        Lanes that lead out of it.

    Yields
    ------
    lane : Lane
        Of the kind ``CONNECTING``.
    """
    bends: dict[tuple[int, int], float] = {}
    # How much each pair of lanes would bend, at both of its ends.
    entries = [lane_line(lane, is_in=True, length_m=_MOUTH_M)[0] for lane in ends]
    exits = [lane_line(lane, is_in=False, length_m=_MOUTH_M)[0] for lane in begins]
    for one, before in enumerate(entries):
        for other, after in enumerate(exits):
            ahead = unit(after.point_m - before.point_m)
            cosines = [before.direction @ ahead, after.direction @ ahead]
            bend_deg = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
            if bend_deg.max() <= _STRAIGHT_ON_DEG:
                bends[one, other] = float(bend_deg.sum())
    # For each lane on either side, the pair that bends least.
    wanted: set[tuple[int, int]] = set()
    for side in (0, 1):
        for index in {pair[side] for pair in bends}:
            pairs = [pair for pair in bends if pair[side] == index]
            wanted.add(min(pairs, key=bends.__getitem__))
    for one, other in sorted(wanted):
        lane_id = f"{ends[one].id} to {begins[other].id}"
        width_m = min(ends[one].width_m, begins[other].width_m)
        curve_m = curve_between(entries[one], exits[other])
        yield Lane(id=lane_id, kind=CONNECTING, width_m=width_m, centreline_m=curve_m)


def _apart(points_m: FloatArray) -> FloatArray:
    """Line without points that lie within 2 mm of the one before.

    A file with three digits could not tell them apart.
    """
    is_new = np.append(True, steps_m(points_m) > _DIGITS_M)
    # The end stays, and the point before it goes.
    if not is_new[-1] and is_new.sum() > 1:
        is_new[np.flatnonzero(is_new)[-1]] = False
        is_new[-1] = True
    return np.asarray(points_m[is_new])


def _is_elsewhere(
    line_m: FloatArray,
    lane: MapLane,
    junction: MapJunction,
    outline_m: FloatArray,
    reach_m: float,
) -> bool:
    """True if a lane of other roads does not belong to a junction.

    It is far away, on another level, or ends at the outline.

    Parameters
    ----------
    line_m : (n, 2) float
        Its centreline in the scene's frame. [m]
    lane : MapLane
        The lane.
    junction : MapJunction
        The junction.
    outline_m : (n, 2) float
        Outline of the junction's road surface. [m]
    reach_m : float
        Radius of the circle around the origin within which lanes are kept. [m]

    Returns
    -------
    is_elsewhere : bool
        It is left out.
    """
    distance = np.hypot(*line_m.T)
    height_m = lane.centreline_m[np.argmin(distance), 2] - junction.height_m
    if distance.min() > reach_m or abs(height_m) > _SAME_LEVEL_M:
        return True
    tips = (line_m[0], line_m[-1])
    return any(distance_to_outline_m(tip, outline_m) <= _AT_OUTLINE_M for tip in tips)


def _reaching(points_m: FloatArray, reach_m: float, *, from_end: bool) -> FloatArray:
    """Part of a line from one end to where it first leaves the circle."""
    points = points_m
    if from_end:
        points = points_m[::-1]
    outside = np.flatnonzero(np.hypot(*points.T) > reach_m)
    if len(outside):
        last = max(int(outside[0]), 1)
        points = np.vstack(
            [points[:last], _on_circle(points[last - 1], points[last], reach_m)]
        )
    if from_end:
        return points[::-1]
    return points


def _longest_within(points_m: FloatArray, reach_m: float) -> FloatArray:
    """Stretch of a line within the circle that has the most of its points."""
    runs = true_runs(np.hypot(*points_m.T) <= reach_m)
    if not len(runs):
        return points_m[:0]
    begin, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    stretch = [points_m[begin:end]]
    if begin > 0:
        stretch.insert(
            0, _on_circle(points_m[begin], points_m[begin - 1], reach_m)[None]
        )
    if end < len(points_m):
        stretch.append(_on_circle(points_m[end - 1], points_m[end], reach_m)[None])
    return np.concatenate(stretch)


def _on_circle(
    inside_m: FloatArray,
    outside_m: FloatArray,
    reach_m: float,
) -> FloatArray:
    """Where a segment leaves the circle around the origin."""
    way = outside_m - inside_m
    a = way @ way
    b = inside_m @ way
    c = inside_m @ inside_m - reach_m**2
    if a == 0.0 or b * b - a * c < 0.0:
        return inside_m
    share = float(np.clip((-b + np.sqrt(b * b - a * c)) / a, 0.0, 1.0))
    return inside_m + share * way


def _crosswalks(
    maps: Sequence[SourceMap],
    frame: LocalFrame,
    outline_m: FloatArray,
) -> FloatArray:
    """Crosswalks of all maps near the junction's outline, (n, 2, 2)."""
    lines = np.concatenate([frame.take(source.crosswalks_m, source) for source in maps])
    middles = lines.mean(axis=1)
    lengths = np.hypot(*(lines[:, 1] - lines[:, 0]).T)
    off_m = np.array([distance_to_outline_m(middle, outline_m) for middle in middles])
    is_length = (lengths > 0.0) & (lengths <= load_limits().crosswalk_length_m)
    return np.asarray(lines[(off_m <= _CROSSWALK_WITHIN_M) & is_length])


def _paths(maps: Sequence[SourceMap], frame: LocalFrame, radius_m: float) -> Any:
    """Ground of the paths of all maps within a radius, a shapely geometry."""
    strips = []
    for source in maps:
        for path in source.paths:
            line = shapely.LineString(frame.take(path.line_m, source))
            if line.distance(shapely.Point(0.0, 0.0)) <= radius_m:
                strips.append(line.buffer(0.5 * path.width_m, quad_segs=4))
    return shapely.union_all(strips)


def _near_things(
    source: SourceMap,
    frame: LocalFrame,
    radius_m: float,
    skipped: list[Note],
) -> list[Thing]:
    """Things within a radius; the others are noted.

    Vertices are in the scene's frame, except for heights.

    Parameters
    ----------
    source : SourceMap
        The map.
    frame : LocalFrame
        Frame of the scene.
    radius_m : float
        Radius around the middle of the junction. [m]
    skipped : list of Note
        Notes on what was left out; entries are added.

    Returns
    -------
    near : list of Thing
        Those with triangles.
    """
    if not source.things:
        return []
    near: list[Thing] = []
    n_far = 0
    counts = [len(thing.vertices_m) for thing in source.things]
    # Project all vertices at once.
    every = frame.take(
        np.concatenate([thing.vertices_m for thing in source.things]), source
    )
    for thing, vertices in zip(
        source.things,
        np.split(every, np.cumsum(counts)[:-1]),
        strict=True,
    ):
        if len(vertices) and len(thing.triangles):
            if _off_m(vertices[:, :2]) > radius_m:
                n_far += 1
            else:
                near.append(replace(thing, vertices_m=vertices))
    if n_far:
        why = f"farther than {radius_m:g} m from the junction"
        if frame.map_crs and not source.crs:
            lies = (
                "the file names no coordinate reference system, and in that of the map"
                " with the"
            )
            why = (
                f"{lies} roads they lie {why}: name it (such as EPSG:25832), or move"
                " them"
            )
        skipped.append(Note(f"{n_far} things in {source.name}", why))
    return near


def _off_m(points_m: FloatArray) -> float:
    """Distance of the origin from the box around points (n, 2)."""
    nearest_m = np.clip(0.0, points_m.min(axis=0), points_m.max(axis=0))
    return float(np.hypot(*nearest_m))


def _unique(name: str, source: SourceMap, taken: Counter[str]) -> str:
    """Id that no other thing has, fit for a command line."""
    clean = plain_id(name) or "thing"
    if clean in taken:
        clean = f"{source.name}-{clean}"
    return unique_id(clean, taken)


# ---------- many junctions out of maps that are read once
def _trees(source: SourceMap) -> dict[str, shapely.STRtree]:
    """Search trees over the boxes of everything in a map, by field."""
    points_m = {
        "lanes": [lane.centreline_m for lane in source.lanes],
        "connections": [lane.centreline_m for lane in source.connections],
        "junctions": [junction.outline_m for junction in source.junctions],
        "things": [thing.vertices_m for thing in source.things],
        "poles": [pole.position_m[None] for pole in source.poles],
        "paths": [path.line_m for path in source.paths],
        "crosswalks_m": source.crosswalks_m.mean(axis=1, keepdims=True),
    }
    return {
        name: shapely.STRtree([shapely.multipoints(one[:, :2]) for one in some])
        for name, some in points_m.items()
    }


class Neighbourhoods:
    """Maps from which what lies around junctions is taken repeatedly."""

    def __init__(self, maps: Sequence[SourceMap], *, radius_m: float) -> None:
        self._half_m = radius_m + LANES_BEYOND_M + _MORE_M
        # Of the square that has things.
        self._share = (radius_m + _THINGS_MORE_M) / self._half_m
        self._maps = [(source, _trees(source)) for source in maps]

    def around(self, junction: MapJunction) -> tuple[SourceMap, ...]:
        """What the maps have around a junction of the first one.

        The scene that is cut out of these is the one that is cut out of the whole maps;
        what was left out when the maps were read is not told again. A map that has
        nothing there is left out.
        """
        roads = self._maps[0][0]
        middle = junction.position_m
        # A square around the junction, in each map's own coordinates.
        corners = middle + self._half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        parts = []
        for source, trees in self._maps:
            here = corners
            if source.crs and roads.crs and source.crs != roads.crs:
                here = transform(corners, roads.crs, source.crs)
            low = here.min(axis=0)
            high = here.max(axis=0)
            less = 0.5 * (1.0 - self._share) * (high - low)
            part = _within(source, trees, (low, high), near=(low + less, high - less))
            has_any = (
                part.things
                or part.poles
                or len(part.crosswalks_m)
                or len(part.ground_m)
            )
            if source is roads or has_any:
                parts.append(part)
        return tuple(parts)


def _within(
    source: SourceMap,
    trees: dict[str, shapely.STRtree],
    square: _Square,
    *,
    near: _Square,
) -> SourceMap:
    """Part of a map: lanes and ground of a square, and nearer things.

    Parameters
    ----------
    source : SourceMap
        The map.
    trees : dict[str, shapely.STRtree]
        See :func:`_trees`.
    square : ((2,) float, (2,) float)
        Lowest and highest x and y of lanes and ground. [m]
    near : ((2,) float, (2,) float)
        The same of what stands and is painted there. [m]

    Returns
    -------
    part : SourceMap
        Without notes on what was left out.
    """
    found: dict[str, Any] = {}
    for name, tree in trees.items():
        if name in _FAR_FIELDS:
            low, high = square
        else:
            low, high = near
        every = getattr(source, name)
        at = np.sort(tree.query(shapely.box(*low, *high))).tolist()
        if name == _LINES:
            found[name] = every[at]
        else:
            found[name] = tuple(every[index] for index in at)
    low, high = square
    ground = source.ground_m[:, :2]
    is_near = ((ground >= low) & (ground <= high)).all(axis=1)
    skipped = assumptions(source.skipped)
    return replace(source, **found, ground_m=source.ground_m[is_near], skipped=skipped)
