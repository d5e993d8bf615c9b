"""How high the ground lies around a junction, and things set upon it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray
from ..notes import Note
from ..terrain import Terrain, fit_terrain
from .georeferences import LocalFrame
from .source_map import MapJunction, SourceMap, Thing

_STEP_M = 2.0  # of the grid
_FLAT_M = 0.1  # ground that is nowhere higher or lower than this is a plane
_BEYOND_M = 50.0  # points farther outside have no say
_SAME_LEVEL_M, _STEEPEST = 2.0, 0.08  # more than this above the arms' roads is a bridge
_OTHER_ZERO_M = 3.0  # a map whose things are this far off counts heights from another zero
_FLOATS_M = 3.0  # at most: what is higher above the ground is meant to be there


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Elevation:
    """Ground from a file of heights."""

    name: str  # of the file
    points_m: FloatArray  # (n, 3), in the coordinates of the map with the roads


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief:
    """The ground around a junction: its middle is at z = 0.

    Attributes
    ----------
    terrain : Terrain or None
        None: the plane z = 0.
    zero_m : float
        Height of the middle of the junction as `source` counts heights. [m]
    source : str
        What told the heights; empty: nothing.
    roads_m : Terrain or None
        Ground of the map with the roads, as that counts heights, where another source told them.
    told : tuple of Note
        What was made of the heights.
    """

    terrain: Terrain | None = None
    zero_m: float = 0.0
    source: str = ""
    roads: SourceMap | None = None
    roads_m: Terrain | None = None
    told: tuple[Note, ...] = ()

    def at(self, points_m: FloatArray) -> FloatArray:
        """Height of the ground at points (n, 2)."""
        return np.zeros(len(points_m)) if self.terrain is None else self.terrain.at(points_m)

    def above_m(self, vertices_m: FloatArray) -> FloatArray:
        """Height of vertices (n, 3) above the ground below them."""
        above: FloatArray = vertices_m[:, 2] - self.at(vertices_m[:, :2])
        return above

    def lower(
        self, source: SourceMap, things: Sequence[Thing], given_m: float | None
    ) -> Iterator[tuple[FloatArray, bool]]:
        """Vertices of a map's things with heights from z = 0, and whether they were set down.

        `given_m` is the height in the map of the road in the junction's middle. Where a map counts
        heights above the ground, walls follow it, and other things stand on the lowest ground below
        them. Buildings that would float are set down, unless a plane's height was given.
        """
        if source.heights == "above ground" and given_m is None:
            for thing in things:
                ground = self.at(thing.vertices_m[:, :2])
                up = ground if thing.class_name == "wall" else ground.min()
                yield _raised(thing, up), False
            return
        zero_m = self._zero_m(source, things, given_m)
        may_float = given_m is None or self.terrain is not None
        for thing in things:
            vertices = _raised(thing, -zero_m)
            if source is self.roads and self.roads_m is not None:
                middle = vertices[:, :2].mean(axis=0, keepdims=True)
                own_m = self.roads_m.at(middle) - self.roads_m.at(np.zeros(2))
                vertices[:, 2] += self.at(middle) - own_m
            gap_m = float(vertices[:, 2].min() - self.at(vertices[:, :2]).min())
            floats = may_float and thing.class_name == "building" and _FLAT_M < gap_m <= _FLOATS_M
            yield vertices - [0.0, 0.0, gap_m if floats else 0.0], floats

    def _zero_m(self, source: SourceMap, things: Sequence[Thing], given_m: float | None) -> float:
        """The height in a map that becomes z = 0."""
        if source is self.roads and source.heights == "absolute":
            return self.zero_m if self.roads_m is None else float(self.roads_m.at(np.zeros(2)))
        if given_m is not None:
            return given_m
        if not things:
            return 0.0
        if self.terrain is None:
            return min(float(thing.vertices_m[:, 2].min()) for thing in things)
        # Feet of things above the ground, were heights counted as those of the ground.
        off_m = float(
            np.median(
                [
                    thing.vertices_m[:, 2].min() - self.at(thing.vertices_m[:, :2]).min()
                    for thing in things
                ]
            )
            - self.zero_m
        )
        return self.zero_m + (off_m if abs(off_m) > _OTHER_ZERO_M else 0.0)


def _raised(thing: Thing, up_m: FloatArray | float) -> FloatArray:
    vertices: FloatArray = thing.vertices_m.copy()
    vertices[:, 2] += up_m
    return vertices


def find_relief(
    maps: Sequence[SourceMap],
    junction: MapJunction,
    frame: LocalFrame,
    *,
    half_m: float,
    elevation: Elevation | None = None,
) -> Relief:
    """The ground within a square around a junction of the first map.

    Heights are those of `elevation`, or else of the first of the other maps that has some near the
    junction, or else of the roads themselves. Ground between points is interpolated, ground beyond
    them as high as the nearest one; roads on bridges, more than 2 m and 8 % off those of the
    junction's arms, have no say.
    """
    roads = maps[0]
    own = _near(frame.take(roads.ground_m, roads), half_m)
    if roads.heights == "absolute":
        own = _on_level(own, roads, junction, frame)
    found = [(roads.name, own)]
    for other in reversed(maps[1:]):
        found.insert(0, (other.name, _near(frame.take(other.ground_m, other), half_m)))
    if elevation is not None:
        found.insert(0, (elevation.name, _near(frame.take(elevation.points_m, roads), half_m)))
    name, points = next((one for one in found if len(one[1])), ("", own))
    if not name:
        return Relief()
    ground = fit_terrain(points, half_m=half_m, step_m=_STEP_M)
    middle_m = float(ground.at(np.zeros(2)))
    terrain = replace(ground, height_m=ground.height_m - middle_m)
    span_m = float(np.ptp(terrain.height_m))
    if np.abs(terrain.height_m).max() <= _FLAT_M:
        return Relief()
    is_other = points is not own and roads.heights == "absolute" and len(own) > 0
    why = f"ground from {terrain.height_m.min():.1f} m to {terrain.height_m.max():.1f} m"
    return Relief(
        terrain=terrain,
        zero_m=middle_m,
        source=name,
        roads=roads,
        roads_m=fit_terrain(own, half_m=half_m, step_m=_STEP_M) if is_other else None,
        told=(Note(what=f"heights of {name}", why=f"{why} around the junction ({span_m:.1f} m)"),),
    )


def _near(points_m: FloatArray, half_m: float) -> FloatArray:
    near: FloatArray = points_m[(np.abs(points_m[:, :2]) <= half_m + _BEYOND_M).all(axis=1)]
    return near


def _on_level(
    points_m: FloatArray, roads: SourceMap, junction: MapJunction, frame: LocalFrame
) -> FloatArray:
    """Points that are not far above or below the nearest road that leads to the junction."""
    arms = [
        lane.centreline_m
        for lane in roads.lanes
        if junction.id in (lane.from_junction, lane.to_junction)
    ]
    middle = np.append(junction.position_m, junction.height_m)
    level = frame.take(np.concatenate([middle[None], *arms]), roads)
    away_m, nearest = cKDTree(level[:, :2]).query(points_m[:, :2])
    most_m = _SAME_LEVEL_M + _STEEPEST * away_m
    kept: FloatArray = points_m[np.abs(points_m[:, 2] - level[nearest, 2]) <= most_m]
    return kept
