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
# What is farther from a point than this is not between it and the end of its ray.
_NEAR_POINT_M = 2.0e-3
# Rays end at least so far before their points.
_LEAST_CUT_M = 0.6e-3
# Rounding in single precision turns no ray by so much.
_SURE_SINE = 0.05
# A normal turned by a radian counts as much as a way of this length.
_TURN_M = 0.3
# Places whose points are turned and moved at once.
_PLACES_TOGETHER = 128


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body at one instant of its gait.

    Attributes
    ----------
    actor : Actor
        The body.
    shape_index : int
        Which of its shapes.
    points_m : (n, 3) float
        Body frame; the extremes of the shape are among them. [m]
    area_m2 : (n, 3) float
        Part of the surface around each point: its area along its mean outward
        normal. [m^2]
    outward : (n, 3) float
        Normal of the face around each point.
    least_sine : (n,) float
        Seen from so far behind its face, the body hides the point: sine of the angle
        between face and line of sight. Above 1 where no angle will do.
    hull_index : (n_corners,) int
        Points at the corners of the convex hull of all points.
    radius_m : float
        Distance from their mean within which all points lie. [m]
    """

    actor: Actor
    shape_index: int
    points_m: FloatArray
    area_m2: FloatArray
    outward: FloatArray
    least_sine: FloatArray
    hull_index: IntArray
    radius_m: float


# Cached, since tables of variants ask for the same bodies.
@cache
def build_surface(
    actor: Actor, shape_index: int, *, n_points: int, seed: int
) -> Surface:
    """Spread points evenly over the outside of a body's shape.

    The extremes along 26 directions come first, so that boxes around the points are
    boxes around the shape; then, one by one, the random sample farthest from all
    points so far.

    Parameters
    ----------
    actor : Actor
        The body.
    shape_index : int
        Which of its shapes, a closed mesh.
    n_points : int
        How many points.
    seed : int
        Of the random samples.

    References
    ----------
    Y. Eldar et al., "The farthest point strategy for progressive image sampling",
    1997.
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
    directions = signs[signs.any(axis=1)]
    extremes = np.unique(np.argmax(shape.vertices_m @ directions.T, axis=0))
    corners = extremes[:n_points]
    corners_m = shape.vertices_m[corners]
    spread = farthest_samples(samples, corners_m, n_points - len(corners))
    points = np.concatenate([corners_m, samples[spread]])
    spread_normals = mesh.face_normals[faces[spread]]
    normals = np.concatenate([mesh.vertex_normals[corners], spread_normals])
    # A sample belongs to the nearest point that faces the same way: not to one around
    # the corner.
    tree = cKDTree(np.hstack([points, _TURN_M * normals]))
    sample_normals = mesh.face_normals[faces]
    _, nearest = tree.query(np.hstack([samples, _TURN_M * sample_normals]))
    area = np.zeros_like(points)
    np.add.at(area, nearest, sample_normals)
    least_sine = np.full(len(points), np.inf)
    least_sine[len(corners) :] = _least_sines(
        mesh.triangles, mesh.face_normals, samples[spread], faces[spread]
    )
    return Surface(
        actor=actor,
        shape_index=shape_index,
        points_m=freeze(points),
        area_m2=freeze(area * (mesh.area / len(samples))),
        outward=freeze(normals),
        least_sine=freeze(least_sine),
        hull_index=freeze(_hull_corners(points)),
        radius_m=float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()),
    )


def farthest_samples(samples: FloatArray, first: FloatArray, n: int) -> IntArray:
    """Choose samples, one by one the farthest from all points so far.

    Parameters
    ----------
    samples : (m, 3) float
        Points to choose from.
    first : (k, 3) float
        Points that are there from the beginning.
    n : int
        How many to choose.

    Returns
    -------
    chosen : (n,) int
        Indices of samples, in the order in which they are chosen.
    """
    # Coordinate by coordinate: numpy is slow along axes of length three.
    x, y, z = np.ascontiguousarray(samples.T)
    distance = np.full(len(samples), np.inf)
    chosen = np.empty(n, dtype=np.int64)
    for step in range(len(first) + n):
        if step < len(first):
            point = first[step]
        else:
            chosen[step - len(first)] = distance.argmax()
            point = samples[chosen[step - len(first)]]
        squared = (x - point[0]) ** 2 + (y - point[1]) ** 2 + (z - point[2]) ** 2
        distance = np.minimum(distance, np.sqrt(squared))
    return chosen


def _least_sines(
    triangles_m: FloatArray, normals: FloatArray, points_m: FloatArray, own: IntArray
) -> FloatArray:
    """From how far behind its face a point of a body is hidden for sure.

    Parameters
    ----------
    triangles_m : (m, 3, 3) float
        Corners of the closed body. [m]
    normals : (m, 3) float
        Their outward normals.
    points_m : (n, 3) float
        Points on it. [m]
    own : (n,) int
        Triangle of each point.

    Returns
    -------
    least : (n,) float
        Sine of the angle between face and line of sight; above 1: none will do.

    Notes
    -----
    A ray ends just before its point. If all triangles as near as `_NEAR_POINT_M` are
    seen from behind there, that is inside of the body. A triangle whose normal differs
    by an angle from the point's own is, if the point's face is by more than this.
    """
    from trimesh.triangles import closest_point

    # Only triangles whose surrounding sphere is as near can be.
    middle_m = triangles_m.mean(axis=1)
    reach_m = np.linalg.norm(triangles_m - middle_m[:, None], axis=2).max(axis=1)
    lengths = (points_m**2).sum(axis=1)[:, None] + (middle_m**2).sum(axis=1)
    squares = lengths - 2.0 * points_m @ middle_m.T
    point, near = np.nonzero(squares <= (reach_m + _NEAR_POINT_M) ** 2)
    closest_m = closest_point(triangles_m[near], points_m[point])
    away_m = np.linalg.norm(closest_m - points_m[point], axis=1)
    is_near = away_m <= _NEAR_POINT_M
    point = point[is_near]
    near = near[is_near]
    # How far each point is before the plane of each triangle near it.
    before_m = ((points_m[point] - triangles_m[near, 0]) * normals[near]).sum(axis=1)
    along = (normals[own[point]] * normals[near]).sum(axis=1)
    excess = _SURE_SINE + np.maximum(before_m, 0.0) / _LEAST_CUT_M
    angle = np.arccos(np.clip(along, -1.0, 1.0)) + np.arcsin(np.minimum(excess, 1.0))
    sine = np.where(angle < 0.5 * np.pi, np.sin(angle), np.inf)
    least = np.full(len(points_m), _SURE_SINE)
    np.maximum.at(least, point, sine)
    return least


def _hull_corners(points_m: FloatArray) -> IntArray:
    """Indices of the points at the corners of the convex hull.

    All points if they are fewer than four or lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(points_m).vertices.astype(np.int64)
    except (QhullError, ValueError):
        # Fewer than four points, or a flat body.
        return np.arange(len(points_m))


# ---------- places and views
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bodies:
    """Bodies of VRUs at their places, a row each.

    Attributes
    ----------
    position_m : (n, 2) float
        Middle of the footprint, relative to the origin. [m]
    up_m : (n,) float
        Height of the ground there. [m]
    yaw_deg : (n,) float
        Heading. [deg]
    surface_index : (n,) int
        Into the surfaces of :class:`Places`.
    axes_m : (n, 3, n_points) float32
        Points of the body by axis, relative to the origin. [m]
    hull_m : (n, 3, n_corners) float32
        Points at the corners of the body's convex hull, by axis; some stand there
        twice. [m]
    middle_m : (n, 3) float
        Mean of the points. [m]
    radius_m : (n,) float
        Distance of the farthest point from it. [m]
    """

    position_m: FloatArray
    up_m: FloatArray
    yaw_deg: FloatArray
    surface_index: IntArray
    axes_m: FloatRays
    hull_m: FloatRays
    middle_m: FloatArray
    radius_m: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places(_Bodies):
    """Distinct (body, shape, pose) in which VRUs are looked at.

    Whatever stands around them. A row of the inherited attributes is a place.

    Attributes
    ----------
    surfaces : tuple of Surface
        Distinct shapes of the VRUs.
    place_of_frame : (n_frames,) int
        Where the VRU is in each frame of the frame axis.
    """

    surfaces: tuple[Surface, ...]
    place_of_frame: IntArray


def build_places(
    scene: Scene, runs: Sequence[Run], origin_m: FloatArray, *, n_points: int, seed: int
) -> Places:
    """Find the poses in which the VRUs of runs are looked at.

    Parameters
    ----------
    scene : Scene
        Its terrain says how high the VRUs stand.
    runs : sequence of Run
        How VRUs walk.
    origin_m : (3,) float
        Subtracted from all coordinates. [m]
    n_points, seed : int
        As in :func:`build_surface`.
    """
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
    yaw_deg = unique[:, 2]
    middle = on_ground(unique[:, :2] + origin_m[:2], terrain_of(scene))
    # As many numbers as machines handle at once divide the number of corners.
    n_corners = -(-max(len(surface.hull_index) for surface in surfaces) // 16) * 16
    corners = np.stack(
        [np.resize(surface.hull_index, n_corners) for surface in surfaces]
    )
    body_points = np.stack([surface.points_m for surface in surfaces])
    axes = np.empty((len(unique), 3, body_points.shape[1]), dtype=np.float32)
    hull = np.empty((len(unique), 3, n_corners), dtype=np.float32)
    middle_of_points = np.empty((len(unique), 3))
    # A block at a time: fresh memory for all points takes longer than their numbers.
    for begin in range(0, len(unique), _PLACES_TOGETHER):
        block = slice(begin, begin + _PLACES_TOGETHER)
        bodies = surface_index[block]
        rotation = body_rotation(yaw_deg[block])
        points = body_points[bodies] @ np.swapaxes(rotation, 1, 2)
        points[..., :2] += unique[block, None, :2]
        points[..., 2] += middle[block, None, 2]
        middle_of_points[block] = points.mean(axis=1)
        axes[block] = np.swapaxes(points, 1, 2)
        hull[block] = np.take_along_axis(axes[block], corners[bodies][:, None], axis=2)
    return Places(
        surfaces=surfaces,
        position_m=unique[:, :2],
        up_m=middle[:, 2],
        yaw_deg=yaw_deg,
        surface_index=surface_index,
        axes_m=axes,
        hull_m=hull,
        middle_m=middle_of_points,
        radius_m=np.array([surface.radius_m for surface in surfaces])[surface_index],
        place_of_frame=place_of_frame.ravel(),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VruViews(_Bodies):
    """Distinct (place, obstruction) in which VRUs are looked at.

    A row of the inherited attributes is a view; see :class:`Places`.

    Attributes
    ----------
    place_index : (n_views,) int
        Place of each view.
    obstruction_index : (n_views,) int
        What stands around, into the obstructions of `World`.
    view_of_frame : (n_frames,) int
        View that each frame of the frame axis shows.
    weathers : tuple of Weather
        Distinct weathers.
    weather_of_frame : (n_frames,) int
        Weather of each frame.
    """

    place_index: IntArray
    obstruction_index: IntArray
    view_of_frame: IntArray
    weathers: tuple[Weather, ...]
    weather_of_frame: IntArray

    @property
    def points_m(self) -> FloatRays:
        """Points of the bodies, (n_views, n_points, 3), in metres.

        Relative to the origin of `World`.
        """
        return np.swapaxes(self.axes_m, 1, 2)


def build_views(
    places: Places, runs: Sequence[Run], obstruction_index: IntArray
) -> VruViews:
    """Find out which obstruction stands around each place.

    Parameters
    ----------
    places : Places
        Where VRUs are looked at.
    runs : sequence of Run
        The runs that the places are of, or others with the same VRUs.
    obstruction_index : (n_runs,) int
        Into the obstructions of `World`.

    Raises
    ------
    ValueError
        The runs have another number of frames than the places.
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
    chosen: slice | IntArray = place
    if is_every:
        chosen = slice(None)
    names = [field.name for field in fields(_Bodies)]
    bodies = {name: getattr(places, name)[chosen] for name in names}
    weathers = list(dict.fromkeys(run.weather for run in runs))
    weather_of_run = [weathers.index(run.weather) for run in runs]
    return VruViews(
        place_index=place,
        obstruction_index=obstruction,
        **bodies,
        view_of_frame=view_of_frame.ravel(),
        weathers=tuple(pick_weather(name, "runs: weather") for name in weathers),
        weather_of_frame=np.repeat(weather_of_run, n_frames),
    )


# ---------- what is hidden in all worlds
_MOST_BYTES = 1 << 29
Find = Callable[[IntArray], BoolArray]


class HiddenPoints:
    """Cache of hidden points of bodies, for eyes that come up again.

    Hidden points of a row are found once and cached, as long as there is room. The
    cache changes no result. Several threads may use it.

    Parameters
    ----------
    n_rows : int
        Number of places, or of frames.
    n_points : int
        Points of each body.
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
        """Hidden points of rows, seen from an eye.

        Parameters
        ----------
        eye : hashable
            Names the eye.
        rows : (n,) int
            Distinct rows.
        find : callable
            Finds the hidden points, (k, n_points), of rows (k,).
        foreseen : (m,) int, optional
            Where `find` has to be called, it is asked for these rows, too.

        Returns
        -------
        hidden : (n, n_points) bool
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
            # Set last, since another thread may ask.
            is_known[asked] = True
        return np.unpackbits(bits[rows], axis=1, count=self._n_points).view(bool)


def look(
    cache: HiddenPoints | None,
    eye: object,
    rows: IntArray,
    find: Find,
    *,
    foreseen: IntArray | None = None,
) -> BoolArray:
    """Hidden points of rows, from a cache if there is one.

    Parameters and result as in :meth:`HiddenPoints.look`.
    """
    if cache is None:
        return find(rows)
    return cache.look(eye, rows, find, foreseen=foreseen)
