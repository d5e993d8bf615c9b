"""What is cut out of maps around a junction, and the scene that is made of it."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from geometry.errors import InputError
from geometry.frames import transform
from geometry.junction import Line, build_junction
from geometry.maps.cut import build_scene, cut_out
from geometry.maps.georeferences import frame_at
from geometry.maps.source_map import (
    MapJunction,
    MapLane,
    Pole,
    SourceMap,
    Thing,
    extrude,
)
from geometry.scene import thing_footprint
from geometry.scene_checks import arms_that_end, check_scene

SQUARE_M = np.array(
    [
        [8.0, -8.0],
        [8.0, 8.0],
        [-8.0, 8.0],
        [-8.0, -8.0],
    ]
)
UTM = "EPSG:25832"
AT_M = np.array([691_000.0, 5_334_000.0])  # Munich, more or less


def lane(name, ends, *, kind="driving", to="", start="", height_m=5.0, n_points=2):
    """A lane of the map from one place to another, in metres from its junction."""
    points = np.linspace(*np.array(ends), n_points) + AT_M
    return MapLane(
        id=name,
        kind=kind,
        width_m=3.0,
        centreline_m=np.column_stack([points, np.full(n_points, height_m)]),
        to_junction=to,
        from_junction=start,
    )


def house(name, middle, *, bottom_m=5.0, top_m=11.0):
    """A building of 4 m by 4 m, in metres from the junction."""
    corners = np.array(middle) + 0.25 * SQUARE_M + AT_M
    vertices, triangles = extrude(corners, bottom_m=bottom_m, top_m=top_m)
    return Thing(
        id=name,
        class_name="building",
        vertices_m=vertices,
        triangles=triangles,
    )


def place(x, y):
    """A place on the junction's height, in metres from its middle."""
    return np.array([AT_M[0] + x, AT_M[1] + y, 5.0])


JUNCTION = MapJunction(
    id="j",
    name="A / B",
    outline_m=SQUARE_M + AT_M,
    height_m=5.0,
)
LANES = (
    lane("in", [(300.0, 1.5), (8.0, 1.5)], to="j", n_points=30),
    lane("out", [(8.0, -1.5), (60.0, -1.5)], start="j"),
    lane("further", [(60.0, -1.5), (120.0, -1.5)], n_points=7),
    lane("bridge", [(-50.0, 8.0), (50.0, 8.5)], height_m=12.0),
    lane("stranger", [(-8.5, 3.0), (-40.0, 3.0)]),
    lane("walk", [(60.0, 5.0), (8.0, 5.0)], kind="walking", to="j"),
)
POLES = (
    Pole(
        id="lamp, 1",
        kind="lamp post",
        position_m=place(10, 10),
        height_m=6.0,
    ),
    Pole(id="off", kind="sign", position_m=place(500, 0)),
)
ROADS = SourceMap(
    name="roads.xodr",
    crs=UTM,
    source_crs=UTM,
    heights="absolute",
    lanes=LANES,
    junctions=(JUNCTION,),
    things=(
        house("near", (20.0, 20.0)),
        house("far", (200.0, 20.0)),
        house("cellar", (20.0, -20.0), bottom_m=0.0, top_m=5.1),
    ),
    poles=POLES,
    crosswalks_m=np.array(
        [
            [12.0, -4.0],
            [12.0, 4.0],
            [90.0, -4.0],
            [90.0, 4.0],
        ]
    ).reshape(2, 2, 2)
    + AT_M,
)


def cut(*sources, radius_m=50.0):
    """What lies around the junction."""
    return cut_out(sources, JUNCTION, radius_m=radius_m)


def scene_around(found, *, source_crs="", radius_m=50.0):
    """The scene of what lies around the junction."""
    return build_scene(
        found,
        name="a",
        source_crs=source_crs,
        sites=(),
        radius_m=radius_m,
    )


def lines_of(scene, kind):
    """Centrelines of lanes of a kind, by id."""
    return {one.id: one.centreline_m for one in scene.lanes if one.kind == kind}


def notes_of(found):
    """Reasons of what was told, by what it is about."""
    return {skip.what: skip.why for skip in found.skipped}


def unit(vector):
    """A vector in the same direction, of length 1."""
    return vector / np.linalg.norm(vector, axis=-1)


def test_what_lies_around_the_junction_is_taken_and_nothing_else():
    found = cut(ROADS)
    lanes = {one.id: one for one in found.lanes}

    assert sorted(lanes) == ["further", "in", "out"]
    assert np.linalg.norm(lanes["in"].centreline_m[0]) == pytest.approx(120.0, abs=1e-6)
    assert np.linalg.norm(lanes["in"].centreline_m[-1]) < 9.0
    assert found.outline_m == pytest.approx(SQUARE_M, abs=0.5)
    assert [one.id for one in found.things] == ["near"]

    heights = found.things[0].vertices_m[:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((0.0, 6.0))

    (pole,) = found.poles
    assert pole.id == "lamp-1"
    assert pole.position_m[2] == 0.0
    assert len(found.crosswalks_m) == 1

    told = notes_of(found)
    assert told["1 things in roads.xodr"] == "farther than 50 m from the junction"
    assert told["1 x building in roads.xodr"] == "not above the road"


def test_a_scene_has_ground_things_and_bodies_of_poles_and_a_junction():
    found = cut(ROADS)
    scene = scene_around(found, source_crs=UTM)

    assert [(one.id, one.class_name) for one in scene.instances] == [
        ("ground", "ground"),
        ("near", "building"),
        ("lamp-1", "lamp post"),
    ]

    post = scene.vertices_m[np.unique(scene.triangles[scene.triangle_instance == 2])]
    assert (post[:, 2].min(), post[:, 2].max()) == pytest.approx((0.0, 6.0))

    (arm,) = build_junction(scene).arms.values()
    assert [one.id for one in arm.entry_lanes] == ["in"]
    assert [one.id for one in arm.exit_lanes] == ["out"]
    # The lane goes on behind the place where its first piece ends.
    assert arm.lanes_out[0].centreline_m[-1, 0] == pytest.approx(120.0, abs=0.6)


@given(east_m=st.floats(-400.0, 400.0), north_m=st.floats(-400.0, 400.0))
def test_distances_are_metres_on_the_ground_and_places_stay(east_m, north_m):
    frame = frame_at(ROADS, AT_M)
    point = AT_M + [east_m, north_m]
    here = frame.take(point, ROADS)
    lon_lat = transform(here, frame.crs, "EPSG:4326")

    assert transform(lon_lat, "EPSG:4326", UTM) == pytest.approx(point, abs=1e-4)

    # UTM shrinks by up to 0.04 % there and is turned by the convergence of its
    # meridians.
    away_m = np.hypot(east_m, north_m)
    assert np.linalg.norm(here, axis=-1) == pytest.approx(away_m, rel=5e-4, abs=0.01)


def test_a_map_of_no_known_place_is_moved_to_the_junction():
    roads = replace(ROADS, crs="", source_crs="")
    found = cut(roads)

    assert found.frame.crs == ""
    assert found.frame.origin_m == pytest.approx(AT_M)
    assert found.outline_m == pytest.approx(SQUARE_M)

    scene = scene_around(found)
    assert scene.source_origin_m == pytest.approx(AT_M)


def city_at(middle_m):
    """A model of a city in another reference system, with a house 500 m up."""
    crs = "EPSG:3857"
    there = transform(transform(middle_m, UTM, "EPSG:4326"), "EPSG:4326", crs)
    vertices, triangles = extrude(there + SQUARE_M, bottom_m=500.0, top_m=510.0)
    thing = Thing(
        id="near",
        class_name="building",
        vertices_m=vertices,
        triangles=triangles,
    )
    return SourceMap(
        name="c.gml",
        crs=crs,
        heights="absolute",
        things=(thing,),
    )


def test_other_files_lie_where_they_say():
    there = AT_M + [30.0, -30.0]
    found = cut(ROADS, city_at(there))

    assert [one.id for one in found.things] == ["near", "c.gml-near"]

    corners = found.things[1].vertices_m
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))

    assert middle[:2] == pytest.approx(found.frame.take(there, ROADS), abs=0.05)
    assert corners[:, 2].min() == pytest.approx(0.0)  # its own lowest point


def test_other_files_that_say_nothing_lie_where_the_roads_are():
    things = (house("x", (0.0, 30.0), bottom_m=0.0, top_m=6.0),)
    silent = replace(city_at(AT_M), crs="", things=things, heights="above ground")
    corners = cut(ROADS, silent).things[1].vertices_m

    assert corners[:, :2].mean(axis=0) == pytest.approx([0.0, 30.0], abs=1.0)


def test_roads_of_no_known_place_go_with_no_file_that_says_where_it_lies():
    told = r"c\.gml: got coordinates in EPSG:3857; expected a file"
    with pytest.raises(InputError, match=told):
        cut(replace(ROADS, crs=""), city_at(AT_M))


def test_coordinates_that_cannot_be_are_refused():
    wild = replace(JUNCTION, outline_m=SQUARE_M + 1.0e12)
    with pytest.raises(InputError, match=r"roads\.xodr: got"):
        cut_out([ROADS], wild, radius_m=50.0)


# Lanes through other junctions, and beyond the map


def crossing_map(*, goes_on=True, aside_m=0.0):
    """A junction with an arm of 20 m to the east, where another junction lies."""
    lanes = [
        lane("near in", [(28.0, 1.5), (8.0, 1.5)], to="j", start="k"),
        lane("near out", [(8.0, -1.5), (28.0, -1.5)], start="j", to="k"),
        lane("side", [(34.0, 40.0), (34.0, 8.0)], to="k"),
    ]
    if goes_on:
        left_m = aside_m + 1.5
        right_m = aside_m - 1.5
        lanes += [
            lane("far in", [(300.0, left_m), (40.0, left_m)], to="k"),
            lane("far out", [(40.0, right_m), (80.0, right_m)], start="k"),
        ]
    other = replace(JUNCTION, id="k", outline_m=JUNCTION.outline_m + [34.0, 0.0])
    return replace(
        ROADS,
        lanes=tuple(lanes),
        junctions=(JUNCTION, other),
        things=(),
        poles=(),
    )


def imported(source):
    """What lies within 80 m of the junction, and its scene."""
    surroundings = cut(source, radius_m=80.0)
    return surroundings, scene_around(surroundings, radius_m=80.0)


@pytest.mark.parametrize("aside_m", [0.0, 1.0])
def test_lanes_are_led_straight_on_through_another_junction(aside_m):
    surroundings, scene = imported(crossing_map(aside_m=aside_m))
    through = lines_of(scene, "connecting")

    assert through.keys() == {"far in to near in", "near out to far out"}

    lanes = {one.id: one.centreline_m for one in scene.lanes}
    middle = through["near out to far out"]

    assert middle[0] == pytest.approx(lanes["near out"][-1])
    assert middle[-1] == pytest.approx(lanes["far out"][0])

    # From one to the other it swings no farther aside than they lie.
    chord = unit(middle[-1] - middle[0])
    ahead_m = (middle - middle[0]) @ chord
    left_m = (middle - middle[0]) @ [-chord[1], chord[0]]

    assert (np.diff(ahead_m) > 0.0).all()
    assert np.abs(left_m).max() <= 0.2 * aside_m + 0.02

    (arm,) = build_junction(scene).arms.values()
    (entry,) = arm.entry_lanes
    (leaving,) = arm.exit_lanes

    assert np.linalg.norm(entry.centreline_m[0]) == pytest.approx(150.0)
    assert leaving.centreline_m[-1] == pytest.approx(lanes["far out"][-1])

    # The circle cuts the lane off: the map goes on, and nothing is assumed.
    assert not lines_of(scene, "assumed")
    assert "other junctions around it" in notes_of(surroundings)


@pytest.mark.parametrize(
    ("more", "led"),
    [
        (slice(0, 2), {"near out to far out", "second out to second far"}),
        # Where lanes merge or part, each of them has a way on.
        (slice(0, 1), {"near out to far out", "second out to far out"}),
        (slice(1, 2), {"near out to far out", "near out to second far"}),
    ],
)
def test_each_lane_leads_into_the_one_for_which_it_bends_least(more, led):
    source = crossing_map()
    second = (
        lane("second out", [(8.0, -4.5), (28.0, -4.5)], start="j", to="k"),
        lane("second far", [(40.0, -4.5), (80.0, -4.5)], start="k"),
    )
    _, scene = imported(replace(source, lanes=(*source.lanes, *second[more])))

    assert lines_of(scene, "connecting").keys() == {"far in to near in", *led}


def test_where_the_map_ends_a_lane_is_assumed_and_told():
    surroundings, scene = imported(crossing_map(goes_on=False))
    assert "other junctions around it" not in notes_of(surroundings)

    (assumed,) = lines_of(scene, "assumed").values()
    entry = lines_of(scene, "driving")["near in"]

    assert assumed[-1] == pytest.approx(entry[0])
    assert assumed[0] == pytest.approx(entry[0] - 60.0 * unit(entry[1] - entry[0]))

    ((name, why),) = arms_that_end(scene)
    assert name == "east"
    assert why.startswith("the map ends 20 m from the junction")

    levels = [finding.level for finding in check_scene(scene) if finding.why == why]
    assert levels == ["warning"]


def test_a_lane_that_only_turns_at_another_junction_is_not_led_on():
    _, scene = imported(crossing_map(goes_on=False))
    assert not lines_of(scene, "connecting")


def test_the_maps_own_lanes_lead_through_junctions_and_else_straight_ones():
    def through(name, junction, line_m):
        points = np.array(line_m) + AT_M
        line = np.column_stack([points, np.full(len(points), 5.0)])
        made = lane(name, [(0.0, 0.0), (1.0, 0.0)], start=junction, to=junction)
        return replace(made, centreline_m=line)

    connections = (
        through(
            "own turn",
            "j",
            [
                (1.5, 8.0),
                (2.0, 3.0),
                (8.0, -1.5),
            ],
        ),
        through(
            "their way",
            "k",
            [
                (28.0, -1.5),
                (34.0, -0.5),
                (40.0, -1.5),
            ],
        ),
        through(
            "their turn",
            "k",
            [
                (28.0, -1.5),
                (33.0, -1.5),
                (34.0, -0.5),
                (34.0, 8.0),
            ],
        ),
        through("far away", "k", [(928.0, -1.5), (940.0, -1.5)]),
    )
    surroundings, scene = imported(replace(crossing_map(), connections=connections))
    found = lines_of(scene, "connecting")

    assert found.keys() == {"own turn", "their way"}
    assert len(found["their way"]) == 3
    assert "other junctions around it" not in notes_of(surroundings)

    (arm,) = build_junction(scene).arms.values()
    # From here, over that way, and beyond.
    assert len(arm.exit_lanes[0].centreline_m) == 5


def with_houses(middles):
    """The lane from the east ends 20 m from the middle; houses of 4 m stand there.

    Returned are the scene and the lanes that are assumed beyond.
    """
    houses = tuple(house(f"house {x} {y}", (x, y)) for x, y in middles)
    _, scene = imported(replace(crossing_map(goes_on=False), things=houses))
    assumed = [one for one in scene.lanes if one.kind == "assumed"]

    footprints = []
    for index, instance in enumerate(scene.instances):
        if instance.class_name == "building":
            footprints.append(thing_footprint(scene, index))

    assert len(footprints) == len(houses)

    built = shapely.union_all(footprints)
    for one in assumed:
        line = shapely.LineString(one.centreline_m)
        strip = line.buffer(0.5 * one.width_m, cap_style="flat")
        assert not shapely.intersects(built, strip)

    return scene, assumed


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_assumed_road_bends_past_a_house(side):
    scene, (road,) = with_houses([(50.0, 1.5 + side * 2.5)])
    junction = build_junction(scene)
    (entry,) = junction.arms["east"].entry_lanes
    # On a circle of 100 m that touches the lane at its begin, about a point away from
    # the house.
    begin = entry.centreline_m[0]
    line = Line(point_m=begin, direction=begin - entry.centreline_m[-1])
    ahead, left = line.coordinates(road.centreline_m[:-1]).T

    assert (ahead**2 + left**2) / (2.0 * left) == pytest.approx(-side * 100.0)
    assert junction.is_led_on(entry)

    followed = junction.followed(entry).centreline_m
    assert followed[0] == pytest.approx(road.centreline_m[0])

    own = followed[-len(entry.centreline_m) :]
    assert own == pytest.approx(entry.centreline_m)

    ((_, why),) = arms_that_end(scene)
    assert "come round a bend, past the buildings there" in why


def row_at(east_m):
    """Places of a row of houses from south to north."""
    return [(east_m, north_m) for north_m in range(-60, 61, 3)]


def test_an_assumed_road_ends_where_no_bend_leads_past_houses():
    _, (road,) = with_houses(row_at(50))  # their fronts are at 48 m
    begin, end = road.centreline_m
    assert np.linalg.norm(begin - end) == pytest.approx(19.7, abs=0.02)


def test_no_road_is_assumed_where_houses_stand_right_behind_the_map():
    scene, roads = with_houses(row_at(31))
    assert not roads

    junction = build_junction(scene)
    (entry,) = junction.arms["east"].entry_lanes

    assert not junction.is_led_on(entry)
