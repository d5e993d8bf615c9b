"""Poles and sites beside the road, wherever the map has them."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from osm_text import OsmText, crossing

from geometry.maps.cut import Surroundings, cut_out
from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.site_places import find_places, settle_poles
from geometry.maps.source_map import Pole, Thing
from geometry.scene import covered_area, road_area
from geometry.scene_checks import check_scene

FOUR = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> Surroundings:
    osm = OsmText()
    crossing(osm, bearings=FOUR, lanes="4", highway="secondary")
    source = read_openstreetmap(osm.write(tmp_path_factory.mktemp("map")), keeps_left=False)
    return cut_out([source], source.junctions[0], radius_m=60.0)


@given(
    points=st.lists(
        st.tuples(st.floats(-70.0, 70.0), st.floats(-70.0, 70.0)), min_size=1, max_size=8
    )
)
def test_no_place_lies_on_a_lane_and_none_moves_without_need(
    around: Surroundings, points: list[tuple[float, float]]
) -> None:
    road = covered_area(around.outline_m, around.lanes)
    for point, place in zip(points, find_places(points, around), strict=True):
        is_on_road = road.distance(shapely.Point(point)) == 0.0
        assert bool(place.why) == is_on_road
        if place.position_m is None:
            continue
        assert road.distance(shapely.Point(place.position_m)) > (0.4 if is_on_road else 0.0)
        away_m = float(np.hypot(*(place.position_m - point)))
        assert away_m <= 15.0
        # No point on a circle that is clearly smaller is half a metre beside the road.
        if is_on_road:
            ring = shapely.Point(point).buffer(0.9 * away_m, quad_segs=32)
            assert (
                shapely.distance(shapely.points(np.array(ring.exterior.coords)), road).max() < 0.5
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


def with_parts(around: Surroundings, **parts: object) -> Surroundings:
    from dataclasses import replace

    return replace(around, **parts)  # type: ignore[arg-type]


def test_what_stands_in_a_wall_is_moved_out_of_it_or_refused(around: Surroundings) -> None:
    thin = with_parts(around, things=(wall((30.0, 30.0), 0.5),))
    (place,) = find_places([(30.1, 30.0)], thin)
    assert place.position_m == pytest.approx([30.55, 30.0])
    assert place.why == "inside wall w1: moved 0.4 m out of it"
    thick = with_parts(around, things=(wall((30.0, 30.0), 8.0),))
    (place,) = find_places([(30.0, 30.0)], thick)
    assert place.position_m is None
    assert place.why == "inside wall w1, farther than 2 m from where it could"


def test_a_signal_over_the_road_is_left_to_its_pole_and_others_go_to_the_kerb(
    around: Surroundings,
) -> None:
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


def test_an_import_has_no_site_in_a_lane_and_says_what_it_moved(tmp_path: Path) -> None:
    osm = OsmText()
    crossing(osm, bearings=FOUR, lanes="4", highway="secondary")
    for place in ((1.0, 1.0), (30.0, 2.0), (-2.0, 40.0), (20.0, 20.0)):
        osm.node(*place, traffic_sign="DE:206")
    osm.node(25.0, 25.0, man_made="pole", height="1")
    imported = import_scene([osm.write(tmp_path)], ImportOptions())
    road = road_area(imported.scene)
    feet = [shapely.Point(site.position_m[:2]) for site in imported.scene.sites]
    assert len(feet) == 4
    assert min(road.distance(foot) for foot in feet) > 0.4
    told = {note.what: note.why for note in imported.scene.notes}
    assert sum("moved" in why for why in told.values()) == 3
    assert any(why == "1 m high: too low for sensors" for why in told.values())
    assert not [one for one in check_scene(imported.scene) if one.what.startswith("site")]


def test_a_check_finds_every_site_on_the_road(around: Surroundings, tmp_path: Path) -> None:
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
