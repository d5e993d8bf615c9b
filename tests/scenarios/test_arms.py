"""Who may drive where: by lanes through the junction, or by markings."""

import dataclasses

import pytest
from junctions import LANE_M, build_scene, lanes_of
from scenario_lanes import arm_lanes, build_lane

from geometry.junction import build_junction, mirrored
from scenarios.cases import load_cases
from scenarios.protocol import stage_by_protocol
from scenarios.staging import NoRoadError
from scenarios.ways import joints, straight_lane

MOVEMENTS = {"left": "north", "through": "east", "right": "south"}


def junction_with(turns=(), connections=()):
    """Three lanes from the west, from the kerb, with their markings; two lanes
    elsewhere.
    """
    lanes = arm_lanes(without=["west"], n_lanes=2)
    lanes += lanes_of("west", 180.0, n_lanes=3)
    marked = {f"west-in-{number}": words for number, words in enumerate(turns)}
    lanes = [dataclasses.replace(lane, turns=marked.get(lane.id, ())) for lane in lanes]
    named = {lane.id: lane for lane in lanes}

    for before, after in connections:
        line = [named[before].centreline_m[-1], named[after].centreline_m[0]]
        lanes.append(build_lane(f"{before} {after}", line, kind="connecting"))

    return build_junction(build_scene(lanes))


def entries(junction, movement):
    """Lanes from the west by which a movement is driven, in the order in which they are
    tried.
    """
    into = junction.arms[MOVEMENTS[movement]]
    found = joints(
        junction,
        junction.arms["west"],
        into,
        movement,
    )
    return list(dict.fromkeys(before.id for before, _, _ in found))


def test_without_markings_all_lanes_lead_everywhere_from_the_usual_side():
    junction = junction_with()
    kerb_first = ["west-in-0", "west-in-1", "west-in-2"]

    assert entries(junction, "through") == entries(junction, "right") == kerb_first
    assert entries(junction, "left") == kerb_first[::-1]


def test_markings_decide_who_may_go_where():
    junction = junction_with([("right",), ("through", "left"), ("left",)])
    assert entries(junction, "right") == ["west-in-0"]
    assert entries(junction, "through") == ["west-in-1"]
    assert entries(junction, "left") == ["west-in-2", "west-in-1"]
    assert straight_lane(junction, junction.arms["west"]).id == "west-in-1"

    # Lanes without a marking serve what no marked lane does.
    junction = junction_with([(), (), ("left",)])
    assert entries(junction, "through") == ["west-in-0", "west-in-1"]
    assert entries(junction, "left") == ["west-in-2"]


def test_what_no_lane_is_marked_for_is_not_driven(vut):
    junction = junction_with([("right",), ("through",), ("through",)])

    def stage(name, speed_kmh):
        case = load_cases()[name]
        return stage_by_protocol(
            case,
            junction,
            "west",
            vut_speed_kmh=speed_kmh,
            vut=vut,
        )

    told = "according to its markings, no lane from the west leads to the l"
    with pytest.raises(NoRoadError, match=told):
        stage("CPTAfs-50", 10.0)

    # A cyclist crosses in the junction's middle: there the car drives straight on.
    motion = stage("CBNA-50", 30.0).encounter.vut_motion
    assert motion.path.start_m[1] == pytest.approx(-1.5 * LANE_M)


def test_lanes_through_the_junction_decide_where_the_map_has_them():
    through = ("west-in-1", "east-out-1")
    left = ("west-in-2", "north-out-1")
    junction = junction_with(connections=[through, left])

    assert entries(junction, "through") == ["west-in-1"]
    assert entries(junction, "left") == ["west-in-2"]

    told = "the map has no lane from the west to the south"
    with pytest.raises(NoRoadError, match=told):
        entries(junction, "right")


def test_in_a_mirror_left_is_right():
    arm = mirrored(junction_with([("right",), ("through", "left"), ()])).arms["west"]
    assert {lane.id: lane.turns for lane in arm.entry_lanes} == {
        "west-in-0": ("left",),
        "west-in-1": ("through", "right"),
        "west-in-2": (),
    }
