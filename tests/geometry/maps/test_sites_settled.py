"""Poles and sites beside the road, wherever the map has them."""

from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from osm_text import OsmText, crossing

from geometry.maps.cut import CutSurroundings, cut_out
from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.sites import choose_sites, find_places, settle_poles
from geometry.maps.source_map import Pole, SourceMap, Thing
from geometry.scene import Site, covered_area, road_area
from geometry.scene_checks import check_scene

FOUR = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> CutSurroundings:
    osm = OsmText()
    crossing(osm, bearings=FOUR, lanes="4", highway="secondary")
    source = read_openstreetmap(
        osm.write(tmp_path_factory.mktemp("map")), keeps_left=False
    )
    return cut_out([source], source.junctions[0], radius_m=60.0)


@given(
    points=st.lists(
        st.tuples(st.floats(-70.0, 70.0), st.floats(-70.0, 70.0)),
        min_size=1,
        max_size=8,
    )
)
def test_no_place_lies_on_a_lane_and_none_moves_without_need(around, points):
    road = covered_area(around.outline_m, around.lanes)
    for point, place in zip(points, find_places(points, around), strict=True):
        is_on_road = road.distance(shapely.Point(point)) == 0.0
        assert bool(place.why) == is_on_road
        if place.position_m is None:
            continue
        assert road.distance(shapely.Point(place.position_m)) > (
            0.4 if is_on_road else 0.0
        )
        away_m = float(np.hypot(*(place.position_m - point)))
        assert away_m <= 15.0
        # No point on a circle that is clearly smaller is half a metre beside the road.
        if is_on_road:
            ring = shapely.Point(point).buffer(0.9 * away_m, quad_segs=32)
            assert (
                shapely.distance(
                    shapely.points(np.array(ring.exterior.coords)), road
                ).max()
                < 0.5
            )


def wall(position: tuple[float, float], size_m: float) -> Thing:
    import trimesh

    box = trimesh.creation.box(extents=[size_m, 8.0, 3.0])
    return Thing(
        id="w1",
        class_name="wall",
        vertices_m=np.asarray(box.vertices) + [*position, 1.5],
        triangles=np.asarray(box.faces, dtype=np.int32),
    )


def with_parts(around: CutSurroundings, **parts: object) -> CutSurroundings:
    from dataclasses import replace

    return replace(around, **parts)  # type: ignore[arg-type]


def test_what_stands_in_a_wall_is_moved_out_of_it_or_refused(around):
    thin = with_parts(around, things=(wall((30.0, 30.0), 0.5),))
    (place,) = find_places([(30.1, 30.0)], thin)
    assert place.position_m == pytest.approx([30.55, 30.0])
    assert place.why == "it stood inside wall w1: moved 0.4 m out of it"
    thick = with_parts(around, things=(wall((30.0, 30.0), 8.0),))
    (place,) = find_places([(30.0, 30.0)], thick)
    assert place.position_m is None
    assert place.why == "it stands inside wall w1, farther than 2 m from where it could"


def test_a_signal_over_the_road_is_left_to_its_pole_and_others_go_to_the_kerb(around):
    poles = (
        Pole(id="mast", kind="pole", position_m=np.array([16.0, 16.0, 0.0])),
        Pole(id="head", kind="traffic light", position_m=np.array([12.0, 5.0, 0.0])),
        Pole(id="alone", kind="sign", position_m=np.array([-40.0, 1.0, 0.0])),
    )
    settled, told = settle_poles(with_parts(around, poles=poles))
    assert [pole.id for pole in settled.poles] == ["mast", "alone"]
    assert settled.poles[0] is poles[0]
    assert [skip.what for skip in told] == ["traffic light head", "sign alone"]
    assert told[0].why == "it hangs over the road: its pole is mast"
    assert told[1].why.startswith("it stood on a lane or in the junction: moved ")


def test_an_import_has_no_site_in_a_lane_and_says_what_it_moved(tmp_path):
    osm = OsmText()
    crossing(osm, bearings=FOUR, lanes="4", highway="secondary")
    for place in ((1.0, 1.0), (30.0, 2.0), (-2.0, 40.0), (20.0, 20.0)):
        osm.node(*place, traffic_sign="DE:206")
    osm.node(25.0, 25.0, man_made="pole", height="1")
    imported = import_scene([osm.write(tmp_path)], ImportOptions(sites="map"))
    road = road_area(imported.scene)
    feet = [shapely.Point(site.position_m[:2]) for site in imported.scene.sites]
    assert len(feet) == 4
    assert min(road.distance(foot) for foot in feet) > 0.4
    told = {note.what: note.why for note in imported.scene.notes}
    assert sum("moved" in why for why in told.values()) == 3
    assert any(why == "1 m high: too low for sensors" for why in told.values())
    assert not [
        one for one in check_scene(imported.scene) if one.what.startswith("site")
    ]


def lamps(*positions: tuple[float, float], **about: Any) -> tuple[Pole, ...]:
    return tuple(
        Pole(
            **{"kind": "lamp post", "id": f"p{number}"} | about,
            position_m=np.array([*at, 0.0]),
        )
        for number, at in enumerate(positions)
    )


def chosen(around: CutSurroundings, where: str = "auto") -> tuple[dict[str, Site], str]:
    sites, told = choose_sites(
        where, around, SourceMap(name="map", crs=""), radius_m=60.0
    )
    return {site.id: site for site in sites}, "; ".join(
        f"{note.what}: {note.why}" for note in told
    )


def test_masts_are_added_where_no_pole_is_near_the_middle(around):
    near = with_parts(around, poles=lamps((17.0, 17.0), (40.0, 17.0)))
    sites, told = chosen(near)
    assert set(sites) == {"p0", "p1"}
    assert told == ""
    far = with_parts(around, poles=lamps((20.0, 20.0), (40.0, 17.0)))
    sites, told = chosen(far)
    assert {"p0", "p1", "kerb-ne-1", "kerb-sw-1"} < set(sites)
    assert (
        "the nearest one stands 28 m from the junction's middle: masts every 15 m"
        in told
    )
    assert set(chosen(far, "map")[0]) == {"p0", "p1"}


def test_poles_of_another_junction_are_no_sites_by_default(around):
    square = np.array([[-8.0, -8.0], [8.0, -8.0], [8.0, 8.0], [-8.0, 8.0]])
    poles = lamps((17.0, 17.0), (30.0, 17.0), (45.0, 17.0))
    other = with_parts(around, poles=poles, neighbours_m=(square + [55.0, 0.0],))
    sites, told = chosen(other)
    assert set(sites) == {"p0", "p1"}
    assert (
        told
        == "lamp post p2: within 15 m of another junction, nearer than here: no site"
        " unless asked for"
    )
    assert set(chosen(other, "map")[0]) == {"p0", "p1", "p2"}


def test_low_sign_posts_are_no_sites_by_default(around):
    lamp = lamps((17.0, 17.0))
    signs = (
        *lamps((17.0, -17.0), id="unknown", kind="sign"),
        *lamps((-17.0, 17.0), id="low", kind="sign", height_m=4.4),
        *lamps((-17.0, -17.0), id="high", kind="sign", height_m=6.0),
    )
    posts = with_parts(around, poles=(*lamp, *signs))
    sites, told = chosen(posts)
    assert set(sites) == {"p0", "high"}
    assert told.startswith("2 sign posts, such as unknown: lower than 4.5 m")
    assert set(chosen(posts, "map")[0]) == {"p0", "unknown", "low", "high"}


def test_other_junctions_are_known_to_what_is_cut_out(tmp_path):
    osm = OsmText()
    crossing(osm, bearings=FOUR)
    other = osm.node(70.0, -70.0)
    osm.road([(0.0, -100.0), other, (140.0, -40.0)])
    osm.road([other, (70.0, -170.0)])
    source = read_openstreetmap(osm.write(tmp_path), keeps_left=False)
    for junction in source.junctions:
        for radius_m, n_neighbours in ((80.0, 1), (40.0, 0)):
            assert (
                len(cut_out([source], junction, radius_m=radius_m).neighbours_m)
                == n_neighbours
            )
    assert len(source.junctions) == 2


@pytest.mark.parametrize(
    ("bottom_m", "heights_m"), [(4.5, [4.0, 4.2]), (20.0, [4.0, 8.0]), (2.5, None)]
)
def test_sites_stand_below_roofs_but_not_inside_houses(around, bottom_m, heights_m):
    def house(name: str, position: tuple[float, float], bottom_m: float) -> Thing:
        body = wall(position, 8.0)
        up = [0.0, 0.0, bottom_m]
        return Thing(
            id=name,
            class_name="building",
            vertices_m=body.vertices_m + up,
            triangles=body.triangles,
        )

    things = (house("roof", (20.0, 20.0), bottom_m), house("house", (-20.0, 20.0), 0.0))
    poles = lamps((17.0, 17.0), (17.0, -17.0), (-19.0, 19.0))
    sites, told = chosen(with_parts(around, things=things, poles=poles), "map")
    assert "site p2: it stands inside building house" in told
    assert set(sites) == ({"p1"} if heights_m is None else {"p0", "p1"})
    if heights_m is None:
        assert (
            "site p0: below a roof 2.5 m above the ground: too low for sensors" in told
        )
    else:
        assert sites["p0"].height_range_m.tolist() == heights_m
    assert sites["p1"].height_range_m.tolist() == [4.0, 8.0]


def test_a_check_finds_every_site_on_the_road(around, tmp_path):
    from dataclasses import replace

    osm = OsmText()
    crossing(osm, bearings=FOUR, lanes="4", highway="secondary")
    scene = import_scene([osm.write(tmp_path)], ImportOptions(sites="kerb:15")).scene
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
