"""Objects: bodies, poles, crosswalks, parking spaces."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, geometry, read_text, road

from geometry.maps.opendrive.object_shapes import build_prism
from geometry.maps.source_map import Thing

_SLOPE = cubic("elevation", 0.0, 5.0, 0.1)


def _object(
    kind: str, *, s: float = 50.0, t: float = 10.0, inside: str = "", **more: object
) -> str:
    attributes = " ".join(f'{key}="{value}"' for key, value in more.items())
    return (
        f'<object id="7" type="{kind}" s="{s}" t="{t}" {attributes}>{inside}</object>'
    )


def _outline(corners: str, **more: object) -> str:
    attributes = " ".join(f'{key}="{value}"' for key, value in more.items())
    return f"<outline {attributes}>{corners}</outline>"


def _local(*points: tuple[float, ...]) -> str:
    keys = ("u", "v", "z", "height")
    return "".join(
        "<cornerLocal"
        f" {' '.join(f'{k}={str(p)!r}' for k, p in zip(keys, point, strict=False))}/>"
        for point in points
    )


def _on_road(*points: tuple[float, ...]) -> str:
    keys = ("s", "t", "dz", "height")
    return "".join(
        "<cornerRoad"
        f" {' '.join(f'{k}={str(p)!r}' for k, p in zip(keys, point, strict=False))}/>"
        for point in points
    )


def _read(tmp_path, objects, **more):
    return read_text(tmp_path, document(road(objects=objects, **more)))


def _thing(tmp_path, objects, **more) -> Thing:
    (thing,) = _read(tmp_path, objects, **more).things
    return thing


def _mesh(thing: Thing) -> trimesh.Trimesh:
    return trimesh.Trimesh(thing.vertices_m, thing.triangles, process=False)


def _is_solid(thing: Thing) -> bool:
    mesh = trimesh.Trimesh(thing.vertices_m, thing.triangles)
    return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0)


def test_a_box_stands_on_the_road_plane_turned_with_it(tmp_path):
    thing = _thing(
        tmp_path,
        _object("building", hdg=np.pi / 2, length=20, width=6, height=4, zOffset=1),
        elevation=_SLOPE,
    )
    assert thing.class_name == "building"
    assert not thing.is_height_assumed
    assert_allclose(_mesh(thing).bounds, [[47, 0, 11], [53, 20, 15]], atol=1e-9)
    assert _is_solid(thing)


def test_a_building_without_height_gets_one_and_says_so(tmp_path):
    thing = _thing(tmp_path, _object("building", length=20, width=6, height=0))
    assert thing.is_height_assumed
    assert np.ptp(thing.vertices_m[:, 2]) == pytest.approx(9.0)


def test_a_cylinder_has_its_radius(tmp_path):
    thing = _thing(tmp_path, _object("barrier", radius=2, height=3))
    assert thing.class_name == "wall"
    assert_allclose(_mesh(thing).bounds, [[48, 8, 0], [52, 12, 3]], atol=1e-9)
    assert _is_solid(thing)


def test_outlines_in_the_objects_frame(tmp_path):
    corners = _local(
        (0, 0, 0, 6), (4, 0, 0, 6), (4, 2, 0, 6), (0, 2, 0, 6), (0, 0, 0, 6)
    )
    thing = _thing(
        tmp_path, _object("building", hdg=np.pi / 2, inside=_outline(corners))
    )
    assert_allclose(_mesh(thing).bounds, [[48, 10, 0], [50, 14, 6]], atol=1e-9)
    assert not thing.is_height_assumed
    assert _mesh(thing).volume == pytest.approx(48.0)


def test_outlines_on_the_road_follow_it(tmp_path):
    corners = _on_road((10, 5, 1, 4), (30, 5, 1, 4), (30, 9, 1, 4), (10, 9, 1, 4))
    text = _object(
        "building", s=0, t=0, inside=f"<outlines>{_outline(corners)}</outlines>"
    )
    thing = _thing(tmp_path, text, elevation=_SLOPE)
    mesh = _mesh(thing)
    assert_allclose(mesh.bounds, [[10, 5, 7], [30, 9, 13]], atol=1e-9)
    assert _is_solid(thing)
    assert mesh.volume == pytest.approx(20 * 4 * 4.0)  # a sheared box


def test_corners_of_different_height_make_a_sloping_roof(tmp_path):
    corners = _local((0, 0, 0, 2), (10, 0, 0, 6), (10, 5, 0, 6), (0, 5, 0, 2))
    thing = _thing(tmp_path, _object("building", inside=_outline(corners)))
    assert _is_solid(thing)
    assert _mesh(thing).volume == pytest.approx(10 * 5 * 4.0)


def test_inner_outlines_do_not_count(tmp_path):
    ring = _local((0, 0, 0, 5), (10, 0, 0, 5), (10, 10, 0, 5), (0, 10, 0, 5))
    yard = _local((3, 3), (6, 3), (6, 6), (3, 6))
    inside = f"<outlines>{_outline(ring)}{_outline(yard, outer='false')}</outlines>"
    thing = _thing(tmp_path, _object("building", inside=inside))
    assert _is_solid(thing)
    assert _mesh(thing).volume == pytest.approx(100 * 5.0)


def test_an_open_outline_is_a_thin_wall(tmp_path):
    line = _outline(_local((0, 0, 0, 2), (10, 0, 0, 2), (10, 5, 0, 2)), closed="false")
    thing = _thing(tmp_path, _object("fence", inside=line))
    assert _is_solid(thing)
    # Straight pieces of 0.2 m, a little narrower at the corner that joins them.
    assert 0.7 * 15 * 0.2 * 2 < _mesh(thing).volume <= 15 * 0.2 * 2 + 1e-6


def test_a_repeat_without_distance_is_swept_along_the_road(tmp_path):
    repeat = (
        '<repeat s="0" length="100" distance="0" tStart="5" tEnd="5" heightStart="1"'
        ' heightEnd="3" widthStart="0.5" widthEnd="0.5" zOffsetStart="0"'
        ' zOffsetEnd="0"/>'
    )
    thing = _thing(
        tmp_path,
        _object("barrier", inside=repeat),
        plan=geometry('<arc curvature="0.01"/>'),
    )
    assert _is_solid(thing)
    # The line 5 m to the left of an arc of 100 m radius is 5 % shorter.
    assert _mesh(thing).volume == pytest.approx(95.0 * 0.5 * 2.0, rel=1e-2)
    radius = np.hypot(*(thing.vertices_m[:, :2] - [0.0, 100.0]).T)
    assert radius.min() == pytest.approx(94.75)
    assert radius.max() == pytest.approx(95.25)


def test_a_swept_wall_on_a_straight_road_is_a_box(tmp_path):
    repeat = '<repeat s="10" length="60" distance="0"/>'
    thing = _thing(tmp_path, _object("wall", height=2, width=0.3, inside=repeat))
    assert len(thing.vertices_m) == 8
    assert_allclose(_mesh(thing).bounds, [[10, 9.85, 0], [70, 10.15, 2]])
    assert _is_solid(thing)


def test_copies_stand_at_their_distance_and_change_on_the_way(tmp_path):
    repeat = (
        '<repeat s="10" length="40" distance="20" tStart="5" tEnd="9" heightStart="4"'
        ' heightEnd="8"/>'
    )
    things = _read(tmp_path, _object("tree", radius=1, inside=repeat)).things
    assert [thing.id for thing in things] == [
        f"road 1 object 7/{index}" for index in range(3)
    ]
    tops = [thing.vertices_m[:, 2].max() for thing in things]
    assert_allclose(tops, [4, 6, 8])
    feet = [0.5 * np.sum(_mesh(thing).bounds[:, :2], axis=0) for thing in things]
    assert_allclose(feet, [[10, 5], [30, 7], [50, 9]], atol=1e-6)


def test_outlines_go_with_their_copies(tmp_path):
    corners = _on_road((50, 10), (52, 10), (52, 12), (50, 12))
    repeat = '<repeat s="20" length="30" distance="30" tStart="10" tEnd="10"/>'
    things = _read(
        tmp_path, _object("building", inside=repeat + _outline(corners))
    ).things
    assert_allclose([thing.vertices_m[:, 0].min() for thing in things], [20, 50])


def test_copies_beyond_the_road_are_left_out(tmp_path):
    repeat = '<repeat s="60" length="100" distance="30"/>'
    assert len(_read(tmp_path, _object("tree", inside=repeat)).things) == 2


def test_a_tree_has_a_trunk_and_a_crown(tmp_path):
    thing = _thing(tmp_path, _object("tree", height=10, width=6, length=6))
    assert thing.class_name == "vegetation"
    assert not thing.is_height_assumed
    assert _is_solid(thing)
    vertices = thing.vertices_m - [50.0, 10.0, 0.0]
    reach = np.hypot(*vertices[:, :2].T)
    assert vertices[:, 2].min() == pytest.approx(0.0)
    assert vertices[:, 2].max() == pytest.approx(10.0)
    assert reach[vertices[:, 2] < 2.0].max() < 0.3
    assert reach.max() == pytest.approx(3.0, rel=0.05)


def test_low_vegetation_is_no_tree(tmp_path):
    thing = _thing(tmp_path, _object("vegetation", length=10, width=1, height=1.5))
    assert_allclose(_mesh(thing).bounds, [[45, 9.5, 0], [55, 10.5, 1.5]])


@pytest.mark.parametrize(
    ("kind", "name", "class_name"),
    [
        ("obstacle", "garden_wall", "wall"),
        ("-1", "House_Brick_3", "building"),
        ("none", "GuardRail", "wall"),
        ("", "SimpleHedge", "vegetation"),
    ],
)
def test_names_say_what_types_do_not(tmp_path, kind, name, class_name):
    thing = _thing(tmp_path, _object(kind, name=name, length=4, width=2, height=2))
    assert thing.class_name == class_name


@pytest.mark.parametrize("kind", ["gantry", "roadMark", ""])
def test_kinds_that_hide_nothing_are_counted(tmp_path, kind):
    source = _read(tmp_path, 2 * _object(kind, length=4, width=2, height=2))
    assert not source.things
    assert (
        source.skipped[0].what
        == f"2 objects ({kind or 'no type'}), such as road 1 object 7 and road 1 object"
        " 7 #2"
    )


def test_what_has_no_size_is_noted(tmp_path):
    flat = _outline(_local((0, 0), (1, 0), (2, 0)))
    source = _read(
        tmp_path, _object("building", height=3) + _object("building", inside=flat)
    )
    assert not source.things
    assert source.skipped[0].what.startswith("2 objects (building) without size")


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("streetLamp", "", "lamp post"),
        ("pole", "", "pole"),
        ("-1", "Speed_30", "sign"),
        ("trafficLight", "", "traffic light"),
    ],
)
def test_poles(tmp_path, kind, name, expected):
    source = _read(
        tmp_path, _object(kind, name=name, height=5, zOffset=0.5), elevation=_SLOPE
    )
    (pole,) = source.poles
    assert pole.kind == expected
    assert_allclose(pole.position_m, [50, 10, 10])
    assert pole.height_m == pytest.approx(5.5)


def test_a_pole_without_height_says_nothing_about_it(tmp_path):
    (pole,) = _read(tmp_path, _object("streetLamp", height=0)).poles
    assert pole.height_m is None


def test_a_row_of_lamps_is_one_pole_each(tmp_path):
    repeat = '<repeat s="0" length="100" distance="25"/>'
    poles = _read(tmp_path, _object("streetLamp", height=5, inside=repeat)).poles
    assert_allclose([pole.position_m[0] for pole in poles], [0, 25, 50, 75, 100])


@pytest.mark.parametrize(
    ("inside", "more"),
    [
        ("", {"length": 4, "width": 8}),
        ("", {"length": 8, "width": 4, "hdg": np.pi / 2}),
        (_outline(_local((-2, -4), (2, -4), (2, 4), (-2, 4), (-2, -4))), {}),
        (_outline(_on_road((48, -4), (52, -4), (52, 4), (48, 4))), {"length": 99}),
        (_outline(_on_road((50, -4), (50, 4))), {}),
    ],
)
def test_crosswalks_lead_the_long_way(tmp_path, inside, more):
    (ends,) = _read(
        tmp_path, _object("crosswalk", t=0, inside=inside, **more)
    ).crosswalks_m
    assert_allclose(sorted(ends.tolist()), [[50, -4], [50, 4]], atol=1e-9)


def test_a_crosswalk_that_is_nearly_square_leads_across_the_road(tmp_path):
    (ends,) = _read(
        tmp_path, _object("crosswalk", t=0, length=4, width=3.5)
    ).crosswalks_m
    assert_allclose(sorted(ends.tolist()), [[50, -1.75], [50, 1.75]], atol=1e-9)


def test_parking_spaces_side_by_side_are_one_lane(tmp_path):
    repeat = '<repeat s="20" length="25" distance="2.5" tStart="-6" tEnd="-6"/>'
    apart = _object("parkingSpace", s=80, t=-6, length=2.5, width=5)
    other = _object("parkingSpace", s=30, t=6, length=6, width=2)
    spaces = _object("parkingSpace", length=2.5, width=5, inside=repeat) + apart + other
    lanes = [one for one in _read(tmp_path, spaces).lanes if one.kind == "parking"]
    assert [one.id for one in lanes] == ["1/parking 1", "1/parking 2", "1/parking 3"]
    row, along, alone = lanes
    assert_allclose(row.centreline_m[[0, -1], :2], [[18.75, -6], [46.25, -6]])
    assert row.width_m == pytest.approx(5.0)
    # To the left of the road traffic comes back.
    assert_allclose(along.centreline_m[[0, -1], :2], [[33, 6], [27, 6]])
    assert along.width_m == pytest.approx(2.0)
    assert alone.centreline_m[0, 0] == pytest.approx(78.75)


def test_a_parking_space_may_be_one_by_what_it_contains(tmp_path):
    text = _object("-1", t=-6, length=5, width=2, inside='<parkingSpace access="all"/>')
    assert any(one.kind == "parking" for one in _read(tmp_path, text).lanes)


def test_bridges_tunnels_and_references_are_counted(tmp_path):
    text = '<bridge id="1"/><bridge id="2"/><tunnel id="3"/><objectReference id="4"/>'
    assert [note.what for note in _read(tmp_path, text).skipped] == [
        "road 1 tunnel 3",
        "2 bridges, such as road 1 bridge 1 and road 1 bridge 2",
        "road 1 objectReference 4",
    ]


@given(
    angles=st.lists(
        st.floats(0.0, 6.28), min_size=3, max_size=9, unique_by=lambda a: round(a, 1)
    ),
    heights=st.lists(st.floats(0.5, 9.0), min_size=9, max_size=9),
    clockwise=st.booleans(),
)
def test_prisms_over_stars_are_closed_whatever_their_corners_heights(
    angles, heights, clockwise
):
    angles = np.sort(angles)[:: -1 if clockwise else 1]
    if np.max(np.diff(np.append(np.sort(angles), np.min(angles) + 2 * np.pi))) > 2.8:
        return  # the middle lies outside: the outline may cross itself
    n = len(angles)
    reach = 5.0 + np.arange(n) % 3
    outline = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tops = np.array(heights[:n])
    vertices, triangles = build_prism(
        outline, bottom_m=np.zeros(n), top_m=tops, where="made"
    )
    mesh = trimesh.Trimesh(vertices, triangles)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0


@pytest.mark.parametrize("names", [{"subtype": "crosswalk"}, {"name": "crossWalk"}])
def test_a_crosswalk_may_be_written_as_a_road_mark(tmp_path, names):
    text = _object("roadMark", t=0, length=3, width=8, **names)
    (ends,) = _read(tmp_path, text).crosswalks_m
    assert np.hypot(*(ends[1] - ends[0])) == pytest.approx(8.0)
    assert not len(
        _read(tmp_path, _object("roadMark", t=0, length=3, width=8)).crosswalks_m
    )
