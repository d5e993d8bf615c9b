"""Where VRUs are looked at: points on their bodies, and every distinct pose once.

In sampled worlds other things stand in the street, but VRUs walk as planned, between
the same houses. The points that the scene hides, and those that the body hides itself,
are the same in all of them, for mounts at the same height: :class:`HiddenPoints` caches
them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from numpy.typing import NDArray

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.poses import body_rotation
from geometry.raycast import FloatRays
from geometry.scene import Scene
from geometry.terrain import on_ground, terrain_of
from geometry.weather import Weather, pick_weather
from scenarios.runs import Run

# ---------- points on the outside of bodies
_SAMPLES_PER_POINT = 30
_TURN_M = 0.3  # a normal turned by a radian counts as much as a way of this length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body at one instant of its gait."""

    actor: Actor
    shape_index: int  # which of its shapes
    points_m: FloatArray  # (n, 3): body frame; the shape's extremes are among them. [m]
    # (n, 3): the part of the surface around each point: its area along its mean outward
    # normal. [m^2]
    area_m2: FloatArray
    hull_index: (
        IntArray  # (n_corners,): points at the corners of the convex hull of all
    )
    radius_m: float  # all points lie this near to their mean. [m]


@cache  # tables of variants ask for the same bodies again
def build_surface(
    actor: Actor, shape_index: int, *, n_points: int, seed: int
) -> Surface:
    """Spread points evenly over the outside of a body's shape, a closed mesh.

    The extremes along 26 directions come first, so that boxes around the points are
    boxes around the shape; then, one by one, the random sample farthest from all points
    so far.

    Source: Y. Eldar et al., "The farthest point strategy for progressive image
    sampling", 1997.
    """
    import trimesh
    from scipy.spatial import cKDTree

    shape = actor.shapes[shape_index]
    mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
    samples, faces = trimesh.sample.sample_surface(
        mesh, _SAMPLES_PER_POINT * n_points, seed=seed
    )
    signs = np.array(
        [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    )
    extremes = np.unique(
        np.argmax(shape.vertices_m @ signs[signs.any(axis=1)].T, axis=0)
    )
    corners = extremes[:n_points]
    spread = farthest_samples(
        samples, shape.vertices_m[corners], n_points - len(corners)
    )
    points = np.concatenate([shape.vertices_m[corners], samples[spread]])
    normals = np.concatenate(
        [mesh.vertex_normals[corners], mesh.face_normals[faces[spread]]]
    )
    # A sample belongs to the nearest point that faces the same way: not to one around
    # the corner.
    tree = cKDTree(np.hstack([points, _TURN_M * normals]))
    sample_normals = mesh.face_normals[faces]
    _, nearest = tree.query(np.hstack([samples, _TURN_M * sample_normals]))
    area = np.zeros_like(points)
    np.add.at(area, nearest, sample_normals)
    return Surface(
        actor=actor,
        shape_index=shape_index,
        points_m=freeze(points),
        area_m2=freeze(area * (mesh.area / len(samples))),
        hull_index=freeze(_hull_corners(points)),
        radius_m=float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()),
    )


def farthest_samples(samples: FloatArray, first: FloatArray, n: int) -> IntArray:
    """Indices (n,) of samples (m, 3): one by one the farthest from all points so far.

    The points `first` (k, 3) are there from the beginning.
    """
    distance = np.full(len(samples), np.inf)
    chosen = np.empty(n, dtype=np.int64)
    for step in range(len(first) + n):
        if step < len(first):
            point = first[step]
        else:
            chosen[step - len(first)] = distance.argmax()
            point = samples[chosen[step - len(first)]]
        distance = np.minimum(distance, np.linalg.norm(samples - point, axis=1))
    return chosen


def _hull_corners(points_m: FloatArray) -> IntArray:
    """Points at the corners of the convex hull; all of them if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(points_m).vertices.astype(np.int64)
    except (QhullError, ValueError):  # fewer than four points, or a flat body
        return np.arange(len(points_m))


# ---------- places and views
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bodies:
    """Bodies of VRUs at their places, a row each."""

    # (n, 2): middle of the footprint, relative to the origin. [m]
    position_m: FloatArray
    up_m: FloatArray  # (n,): height of the ground there. [m]
    yaw_deg: FloatArray  # (n,): heading. [deg]
    surface_index: IntArray  # (n,): into `surfaces`
    # (n, 3, n_points): by axis, the body's points, relative to the origin. [m]
    axes_m: FloatRays
    # (n, 3, n_corners): by axis, the points at the corners of the body's convex hull;
    # some stand there twice. [m]
    hull_m: FloatRays
    # middle_m, radius_m: (n, 3), (n,): mean of the points, and how far the farthest is
    # from it. [m]
    middle_m: FloatArray
    radius_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places(_Bodies):
    """Every distinct (body, shape, pose) in which a VRU is looked at, whatever stands around."""

    surfaces: tuple[Surface, ...]  # each distinct shape of a VRU
    place_of_frame: (
        IntArray  # (n_frames,): where the VRU is in each frame of the frame axis
    )


def build_places(
    scene: Scene, runs: Sequence[Run], origin_m: FloatArray, *, n_points: int, seed: int
) -> Places:
    """Find the poses in which the VRUs of runs are looked at, relative to an origin."""
    shapes = {
        (run.encounter.vru, index): None
        for run in runs
        for index in np.unique(run.vru_shape)
    }
    surfaces = tuple(
        build_surface(actor, int(index), n_points=n_points, seed=seed)
        for actor, index in shapes
    )
    numbers = {
        (surface.actor, surface.shape_index): number
        for number, surface in enumerate(surfaces)
    }
    parts = []
    for run in runs:
        shape = [numbers[run.encounter.vru, int(index)] for index in run.vru_shape]
        where = run.vru_position_m - origin_m[:2]
        parts.append(np.column_stack([where, run.vru_yaw_deg, shape]))
    rows = np.concatenate(parts)
    # Rounded to a tenth of a millimetre: the same pose at another speed differs in the
    # last bits.
    _, first, place_of_frame = np.unique(
        rows.round(4), axis=0, return_index=True, return_inverse=True
    )
    unique = rows[first]
    surface_index = unique[:, 3].astype(np.int64)
    body_points = np.stack([surface.points_m for surface in surfaces])[surface_index]
    points = body_points @ np.swapaxes(body_rotation(unique[:, 2]), 1, 2)
    middle = on_ground(unique[:, :2] + origin_m[:2], terrain_of(scene))
    points[..., :2] += unique[:, None, :2]
    points[..., 2] += middle[:, None, 2]
    # As many numbers as machines handle at once divide the number of corners.
    n_corners = -(-max(len(surface.hull_index) for surface in surfaces) // 16) * 16
    corners = np.stack(
        [np.resize(surface.hull_index, n_corners) for surface in surfaces]
    )
    axes = np.ascontiguousarray(np.swapaxes(points, 1, 2), dtype=np.float32)
    return Places(
        surfaces=surfaces,
        position_m=unique[:, :2],
        up_m=middle[:, 2],
        yaw_deg=unique[:, 2],
        surface_index=surface_index,
        axes_m=axes,
        hull_m=np.take_along_axis(axes, corners[surface_index][:, None, :], axis=2),
        middle_m=points.mean(axis=1),
        radius_m=np.array([surface.radius_m for surface in surfaces])[surface_index],
        place_of_frame=place_of_frame.ravel(),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VruViews(_Bodies):
    """Every distinct (place, obstruction) in which a VRU is looked at; see :class:`Places`."""

    # (n_views,) each: place, and what stands around, into the obstructions of `World`
    place_index: IntArray
    obstruction_index: IntArray
    view_of_frame: (
        IntArray  # (n_frames,): which view each frame of the frame axis shows
    )
    weathers: tuple[Weather, ...]  # distinct weathers
    weather_of_frame: IntArray  # (n_frames,): which of them it is

    @property
    def points_m(self) -> FloatRays:
        """The body's points (n_views, n_points, 3), in metres from the origin of `World`."""
        return np.swapaxes(self.axes_m, 1, 2)


def build_views(
    places: Places, runs: Sequence[Run], obstruction_index: IntArray
) -> VruViews:
    """Find out what stands around where: of the runs that the places are of, or the same VRUs'.

    `obstruction_index`, (n_runs,), is into the obstructions of `World`.
    """
    n_frames = [len(run.time_s) for run in runs]
    if sum(n_frames) != len(places.place_of_frame):
        raise ValueError(
            f"runs: {sum(n_frames)} frames; expected {len(places.place_of_frame)}"
        )
    n_obstructions = int(obstruction_index.max()) + 1
    pairs, view_of_frame = np.unique(
        places.place_of_frame * n_obstructions + np.repeat(obstruction_index, n_frames),
        return_inverse=True,
    )
    place, obstruction = np.divmod(pairs, n_obstructions)
    # Mostly nothing but one thing stands around each: then there is nothing to copy.
    is_every = np.array_equal(place, np.arange(len(places.yaw_deg)))
    chosen = slice(None) if is_every else place
    weathers = list(dict.fromkeys(run.weather for run in runs))
    return VruViews(
        place_index=place,
        obstruction_index=obstruction,
        **{
            field.name: getattr(places, field.name)[chosen] for field in fields(_Bodies)
        },
        view_of_frame=view_of_frame.ravel(),
        weathers=tuple(pick_weather(name, "runs: weather") for name in weathers),
        weather_of_frame=np.repeat(
            [weathers.index(run.weather) for run in runs], n_frames
        ),
    )


# ---------- what is hidden in all worlds
_MOST_BYTES = 1 << 29
Find = Callable[[IntArray], BoolArray]


class HiddenPoints:
    """Cache of hidden points of bodies, row by row, for eyes that come up again.

    Rows are places, or frames. Hidden points are found once and cached, as long as
    there is room; the cache changes no result. Several threads may ask.
    """

    def __init__(self, n_rows: int, n_points: int) -> None:
        self._n_rows = n_rows
        self._n_points = n_points
        self._of_eye: dict[object, tuple[BoolArray, NDArray[np.uint8]]] = {}
        self._most_eyes = _MOST_BYTES // max(1, n_rows * (1 + -(-n_points // 8)))

    def look(
        self,
        eye: object,
        rows: IntArray,
        find: Find,
        *,
        foreseen: IntArray | None = None,
    ) -> BoolArray:
        """Hidden points of rows (n,), distinct, seen from an eye by its name, (n, n_points).

        `find` finds them. Where it has to, it is asked for the rows that are
        `foreseen`, too.
        """
        if eye not in self._of_eye:
            if len(self._of_eye) >= self._most_eyes:
                return find(rows)
            bits = np.zeros((self._n_rows, -(-self._n_points // 8)), dtype=np.uint8)
            self._of_eye.setdefault(eye, (np.zeros(self._n_rows, dtype=bool), bits))
        is_known, bits = self._of_eye[eye]
        if not is_known[rows].all():
            is_asked = np.zeros(self._n_rows, dtype=bool)
            is_asked[rows] = True
            if foreseen is not None:
                is_asked[foreseen] = True
            asked = np.flatnonzero(is_asked & ~is_known)
            bits[asked] = np.packbits(find(asked), axis=1)
            is_known[asked] = True  # last: another thread may ask
        return np.unpackbits(bits[rows], axis=1, count=self._n_points).view(bool)


def look(
    cache: HiddenPoints | None,
    eye: object,
    rows: IntArray,
    find: Find,
    *,
    foreseen: IntArray | None = None,
) -> BoolArray:
    """Hidden points of rows: found, or those of a cache; see :meth:`HiddenPoints.look`."""
    if cache is None:
        return find(rows)
    return cache.look(eye, rows, find, foreseen=foreseen)
