"""Objects: bodies, poles, crosswalks, parking spaces."""

import re

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, geometry, read_text, road

from geometry.maps.opendrive.object_shapes import build_prism

SLOPE = cubic("elevation", 0.0, 5.0, 0.1)
HALF_PI = np.pi / 2


def quoted(text):
    """Attributes as XML has them, of a text such as "length=20 width=6"."""
    return re.sub(r"(\S+)=(\S+)", r'\1="\2"', text)


def element(kind, attributes="", inside=""):
    """An object, 50 m along the road and 10 m to its left unless said otherwise."""
    place = ""
    for default in ("s=50", "t=10"):
        if not re.search(rf"\b{default[:2]}", attributes):
            place += f"{default} "

    told = quoted(f"{place}{attributes}")
    return f'<object id="7" type="{kind}" {told}>{inside}</object>'


def outline(corners, attributes=""):
    """An outline of an object."""
    return f"<outline {quoted(attributes)}>{corners}</outline>"


def corners_of(tag, keys, corners):
    """Corners of an outline: their numbers in the order of the keys."""
    elements = ""
    for corner in corners:
        told = ""
        for key, number in zip(keys, corner, strict=False):
            told += f'{key}="{number}" '
        elements += f"<{tag} {told}/>"
    return elements


def local(corners):
    """Corners in the object's frame: u, v, z and height."""
    return corners_of("cornerLocal", ("u", "v", "z", "height"), corners)


def on_road(corners):
    """Corners along the road: s, t, dz and height."""
    return corners_of("cornerRoad", ("s", "t", "dz", "height"), corners)


@pytest.fixture
def read(tmp_path):
    """A function that reads a road with objects."""

    def build(objects, **more):
        return read_text(tmp_path, document(road(objects=objects, **more)))

    return build


@pytest.fixture
def thing_of(read):
    """A function that reads a road with one thing: its mesh and the thing."""

    def build(kind, attributes="", inside="", **more):
        (thing,) = read(element(kind, attributes, inside), **more).things
        return trimesh.Trimesh(thing.vertices_m, thing.triangles), thing

    return build


def assert_solid(mesh):
    """A mesh is closed and looks outwards."""
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0


def assert_bounds(mesh, expected_m):
    """A mesh reaches from its lowest corner to its highest one."""
    assert_allclose(mesh.bounds, expected_m, atol=1e-9)


def test_a_box_stands_on_the_road_plane_turned_with_it(thing_of):
    size = "length=20 width=6 height=4 zOffset=1"
    mesh, thing = thing_of("building", f"hdg={HALF_PI} {size}", elevation=SLOPE)

    assert thing.class_name == "building"
    assert not thing.is_height_assumed
    assert_bounds(mesh, [(47.0, 0.0, 11.0), (53.0, 20.0, 15.0)])
    assert_solid(mesh)


def test_a_building_without_height_gets_one_and_says_so(thing_of):
    mesh, thing = thing_of("building", "length=20 width=6 height=0")
    assert thing.is_height_assumed
    assert mesh.extents[2] == pytest.approx(9.0)


def test_a_cylinder_has_its_radius(thing_of):
    mesh, thing = thing_of("barrier", "radius=2 height=3")
    assert thing.class_name == "wall"
    assert_bounds(mesh, [(48.0, 8.0, 0.0), (52.0, 12.0, 3.0)])
    assert_solid(mesh)


def test_outlines_in_the_objects_frame(thing_of):
    ring = outline(
        local(
            [
                (0.0, 0.0, 0.0, 6.0),
                (4.0, 0.0, 0.0, 6.0),
                (4.0, 2.0, 0.0, 6.0),
                (0.0, 2.0, 0.0, 6.0),
                (0.0, 0.0, 0.0, 6.0),
            ]
        )
    )
    mesh, thing = thing_of("building", f"hdg={HALF_PI}", ring)

    assert_bounds(mesh, [(48.0, 10.0, 0.0), (50.0, 14.0, 6.0)])
    assert not thing.is_height_assumed
    assert mesh.volume == pytest.approx(48.0)


def test_outlines_on_the_road_follow_it(thing_of):
    ring = outline(
        on_road(
            [
                (10.0, 5.0, 1.0, 4.0),
                (30.0, 5.0, 1.0, 4.0),
                (30.0, 9.0, 1.0, 4.0),
                (10.0, 9.0, 1.0, 4.0),
            ]
        )
    )
    inside = f"<outlines>{ring}</outlines>"
    mesh, _ = thing_of("building", "s=0 t=0", inside, elevation=SLOPE)

    assert_bounds(mesh, [(10.0, 5.0, 7.0), (30.0, 9.0, 13.0)])
    assert_solid(mesh)
    assert mesh.volume == pytest.approx(20 * 4 * 4.0)  # a sheared box


def test_corners_of_different_height_make_a_sloping_roof(thing_of):
    ring = outline(
        local(
            [
                (0.0, 0.0, 0.0, 2.0),
                (10.0, 0.0, 0.0, 6.0),
                (10.0, 5.0, 0.0, 6.0),
                (0.0, 5.0, 0.0, 2.0),
            ]
        )
    )
    mesh, _ = thing_of("building", inside=ring)

    assert_solid(mesh)
    assert mesh.volume == pytest.approx(10 * 5 * 4.0)


def test_inner_outlines_do_not_count(thing_of):
    ring = outline(
        local(
            [
                (0.0, 0.0, 0.0, 5.0),
                (10.0, 0.0, 0.0, 5.0),
                (10.0, 10.0, 0.0, 5.0),
                (0.0, 10.0, 0.0, 5.0),
            ]
        )
    )
    yard = outline(
        local(
            [
                (3.0, 3.0),
                (6.0, 3.0),
                (6.0, 6.0),
                (3.0, 6.0),
            ]
        ),
        "outer=false",
    )
    mesh, _ = thing_of("building", inside=f"<outlines>{ring}{yard}</outlines>")

    assert_solid(mesh)
    assert mesh.volume == pytest.approx(100 * 5.0)


def test_an_open_outline_is_a_thin_wall(thing_of):
    line = outline(
        local(
            [
                (0.0, 0.0, 0.0, 2.0),
                (10.0, 0.0, 0.0, 2.0),
                (10.0, 5.0, 0.0, 2.0),
            ]
        ),
        "closed=false",
    )
    mesh, _ = thing_of("fence", inside=line)

    assert_solid(mesh)
    # Straight pieces of 0.2 m, a little narrower at the corner that joins them.
    assert 0.7 * 15 * 0.2 * 2 < mesh.volume <= 15 * 0.2 * 2 + 1e-6


def test_a_repeat_without_distance_is_swept_along_the_road(thing_of):
    repeat = (
        '<repeat s="0" length="100" distance="0" tStart="5" tEnd="5" heightStart="1"'
        ' heightEnd="3" widthStart="0.5" widthEnd="0.5" zOffsetStart="0"'
        ' zOffsetEnd="0"/>'
    )
    arc = geometry('<arc curvature="0.01"/>')
    mesh, thing = thing_of("barrier", inside=repeat, plan=arc)

    assert_solid(mesh)
    # The line 5 m to the left of an arc of 100 m radius is 5 % shorter.
    assert mesh.volume == pytest.approx(95.0 * 0.5 * 2.0, rel=1e-2)

    radius = np.linalg.norm(thing.vertices_m[:, :2] - [0.0, 100.0], axis=-1)
    assert radius.min() == pytest.approx(94.75)
    assert radius.max() == pytest.approx(95.25)


def test_a_swept_wall_on_a_straight_road_is_a_box(thing_of):
    repeat = '<repeat s="10" length="60" distance="0"/>'
    mesh, thing = thing_of("wall", "height=2 width=0.3", repeat)

    assert len(thing.vertices_m) == 8
    assert_bounds(mesh, [(10.0, 9.85, 0.0), (70.0, 10.15, 2.0)])
    assert_solid(mesh)


def test_copies_stand_at_their_distance_and_change_on_the_way(read):
    repeat = (
        '<repeat s="10" length="40" distance="20" tStart="5" tEnd="9" heightStart="4"'
        ' heightEnd="8"/>'
    )
    things = read(element("tree", "radius=1", repeat)).things
    ids = [thing.id for thing in things]

    assert ids == [f"road 1 object 7/{index}" for index in range(3)]

    tops = [thing.vertices_m[:, 2].max() for thing in things]
    assert_allclose(tops, [4, 6, 8])

    low = np.array([thing.vertices_m.min(axis=0) for thing in things])
    high = np.array([thing.vertices_m.max(axis=0) for thing in things])
    middles = 0.5 * (low + high)

    assert_allclose(
        middles[:, :2],
        np.array(
            [
                [10.0, 5.0],
                [30.0, 7.0],
                [50.0, 9.0],
            ]
        ),
        atol=1e-6,
    )


def test_outlines_go_with_their_copies(read):
    ring = outline(
        on_road(
            [
                (50.0, 10.0),
                (52.0, 10.0),
                (52.0, 12.0),
                (50.0, 12.0),
            ]
        )
    )
    repeat = '<repeat s="20" length="30" distance="30" tStart="10" tEnd="10"/>'
    things = read(element("building", inside=repeat + ring)).things

    assert_allclose([thing.vertices_m[:, 0].min() for thing in things], [20, 50])


def test_copies_beyond_the_road_are_left_out(read):
    repeat = '<repeat s="60" length="100" distance="30"/>'
    assert len(read(element("tree", inside=repeat)).things) == 2


def test_a_tree_has_a_trunk_and_a_crown(thing_of):
    mesh, thing = thing_of("tree", "height=10 width=6 length=6")
    assert thing.class_name == "vegetation"
    assert not thing.is_height_assumed
    assert_solid(mesh)

    x, y, z = (thing.vertices_m - [50.0, 10.0, 0.0]).T
    reach = np.hypot(x, y)

    assert z.min() == pytest.approx(0.0)
    assert z.max() == pytest.approx(10.0)
    assert reach[z < 2.0].max() < 0.3
    assert reach.max() == pytest.approx(3.0, rel=0.05)


def test_low_vegetation_is_no_tree(thing_of):
    mesh, _ = thing_of("vegetation", "length=10 width=1 height=1.5")
    assert_bounds(mesh, [(45.0, 9.5, 0.0), (55.0, 10.5, 1.5)])


@pytest.mark.parametrize(
    ("kind", "name", "class_name"),
    [
        ("obstacle", "garden_wall", "wall"),
        ("-1", "House_Brick_3", "building"),
        ("none", "GuardRail", "wall"),
        ("", "SimpleHedge", "vegetation"),
    ],
)
def test_names_say_what_types_do_not(thing_of, kind, name, class_name):
    _, thing = thing_of(kind, f"name={name} length=4 width=2 height=2")
    assert thing.class_name == class_name


@pytest.mark.parametrize("kind", ["gantry", "roadMark", ""])
def test_kinds_that_hide_nothing_are_counted(read, kind):
    source = read(2 * element(kind, "length=4 width=2 height=2"))
    assert not source.things
    assert source.skipped[0].what == (
        f"2 objects ({kind or 'no type'}), such as road 1 object 7 and road 1 object"
        " 7 #2"
    )


def test_what_has_no_size_is_noted(read):
    flat = outline(
        local(
            [
                (0.0, 0.0),
                (1.0, 0.0),
                (2.0, 0.0),
            ]
        )
    )
    source = read(element("building", "height=3") + element("building", inside=flat))

    assert not source.things
    assert source.skipped[0].what.startswith("2 objects (building) without size")


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("streetLamp", "", "lamp post"),
        ("pole", "", "pole"),
        ("-1", "name=Speed_30", "sign"),
        ("trafficLight", "", "traffic light"),
    ],
)
def test_poles(read, kind, name, expected):
    text = element(kind, f"{name} height=5 zOffset=0.5")
    (pole,) = read(text, elevation=SLOPE).poles

    assert pole.kind == expected
    assert_allclose(pole.position_m, [50, 10, 10])
    assert pole.height_m == pytest.approx(5.5)


def test_a_pole_without_height_says_nothing_about_it(read):
    (pole,) = read(element("streetLamp", "height=0")).poles
    assert pole.height_m is None


def test_a_row_of_lamps_is_one_pole_each(read):
    repeat = '<repeat s="0" length="100" distance="25"/>'
    poles = read(element("streetLamp", "height=5", repeat)).poles
    assert_allclose([pole.position_m[0] for pole in poles], [0, 25, 50, 75, 100])


@pytest.mark.parametrize(
    ("attributes", "inside", "half_m"),
    [
        ("length=4 width=8", "", 4),
        (f"length=8 width=4 hdg={HALF_PI}", "", 4),
        (
            "",
            outline(
                local(
                    [
                        (-2.0, -4.0),
                        (2.0, -4.0),
                        (2.0, 4.0),
                        (-2.0, 4.0),
                        (-2.0, -4.0),
                    ]
                )
            ),
            4,
        ),
        (
            "length=99",
            outline(
                on_road(
                    [
                        (48.0, -4.0),
                        (52.0, -4.0),
                        (52.0, 4.0),
                        (48.0, 4.0),
                    ]
                )
            ),
            4,
        ),
        ("", outline(on_road([(50.0, -4.0), (50.0, 4.0)])), 4),
        # Nearly square: it leads across the road.
        ("length=4 width=3.5", "", 1.75),
    ],
)
def test_crosswalks_lead_the_long_way(read, attributes, inside, half_m):
    (ends,) = read(element("crosswalk", f"t=0 {attributes}", inside)).crosswalks_m
    assert_allclose(sorted(ends.tolist()), [[50, -half_m], [50, half_m]], atol=1e-9)


def test_the_long_way_of_a_crosswalk_may_lead_along_the_road(read):
    (ends,) = read(element("crosswalk", "t=0 length=8 width=3")).crosswalks_m
    expected = np.array([[46.0, 0.0], [54.0, 0.0]])

    assert_allclose(sorted(ends.tolist()), expected, atol=1e-9)


def test_parking_spaces_side_by_side_are_one_lane(read):
    repeat = '<repeat s="20" length="25" distance="2.5" tStart="-6" tEnd="-6"/>'
    spaces = (
        element("parkingSpace", "length=2.5 width=5", repeat)
        + element("parkingSpace", "s=80 t=-6 length=2.5 width=5")
        + element("parkingSpace", "s=30 t=6 length=6 width=2")
    )
    row, along, alone = (one for one in read(spaces).lanes if one.kind == "parking")

    assert [one.id for one in (row, along, alone)] == [
        "1/parking 1",
        "1/parking 2",
        "1/parking 3",
    ]
    assert_allclose(
        row.centreline_m[[0, -1], :2], np.array([[18.75, -6.0], [46.25, -6.0]])
    )
    assert row.width_m == pytest.approx(5.0)
    # To the left of the road traffic comes back.
    assert_allclose(
        along.centreline_m[[0, -1], :2], np.array([[33.0, 6.0], [27.0, 6.0]])
    )
    assert along.width_m == pytest.approx(2.0)
    assert alone.centreline_m[0, 0] == pytest.approx(78.75)


def test_a_parking_space_may_be_one_by_what_it_contains(read):
    space = element("-1", "t=-6 length=5 width=2", '<parkingSpace access="all"/>')
    assert any(one.kind == "parking" for one in read(space).lanes)


def test_bridges_tunnels_and_references_are_counted(read):
    text = '<bridge id="1"/><bridge id="2"/><tunnel id="3"/><objectReference id="4"/>'
    assert [note.what for note in read(text).skipped] == [
        "road 1 tunnel 3",
        "2 bridges, such as road 1 bridge 1 and road 1 bridge 2",
        "road 1 objectReference 4",
    ]


ANGLES = st.lists(
    st.floats(0.0, 6.28),
    min_size=3,
    max_size=9,
    unique_by=lambda angle: round(angle, 1),
)


@given(
    angles=ANGLES,
    heights=st.lists(st.floats(0.5, 9.0), min_size=9, max_size=9),
    clockwise=st.booleans(),
)
def test_prisms_over_stars_are_closed_whatever_their_corners_heights(
    angles, heights, clockwise
):
    angles = np.sort(angles)
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    if gaps.max() > 2.8:
        return  # the middle lies outside: the outline may cross itself
    if clockwise:
        angles = angles[::-1]
    n = len(angles)
    reach = 5.0 + np.arange(n) % 3
    ring = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1)
    tops = np.array(heights[:n])
    vertices, triangles = build_prism(
        ring,
        bottom_m=np.zeros(n),
        top_m=tops,
        where="made",
    )

    assert_solid(trimesh.Trimesh(vertices, triangles))


@pytest.mark.parametrize("name", ["subtype=crosswalk", "name=crossWalk"])
def test_a_crosswalk_may_be_written_as_a_road_mark(read, name):
    size = "t=0 length=3 width=8"
    (ends,) = read(element("roadMark", f"{size} {name}")).crosswalks_m

    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(8.0)
    assert not len(read(element("roadMark", size)).crosswalks_m)
