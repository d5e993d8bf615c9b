"""Arms of junctions against the roads that a map leads to them: stubs, medians, what is
missing.
"""

from pathlib import Path

import numpy as np
import pytest
from osm_text import OsmText, arm_lanes, arms_of, as_drawn

from geometry.errors import InputError
from geometry.maps.importing import choose_junction, sort_junctions, survey_junctions
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.source_map import SourceMap
from geometry.scene import LeadingRoad
from geometry.scene_checks import compare_arms


def read(osm: OsmText, folder: Path) -> SourceMap:
    return as_drawn(read_openstreetmap(osm.write(folder), keeps_left=False))


def dual_carriageway(stub_m: float) -> OsmText:
    """A T junction of a street with two carriageways, cut in two at its crosswalk to
    the north.

    As at Northgate: the carriageways have two lanes north of the cut and three south of
    it.
    """
    osm = OsmText()
    west_node = osm.node(-5.0, 0.0)
    east_node = osm.node(5.0, 0.0)
    cut_m = 10.0 + stub_m
    down_cut = osm.node(-5.0, cut_m)
    up_cut = osm.node(5.0, cut_m)
    avenue = {"name": "Avenue", "oneway": "yes", "highway": "secondary"}
    osm.road([(-5.0, 120.0), down_cut], lanes="2", **avenue)
    osm.road([down_cut, west_node, (-5.0, -120.0)], lanes="3", **avenue)
    osm.road([(5.0, -120.0), east_node, up_cut], lanes="3", **avenue)
    osm.road([up_cut, (5.0, 120.0)], lanes="2", **avenue)
    osm.road([east_node, west_node, (-120.0, 0.0)], name="Street", lanes="2")
    return osm


@pytest.mark.parametrize("stub_m", [1.5, 3.0, 6.0])
def test_a_stub_between_crosswalk_and_junction_is_no_arm(stub_m, tmp_path):
    source = read(dual_carriageway(stub_m), tmp_path)
    (junction,) = source.junctions
    assert arm_lanes(source, junction) == {
        "north": (2, 2),
        "west": (1, 1),
        "south": (3, 3),
    }
    assert not list(compare_arms(arms_of(source, junction), junction.roads))


def test_a_road_that_the_cut_out_clips_is_no_arm_and_told(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    for point in ((100.0, 0.0), (-100.0, 0.0), (0.0, -100.0)):
        osm.road([middle, point])
    stub = osm.road([middle, (0.0, 14.0)])
    source = read(osm, tmp_path)
    (junction,) = source.junctions
    assert set(arm_lanes(source, junction)) == {"east", "west", "south"}
    assert (
        f"way {stub}",
        "it ends nowhere, less than 10 m beyond a junction: no arm",
    ) in [(skip.what, skip.why) for skip in source.skipped]
    assert len(junction.roads) == 3


@pytest.mark.parametrize("keeps_left", [False, True])
def test_carriageways_with_tracks_between_them_are_one_arm(keeps_left, tmp_path):
    osm = OsmText()
    if keeps_left:
        sign = -1.0
    else:
        sign = 1.0
    nodes = [osm.node(-11.0, 0.0), osm.node(11.0, 0.0)]
    tags = {"name": "Avenue", "oneway": "yes", "highway": "secondary", "lanes": "2"}
    osm.road([(-11.0, 120.0 * sign), nodes[0], (-11.0, -120.0 * sign)], **tags)
    osm.road([(11.0, -120.0 * sign), nodes[1], (11.0, 120.0 * sign)], **tags)
    osm.road([(-120.0, 0.0), *nodes, (120.0, 0.0)], name="Street")
    source = as_drawn(read_openstreetmap(osm.write(tmp_path), keeps_left=keeps_left))
    (junction,) = source.junctions
    lanes = arm_lanes(source, junction)
    assert lanes == {"east": (1, 1), "north": (2, 2), "west": (1, 1), "south": (2, 2)}


def road(
    name: str, direction: tuple[float, float], n_in: int, n_out: int
) -> LeadingRoad:
    unit = np.array(direction)
    return LeadingRoad(
        name=name, point_m=12.0 * unit, direction=unit, lanes_in=n_in, lanes_out=n_out
    )


def test_what_arms_lack_is_told(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    for point in ((100.0, 0.0), (-100.0, 0.0), (0.0, -100.0)):
        osm.road([middle, point], lanes="2")
    source = read(osm, tmp_path)
    junction = arms_of(source, source.junctions[0])
    roads = [
        road("Mill Lane", (0.0, 1.0), 1, 1),
        road("High Street", (1.0, 0.0), 2, 1),
        road("High Street", (-1.0, 0.0), 1, 1),
    ]
    assert [(one.what, one.why) for one in compare_arms(junction, roads)] == [
        (
            "road Mill Lane from the north",
            "it leads to the junction, but no arm has a lane of it",
        ),
        (
            "arm east",
            "it has 1 lanes in and 1 out; by the map High Street has 2 in and 1 out",
        ),
        ("arm south", "no road of the map leads to the junction there"),
    ]


# ---------------------------------------------------------------- choosing


@pytest.fixture
def town(tmp_path: Path) -> SourceMap:
    osm = OsmText()
    nodes = [osm.node(300.0 * index, 0.0) for index in range(3)]
    osm.road([(-100.0, 0.0), *nodes, (700.0, 0.0)], name="High Street")
    for index, name in enumerate(("Mill Lane", "Church Lane", "Mill Lane")):
        osm.road([nodes[index], (300.0 * index, 90.0)], name=name)
    osm.road([nodes[1], (300.0, -90.0)], name="Church Lane")
    osm.road([nodes[2], (600.0, -90.0)], name="Station Road")
    return read_openstreetmap(osm.write(tmp_path), keeps_left=False)


def test_junctions_are_chosen_by_their_streets_in_any_order(town):
    surveyed = survey_junctions(town)
    for name in (
        "High Street / Church Lane",
        "church lane / High Street",
        "Church Lane",
    ):
        assert "Church Lane" in choose_junction(town, surveyed, name=name).junction.name
    whole = choose_junction(town, surveyed, name="Station Road / Mill Lane")
    assert "Station Road" in whole.junction.name


def test_streets_that_meet_twice_are_told_with_their_places(tmp_path):
    osm = OsmText()
    nodes = [osm.node(300.0 * index, 0.0) for index in range(2)]
    osm.road([(-100.0, 0.0), *nodes, (400.0, 0.0)], name="High Street")
    for index in range(2):
        osm.road([nodes[index], (300.0 * index, 90.0)], name="Mill Lane")
    source = read_openstreetmap(osm.write(tmp_path), keeps_left=False)
    with pytest.raises(
        InputError, match=r"\(High Street / Mill Lane at 13\.4\d*,52\.5\d*\)"
    ):
        choose_junction(
            source, survey_junctions(source), name="Mill Lane / High Street"
        )


def test_junctions_are_sorted_by_what_they_have(town):
    surveyed = survey_junctions(town)
    by_name = sort_junctions(surveyed, "name")
    assert [one.junction.name for one in by_name] == sorted(
        one.junction.name for one in surveyed
    )
    by_lanes = [one.n_lanes for one in sort_junctions(surveyed, "lanes")]
    assert by_lanes == sorted(by_lanes, reverse=True)
    assert sort_junctions(surveyed, "arms") == surveyed
    with pytest.raises(InputError, match="sort: got 'size'"):
        sort_junctions(surveyed, "size")
