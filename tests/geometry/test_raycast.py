"""Rays against triangles, by both libraries."""

import builtins
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles import slab_hits
from refusals import refused_with

from geometry import raycast
from geometry.errors import InputError
from geometry.raycast import build_caster, caster_name, open3d_problem

BOX_M = np.array([2.0, 3.0, 4.0])
BOX = trimesh.creation.box(extents=2.0 * BOX_M)


@pytest.fixture(scope="module")
def open3d():
    """Skips where Open3D cannot load; to collect tests, which loads it not, is
    quick.
    """
    if (problem := open3d_problem()) is not None:
        pytest.skip(problem)


@pytest.fixture(
    scope="module", params=[pytest.param("open3d", marks=pytest.mark.system), "embree"]
)
def library(request):
    """Name of a library that casts rays."""
    if request.param == "open3d":
        request.getfixturevalue("open3d")
    return request.param


SEEDS = st.integers(0, 2**32 - 1)


WALL = np.array(
    [
        [0.0, -5.0, -5.0],
        [0.0, 5.0, -5.0],
        [0.0, 5.0, 5.0],
        [0.0, -5.0, 5.0],
    ]
)
WALL_TRIANGLES = np.array(
    [
        [0, 1, 2],
        [0, 2, 3],
    ]
)


def wall(x_m):
    """Corners of a wall across the x axis, and its triangles."""
    return WALL + [x_m, 0.0, 0.0], WALL_TRIANGLES


def random_rays(rng, n, reach_m):
    """Origins and vectors of rays between random points."""
    origins = rng.uniform(-reach_m, reach_m, (n, 3)).astype(np.float32)
    vectors = rng.uniform(-reach_m, reach_m, (n, 3)) - origins
    return origins, vectors.astype(np.float32)


def random_triangles(rng, *, n=60, n_vertices=90):
    """Triangles anywhere within 50 m; of some, two corners may be the same."""
    vertices = rng.uniform(-50.0, 50.0, (n_vertices, 3))
    return vertices, rng.integers(0, n_vertices, (n, 3))


def normals_of(corners):
    """Vectors (n, 3) across triangles (n, 3, 3)."""
    first, second, third = np.swapaxes(corners, 0, 1)
    return np.cross(second - first, third - first)


def products(a, b):
    """Scalar product of each row of two arrays."""
    return (a * b).sum(axis=1)


@given(seed=SEEDS)
def test_rays_against_a_box_are_those_of_the_slab_formula(library, seed):
    origins, vectors = random_rays(np.random.default_rng(seed), 500, 8.0)
    caster = build_caster(BOX.vertices, BOX.faces, library=library)
    rays = (origins.astype(float), vectors.astype(float))
    entry, leave = slab_hits(*rays, -BOX_M, BOX_M)
    margin = 1e-3  # rays along an edge or from the surface may go either way
    is_inside = (entry < -margin) & (leave > margin)
    is_hit = (entry > margin) & (leave > entry + margin)
    is_missed = (entry > leave + margin) | (leave < -margin)

    assert (is_inside | is_hit | is_missed).mean() > 0.9

    share, _ = caster.first_triangle(origins, vectors)
    assert share[is_hit] == pytest.approx(entry[is_hit], rel=1e-4, abs=1e-5)
    assert share[is_inside] == pytest.approx(leave[is_inside], rel=1e-4, abs=1e-5)
    assert np.isposinf(share[is_missed]).all()

    first = np.where(is_inside, leave, entry)
    is_clear = (is_inside | is_hit) & (np.abs(first - 1.0) > margin)
    blocked = caster.is_blocked(origins, vectors)

    assert np.array_equal(blocked[is_clear], first[is_clear] < 1.0)
    assert not blocked[is_missed].any()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_segment_ends_where_it_ends(library, side):
    """From both sides: walls have no back."""
    caster = build_caster(*wall(10.0), library=library)
    place = np.array([10.0 - 10.0 * side, 0.3, 0.2], dtype=np.float32)
    origins = np.tile(place, (3, 1))
    # Just before, just after, away from it.
    ways = side * np.array(
        [
            [9.999, 0.0, 0.0],
            [10.001, 0.0, 0.0],
            [-9.0, 0.0, 0.0],
        ]
    )
    blocked = caster.is_blocked(origins, ways.astype(np.float32))

    assert blocked.tolist() == [False, True, False]


def test_the_nearest_of_several_triangles_is_hit_at_its_share_of_the_vector(library):
    """Short, long, backwards, and from between two walls."""
    vertices = []
    faces = []
    for number, x_m in enumerate((9.0, 3.0, 6.0)):
        corners, triangles = wall(x_m)
        vertices.append(corners)
        faces.append(triangles + 4 * number)

    walls = (np.concatenate(vertices), np.concatenate(faces))
    caster = build_caster(*walls, library=library)
    origins = np.array(
        [
            [0.0, 0.1, 0.2],
            [0.0, 0.1, 0.2],
            [0.0, 0.1, 0.2],
            [4.0, 0.1, 0.2],
        ]
    )
    vectors = np.array(
        [
            [1.0, 0.0, 0.0],
            [12.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.5, 0.0, 0.0],
        ]
    )
    rays = (origins.astype(np.float32), vectors.astype(np.float32))
    share, _ = caster.first_triangle(*rays)

    assert share == pytest.approx([3.0, 0.25, np.inf, 4.0], rel=1e-6)


@pytest.mark.system
@pytest.mark.usefixtures("open3d")
@given(seed=SEEDS)
def test_open3d_and_embreex_agree_on_any_triangles_and_rays(seed):
    rng = np.random.default_rng(seed)
    vertices, triangles = random_triangles(rng)
    origins, vectors = random_rays(rng, 4000, 60.0)
    ours = build_caster(vertices, triangles, library="embree")
    theirs = build_caster(vertices, triangles, library="open3d")
    blocked = ours.is_blocked(origins, vectors)
    also = theirs.is_blocked(origins, vectors)

    assert np.array_equal(blocked, also)

    one_share, one = ours.first_triangle(origins, vectors)
    other_share, other = theirs.first_triangle(origins, vectors)

    assert_allclose(one_share, other_share, rtol=1e-5)
    assert (one >= 0).any()

    # Where two triangles cross or share an edge, either may come first: both are met
    # there.
    where = np.flatnonzero(one != other)
    for named in (one[where], other[where]):
        corners = vertices[triangles[named]]
        normals = normals_of(corners)
        ahead = products(corners[:, 0] - origins[where], normals)
        speed = products(vectors[where], normals)
        assert_allclose(
            ahead,
            one_share[where] * speed,
            rtol=1e-3,
            atol=1e-1,
        )


@given(seed=SEEDS)
def test_the_first_triangle_is_at_the_first_hit_and_in_the_named_plane(library, seed):
    rng = np.random.default_rng(seed)
    vertices, drawn = random_triangles(rng, n=90)
    # A triangle of which two corners are the same has no plane.
    has_plane = np.diff(np.sort(drawn), axis=1).all(axis=1)
    triangles = drawn[has_plane]
    caster = build_caster(vertices, triangles, library=library)
    origins, vectors = random_rays(rng, 2000, 60.0)
    share, index = caster.first_triangle(origins, vectors)

    assert share.dtype == np.float32
    assert index.dtype == np.int64

    is_hit = np.isfinite(share)
    assert is_hit.any()
    assert np.array_equal(is_hit, index >= 0)
    assert (index[~is_hit] == -1).all()

    corners = vertices[triangles[index[is_hit]]]
    normals = normals_of(corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hits = origins[is_hit] + share[is_hit, None] * vectors[is_hit]
    off_m = products(hits - corners[:, 0], normals)

    assert off_m == pytest.approx(0.0, abs=2e-3)


@given(seed=SEEDS)
def test_blocked_means_that_the_first_hit_comes_before_the_end(library, seed):
    """Both questions have kernels of their own."""
    rng = np.random.default_rng(seed)
    vertices, triangles = random_triangles(rng)
    caster = build_caster(vertices, triangles, library=library)
    origins, vectors = random_rays(rng, 2000, 60.0)
    share, _ = caster.first_triangle(origins, vectors)
    blocked = caster.is_blocked(origins, vectors)
    is_clear = np.abs(share - 1.0) > 1e-5

    assert np.array_equal(blocked[is_clear], (share <= 1.0)[is_clear])


def test_nothing_is_hit_where_nothing_is(library):
    no_triangles = np.zeros((0, 3), dtype=int)
    caster = build_caster(np.zeros((0, 3)), no_triangles, library=library)
    origins, vectors = random_rays(np.random.default_rng(0), 10, 5.0)
    share, index = caster.first_triangle(origins, vectors)

    assert not caster.is_blocked(origins, vectors).any()
    assert np.isposinf(share).all()
    assert (index == -1).all()


def test_no_rays_give_no_answers(library):
    none = np.zeros((0, 3), dtype=np.float32)
    caster = build_caster(*wall(10.0), library=library)

    share, index = caster.first_triangle(none, none)

    assert caster.is_blocked(none, none).shape == (0,)
    assert share.shape == (0,)
    assert index.shape == (0,)


def test_answers_have_the_declared_types_and_rays_may_be_strided(library):
    caster = build_caster(*wall(10.0), library=library)
    rays = np.zeros((4, 6), dtype=np.float32)
    rays[:, 3] = [20.0, 5.0, 20.0, 5.0]
    blocked = caster.is_blocked(rays[:, :3], rays[:, 3:])

    assert blocked.dtype == np.bool_
    assert blocked.tolist() == [True, False, True, False]

    share, _ = caster.first_triangle(rays[:, :3], rays[:, 3:])
    assert share.dtype == np.float32
    assert share == pytest.approx([0.5, 2.0, 0.5, 2.0])


def test_two_threads_get_the_answers_of_one(library):
    rng = np.random.default_rng(7)
    vertices, triangles = random_triangles(rng, n=200, n_vertices=300)
    batches = [random_rays(rng, 20_000, 60.0) for _ in range(8)]
    alone = build_caster(vertices, triangles, library=library)
    shared = build_caster(vertices, triangles, library=library)

    with ThreadPoolExecutor(2) as pool:
        blocked = list(pool.map(lambda rays: shared.is_blocked(*rays), batches))
        first = list(pool.map(lambda rays: shared.first_triangle(*rays), batches))

    for rays, two_blocked, (two_share, _) in zip(batches, blocked, first, strict=True):
        share, _ = alone.first_triangle(*rays)
        assert np.array_equal(alone.is_blocked(*rays), two_blocked)
        assert np.array_equal(share, two_share)


def test_a_vertex_that_is_not_finite_is_refused(library):
    vertices = np.eye(3)
    vertices[1, 1] = np.nan
    with refused_with(
        "vertices_m: got a vertex that is not finite; expected finite coordinates"
    ):
        build_caster(vertices, [[0, 1, 2]], library=library)


@pytest.mark.parametrize(
    ("triangle", "index"),
    [
        ([0, 1, 3], 3),
        ([0, -1, 2], -1),
    ],
)
def test_a_triangle_outside_the_vertices_is_refused(library, triangle, index):
    with refused_with(f"triangles: got {index}; expected vertex indices from 0 to 2"):
        build_caster(np.eye(3), [triangle], library=library)


@pytest.fixture
def break_open3d(monkeypatch):
    """Let ``import open3d`` fail with a given error, and forget that afterwards."""
    real_import = builtins.__import__

    def apply(error):
        def fail(name, *arguments, **options):
            if name == "open3d":
                raise error
            return real_import(name, *arguments, **options)

        raycast._open3d_or_reason.cache_clear()
        monkeypatch.setattr(builtins, "__import__", fail)

    yield apply
    monkeypatch.undo()
    raycast._open3d_or_reason.cache_clear()


INSTALL = "pip install open3d-cpu, or open3d"


def missing(library):
    """What the loader tells of a library."""
    return OSError(
        f"{library}: cannot open shared object file: No such file or directory"
    )


@pytest.mark.parametrize(
    ("error", "cause", "remedy"),
    [
        (
            missing("libusb-1.0.so.0"),
            "libusb-1.0.so.0 is missing",
            "apt-get install libusb-1.0-0",
        ),
        (missing("libGL.so.1"), "libGL.so.1 is missing", "apt-get install libgl1"),
        (missing("libEGL.so.1"), "libEGL.so.1 is missing", "apt-get install libegl1"),
        (missing("libX11.so.6"), "libX11.so.6 is missing", "apt-get install libx11-6"),
        (
            ModuleNotFoundError("No module named 'open3d'"),
            "No module named 'open3d'",
            INSTALL,
        ),
        (
            ImportError("DLL load failed:\n  not a valid application"),
            "DLL load failed: not a valid application",
            INSTALL,
        ),
    ],
)
def test_why_open3d_cannot_load_is_told_with_the_remedy(
    break_open3d, error, cause, remedy
):
    break_open3d(error)
    reason = f"Open3D cannot load ({cause}); to use it: {remedy}"

    assert open3d_problem() == reason
    assert caster_name() == "embree"

    with refused_with(f"--rays: got 'open3d'; expected a library that loads: {reason}"):
        caster_name("open3d", where="--rays")

    with pytest.raises(InputError, match="library: got 'open3d'"):
        build_caster(BOX.vertices, BOX.faces, library="open3d")


def test_embreex_casts_where_it_loads_and_open3d_is_not_imported(break_open3d):
    break_open3d(AssertionError("imported"))
    assert caster_name() == "embree"
    assert isinstance(build_caster(BOX.vertices, BOX.faces), raycast.EmbreexCaster)


@pytest.mark.system
@pytest.mark.usefixtures("open3d")
def test_open3d_casts_where_embreex_cannot_load_or_it_is_asked_for(monkeypatch):
    caster = build_caster(BOX.vertices, BOX.faces, library="open3d")
    assert isinstance(caster, raycast.Open3dCaster)

    monkeypatch.setattr(raycast, "embreex_problem", lambda: "embreex cannot load")
    assert caster_name() == "open3d"

    with pytest.raises(InputError, match="a library that loads: embreex cannot load"):
        caster_name("embree")


def test_where_no_library_loads_both_reasons_are_told(monkeypatch):
    for name in ("embreex", "open3d"):
        monkeypatch.setattr(raycast, f"{name}_problem", lambda name=name: f"no {name}")
    with refused_with(
        "rays: got 'auto'; expected a library that loads: no embreex; no open3d"
    ):
        caster_name()


def test_an_unknown_library_is_refused_with_the_known_ones():
    with refused_with("rays: got 'optix'; expected one of auto, embree, open3d"):
        caster_name("optix")
