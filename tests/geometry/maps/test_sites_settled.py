"""Poles and sites beside the road, wherever the map has them."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from osm_drawing import drawn_crossing, read_drawing

from geometry.maps.cut import cut_out
from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.sites import choose_sites, find_places, settle_poles
from geometry.maps.source_map import Pole, SourceMap, Thing, extrude
from geometry.scene import covered_area, road_area
from geometry.scene_checks import check_scene

WIDE = "lanes=4; highway=secondary"


@pytest.fixture(scope="module")
def around(tmp_path_factory):
    """What lies around a crossing of wide streets."""
    folder = tmp_path_factory.mktemp("map")
    source = read_drawing(drawn_crossing(WIDE), folder, keeps_left=False)
    return cut_out([source], source.junctions[0], radius_m=60.0)


PLACE = st.floats(-70.0, 70.0)


PLACES = st.lists(st.tuples(PLACE, PLACE), min_size=1, max_size=8)


@given(points=PLACES)
def test_no_place_lies_on_a_lane_and_none_moves_without_need(around, points):
    road = covered_area(around.outline_m, around.lanes)
    found = find_places(points, around)

    for point, place in zip(points, found, strict=True):
        is_on_road = road.distance(shapely.Point(point)) == 0.0
        assert bool(place.why) == is_on_road

        if place.position_m is None:
            continue
        away_m = float(np.linalg.norm(place.position_m - point))
        clearance_m = road.distance(shapely.Point(place.position_m))

        assert away_m <= 15.0
        if not is_on_road:
            assert clearance_m > 0.0
            continue
        assert clearance_m > 0.4

        # No point on a circle that is clearly smaller is half a metre beside the road.
        ring = shapely.Point(point).buffer(0.9 * away_m, quad_segs=32)
        on_ring = shapely.points(np.array(ring.exterior.coords))

        assert shapely.distance(on_ring, road).max() < 0.5


def solid(middle, size_m, *, bottom_m=0.0, class_name="wall", name="w1"):
    """A box, 8 m long from south to north and 3 m high."""
    corners = np.array(
        [
            [-1.0, -1.0],
            [1.0, -1.0],
            [1.0, 1.0],
            [-1.0, 1.0],
        ]
    ) * [0.5 * size_m, 4.0]
    vertices, triangles = extrude(
        corners + middle,
        bottom_m=bottom_m,
        top_m=bottom_m + 3.0,
    )
    return Thing(
        id=name,
        class_name=class_name,
        vertices_m=vertices,
        triangles=triangles,
    )


def test_what_stands_in_a_wall_is_moved_out_of_it_or_refused(around):
    thin = replace(around, things=(solid((30.0, 30.0), 0.5),))
    (place,) = find_places([(30.1, 30.0)], thin)

    assert place.position_m == pytest.approx([30.55, 30.0])
    assert place.why == "it stood inside wall w1: moved 0.4 m out of it"

    thick = replace(around, things=(solid((30.0, 30.0), 8.0),))
    (place,) = find_places([(30.0, 30.0)], thick)

    assert place.position_m is None
    assert place.why == "it stands inside wall w1, farther than 2 m from where it could"


def test_a_signal_over_the_road_is_left_to_its_pole_and_others_go_to_the_kerb(around):
    poles = (
        *lamps([(16.0, 16.0)], id="mast", kind="pole"),
        *lamps([(12.0, 5.0)], id="head", kind="traffic light"),
        *lamps([(-40.0, 1.0)], id="alone", kind="sign"),
    )
    settled, told = settle_poles(replace(around, poles=poles))

    assert [pole.id for pole in settled.poles] == ["mast", "alone"]
    assert settled.poles[0] is poles[0]
    assert [skip.what for skip in told] == ["traffic light head", "sign alone"]
    assert told[0].why == "it hangs over the road: its pole is mast"
    assert told[1].why.startswith("it stood on a lane or in the junction: moved ")


def test_an_import_has_no_site_in_a_lane_and_says_what_it_moved(tmp_path):
    osm = drawn_crossing(WIDE).draw("""
        node 1 1: traffic_sign=DE:206
        node 30 2: traffic_sign=DE:206
        node -2 40: traffic_sign=DE:206
        node 20 20: traffic_sign=DE:206
        node 25 25: man_made=pole; height=1
    """)
    imported = import_scene([osm.write(tmp_path)], ImportOptions(sites="map"))
    road = road_area(imported.scene)
    feet = [shapely.Point(site.position_m[:2]) for site in imported.scene.sites]

    assert len(feet) == 4
    assert min(road.distance(foot) for foot in feet) > 0.4

    told = {note.what: note.why for note in imported.scene.notes}
    assert sum("moved" in why for why in told.values()) == 3
    assert any(why == "1 m high: too low for sensors" for why in told.values())

    found = check_scene(imported.scene)
    assert not [one for one in found if one.what.startswith("site")]


def lamps(places, **about):
    """Lamp posts p0, p1 and so on at places, unless more is said about them."""
    poles = []
    for number, at in enumerate(np.array(places)):
        told = {"kind": "lamp post", "id": f"p{number}"} | about
        poles.append(Pole(position_m=np.append(at, 0.0), **told))
    return tuple(poles)


def chosen(around, where="auto"):
    """Sites by their ids, and notes in one text."""
    source = SourceMap(name="map", crs="")
    sites, notes = choose_sites(where, around, source, radius_m=60.0)
    told = "; ".join(f"{note.what}: {note.why}" for note in notes)
    return {site.id: site for site in sites}, told


def test_masts_are_added_where_no_pole_is_near_the_middle(around):
    near = replace(around, poles=lamps([(17.0, 17.0), (40.0, 17.0)]))
    sites, told = chosen(near)

    assert set(sites) == {"p0", "p1"}
    assert told == ""

    far = replace(around, poles=lamps([(20.0, 20.0), (40.0, 17.0)]))
    sites, told = chosen(far)

    assert {"p0", "p1", "kerb-ne-1", "kerb-sw-1"} < set(sites)

    why = "the nearest one stands 28 m from the junction's middle: masts every 15 m"
    assert why in told
    assert set(chosen(far, "map")[0]) == {"p0", "p1"}


def test_poles_of_another_junction_are_no_sites_by_default(around):
    neighbour_m = np.array(
        [
            [47.0, -8.0],
            [63.0, -8.0],
            [63.0, 8.0],
            [47.0, 8.0],
        ]
    )
    poles = lamps(
        [
            (17.0, 17.0),
            (30.0, 17.0),
            (45.0, 17.0),
        ]
    )
    other = replace(around, poles=poles, neighbours_m=(neighbour_m,))
    sites, told = chosen(other)

    assert set(sites) == {"p0", "p1"}
    assert told == (
        "lamp post p2: within 15 m of another junction, nearer than here: no site"
        " unless asked for"
    )
    assert set(chosen(other, "map")[0]) == {"p0", "p1", "p2"}


def test_low_sign_posts_are_no_sites_by_default(around):
    poles = (
        *lamps([(17.0, 17.0)]),
        *lamps([(17.0, -17.0)], id="unknown", kind="sign"),
        *lamps([(-17.0, 17.0)], id="low", kind="sign", height_m=4.4),
        *lamps([(-17.0, -17.0)], id="high", kind="sign", height_m=6.0),
    )
    posts = replace(around, poles=poles)
    sites, told = chosen(posts)

    assert set(sites) == {"p0", "high"}
    assert told.startswith("2 sign posts, such as unknown: lower than 4.5 m")
    assert set(chosen(posts, "map")[0]) == {"p0", "unknown", "low", "high"}


def test_other_junctions_are_known_to_what_is_cut_out(tmp_path):
    osm = drawn_crossing().draw("""
        road 0 -100, 70 -70, 140 -40
        road 70 -70, 70 -170
    """)
    source = read_drawing(osm, tmp_path, keeps_left=False)

    assert len(source.junctions) == 2
    for junction in source.junctions:
        for radius_m, n_neighbours in ((80.0, 1), (40.0, 0)):
            found = cut_out([source], junction, radius_m=radius_m)
            assert len(found.neighbours_m) == n_neighbours


ROOF = {"class_name": "building", "name": "roof"}
HOUSE = solid((-20.0, 20.0), 8.0, class_name="building", name="house")
LAMPS = [
    (17.0, 17.0),
    (17.0, -17.0),
    (-19.0, 19.0),
]  # below the roof, in the open, inside the house


@pytest.mark.parametrize(
    ("bottom_m", "heights_m"),
    [
        (4.5, [4.0, 4.2]),
        (20.0, [4.0, 8.0]),
    ],
)
def test_sites_stand_below_roofs_but_not_inside_houses(around, bottom_m, heights_m):
    roof = solid((20.0, 20.0), 8.0, bottom_m=bottom_m, **ROOF)
    covered = replace(around, things=(roof, HOUSE), poles=lamps(LAMPS))
    sites, told = chosen(covered, "map")

    assert set(sites) == {"p0", "p1"}
    assert sites["p0"].height_range_m.tolist() == heights_m
    assert sites["p1"].height_range_m.tolist() == [4.0, 8.0]
    assert "site p2: it stands inside building house" in told


def test_a_low_roof_leaves_no_room_for_a_site(around):
    roof = solid((20.0, 20.0), 8.0, bottom_m=2.5, **ROOF)
    sites, told = chosen(replace(around, things=(roof,), poles=lamps(LAMPS)), "map")

    assert set(sites) == {"p1", "p2"}
    assert "site p0: below a roof 2.5 m above the ground: too low for sensors" in told


def test_a_check_finds_every_site_on_the_road(tmp_path):
    path = drawn_crossing(WIDE).write(tmp_path)
    scene = import_scene([path], ImportOptions(sites="kerb:15")).scene
    one, two, three, *rest = scene.sites
    moved = (
        replace(one, position_m=np.array([0.5, 0.5, 0.0])),
        replace(two, position_m=np.array([40.0, 1.5, 0.0])),
        replace(three, position_m=np.array([40.0, 1.5, 0.0]), kind="mast arm"),
    )
    found = check_scene(replace(scene, sites=(*moved, *rest)))
    told = {one.what: one.why for one in found if one.what.startswith("site")}

    assert set(told) == {f"site {one.id}", f"site {two.id}"}
    assert told[f"site {one.id}"].startswith("it stands in the junction")
    assert told[f"site {two.id}"].startswith("it stands on lane ")
