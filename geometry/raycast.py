"""Rays against triangles, by one of two libraries.

They are trimesh's embreex and Open3D's RaycastingScene; both are Embree.

embreex leaves Python's lock to others while it casts, loads in milliseconds, and needs
no library of the system: it is taken where it loads. Open3D is imported only when it is
asked for, or needed.
"""

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import BoolArray, FloatArray, IntArray
from .errors import InputError, check_one_of, refuse

FloatRays = NDArray[np.float32]
# Libraries that Open3D's wheels expect from the system, and Debian's packages that hold
# them.
_DEBIAN_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
}


class RayCaster(Protocol):
    """Rays against one fixed set of triangles; safe to use from several threads."""

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """True if a triangle lies between origin and origin + vector.

        Arrays are (n, 3); the result is (n,).
        """

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """Distance to the first triangle as a share of the vector, and its row.

        Vectors (n, 3) may have any length; both results are (n,).

        Infinite and -1 where nothing is hit.
        """


class Open3dCaster:
    """Rays by Open3D's RaycastingScene, on all processors.

    It holds Python's lock while it casts.
    """

    name = "open3d"
    # All processors.
    n_threads = 0

    def __init__(self, vertices_m: ArrayLike, triangles: ArrayLike) -> None:
        o3d, _ = _open3d_or_reason()
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene()
        vertices, faces = _checked(vertices_m, triangles)
        if len(faces):
            self._scene.add_triangles(
                self._tensor(vertices), self._tensor(faces.astype(np.uint32))
            )
        # Embree must not be asked about a scene without triangles.
        self._is_empty = len(faces) == 0

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """See :class:`RayCaster`."""
        if self._is_empty or len(origins_m) == 0:
            return np.zeros(len(origins_m), dtype=bool)
        rays = self._tensor.from_numpy(_rays(origins_m, vectors_m))
        hits = self._scene.test_occlusions(
            rays, tnear=0.0, tfar=1.0, nthreads=self.n_threads
        )
        return np.asarray(hits.numpy())

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """See :class:`RayCaster`."""
        if self._is_empty or len(origins_m) == 0:
            return _no_triangle(len(origins_m))
        rays = self._tensor.from_numpy(_rays(origins_m, vectors_m))
        hits = self._scene.cast_rays(rays, nthreads=self.n_threads)
        share: FloatRays = hits["t_hit"].numpy()
        index: IntArray = hits["primitive_ids"].numpy().astype(np.int64)
        # Embree's own sign for nothing is the largest uint32.
        index[np.isinf(share)] = -1
        return share, index


class EmbreexCaster:
    """Rays by embreex, the Embree binding that trimesh uses."""

    name = "embree"
    # Where rays end.
    _FAR = np.float32(1.0e6)

    def __init__(self, vertices_m: ArrayLike, triangles: ArrayLike) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        vertices, faces = _checked(vertices_m, triangles)
        self._scene = EmbreeScene()
        self._is_empty = len(faces) == 0
        if not self._is_empty:
            self._mesh = TriangleMesh(self._scene, vertices, faces)
            # The first query commits the scene, which must not happen in two threads at
            # once.
            self.is_blocked(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """See :class:`RayCaster`."""
        if self._is_empty or len(origins_m) == 0:
            return np.zeros(len(origins_m), dtype=bool)
        hits = self._scene.run(
            *_contiguous(origins_m, vectors_m), dists=1.0, query="OCCLUDED"
        )
        return np.asarray(hits != -1)

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """See :class:`RayCaster`."""
        if self._is_empty or len(origins_m) == 0:
            return _no_triangle(len(origins_m))
        ends = np.full(len(origins_m), self._FAR, dtype=np.float32)
        hits = self._scene.run(*_contiguous(origins_m, vectors_m), dists=ends, output=1)
        share: FloatRays = hits["tfar"]
        index: IntArray = hits["primID"].astype(np.int64)
        share[index < 0] = np.inf
        return share, index


CASTERS: dict[str, type[Open3dCaster] | type[EmbreexCaster]] = {
    EmbreexCaster.name: EmbreexCaster,
    Open3dCaster.name: Open3dCaster,
}
RAYS = ("auto", EmbreexCaster.name, Open3dCaster.name)
"""Names that a user may ask for; "auto" is the fastest library that loads."""


def caster_name(rays: str = "auto", *, where: str = "rays") -> str:
    """Name of the library that casts rays.

    Parameters
    ----------
    rays : str
        One of ``RAYS``. By "auto" it is "embree", or "open3d" where embreex cannot
        load.
    where : str
        What asked for it, for error messages.

    Raises
    ------
    InputError
        The name is unknown, or the library cannot load; the message says why.
    """
    check_one_of(where, rays, RAYS)
    problems: dict[str, Callable[[], str | None]] = {
        EmbreexCaster.name: embreex_problem,
        Open3dCaster.name: open3d_problem,
    }
    reasons = []
    # By "auto" the first library that loads is taken.
    for name in (rays,) if rays in CASTERS else tuple(problems):
        reason = problems[name]()
        if reason is None:
            return name
        reasons.append(reason)
    raise InputError(where, rays, "a library that loads: " + "; ".join(reasons))


@cache
def embreex_problem() -> str | None:
    """Why embreex cannot be used, in one line with the remedy; None where it can."""
    try:
        import embreex.rtcore_scene  # noqa: F401
    except (ImportError, OSError) as error:
        cause = " ".join(str(error).split())
        return f"embreex cannot load ({cause}); to use it: pip install embreex"
    return None


def open3d_problem() -> str | None:
    """Why Open3D cannot be used, in one line with the remedy.

    None where it can. The call imports Open3D.
    """
    return _open3d_or_reason()[1]


def build_caster(
    vertices_m: ArrayLike, triangles: ArrayLike, *, library: str | None = None
) -> RayCaster:
    """Prepare triangles for rays, which may be cast from any thread.

    Parameters
    ----------
    vertices_m : (n, 3) float
        World or body frame, near the origin: rays are cast in single precision. [m]
    triangles : (m, 3) int
        Vertex indices; none at all is allowed.
    library : str, optional
        One of ``RAYS``; by default "auto".

    Raises
    ------
    InputError
        A vertex is not finite, a triangle points outside the vertices, or the library
        cannot load.
    """
    return CASTERS[caster_name(library or "auto", where="library")](
        vertices_m, triangles
    )


def ray_lengths_m(vectors_m: FloatRays) -> FloatRays:
    """Lengths of vectors, (n, 3) -> (n,).

    Column by column it is four times as fast as row by row.
    """
    x, y, z = vectors_m.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _checked(
    vertices_m: ArrayLike, triangles: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Vertices and triangles as Embree takes them, or InputError."""
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32).reshape(-1, 3)
    faces = np.ascontiguousarray(triangles, dtype=np.int32).reshape(-1, 3)
    if not np.isfinite(vertices).all():
        refuse("vertices_m", "a vertex that is not finite", "finite coordinates")
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        outside = int(faces[(faces < 0) | (faces >= len(vertices))][0])
        raise InputError(
            "triangles", outside, f"vertex indices from 0 to {len(vertices) - 1}"
        )
    return vertices, faces


def _no_triangle(n_rays: int) -> tuple[FloatRays, IntArray]:
    """What :meth:`RayCaster.first_triangle` returns where nothing is hit."""
    return np.full(n_rays, np.inf, dtype=np.float32), np.full(
        n_rays, -1, dtype=np.int64
    )


def _rays(origins_m: FloatRays, vectors_m: FloatRays) -> FloatRays:
    """Rays as Open3D takes them: origin and vector in one row, (n, 6)."""
    rays = np.empty((len(origins_m), 6), dtype=np.float32)
    rays[:, :3] = origins_m
    rays[:, 3:] = vectors_m
    return rays


def _contiguous(
    origins_m: FloatRays, vectors_m: FloatRays
) -> tuple[FloatRays, FloatRays]:
    """Origins and vectors as embreex takes them."""
    origins, vectors = (
        np.ascontiguousarray(one, np.float32) for one in (origins_m, vectors_m)
    )
    return origins, vectors


@cache
def _open3d_or_reason() -> tuple[Any, str | None]:
    """The module open3d and None, or None and why it cannot load."""
    try:
        with warnings.catch_warnings():
            # Those of Open3D's own imports.
            warnings.simplefilter("ignore")
            import open3d
    except (ImportError, OSError) as error:
        library = str(error).split(":")[0]
        package = _DEBIAN_PACKAGES.get(library)
        if package:
            cause = f"{library} is missing"
        else:
            cause = " ".join(str(error).split())
        if package:
            remedy = f"apt-get install {package}"
        else:
            remedy = "pip install open3d-cpu, or open3d"
        return None, f"Open3D cannot load ({cause}); to use it: {remedy}"
    return open3d, None


# Rays end a little before the point.
_SHORT_OF_M = 0.05


def is_in_sight(
    caster: RayCaster, mount_m: ArrayLike, points_m: FloatArray, *, near_m: float
) -> BoolArray:
    """True for points (n, 3) that nothing hides from a mount.

    It is False for points that are nearer than `near_m`. The caster has the frame
    of the points. Things nearer than `near_m`, such as the sensor's pole, hide
    nothing.
    """
    mount = np.asarray(mount_m, dtype=np.float64)
    # Rays begin beyond `near_m` and end a little before the points.
    ways = points_m - mount
    lengths = np.linalg.norm(ways, axis=1)
    is_far = lengths > near_m + _SHORT_OF_M
    directions = ways / np.maximum(lengths, 1.0e-9)[:, None]
    starts = mount + near_m * directions
    vectors = directions * np.maximum(lengths - near_m - _SHORT_OF_M, 0.0)[:, None]
    is_hidden = caster.is_blocked(starts.astype(np.float32), vectors.astype(np.float32))
    return np.asarray(is_far & ~is_hidden)
