"""Files that others have made."""

from collections import Counter

import numpy as np
import pytest
import shapely
from opendrive_text import arms_of

from geometry.maps.opendrive import read_opendrive
from geometry.study_scene import load_study_scene

LONG = pytest.mark.long  # smaller files, quickly: test_arms_and_what_stands_there


@pytest.fixture(scope="module")
def town05(real_input):
    """A town of the simulator CARLA."""
    return read_opendrive(real_input("opendrive/Town05.xodr"))


@LONG
def test_town05_has_its_junctions(town05):
    assert len(town05.junctions) == 21
    assert town05.skipped == ()
    assert town05.crs.startswith("+proj=tmerc +lat_0=4.9")
    assert Counter(one.kind for one in town05.lanes) == {
        "driving": 206,
        "walking": 108,
        "parking": 18,
    }


@LONG
def test_the_studys_junction_has_the_lanes_of_its_scene(town05):
    study = load_study_scene()
    middle = 0.5 * (study.outline_m.min(axis=0) + study.outline_m.max(axis=0))
    junction = min(
        town05.junctions,
        key=lambda one: np.linalg.norm(one.position_m - middle),
    )

    np.testing.assert_allclose(junction.position_m, [-126.5, -1.0], atol=0.5)

    arms = arms_of(town05, junction)
    assert arms == dict.fromkeys(("east", "north", "west", "south"), (2, 2))
    # The scene's lanes come from the same map through another reader; its junction is a
    # little larger.
    for kind in ("driving", "parking"):
        lines = []
        for one in town05.lanes:
            if one.kind == kind:
                lines.append(shapely.LineString(one.centreline_m[:, :2]))
        together = shapely.union_all(lines)

        for lane in study.lanes:
            if lane.kind == kind:
                gaps_m = shapely.distance(together, shapely.points(lane.centreline_m))
                assert gaps_m.max() < 0.1, lane.id


@LONG
def test_every_junction_of_town05_has_three_or_four_arms(town05):
    n_arms = {one.id: len(arms_of(town05, one)) for one in town05.junctions}
    three = {"224", "905", "924", "943", "1050", "1148", "1162", "1260"}

    assert {name for name, n in n_arms.items() if n == 3} == three
    assert set(n_arms.values()) == {3, 4}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "arms", "poles", "n_things", "n_crosswalks"),
    [
        ("X-Intersection_NCAP", [4], {}, 0, 0),
        ("StraightRoad_NCAP_noRoadmarks_Streetlights", [], {"lamp post": 7}, 0, 0),
        ("fabriksgatan_traffic_lights", [4], {"traffic light": 2}, 0, 0),
        (
            "multi_intersections",
            [4, 3, 4, 3, 3],
            {"traffic light": 34, "sign": 2},
            0,
            17,
        ),
        ("Town01", 12 * [3], {"traffic light": 36, "sign": 21}, 0, 0),
        ("Junction_with_building0", [3], {}, 1, 0),
        ("parking_demo", [3], {}, 10, 3),
    ],
)
def test_arms_and_what_stands_there(
    real_input, name, arms, poles, n_things, n_crosswalks
):
    source = read_opendrive(real_input(f"opendrive/{name}.xodr"))
    assert [len(arms_of(source, one)) for one in source.junctions] == arms
    assert Counter(pole.kind for pole in source.poles) == poles
    assert len(source.things) == n_things
    assert len(source.crosswalks_m) == n_crosswalks


@pytest.mark.long
def test_lanes_meet_their_continuation_at_the_roads_end(real_input):
    source = read_opendrive(real_input("opendrive/Town01.xodr"))
    inner = [one for one in source.lanes if one.kind == "driving"]
    starts = np.array([one.centreline_m[0] for one in inner])

    for one in inner:
        if not one.to_junction:
            away_m = np.linalg.norm(starts - one.centreline_m[-1], axis=1)
            assert away_m.min() < 0.5, one.id
