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

SQUARE_M = 8.0 * np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
UTM = "EPSG:25832"
AT_M = np.array([691_000.0, 5_334_000.0])  # Munich, more or less


def lane(
    name, begin, end, *, kind="driving", to="", start="", height_m=0.0, n_points=2
):
    share = np.linspace(0.0, 1.0, n_points)[:, None]
    points = np.array(begin) + share * (np.array(end, dtype=float) - begin)
    return MapLane(
        id=name,
        kind=kind,
        width_m=3.0,
        centreline_m=np.column_stack([points + AT_M, np.full(n_points, height_m)]),
        to_junction=to,
        from_junction=start,
    )


def thing(name, middle, *, class_name="building", bottom_m=0.0, top_m=6.0):
    corners = np.array(middle) + 2.0 * SQUARE_M / 8.0 + AT_M
    vertices, triangles = extrude(corners, bottom_m=bottom_m, top_m=top_m)
    return Thing(
        id=name, class_name=class_name, vertices_m=vertices, triangles=triangles
    )


JUNCTION = MapJunction(id="j", name="A / B", outline_m=SQUARE_M + AT_M, height_m=5.0)
LANES = (
    lane("in", (300.0, 1.5), (8.0, 1.5), to="j", height_m=5.0, n_points=30),
    lane("out", (8.0, -1.5), (60.0, -1.5), start="j", height_m=5.0),
    lane("further", (60.0, -1.5), (120.0, -1.5), height_m=5.0, n_points=7),
    lane("bridge", (-50.0, 8.0), (50.0, 8.5), height_m=12.0),
    lane("stranger", (-8.5, 3.0), (-40.0, 3.0), height_m=5.0),
    lane("walk", (60.0, 5.0), (8.0, 5.0), kind="walking", to="j", height_m=5.0),
)
ROADS = SourceMap(
    name="roads.xodr",
    crs=UTM,
    source_crs=UTM,
    heights="absolute",
    lanes=LANES,
    junctions=(JUNCTION,),
    things=(
        thing("near", (20.0, 20.0), bottom_m=5.0, top_m=11.0),
        thing("far", (200.0, 20.0), bottom_m=5.0, top_m=11.0),
        thing("cellar", (20.0, -20.0), bottom_m=0.0, top_m=5.1),
    ),
    poles=(
        Pole(
            id="lamp, 1",
            kind="lamp post",
            position_m=[*(AT_M + [10.0, 10.0]), 5.0],
            height_m=6.0,
        ),
        Pole(id="off", kind="sign", position_m=[*(AT_M + [500.0, 0.0]), 5.0]),
    ),
    crosswalks_m=np.array([[[12.0, -4.0], [12.0, 4.0]], [[90.0, -4.0], [90.0, 4.0]]])
    + AT_M,
)


def test_what_lies_around_the_junction_is_taken_and_nothing_else():
    found = cut_out([ROADS], JUNCTION, radius_m=50.0)
    lanes = {one.id: one for one in found.lanes}
    assert sorted(lanes) == ["further", "in", "out"]
    assert np.hypot(*lanes["in"].centreline_m[0]) == pytest.approx(120.0, abs=1e-6)
    assert np.hypot(*lanes["in"].centreline_m[-1]) < 9.0
    assert found.outline_m == pytest.approx(SQUARE_M, abs=0.5)
    assert [one.id for one in found.things] == ["near"]
    heights = found.things[0].vertices_m[:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((0.0, 6.0))
    (pole,) = found.poles
    assert pole.id == "lamp-1"
    assert pole.position_m[2] == 0.0
    assert len(found.crosswalks_m) == 1
    told = {skip.what: skip.why for skip in found.skipped}
    assert told["1 things in roads.xodr"] == "farther than 50 m from the junction"
    assert told["1 x building in roads.xodr"] == "not above the road"


def test_a_scene_has_ground_things_and_bodies_of_poles_and_a_junction():
    found = cut_out([ROADS], JUNCTION, radius_m=50.0)
    scene = build_scene(found, name="a", source_crs=UTM, sites=(), radius_m=50.0)
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
    assert np.hypot(*here) == pytest.approx(
        np.hypot(east_m, north_m), rel=5e-4, abs=0.01
    )


def test_a_map_of_no_known_place_is_moved_to_the_junction():
    roads = replace(ROADS, crs="", source_crs="")
    found = cut_out([roads], JUNCTION, radius_m=50.0)
    assert found.frame.crs == ""
    assert found.frame.origin_m == pytest.approx(AT_M)
    assert found.outline_m == pytest.approx(SQUARE_M)
    scene = build_scene(found, name="a", source_crs="", sites=(), radius_m=50.0)
    assert scene.source_origin_m == pytest.approx(AT_M)


def test_other_files_lie_where_they_say_or_where_the_roads_are():
    lon_lat = transform(AT_M + [30.0, -30.0], UTM, "EPSG:4326")
    other_crs = "EPSG:3857"
    there = transform(lon_lat, "EPSG:4326", other_crs)
    vertices, triangles = extrude(there + SQUARE_M, bottom_m=500.0, top_m=510.0)
    house = Thing(
        id="near", class_name="building", vertices_m=vertices, triangles=triangles
    )
    city = SourceMap(name="c.gml", crs=other_crs, heights="absolute", things=(house,))
    found = cut_out([ROADS, city], JUNCTION, radius_m=50.0)
    assert [one.id for one in found.things] == ["near", "c.gml-near"]
    corners = found.things[1].vertices_m
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    assert middle[:2] == pytest.approx(
        found.frame.take(AT_M + [30.0, -30.0], ROADS), abs=0.05
    )
    assert found.things[1].vertices_m[:, 2].min() == pytest.approx(
        0.0
    )  # its own lowest point
    silent = replace(
        city, crs="", things=(thing("x", (0.0, 30.0)),), heights="above ground"
    )
    found = cut_out([ROADS, silent], JUNCTION, radius_m=50.0)
    assert found.things[1].vertices_m[:, :2].mean(axis=0) == pytest.approx(
        [0.0, 30.0], abs=1.0
    )
    with pytest.raises(
        InputError, match=r"c\.gml: got coordinates in EPSG:3857; expected a file"
    ):
        cut_out([replace(ROADS, crs=""), city], JUNCTION, radius_m=50.0)


def test_coordinates_that_cannot_be_are_refused():
    wild = replace(JUNCTION, outline_m=SQUARE_M + 1.0e12)
    with pytest.raises(InputError, match=r"roads\.xodr: got"):
        cut_out([ROADS], wild, radius_m=50.0)


# Lanes through other junctions, and beyond the map


def crossing_map(*, goes_on=True, aside_m=0.0):
    """A junction with an arm of 20 m to the east, where another junction lies."""
    lanes = [
        lane("near in", (28.0, 1.5), (8.0, 1.5), to="j", start="k", height_m=5.0),
        lane("near out", (8.0, -1.5), (28.0, -1.5), start="j", to="k", height_m=5.0),
        lane("side", (34.0, 40.0), (34.0, 8.0), to="k", height_m=5.0),
    ]
    if goes_on:
        lanes += [
            lane(
                "far in",
                (300.0, 1.5 + aside_m),
                (40.0, 1.5 + aside_m),
                to="k",
                height_m=5.0,
            ),
            lane(
                "far out",
                (40.0, aside_m - 1.5),
                (80.0, aside_m - 1.5),
                start="k",
                height_m=5.0,
            ),
        ]
    other = replace(JUNCTION, id="k", outline_m=JUNCTION.outline_m + [34.0, 0.0])
    return replace(
        ROADS, lanes=tuple(lanes), junctions=(JUNCTION, other), things=(), poles=()
    )


def imported(source):
    surroundings = cut_out([source], JUNCTION, radius_m=80.0)
    return surroundings, build_scene(
        surroundings, name="s", source_crs="", sites=(), radius_m=80.0
    )


@pytest.mark.parametrize("aside_m", [0.0, 1.0])
def test_lanes_are_led_straight_on_through_another_junction(aside_m):
    surroundings, scene = imported(crossing_map(aside_m=aside_m))
    through = {one.id: one for one in scene.lanes if one.kind == "connecting"}
    assert through.keys() == {"far in to near in", "near out to far out"}
    lanes = {one.id: one.centreline_m for one in scene.lanes}
    middle = through["near out to far out"].centreline_m
    assert middle[0] == pytest.approx(lanes["near out"][-1])
    assert middle[-1] == pytest.approx(lanes["far out"][0])
    # From one to the other it swings no farther aside than they lie.
    chord = (middle[-1] - middle[0]) / np.hypot(*(middle[-1] - middle[0]))
    ahead_m = (middle - middle[0]) @ chord
    left_m = (middle - middle[0]) @ [-chord[1], chord[0]]
    assert (np.diff(ahead_m) > 0.0).all()
    assert np.abs(left_m).max() <= 0.2 * aside_m + 0.02
    (arm,) = build_junction(scene).arms.values()
    (entry,), (leaving,) = arm.entry_lanes, arm.exit_lanes
    assert np.hypot(*entry.centreline_m[0]) == pytest.approx(150.0)
    assert leaving.centreline_m[-1] == pytest.approx(lanes["far out"][-1])
    # The circle cuts the lane off: the map goes on, and nothing is assumed.
    assert not [one for one in scene.lanes if one.kind == "assumed"]
    assert "other junctions around it" in {skip.what for skip in surroundings.skipped}


def test_where_the_map_ends_a_lane_is_assumed_and_told():
    surroundings, scene = imported(crossing_map(goes_on=False))
    assert "other junctions around it" not in {
        skip.what for skip in surroundings.skipped
    }
    (assumed,) = (one for one in scene.lanes if one.kind == "assumed")
    (entry,) = (one.centreline_m for one in scene.lanes if one.id == "near in")
    assert assumed.centreline_m[-1] == pytest.approx(entry[0])
    ahead = (entry[1] - entry[0]) / np.hypot(*(entry[1] - entry[0]))
    assert assumed.centreline_m[0] == pytest.approx(entry[0] - 60.0 * ahead)
    ((name, why),) = arms_that_end(scene)
    assert name == "east"
    assert why.startswith("the map ends 20 m from the junction")
    assert [f.level for f in check_scene(scene) if f.why == why] == ["warning"]


def test_a_lane_that_only_turns_at_another_junction_is_not_led_on():
    source = crossing_map(goes_on=False)
    _, scene = imported(source)
    assert not [one for one in scene.lanes if one.kind == "connecting"]


def test_the_maps_own_lanes_lead_through_junctions_and_else_straight_ones():
    def through(name, junction, *points):
        made = lane(
            name, points[0], points[-1], start=junction, to=junction, height_m=5.0
        )
        return replace(
            made,
            centreline_m=np.column_stack([points + AT_M, np.full(len(points), 5.0)]),
        )

    source = crossing_map()
    bend = [(28.0, -1.5), (34.0, -0.5), (40.0, -1.5)]
    source = replace(
        source,
        connections=(
            through("own turn", "j", (1.5, 8.0), (2.0, 3.0), (8.0, -1.5)),
            through("their way", "k", *bend),
            through(
                "their turn", "k", (28.0, -1.5), (33.0, -1.5), (34.0, -0.5), (34.0, 8.0)
            ),
            through("far away", "k", (928.0, -1.5), (940.0, -1.5)),
        ),
    )
    surroundings, scene = imported(source)
    found = {
        one.id: one.centreline_m for one in scene.lanes if one.kind == "connecting"
    }
    assert found.keys() == {"own turn", "their way"}
    assert len(found["their way"]) == len(bend)
    assert "other junctions around it" not in {
        skip.what for skip in surroundings.skipped
    }
    (arm,) = build_junction(scene).arms.values()
    assert (
        len(arm.exit_lanes[0].centreline_m) == 5
    )  # from here, over that way, and beyond


def with_houses(*middles):
    """The lane from the east ends 20 m from the middle; houses of 4 m stand there."""
    source = crossing_map(goes_on=False)
    houses = [
        thing(f"house {x} {y}", (x, y), bottom_m=5.0, top_m=11.0) for x, y in middles
    ]
    scene = imported(replace(source, things=tuple(houses)))[1]
    road = [one for one in scene.lanes if one.kind == "assumed"]
    strips = [
        shapely.LineString(one.centreline_m).buffer(0.5 * one.width_m, cap_style="flat")
        for one in road
    ]
    footprints = [
        thing_footprint(scene, index)
        for index, one in enumerate(scene.instances)
        if one.class_name == "building"
    ]
    assert len(footprints) == len(middles)
    assert not shapely.intersects(shapely.union_all(footprints), strips).any()
    return scene, road


@pytest.mark.parametrize(("side", "radius_m"), [(1.0, 100.0), (-1.0, 100.0)])
def test_an_assumed_road_bends_past_a_house(side, radius_m):
    scene, (road,) = with_houses((50.0, 1.5 + side * 2.5))
    junction = build_junction(scene)
    (entry,) = junction.arms["east"].entry_lanes
    # On a circle that touches the lane at its begin, about a point away from the house.
    line = Line(
        point_m=entry.centreline_m[0],
        direction=entry.centreline_m[0] - entry.centreline_m[-1],
    )
    ahead, left = line.coordinates(road.centreline_m[:-1]).T
    assert (ahead**2 + left**2) / (2.0 * left) == pytest.approx(-side * radius_m)
    assert junction.is_led_on(entry)
    followed = junction.followed(entry)
    assert followed.centreline_m[0] == pytest.approx(road.centreline_m[0])
    assert followed.centreline_m[-len(entry.centreline_m) :] == pytest.approx(
        entry.centreline_m
    )
    ((_, why),) = arms_that_end(scene)
    assert "come round a bend, past the buildings there" in why


def test_an_assumed_road_ends_where_no_bend_leads_past_houses():
    row = [(50.0, float(north)) for north in range(-60, 61, 3)]
    _, (road,) = with_houses(*row)  # their fronts are at 48 m
    assert np.hypot(*(road.centreline_m[0] - road.centreline_m[1])) == pytest.approx(
        19.7, abs=0.02
    )
    assert len(road.centreline_m) == 2
    close = [(31.0, float(north)) for north in range(-60, 61, 3)]
    scene, roads = with_houses(*close)
    assert not roads
    (entry,) = build_junction(scene).arms["east"].entry_lanes
    assert not build_junction(scene).is_led_on(entry)
