"""Parked cars and walls that hide the VRU, and room for them and for all ways."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from geometry.actors import Actor, PlacedActor, box_shape, park_row
from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.junction import CONNECTING
from geometry.phrases import Phrase
from geometry.poses import Pose
from geometry.raycast import FloatRays, RayCaster, build_caster
from geometry.scene import Scene, area_of, strips_of
from geometry.terrain import GROUND, houses_of, on_ground, terrain_of

from .cases import Obstruction
from .encounters import Encounter
from .paths import Motion
from .staging import (
    CannotCarryError,
    NoKerbError,
    Staging,
    is_vehicle,
    load_obstruction_rules,
)
from .ways import StraightWay, Way

# Above kerbs, below bonnets and walls.
_HEIGHTS_M = (0.35, 1.0)
# Along bent paths.
_STEP_M = 2.0
# The thinnest pole is hit.
_ACROSS_STEP_M = 0.1
# How names of walls begin.
_WALL = "wall "
_POLES = ("lamp post", "traffic light")
# Kinds of lanes on which nobody parks.
_DRIVEN = ("driving", "bus", CONNECTING)


def make_room(staging: Staging, scene: Scene) -> Staging:
    """A staging whose obstruction stands where there is room for it.

    Parked cars and walls stand outside the lanes that are driven on and outside the
    junction, cars not on islands between them either, unless the map has a parking lane
    there. Where the protocol's place is not free they are moved, as little as possible:
    aside, away from whom they stand next to, and back, away from where the ways cross;
    how far, ``data/laying.toml`` says. Raises CannotCarryError: a body has no room;
    names it and what stands there. NoKerbError: lanes or the junction cover all places
    of the parked bodies.

    Looked at with rays along the middle and both flanks of the ways, and around and
    across the parked bodies' footprints. A VRU passes next to a pole that stands on its
    line. What the map does not show does not stand in the way.
    """
    encounter = staging.encounter
    _check_islands(encounter, scene)
    # The VUT passes no pole, a VRU may.
    solid = _solid(scene, has_poles=True)
    others = _solid(scene, has_poles=False)
    thing = _first_met(others, _way(encounter.vru_motion, encounter.vru))
    if thing is not None and is_vehicle(encounter.vru):
        raise CannotCarryError(
            Phrase("{thing} stands in the target's way", thing=thing)
        )
    if thing is not None:
        raise CannotCarryError(Phrase("{thing} stands in the VRU's way", thing=thing))
    thing = _first_met(solid, _way(encounter.vut_motion, encounter.vut))
    if thing is not None:
        raise CannotCarryError(Phrase("{thing} stands in the VUT's way", thing=thing))
    if not staging.obstruction:
        return staging
    # Every speed of a case has the same obstruction.
    aside_m, back_m = _find_room(
        scene,
        tuple(staging.aside.tolist()),
        tuple(staging.back.tolist()),
        staging.max_aside_m,
        tuple(
            (body.actor.name, tuple(body.footprint_m.ravel()))
            for body in staging.obstruction
        ),
    )
    if not (aside_m or back_m):
        return staging
    east, north = aside_m * staging.aside + back_m * staging.back
    moved = []
    for body in staging.obstruction:
        position_m = body.pose.position_m + [east, north, 0.0]
        moved.append(replace(body, pose=replace(body.pose, position_m=position_m)))
    return replace(staging, obstruction=tuple(moved))


def _check_islands(encounter: Encounter, scene: Scene) -> None:
    """Raise CannotCarryError if somebody moves over a roundabout's island."""
    if not scene.islands_m:
        return
    islands = shapely.union_all([area_of(island_m) for island_m in scene.islands_m])
    for motion, body in (
        (encounter.vut_motion, encounter.vut),
        (encounter.vru_motion, encounter.vru),
    ):
        middle = np.array_split(_way(motion, body), 3)[1]
        if shapely.intersects(shapely.multilinestrings(middle), islands):
            raise CannotCarryError(Phrase("the path crosses the roundabout's island"))


def is_way_free(
    body: Actor, motion: Motion, scene: Scene, obstruction: Sequence[PlacedActor]
) -> bool:
    """True if nothing stands in a way to the impact.

    Things of the scene count except poles, and so does whatever is parked.
    """
    segments = _way(motion, body)
    if not _is_free(_solid(scene, has_poles=False), segments):
        return False
    parked = shapely.polygons(
        np.array([one.footprint_m for one in obstruction]).reshape(-1, 4, 2)
    )
    return not bool(
        shapely.intersects(shapely.multilinestrings(segments), parked).any()
    )


@lru_cache(maxsize=256)
def _find_room(
    scene: Scene,
    aside: tuple[float, ...],
    back: tuple[float, ...],
    max_aside_m: float,
    bodies: tuple[tuple[str, tuple[float, ...]], ...],
) -> tuple[float, float]:
    """Metres aside and back by which bodies, each a name and its corners, get room."""
    # All places that the bodies may be moved to, the nearest first.
    moves = _moves_m(max_aside_m)
    shifts = moves @ np.array([aside, back])
    rings = np.array([corners for _, corners in bodies]).reshape(-1, 4, 2)
    # (n_moves, n_bodies, 4, 2).
    places = rings + shifts[:, None, None, :]
    outlines = shapely.polygons(places)
    areas = _areas(scene)
    off_road = np.flatnonzero(
        ~shapely.intersects(areas.carriageway, outlines).any(axis=1)
    )
    n_off_road = len(off_road)
    is_car = np.array([not name.startswith(_WALL) for name, _ in bodies])
    on_island = _are_on_islands(
        scene, places[off_road][:, is_car], np.array(aside)
    ).any(axis=1)
    off_road = off_road[~on_island]
    # Rays do not meet the house that is all around them.
    is_indoors = shapely.contains(areas.houses, outlines).any(axis=1)
    solid = _solid(scene, has_poles=True)
    for index in off_road:
        if not is_indoors[index] and _is_free(solid, _sides(places[index])):
            return float(moves[index, 0]), float(moves[index, 1])
    names = [name for name, _ in bodies]
    all_names = Phrase(" and ".join(dict.fromkeys(names)))
    if not len(off_road):
        why = Phrase("{bodies} would stand on the carriageway", bodies=all_names)
        if n_off_road:
            why = Phrase("{bodies} would stand on a traffic island", bodies=all_names)
        raise NoKerbError(why)
    for name, place in zip(names, places[off_road[0]], strict=True):
        thing = _first_met(solid, _sides(place[None]))
        if thing is not None:
            raise CannotCarryError(
                Phrase("{thing} occupies the place of {body}", thing=thing, body=name)
            )
    raise CannotCarryError(
        Phrase("there is no room beside the road for {bodies}", bodies=all_names)
    )


def _are_on_islands(scene: Scene, places_m: FloatArray, aside: FloatArray) -> BoolArray:
    """Cars (..., 4, 2) that would stand on a traffic island, (...,).

    Behind such a car lies a lane that leads about the same way.

    Behind a corner lies the lane of the road that crosses.
    """
    rules = load_obstruction_rules()
    behind = places_m + rules.island_m * aside
    # The ground under a car and behind it.
    swept = shapely.convex_hull(
        shapely.multipoints(np.concatenate([places_m, behind], axis=-2))
    )
    has_lane = shapely.intersects(_areas(scene).parking, shapely.polygons(places_m))
    is_island: BoolArray = np.zeros(swept.shape, dtype=bool)
    if not swept.size:
        return is_island
    # From rear to front.
    axes = (places_m[..., 0, :] - places_m[..., 1, :]).reshape(-1, 2)
    tree, directions = _pieces(scene)
    place, piece = tree.query(swept.ravel(), predicate="intersects")
    along = np.abs((axes[place] * directions[piece]).sum(axis=1)) / np.hypot(
        *axes[place].T
    )
    is_island.ravel()[place[along >= np.cos(np.radians(rules.max_island_skew_deg))]] = (
        True
    )
    is_island &= ~has_lane
    return is_island


@lru_cache(maxsize=8)
def _pieces(scene: Scene) -> tuple[Any, FloatArray]:
    """A tree of the straight pieces of lanes, and their directions (n, 2).

    The lanes are those between junctions.
    """
    pieces = []
    directions = []
    parking = _areas(scene).parking
    for lane in scene.lanes:
        if lane.kind in ("driving", "bus"):
            for begin, end in zip(
                lane.centreline_m[:-1], lane.centreline_m[1:], strict=True
            ):
                side = 0.5 * lane.width_m - _MAY_OVERLAP_M
                strip = shapely.LineString([begin, end]).buffer(side, cap_style="flat")
                pieces.append(shapely.difference(strip, parking))
                directions.append((end - begin) / np.hypot(*(end - begin)))
    return shapely.STRtree(pieces), np.array(directions).reshape(-1, 2)


@cache
def _moves_m(max_aside_m: float) -> FloatArray:
    """Metres aside and back, (n, 2), the shortest ways first."""
    rules = load_obstruction_rules()
    step = rules.step_m
    asides = step * np.arange(
        -int(rules.max_nearer_m / step), int(max_aside_m / step) + 1
    )
    backs = step * np.arange(int(rules.max_back_m / step) + 1)
    moves = np.stack(np.meshgrid(asides, backs, indexing="ij"), axis=-1).reshape(-1, 2)
    return freeze(moves[np.argsort(np.abs(moves).sum(axis=1), kind="stable")])


# Outlines are rounded at the corners.
_INSIDE_OUTLINE_M = 2.0
_MAY_OVERLAP_M = 0.1


class _Areas(NamedTuple):
    """Areas of a scene, shapely geometries that are prepared.

    Attributes
    ----------
    carriageway, parking : Any
        Where cars drive, and where they park.
    houses : Any
        Ground under buildings and walls.
    """

    carriageway: Any
    parking: Any
    houses: Any


@lru_cache(maxsize=8)
def _areas(scene: Scene) -> _Areas:
    """Areas of a scene that cars may not, or need not, be parked on."""
    lanes = (lane for lane in scene.lanes if lane.kind in _DRIVEN)
    strips = strips_of(lanes, less_m=_MAY_OVERLAP_M)
    inside = area_of(scene.outline_m).buffer(-_INSIDE_OUTLINE_M)
    parking = shapely.union_all(
        strips_of(lane for lane in scene.lanes if lane.kind == "parking")
    )
    # Some maps mark parking spaces on a lane that is wide enough for both.
    driven = shapely.difference(shapely.union_all(strips), parking)
    areas = _Areas(shapely.union(inside, driven), parking, houses_of(scene))
    for area in areas:
        shapely.prepare(area)
    return areas


class _Solid(NamedTuple):
    """Things of a scene that may stand in a way.

    Attributes
    ----------
    scene : Scene
        The scene itself.
    caster : RayCaster
        Its triangles, near the origin: rays have single precision.
    origin_m : (2,) float
        Point of the scene that is the caster's origin. [m]
    instance : (n,) int32
        Index of the thing to which each triangle belongs.
    """

    scene: Scene
    caster: RayCaster
    origin_m: FloatArray
    instance: NDArray[np.int32]

    def rays(self, segments_m: FloatArray) -> tuple[FloatRays, FloatRays]:
        """Starts and ways (n, 3) of segments at each height above the ground."""
        terrain = terrain_of(self.scene)
        starts, ends = np.swapaxes(
            on_ground(segments_m, terrain) - [*self.origin_m, 0.0], 0, 1
        )
        lifted = np.concatenate(
            [starts + [0.0, 0.0, height_m] for height_m in _HEIGHTS_M]
        )
        ways = np.tile(ends - starts, (len(_HEIGHTS_M), 1))
        return lifted.astype(np.float32), ways.astype(np.float32)


@lru_cache(maxsize=8)
def _solid(scene: Scene, *, has_poles: bool) -> _Solid:
    """Things of a scene that stand in a way; the ground is none of them."""
    passed = (GROUND,) if has_poles else (GROUND, *_POLES)
    counts = np.array(
        [thing.class_name not in passed for thing in scene.instances], dtype=bool
    )
    kept = counts[scene.triangle_instance]
    origin = scene.outline_m.mean(axis=0)
    # A few thousand rays: not worth the second that Open3D takes to load.
    near_m = scene.vertices_m - [*origin, 0.0]
    caster = build_caster(near_m, scene.triangles[kept], library="embree")
    return _Solid(scene, caster, origin, scene.triangle_instance[kept])


def _is_free(solid: _Solid, segments_m: FloatArray) -> bool:
    """True if no segment (n, 2, 2) meets a thing."""
    return not solid.caster.is_blocked(*solid.rays(segments_m)).any()


def _first_met(solid: _Solid, segments_m: FloatArray) -> Phrase | None:
    """Thing that segments end in or cross, one of those met first.

    None: all are free.
    """
    rays = solid.rays(segments_m)
    if not solid.caster.is_blocked(*rays).any():
        return None
    share, triangle = solid.caster.first_triangle(*rays)
    met = solid.instance[triangle[share <= max(1.0, share.min())]]
    return Phrase(solid.scene.instances[met.min()].id)


def _way(motion: Motion, body: Actor) -> FloatArray:
    """Segments along the middle and the flanks of a body, (n, 2, 2).

    They lead from behind the start to the impact.
    """
    covered_m = float(motion.distance_m(0.0))
    distances = np.linspace(0.0, covered_m, max(2, int(covered_m / _STEP_M) + 2))
    position, yaw_deg = motion.path.at(distances)
    yaw = np.radians(np.broadcast_to(yaw_deg, distances.shape))
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
    segments = []
    for share in (-0.5, 0.0, 0.5):
        # Along the right flank, the middle, and the left flank.
        line = position + share * body.width_m * left
        line = np.concatenate([line[:1] - 0.5 * body.length_m * ahead[:1], line])
        segments.append(np.stack([line[:-1], line[1:]], axis=1))
    return np.concatenate(segments)


def _sides(corners_m: FloatArray) -> FloatArray:
    """Segments around footprints (n, 4, 2) and, close together, across them."""
    # Four sides, two diagonals.
    ends = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)])
    around = corners_m[:, ends].reshape(-1, 2, 2)
    longest = np.hypot(*np.ptp(corners_m, axis=1).T).max()
    share = np.linspace(0.0, 1.0, int(longest / _ACROSS_STEP_M) + 2)[1:-1, None, None]
    one = corners_m[:, 0] + share * (corners_m[:, 1] - corners_m[:, 0])
    other = corners_m[:, 3] + share * (corners_m[:, 2] - corners_m[:, 3])
    across = np.stack([one, other], axis=-2).reshape(-1, 2, 2)
    return np.concatenate([around, across])


# ---------- obstructions
def hide(
    encounter: Encounter,
    obstruction: Obstruction,
    *,
    vut_way: Way,
    vut_m: float,
    vru_way: Way,
    vru_m: float,
) -> Staging:
    """An encounter with its obstruction in place; the ways cross at the stations."""
    vut_line = vut_way.direction(vut_m)
    vru_line = vru_way.direction(vru_m)
    vut = encounter.vut
    vru = encounter.vru
    if obstruction.kind == "beside-vut":
        side = -float(np.sign(vut_line.left @ vru_line.direction))
        aside = side * vut_line.left
        back = -vut_line.direction
        bodies = _beside_vut(
            obstruction, vut=vut, vut_way=vut_way, vut_m=vut_m, vru=vru, side=side
        )
    else:
        # +1 if the VUT comes from the left of the VRU's way, -1 from its right
        side = -float(np.sign(vru_line.left @ vut_line.direction))
        aside = side * vru_line.left
        back = -vru_line.direction
        bodies = _beside_vru(
            obstruction, vru_way=vru_way, vru_m=vru_m, vru=vru, side=side
        )
    return Staging(
        encounter=encounter,
        obstruction=bodies,
        aside=aside,
        back=back,
        max_aside_m=load_obstruction_rules().max_aside_m[obstruction.kind],
    )


def park(
    encounter: Encounter,
    obstruction: Obstruction,
    *,
    row_way: Way,
    bumper_m: float,
    side: float,
) -> Staging:
    """An encounter with a row of cars parked beside a lane.

    Their noses point as the VUT's; they are flush to the road.

    `row_way` is the middle of the lane in the VUT's direction, `bumper_m` the station
    of the first front bumper; `side` is +1 to the left of it, -1 to the right.
    """
    line = row_way.direction(bumper_m)
    gap_m = obstruction.side_gap_m
    bodies = obstruction.bodies
    left_m = {actor: side * (gap_m + 0.5 * actor.width_m) for actor in bodies}
    return Staging(
        encounter=encounter,
        obstruction=_row(obstruction, row_way, bumper_m, left_m),
        aside=side * line.left,
        back=-line.direction,
        max_aside_m=load_obstruction_rules().max_aside_m[obstruction.kind],
    )


def _row(
    obstruction: Obstruction, way: Way, bumper_m: float, left_m: Mapping[Actor, float]
) -> tuple[PlacedActor, ...]:
    """Bodies one behind the other along a way.

    `bumper_m` is the station of the first front bumper.
    """
    bodies = []
    for actor in obstruction.bodies:
        station_m = bumper_m - 0.5 * actor.length_m
        yaw_deg = way.direction(station_m).yaw_deg
        bodies.append(_placed(actor, way.point(station_m, left_m[actor]), yaw_deg))
        bumper_m -= actor.length_m + obstruction.between_gap_m
    return tuple(bodies)


def _beside_vut(
    obstruction: Obstruction,
    *,
    vut: Actor,
    vut_way: Way,
    vut_m: float,
    vru: Actor,
    side: float,
) -> tuple[PlacedActor, ...]:
    """Cars parked along the VUT's way, noses as the VUT's.

    They stand on the side from which the VRU comes.

    Their common centreline is such that the widest keeps the side gap.
    """
    widest_m = max(actor.width_m for actor in obstruction.bodies)
    left_m = side * (0.5 * vut.width_m + obstruction.side_gap_m + 0.5 * widest_m)
    bumper_m = vut_m - 0.5 * vru.width_m - obstruction.first_gap_m
    if isinstance(vut_way, StraightWay):
        line = vut_way.line
        return park_row(
            obstruction.bodies,
            first_bumper_m=line.at(bumper_m, left_m),
            yaw_deg=line.yaw_deg,
            gap_m=obstruction.between_gap_m,
        )
    row_m = sum(
        actor.length_m + obstruction.between_gap_m for actor in obstruction.bodies
    )
    row, bumper_m = vut_way.offset(left_m, bumper_m, back_m=row_m, ahead_m=0.0)
    return _row(obstruction, row, bumper_m, dict.fromkeys(obstruction.bodies, 0.0))


def _beside_vru(
    obstruction: Obstruction, *, vru_way: Way, vru_m: float, vru: Actor, side: float
) -> tuple[PlacedActor, ...]:
    """Cars or a wall between the VRU's way and the VUT that comes.

    The cars' noses point away from the VUT's way.
    """
    bodies = []
    rear_m = obstruction.first_gap_m
    wall = obstruction.wall_size_m
    for actor in (_build_wall(*wall),) if wall else obstruction.bodies:
        beside_m = 0.5 * vru.width_m + obstruction.side_gap_m + 0.5 * actor.width_m
        station_m = vru_m - (rear_m + 0.5 * actor.length_m)
        line = vru_way.direction(station_m)
        if actor.class_name != "wall":
            line = line.turned(180.0)
        bodies.append(
            _placed(actor, vru_way.point(station_m, side * beside_m), line.yaw_deg)
        )
        rear_m += actor.length_m + obstruction.between_gap_m
    return tuple(bodies)


def _placed(actor: Actor, point_m: FloatArray, yaw_deg: float) -> PlacedActor:
    """A body that stands on the plane z = 0."""
    return PlacedActor(
        actor=actor, pose=Pose(position_m=np.append(point_m, 0.0), yaw_deg=yaw_deg)
    )


@cache
def _build_wall(length_m: float, thickness_m: float, height_m: float) -> Actor:
    """A wall as a body, so that it is placed like parked cars."""
    return Actor(
        name=f"wall {length_m:g} x {thickness_m:g} x {height_m:g} m",
        class_name="wall",
        length_m=length_m,
        width_m=thickness_m,
        height_m=height_m,
        shapes=(box_shape(length_m, thickness_m, height_m),),
    )
