"""Room for what a case lays into a scene: nothing in the way, nothing on the carriageway."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from geometry.actors import Actor, PlacedActor
from geometry.arrays import FloatArray
from geometry.footprints import footprint_corners
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Scene

from .laying import load_obstruction_rules
from .obstructions import moved
from .paths import Motion, Path
from .staging import CannotCarryError, Staging

_HEIGHTS_M = (0.35, 1.0)  # above kerbs, below bonnets and walls
_STEP_M = 2.0  # along bent paths
_POLES = ("lamp post", "traffic light")


def make_room(staging: Staging, scene: Scene) -> Staging:
    """A staging whose obstruction stands where there is room for it.

    Parked cars and walls stand outside the lanes that are driven on and outside the junction. Where
    the protocol's place is not free they are moved, as little as possible: aside, away from whom
    they stand beside, and back, away from where the ways cross; how far, ``data/laying.toml`` says.

    Raises
    ------
    CannotCarryError
        A body has no room; names it and what stands there.

    Notes
    -----
    Looked at with rays along the middle and both flanks of the ways, and around and across the
    parked bodies' footprints. A VRU passes beside a pole that stands on its line. What the map does
    not show does not stand in the way.
    """
    encounter = staging.encounter
    solid = _Solid(scene=scene, has_poles=True)
    for name, body, motion, obstacles in (
        ("the VRU", encounter.vru, encounter.vru_motion, _Solid(scene=scene, has_poles=False)),
        ("the VUT", encounter.vut, encounter.vut_motion, solid),
    ):
        _check(obstacles, _way(motion, body), f"{name}'s way")
    if not staging.obstruction:
        return staging
    refused: CannotCarryError | None = None
    for aside_m, back_m in _moves_m():
        settled = moved(staging, aside_m=aside_m, back_m=back_m) if aside_m or back_m else staging
        if _is_on_carriageway(settled.obstruction, scene):
            continue
        try:
            for parked in settled.obstruction:
                _check(solid, _footprint_sides(parked), f"the place of {parked.actor.name}")
        except CannotCarryError as error:
            refused = refused or error
        else:
            return settled
    names = " and ".join(dict.fromkeys(parked.actor.name for parked in staging.obstruction))
    raise refused or CannotCarryError(f"{names} would stand on the carriageway")


def _moves_m() -> Iterator[tuple[float, float]]:
    """Metres aside and back, the shortest ways first."""
    rules = load_obstruction_rules()
    asides, backs = (
        np.arange(0.0, limit_m + 0.5 * rules.step_m, rules.step_m).tolist()
        for limit_m in (rules.max_aside_m, rules.max_back_m)
    )
    return iter(sorted(product(asides, backs), key=lambda move: (sum(move), move)))


_INSIDE_OUTLINE_M = 2.0  # outlines are rounded at the corners
_MAY_OVERLAP_M = 0.1


def _is_on_carriageway(parked: Sequence[PlacedActor], scene: Scene) -> bool:
    import shapely

    rings = [
        footprint_corners(
            body.pose.position_m[:2],
            body.pose.yaw_deg,
            length_m=body.actor.length_m,
            width_m=body.actor.width_m,
        )
        for body in parked
    ]
    return bool(shapely.intersects(_carriageway(scene), shapely.polygons(np.array(rings))).any())


@lru_cache(maxsize=8)
def _carriageway(scene: Scene) -> Any:
    """What is driven on: a shapely geometry."""
    import shapely

    lanes = [
        shapely.LineString(lane.centreline_m).buffer(
            0.5 * lane.width_m - _MAY_OVERLAP_M, cap_style="flat"
        )
        for lane in scene.lanes
        if lane.kind == "driving" and len(lane.centreline_m) > 1
    ]
    inside = shapely.make_valid(shapely.Polygon(scene.outline_m)).buffer(-_INSIDE_OUTLINE_M)
    area = shapely.union_all([inside, *lanes])
    shapely.prepare(area)
    return area


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solid:
    """What of a scene stands in a way."""

    scene: Scene
    has_poles: bool


def _check(solid: _Solid, segments_m: FloatArray, what: str) -> None:
    caster, origin = _caster(solid)
    starts, ends = (
        np.concatenate([_lift(segments_m[:, end] - origin, height) for height in _HEIGHTS_M])
        for end in (0, 1)
    )
    if _is_blocked(caster, starts, ends):
        raise CannotCarryError(f"{_blocker(solid, starts, ends, origin)} stands in {what}")


@lru_cache(maxsize=8)
def _caster(solid: _Solid) -> tuple[RayCaster, FloatArray]:
    """Rays against all of it, near the origin: they are cast in single precision."""
    origin = solid.scene.outline_m.mean(axis=0)
    return _caster_of(solid.scene, _counting(solid), origin), origin


def _counting(solid: _Solid) -> list[int]:
    """Indices of the instances that count."""
    return [
        index
        for index, instance in enumerate(solid.scene.instances)
        if solid.has_poles or instance.class_name not in _POLES
    ]


def _caster_of(scene: Scene, instances: Sequence[int], origin_m: FloatArray) -> RayCaster:
    triangles = np.asarray(scene.triangles)[np.isin(scene.triangle_instance, instances)]
    # A few thousand rays: not worth the second that Open3D takes to load.
    return build_caster(scene.vertices_m - [*origin_m, 0.0], triangles, library="embreex")


def _blocker(solid: _Solid, starts_m: FloatArray, ends_m: FloatArray, origin_m: FloatArray) -> str:
    """The first instance that the rays run into."""
    for index in _counting(solid):
        if _is_blocked(_caster_of(solid.scene, [index], origin_m), starts_m, ends_m):
            return solid.scene.instances[index].id
    return "the scene"


def _is_blocked(caster: RayCaster, starts_m: FloatArray, ends_m: FloatArray) -> bool:
    vectors = (ends_m - starts_m).astype(np.float32)
    return bool(caster.is_blocked(starts_m.astype(np.float32), vectors).any())


def _way(motion: Motion, body: Actor) -> FloatArray:
    """Segments along the middle and the flanks, from behind the start to the impact, (n, 2, 2)."""
    covered_m = float(motion.distance_m(0.0))
    distances = _distances(motion.path, covered_m)
    position, yaw_deg = motion.path.at(distances)
    yaw = np.radians(np.broadcast_to(yaw_deg, distances.shape))
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
    segments = []
    for share in (-0.5, 0.0, 0.5):
        line = position + share * body.width_m * left
        line = np.concatenate([line[:1] - 0.5 * body.length_m * ahead[:1], line])
        segments.append(np.stack([line[:-1], line[1:]], axis=1))
    return np.concatenate(segments)


def _distances(path: Path, covered_m: float) -> FloatArray:
    return np.linspace(0.0, covered_m, max(2, int(covered_m / _STEP_M) + 2))


def _footprint_sides(parked: PlacedActor) -> FloatArray:
    corners = footprint_corners(
        parked.pose.position_m[:2],
        parked.pose.yaw_deg,
        length_m=parked.actor.length_m,
        width_m=parked.actor.width_m,
    )
    ends = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]  # four sides, two diagonals
    return np.array([[corners[a], corners[b]] for a, b in ends])


def _lift(points_m: FloatArray, height_m: float) -> FloatArray:
    return np.column_stack([points_m, np.full(len(points_m), height_m)])
