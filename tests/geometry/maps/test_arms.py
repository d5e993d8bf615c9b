"""Arms of junctions against the roads that a map leads to them: stubs, medians, what is
missing.
"""

import numpy as np
import pytest
from osm_drawing import drawn, read_drawing
from osm_text import arm_lanes, arms_of

from geometry.errors import InputError
from geometry.maps.importing import choose_junction, sort_junctions, survey_junctions
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.scene import LeadingRoad
from geometry.scene_checks import compare_arms


def read(osm, folder, *, keeps_left=False):
    """The map of a drawing, and its only junction."""
    source = read_drawing(osm, folder, keeps_left=keeps_left)
    (junction,) = source.junctions
    return source, junction


def dual_carriageway(stub_m):
    """A T junction of a street with two carriageways, cut in two at its crosswalk to
    the north.

    As at Northgate: the carriageways have two lanes north of the cut and three south of
    it.
    """
    cut_m = 10.0 + stub_m
    avenue = "name=Avenue; oneway=yes; highway=secondary"
    return drawn(f"""
        road -5 120, -5 {cut_m}: {avenue}; lanes=2
        road -5 {cut_m}, -5 0, -5 -120: {avenue}; lanes=3
        road 5 -120, 5 0, 5 {cut_m}: {avenue}; lanes=3
        road 5 {cut_m}, 5 120: {avenue}; lanes=2
        road 5 0, -5 0, -120 0: name=Street; lanes=2
    """)


@pytest.mark.parametrize("stub_m", [1.5, 3.0, 6.0])
def test_a_stub_between_crosswalk_and_junction_is_no_arm(stub_m, tmp_path):
    source, junction = read(dual_carriageway(stub_m), tmp_path)
    lanes = arm_lanes(source, junction)

    assert lanes == {"north": (2, 2), "west": (1, 1), "south": (3, 3)}
    assert not list(compare_arms(arms_of(source, junction), junction.roads))


THREE_ARMS = """
    road 0 0, 100 0: lanes=2
    road 0 0, -100 0: lanes=2
    road 0 0, 0 -100: lanes=2
"""


def test_a_road_that_the_cut_out_clips_is_no_arm_and_told(tmp_path):
    osm = drawn(THREE_ARMS).draw("road 0 0, 0 14")
    source, junction = read(osm, tmp_path)

    assert set(arm_lanes(source, junction)) == {"east", "west", "south"}

    why = "it ends nowhere, less than 10 m beyond a junction: no arm"
    told = [(skip.what, skip.why) for skip in source.skipped]

    assert (f"way {osm.ids[-1]}", why) in told
    assert len(junction.roads) == 3


@pytest.mark.parametrize("keeps_left", [False, True])
def test_carriageways_with_tracks_between_them_are_one_arm(keeps_left, tmp_path):
    west = "-11 120, -11 0, -11 -120"
    east = "11 -120, 11 0, 11 120"
    if keeps_left:
        west = "-11 -120, -11 0, -11 120"
        east = "11 120, 11 0, 11 -120"
    avenue = "name=Avenue; oneway=yes; highway=secondary; lanes=2"
    osm = drawn(f"""
        road {west}: {avenue}
        road {east}: {avenue}
        road -120 0, -11 0, 11 0, 120 0: name=Street
    """)
    source, junction = read(osm, tmp_path, keeps_left=keeps_left)
    lanes = arm_lanes(source, junction)

    assert lanes == {"east": (1, 1), "north": (2, 2), "west": (1, 1), "south": (2, 2)}


def road(name, direction, n_in, n_out):
    """A road that leads to the junction in the direction of a unit vector."""
    unit = np.array(direction)
    return LeadingRoad(
        name=name,
        point_m=12.0 * unit,
        direction=unit,
        lanes_in=n_in,
        lanes_out=n_out,
    )


def test_what_arms_lack_is_told(tmp_path):
    source, junction = read(drawn(THREE_ARMS), tmp_path)
    roads = [
        road("Mill Lane", (0.0, 1.0), 1, 1),
        road("High Street", (1.0, 0.0), 2, 1),
        road("High Street", (-1.0, 0.0), 1, 1),
    ]
    found = compare_arms(arms_of(source, junction), roads)

    assert [(one.what, one.why) for one in found] == [
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
def town(tmp_path):
    """A street with three junctions: with Mill Lane, Church Lane, and both roads."""
    osm = drawn("""
        road -100 0, 0 0, 300 0, 600 0, 700 0: name=High Street
        road 0 0, 0 90: name=Mill Lane
        road 300 -90, 300 0, 300 90: name=Church Lane
        road 600 0, 600 90: name=Mill Lane
        road 600 0, 600 -90: name=Station Road
    """)
    return read_drawing(osm, tmp_path, keeps_left=False)


@pytest.mark.parametrize(
    ("name", "street"),
    [
        ("High Street / Church Lane", "Church Lane"),
        ("church lane / High Street", "Church Lane"),
        ("Church Lane", "Church Lane"),
        ("Station Road / Mill Lane", "Station Road"),
    ],
)
def test_junctions_are_chosen_by_their_streets_in_any_order(town, name, street):
    chosen = choose_junction(town, survey_junctions(town), name=name)
    assert street in chosen.junction.name


def test_streets_that_meet_twice_are_told_with_their_places(tmp_path):
    osm = drawn("""
        road -100 0, 0 0, 300 0, 400 0: name=High Street
        road 0 0, 0 90: name=Mill Lane
        road 300 0, 300 90: name=Mill Lane
    """)
    path = osm.write(tmp_path)
    source = read_openstreetmap(path, keeps_left=False)
    told = r"\(High Street / Mill Lane at 13\.4\d*,52\.5\d*\)"

    with pytest.raises(InputError, match=told):
        choose_junction(
            source, survey_junctions(source), name="Mill Lane / High Street"
        )


def test_junctions_are_sorted_by_what_they_have(town):
    surveyed = survey_junctions(town)
    by_name = [one.junction.name for one in sort_junctions(surveyed, "name")]

    assert by_name == sorted(one.junction.name for one in surveyed)

    by_lanes = [one.n_lanes for one in sort_junctions(surveyed, "lanes")]
    assert by_lanes == sorted(by_lanes, reverse=True)
    assert sort_junctions(surveyed, "arms") == surveyed
    with pytest.raises(InputError, match="sort: got 'size'"):
        sort_junctions(surveyed, "size")
