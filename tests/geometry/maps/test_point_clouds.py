"""Houses and trees out of clouds of points."""

import laspy
import numpy as np
import pyproj
import pytest
import trimesh
from numpy.testing import assert_allclose

from geometry.errors import InputError
from geometry.maps import point_clouds
from geometry.maps.point_clouds import read_point_cloud
from geometry.maps.source_map import volume_m3
from geometry.raycast import build_caster

ORIGIN = np.array([390_000.0, 5_819_000.0, 35.0])
RNG_SEED = 7


def house(n=40_000, size=(12.0, 8.0, 6.0)):
    """Points on a house around the origin."""
    solid = trimesh.creation.box(size)
    solid.apply_translation([0.0, 0.0, 0.5 * size[2]])
    return solid.sample(n, seed=RNG_SEED)


def crown(n=10_000):
    """Points on the crown of a tree, 3 to 7 m high."""
    ball = trimesh.creation.icosphere(radius=2.0)
    ball.apply_translation([20.0, 0.0, 5.0])
    return ball.sample(n, seed=RNG_SEED)


def ground(n=40_000, *, beside_house=True):
    """Points on the ground, by default none below the house."""
    rng = np.random.default_rng(RNG_SEED)
    flat = rng.uniform(-40, 40, (n, 2))
    points = np.column_stack([flat, rng.normal(0.0, 0.02, n)])
    if beside_house:
        is_under = (np.abs(flat) < [6.0, 4.0]).all(axis=1)
        return points[~is_under]
    return points


def new_las(points, offsets, crs, *, scale=0.001):
    """Points in a reference system, to be written."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [scale, scale, 0.001]
    header.offsets = offsets
    if crs:
        header.add_crs(pyproj.CRS(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    return las


def write_las(
    tmp_path,
    parts,
    classes,
    *,
    name="a.las",
    crs="EPSG:25833",
    origin=ORIGIN,
    slope=0.0,
):
    """A file of parts, each of one class."""
    points = np.concatenate(parts)
    points[:, 2] += slope * points[:, 0]
    las = new_las(points + origin, origin, crs)
    counts = [len(part) for part in parts]
    las.classification = np.repeat(classes, counts).astype(np.uint8)
    path = tmp_path / name
    las.write(path)
    return path


def volume(thing):
    """Volume of a thing. [m3]"""
    return volume_m3(thing.vertices_m, thing.triangles)


def size(thing):
    """Length, width and height of a thing."""
    return np.ptp(thing.vertices_m, axis=0)


@pytest.mark.parametrize(
    ("name", "classes"),
    [
        ("a.las", (6, 5, 2)),
        ("a.laz", (1, 1, 1)),
        ("a.las", (0, 0, 2)),
    ],
)
def test_a_house_and_a_tree_stand_on_the_ground_where_they_were(
    tmp_path, name, classes
):
    path = write_las(tmp_path, [house(), crown(), ground()], classes, name=name)
    source = read_point_cloud(path)

    assert source.crs == "EPSG:25833"
    assert source.heights == "above ground"

    tree, solid = sorted(source.things, key=lambda thing: size(thing).max())
    assert solid.class_name == "building"

    is_vegetation = tree.class_name == "vegetation"
    assert is_vegetation == (classes[1] == 5)

    place = solid.vertices_m - [*ORIGIN[:2], 0.0]
    assert_allclose(place.min(axis=0), [-6.0, -4.0, 0.0], atol=0.51)
    assert_allclose(place.max(axis=0), [6.0, 4.0, 6.0], atol=0.51)

    assert volume(solid) == pytest.approx(576.0, rel=0.15)

    # Under the crown one can look through.
    heights = tree.vertices_m[:, 2]
    assert heights.min() == pytest.approx(3.0, abs=0.5)
    assert heights.max() == pytest.approx(7.0, abs=0.5)


def test_rays_find_no_hole_in_a_wall_and_nothing_beside_it(tmp_path):
    low = [-5.0, 0.0, 0.0]
    high = [5.0, 0.0, 4.0]
    wall = np.random.default_rng(1).uniform(low, high, (8000, 3))
    parts = [wall, ground(beside_house=False)]
    path = write_las(tmp_path, parts, (1, 1), origin=np.zeros(3))
    (thing,) = read_point_cloud(path).things

    x = np.repeat(np.linspace(-8, 8, 161), 50)
    z = np.tile(np.linspace(0.1, 5.0, 50), 161)
    origins = np.column_stack([x, np.full(len(x), -20.0), z])
    caster = build_caster(thing.vertices_m, thing.triangles)
    ahead = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    distance_m, _ = caster.first_triangle(origins, ahead)
    is_hit = np.isfinite(distance_m)

    margin = 2.0 * point_clouds.VOXEL_M
    inner = (np.abs(x) < 5.0 - margin) & (z < 4.0 - margin)
    outer = (np.abs(x) > 5.0 + margin) | (z > 4.0 + margin)

    assert is_hit[inner].mean() > 0.995
    assert not is_hit[outer].any()


@pytest.mark.parametrize("slope", [-0.06, 0.06])
def test_ground_may_slope(tmp_path, slope):
    path = write_las(tmp_path, [house(), ground()], (1, 1), slope=slope)
    (thing,) = read_point_cloud(path).things
    heights = thing.vertices_m[:, 2]

    assert heights.min() == 0.0
    assert heights.max() == pytest.approx(6.0, abs=0.8)


@pytest.mark.parametrize("kind", [1, 6])
def test_roofs_seen_from_the_air_get_walls(tmp_path, kind):
    roof = house()
    roof = roof[roof[:, 2] > 5.99]
    path = write_las(tmp_path, [roof, ground()], (kind, 2))
    (thing,) = read_point_cloud(path).things

    assert volume(thing) == pytest.approx(576.0, rel=0.15)


def test_thin_scans_get_larger_voxels_and_say_so(tmp_path):
    path = write_las(tmp_path, [house(1500), ground()], (1, 2))
    source = read_point_cloud(path)

    assert len(source.things) == 1
    assert source.skipped[0].what == "detail below 1 m"


def test_classes_that_hide_nothing_are_left_out_and_counted(tmp_path):
    parts = [house(), crown(500), crown(20), ground()]
    path = write_las(tmp_path, parts, (6, 14, 7, 2))
    source = read_point_cloud(path)

    assert len(source.things) == 1
    assert {skip.what for skip in source.skipped} == {"500 wire", "20 noise"}


def test_the_class_of_points_without_one_is_the_callers(tmp_path):
    path = write_las(tmp_path, [house(), ground()], (1, 1))
    (thing,) = read_point_cloud(path, class_name="wall").things
    assert thing.class_name == "wall"


def test_coordinates_in_degrees_become_metres(tmp_path):
    lonlat = pyproj.Transformer.from_crs("EPSG:25833", "EPSG:4326", always_xy=True)
    x, y, z = (np.concatenate([house(), ground()]) + ORIGIN).T
    points = np.column_stack([*lonlat.transform(x, y), z])
    las = new_las(points, [13.0, 52.0, 0.0], "EPSG:4326", scale=1e-8)
    las.write(tmp_path / "a.las")
    (thing,) = read_point_cloud(tmp_path / "a.las").things
    *across_m, height_m = size(thing)

    assert height_m == pytest.approx(6.0, abs=0.51)
    assert sorted(across_m) == pytest.approx([8.0, 12.0], abs=1.0)


def patched(path, offset, data):
    """A file with other bytes at a place."""
    content = bytearray(path.read_bytes())
    content[offset : offset + len(data)] = data
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("offset", "data", "message"),
    [
        (0, b"NOPE", "LAS file"),
        (247, (10**10).to_bytes(8, "little"), "10,000,000,000 points"),
        (247, (40_000_000).to_bytes(8, "little"), "cut off"),
        (100, (4 * 10**9).to_bytes(4, "little"), "records in its header"),
        (243, (4 * 10**9).to_bytes(4, "little"), "extended records"),
        (131, np.array([np.nan]).tobytes(), "finite scales"),
    ],
)
def test_headers_that_claim_what_cannot_be_are_refused(tmp_path, offset, data, message):
    path = patched(write_las(tmp_path, [house(100)], (1,)), offset, data)
    with pytest.raises(InputError, match=message):
        read_point_cloud(path)


@pytest.mark.parametrize(
    ("place", "data", "message"),
    [
        ("items", b"\0\0", "no known kind"),
        ("items", b"\x01\0\x0a\0\xff\xff", "no known kind"),
        ("record", b"another owner", "without a LASzip record"),
        ("table", (2**32 - 1).to_bytes(4, "little"), "claim more bytes"),
        ("layers", (2**32 - 1).to_bytes(4, "little"), "claim more bytes"),
        ("table offset", (10**15).to_bytes(8, "little"), "outside the file"),
    ],
)
def test_packed_points_that_claim_what_cannot_be_are_refused(
    tmp_path, place, data, message
):
    path = write_las(tmp_path, [house(300)], (1,), name="a.laz")
    content = path.read_bytes()
    first = int.from_bytes(content[96:100], "little")
    record = content.index(b"laszip encoded")
    offset = {
        "items": record + 52 + 32,
        "record": record,
        "table": int.from_bytes(content[first : first + 8], "little") + 4,
        "layers": first + 8 + 30 + 4,
        "table offset": first,
    }[place]

    with pytest.raises(InputError, match=message):
        read_point_cloud(patched(path, offset, data))


def test_clouds_of_nothing_but_ground_are_refused(tmp_path):
    with pytest.raises(InputError, match="only ground"):
        read_point_cloud(write_las(tmp_path, [ground()], (1,)))
    with pytest.raises(InputError, match="no points"):
        read_point_cloud(write_las(tmp_path, [ground(0)], ()))


def test_degrees_are_refused(tmp_path):
    small = house(500) * 1e-4 + [13.0, 52.0, 0.0]
    path = write_las(tmp_path, [small], (1,), crs=None, origin=np.zeros(3))
    with pytest.raises(InputError, match="degrees where metres"):
        read_point_cloud(path)


def test_unknown_options_and_endings_are_refused(tmp_path):
    path = write_las(tmp_path, [house(100)], (1,))
    with pytest.raises(InputError):
        read_point_cloud(path, class_name="castle")
    with pytest.raises(InputError, match="one of"):
        read_point_cloud(tmp_path / "a.e57")
    with pytest.raises(InputError, match="readable"):
        read_point_cloud(tmp_path / "b.las")


def test_too_many_voxels_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(point_clouds, "_MAX_VOXELS", 100)
    path = write_las(tmp_path, [house()], (1,))
    with pytest.raises(InputError, match="a larger voxel"):
        read_point_cloud(path)
