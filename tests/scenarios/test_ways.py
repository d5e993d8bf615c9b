"""Cases on junctions as maps have them: lanes that bend, arms askew, cycleways, things
beside.
"""

from dataclasses import replace

import numpy as np
import pytest
from case_names import case_names
from dragged import front_axle_at
from junctions import (
    ARMS,
    LANE_M,
    MOUTH_M,
    build_scene,
    lanes_of,
    protocol_scene,
    turned,
)
from oracles import distance_to_chain_m

from geometry.footprints import footprint_corners
from geometry.junction import build_junction
from geometry.scene import Lane
from placement.question import Question
from placement.setting import build_rule
from scenarios.cases import load_cases
from scenarios.paths import CoursePath, StraightPath, TowedPath
from scenarios.positions import Position
from scenarios.protocol import stage_by_protocol
from scenarios.runs import build_runs
from scenarios.staging import CannotCarryError, NoRoadError

RADIUS_M = 60.0


@pytest.fixture(scope="module")
def vut(actors):
    return actors["vut"]


def bent(lane, *, radius_m=RADIUS_M, straight_m=0.0):
    """A lane of the western arm on a circle about a point south of the road, from the
    mouth on.
    """
    ahead, left = lane.centreline_m.T
    along = np.arange(0.0, 120.0, 2.0)
    curve = np.maximum(along - straight_m, 0.0) / radius_m
    radius = radius_m + left[0]
    places = np.stack(
        [
            -MOUTH_M - np.minimum(along, straight_m) - radius * np.sin(curve),
            radius * np.cos(curve) - radius_m,
        ],
        axis=-1,
    )
    is_in = ahead[-1] > ahead[0]
    return replace(lane, centreline_m=places[::-1] if is_in else places)


def curved_lanes(**bend):
    others = [
        lane for arm in ARMS if arm != "west" for lane in lanes_of(arm, ARMS[arm])
    ]
    return [*others, *(bent(lane, **bend) for lane in lanes_of("west", 180.0))]


CURVED = build_scene(curved_lanes())


def staged(name, vut, *, scene=CURVED, approach="west", speed_kmh=None):
    case = load_cases()[name]
    return stage_by_protocol(
        case,
        build_junction(scene),
        approach,
        vut_speed_kmh=speed_kmh or case.vut_speeds_kmh[0],
        vut=vut,
    )


def runs_on(scene, names, vut, *, speeds_kmh=(), **choice):
    rule = build_rule(Question())
    cases = [load_cases()[name] for name in names]
    if speeds_kmh:
        cases = [replace(case, vut_speeds_kmh=speeds_kmh) for case in cases]
    return build_runs(scene, cases, vut=vut, rule=rule, **choice)


@pytest.mark.parametrize("name", case_names())
def test_every_case_is_driven_along_a_lane_that_bends(vut, name):
    # Nothing faster is driven round this bend.
    speed_kmh = min(load_cases()[name].vut_speeds_kmh[0], 50.0)
    encounter = staged(name, vut, speed_kmh=speed_kmh).encounter
    motion = encounter.vut_motion
    assert isinstance(motion.path, TowedPath)
    (lane,) = (lane for lane in CURVED.lanes if lane.id == "west-in-0")
    distances = np.linspace(0.0, float(motion.distance_m(0.0)), 60)
    front, _ = motion.path.course.at(motion.path.start_m + distances)
    mapped_m = 118.0 / RADIUS_M * (RADIUS_M - 0.5 * LANE_M)
    is_before = (
        front[:, 0] < -MOUTH_M - 14.0
    )  # turns begin up to so far before the mouth
    is_mapped = is_before & (motion.path.start_m + distances > 15.0 - mapped_m)
    if is_mapped.any():
        assert distance_to_chain_m(front[is_mapped], lane.centreline_m).max() < 0.05
    case = load_cases()[name]
    if case.impact_face == "front" and case.kind != "turning":
        position, yaw_deg = motion.path.at(motion.distance_m(0.0))
        vru, vru_deg = encounter.vru_motion.path.at(
            encounter.vru_motion.distance_m(0.0)
        )
        if case.kind == "longitudinal":
            reference_m = 0.0
        else:
            reference_m = case.vru_reference_m
        point = vru + reference_m * turned([1.0, 0.0], float(vru_deg))
        left_m = float((point - position) @ turned([0.0, 1.0], float(yaw_deg)))
        wanted_m = vut.width_m * (case.impact_percent - 50.0) / 100.0
        # A long body's middle lies farther ahead, round the bend.
        assert left_m == pytest.approx(
            wanted_m, abs=0.12 if case.vru.length_m < 2.0 else 0.2
        )


def test_whoever_moves_ahead_on_a_lane_that_bends_stays_in_it(vut):
    encounter = staged("CBLA-50", vut, speed_kmh=45.0).encounter
    path = encounter.vru_motion.path
    assert isinstance(path, CoursePath)
    distances = np.linspace(0.0, float(encounter.vru_motion.distance_m(0.0)), 50)
    position, yaw_deg = path.at(distances)
    (lane,) = (lane for lane in CURVED.lanes if lane.id == "west-in-0")
    is_before = position[:, 0] < -MOUTH_M
    assert distance_to_chain_m(position[is_before], lane.centreline_m).max() < 0.05
    assert np.ptp(yaw_deg) > 20.0


def test_a_lane_that_bends_only_far_away_is_driven_straight(vut):
    scene = build_scene(curved_lanes(straight_m=70.0))
    straight = staged("CPNA-25", vut, scene=protocol_scene(), speed_kmh=40.0).encounter
    same = staged("CPNA-25", vut, scene=scene, speed_kmh=40.0).encounter
    for one, other in (
        (straight.vut_motion, same.vut_motion),
        (straight.vru_motion, same.vru_motion),
    ):
        assert isinstance(one.path, StraightPath)
        # Equal but for the rounding of the lane's points.
        assert one.start_time_s == pytest.approx(other.start_time_s, abs=1e-9)
        assert one.path.start_m == pytest.approx(other.path.start_m, abs=1e-9)
        assert one.path.yaw_deg == pytest.approx(other.path.yaw_deg, abs=1e-9)
    # As far as the bend, the lane is followed.
    far = staged("CBLA-50", vut, scene=scene, speed_kmh=45.0).encounter
    assert isinstance(far.vut_motion.path, TowedPath)


@pytest.mark.parametrize("bearing_deg", [35.0, 55.0, 125.0])
def test_turns_lead_into_arms_that_lie_askew_and_pedestrians_cross_them_squarely(
    vut, bearing_deg
):
    lanes = [
        lane
        for arm, bearing in (ARMS | {"north": bearing_deg}).items()
        if arm != "east"
        for lane in lanes_of(arm, bearing)
    ]
    rim = np.array(
        [turned([MOUTH_M, 0.0], angle_deg) for angle_deg in range(0, 360, 10)]
    )
    scene = build_scene(lanes, outline_m=rim)
    encounter = staged("CPTAfs-50", vut, scene=scene).encounter
    path = encounter.vut_motion.path
    _, tangent_deg = front_axle_at(path, path.straight_m + path.turn.length_m)
    assert tangent_deg == pytest.approx(bearing_deg)
    across_deg = encounter.vru_motion.path.yaw_deg - bearing_deg
    if abs(bearing_deg - 90.0) > 30.0:
        assert abs(np.cos(np.radians(across_deg))) == pytest.approx(0.0, abs=1e-9)


def test_a_turn_follows_the_junctions_own_lane_where_there_is_one(vut):
    angle = np.radians(np.linspace(-90.0, 0.0, 20))
    radius_m = MOUTH_M + 0.5 * LANE_M
    arc = np.array([-MOUTH_M, MOUTH_M]) + radius_m * np.stack(
        [np.cos(angle), np.sin(angle)], axis=-1
    )
    lane = Lane(id="through", kind="connecting", width_m=LANE_M, centreline_m=arc)
    plain = protocol_scene()
    scene = replace(plain, lanes=(*plain.lanes, lane))
    assert build_junction(scene).arms.keys() == build_junction(plain).arms.keys()
    path = staged("CPTAfs-50", vut, scene=scene).encounter.vut_motion.path
    assert isinstance(path, TowedPath)
    front, _ = path.course.at(np.linspace(0.0, 20.0, 30))
    assert distance_to_chain_m(front, arc).max() < 0.15
    # Where the map has lanes through the junction, no other way is driven.
    with pytest.raises(
        NoRoadError, match="the map has no lane from the west to the south"
    ):
        staged("CPTAns-50", vut, scene=scene)


def quarter_circle(radius_m, *, before, after, n_points=60):
    """A lane to the left: straight on from a lane, a quarter of a circle, straight into
    another.
    """
    (x, y), (end_x, end_y) = before.centreline_m[-1], after.centreline_m[0]
    angle = np.linspace(-0.5 * np.pi, 0.0, n_points)
    middle = np.array([end_x - radius_m, y + radius_m])
    arc = middle + radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    line = np.concatenate([[[x, y]], arc, [[end_x, end_y]]])
    is_new = np.append(True, np.hypot(*np.diff(line, axis=0).T) > 1.0e-6)
    lane = Lane(id="turn", kind="connecting", width_m=LANE_M, centreline_m=line[is_new])
    return lane, middle


def two_lanes():
    return [lane for arm in ARMS for lane in lanes_of(arm, ARMS[arm], n_lanes=2)]


@pytest.mark.parametrize("radius_m", [5.5, 8.0, 13.0])
def test_a_turning_car_stays_within_a_centimetre_of_a_connecting_lane(vut, radius_m):
    plain = protocol_scene()
    named = {lane.id: lane for lane in plain.lanes}
    turn, middle = quarter_circle(
        radius_m, before=named["west-in-0"], after=named["north-out-0"]
    )
    scene = replace(plain, lanes=(*plain.lanes, turn))
    path = staged("CPTAfs-50", vut, scene=scene).encounter.vut_motion.path
    front, _ = path.course.at(np.arange(-20.0, 50.0, 0.05))
    x, y = (front - middle).T
    off_m = np.where(
        x < 0.0, np.abs(y + radius_m), np.where(y > 0.0, np.abs(x - radius_m), np.inf)
    )
    off_m = np.where((x >= 0.0) & (y <= 0.0), np.abs(np.hypot(x, y) - radius_m), off_m)
    assert off_m.max() < 0.01
    position, yaw_deg = path.at(np.arange(0.0, 40.0, 0.5))
    ahead = np.stack(
        [np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))], axis=-1
    )
    axle = position + vut.front_axle_ahead_m * ahead
    assert distance_to_chain_m(axle, path.course.points_m[::5]).max() < 0.001


def test_a_turning_car_takes_the_lane_from_which_the_junction_leads(vut):
    lanes = two_lanes()
    named = {lane.id: lane for lane in lanes}
    for begins, ends in (("west-in-0", "north-out-1"), ("west-in-1", "north-out-0")):
        turn, _ = quarter_circle(9.0, before=named[begins], after=named[ends])
        path = staged(
            "CPTAfs-50", vut, scene=build_scene([*lanes, turn])
        ).encounter.vut_motion.path
        front, _ = path.course.at(np.linspace(-10.0, 30.0, 80))
        lanes_driven = (named[begins], turn, named[ends])
        chain = np.concatenate([lane.centreline_m for lane in lanes_driven])
        chain = chain[np.append(True, np.hypot(*np.diff(chain, axis=0).T) > 1.0e-6)]
        assert distance_to_chain_m(front, chain).max() < 0.01
    assert not isinstance(
        staged("CPTAfs-50", vut, scene=build_scene(lanes)).encounter.vut_motion.path,
        TowedPath,
    )


def test_a_connecting_lane_too_sharp_for_the_speed_is_left_for_the_protocols_curve(vut):
    plain = protocol_scene()
    named = {lane.id: lane for lane in plain.lanes}
    turn, _ = quarter_circle(5.0, before=named["west-in-0"], after=named["north-out-0"])
    scene = replace(plain, lanes=(*plain.lanes, turn))
    for speed_kmh, follows in (
        (15.0, True),
        (20.0, False),
    ):  # 3.5 and 6.2 m/s^2 to the side
        encounter = staged("CPTAfs-50", vut, scene=scene, speed_kmh=speed_kmh).encounter
        assert isinstance(encounter.vut_motion.path, TowedPath) == follows


def test_nobody_takes_the_junctions_own_lanes_for_another_junction(vut):
    plain = protocol_scene()
    named = {lane.id: lane for lane in plain.lanes}
    mouth = named["west-in-0"].centreline_m[-1]
    inside = build_junction(plain).arms["west"].crosswalk
    through = Lane(
        id="through",
        kind="connecting",
        width_m=LANE_M,
        centreline_m=np.array([mouth, named["east-out-0"].centreline_m[0]]),
    )
    # The crosswalk lies so deep in the junction that 5 m before it is still inside.
    deep = np.array([inside.at(-9.0), inside.at(9.0)]) + [8.0, 0.0]
    scene = replace(plain, lanes=(*plain.lanes, through), crosswalks_m=deep[None])
    runs, refusals = runs_on(
        scene,
        ["CPNA-25"],
        vut,
        approaches=["west"],
        positions=[Position(distance_m=5.0)],
    )
    assert runs
    assert not refusals


def test_cyclists_ride_on_the_arms_cycleway(vut):
    south = lanes_of("south", 270.0)[0]
    cycleway = replace(
        south,
        id="track",
        kind="cycling",
        width_m=2.0,
        centreline_m=south.centreline_m + [4.5, 0.0],
    )
    plain = protocol_scene()
    scene = replace(plain, lanes=(*plain.lanes, cycleway))
    junction = build_junction(scene)
    assert [lane.id for lane in junction.arms["south"].cycleways_in] == ["track"]
    assert [lane.id for lane in junction.arms["south"].lanes_in] == ["south-in-0"]
    rides = staged("CBNA-50", vut, scene=scene).encounter.vru_motion.path
    assert rides.start_m[0] == pytest.approx(cycleway.centreline_m[0, 0])


@pytest.mark.parametrize(
    ("off_m", "is_found"), [(0.0, True), (4.0, True), (8.0, False)]
)
def test_a_cycleway_may_end_a_little_beside_the_junctions_outline(off_m, is_found):
    south = lanes_of("south", 270.0)[0]
    cycleway = replace(
        south,
        id="track",
        kind="cycling",
        width_m=2.0,
        centreline_m=south.centreline_m + [4.5, 0.0] - [0.0, off_m],
    )
    plain = protocol_scene()
    arms = build_junction(replace(plain, lanes=(*plain.lanes, cycleway))).arms
    assert {name: len(arm.cycleways_in) for name, arm in arms.items()} == {
        name: int(is_found and name == "south") for name in ARMS
    }
    assert not any(arm.cycleways_out for arm in arms.values())


def test_cyclists_do_not_ride_between_the_lanes_of_one_direction_and_the_other(vut):
    lanes = [
        lane
        for arm, bearing in ARMS.items()
        for lane in lanes_of(arm, bearing, n_lanes=2 if arm == "south" else 1)
    ]
    path = staged("CBNA-50", vut, scene=build_scene(lanes)).encounter.vru_motion.path
    # 0.75 m inside the edge of the outer lane: two lanes of 3.5 m.
    assert path.start_m[0] == pytest.approx(2.0 * LANE_M - 0.75)


def test_a_cyclist_comes_from_a_road_that_exists(vut):
    lanes = [
        lane for arm, at in ARMS.items() if arm != "east" for lane in lanes_of(arm, at)
    ]
    with pytest.raises(
        NoRoadError, match="no lane lies ahead from which the cyclist could come"
    ):
        staged("CBTAfo-50", vut, scene=build_scene(lanes))
    assert staged("CBTAfs-100", vut, scene=build_scene(lanes)).encounter


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "CPNCO-50",
        "CBNA",
        *("CBNA-50", "CBFA-50", "CBNAO-50"),
    ],
)
@pytest.mark.parametrize(
    "scene", [protocol_scene(), CURVED], ids=["straight", "curved"]
)
def test_obstructions_stand_outside_the_carriageway(vut, name, scene):
    import shapely

    runs, refusals = runs_on(scene, [name], vut, approaches=["west"])
    assert all(one.reason.startswith("the lanes curve") for one in refusals)
    carriageway = shapely.union_all(
        [
            shapely.LineString(lane.centreline_m).buffer(
                0.5 * lane.width_m, cap_style="flat"
            )
            for lane in scene.lanes
        ]
    )
    for run in runs:
        for body in run.obstruction:
            corners = footprint_corners(
                body.pose.position_m[:2],
                body.pose.yaw_deg,
                length_m=body.actor.length_m,
                width_m=body.actor.width_m,
            )
            area = shapely.Polygon(corners).intersection(carriageway).area
            assert area <= 0.1 * body.actor.length_m + 1e-6


@pytest.mark.long
def test_parked_cars_give_way_to_a_pole_and_a_house_that_leaves_no_room_is_named(vut):
    free, _ = runs_on(protocol_scene(), ["CPNCO-50"], vut, approaches=["west"])
    first = free[0].obstruction[0].pose.position_m
    pole = ("pole", first[0] + 1.9, first[1], 0.2, 0.2, 4.0)
    given_way, refusals = runs_on(
        protocol_scene(boxes=[pole]), ["CPNCO-50"], vut, approaches=["west"]
    )
    assert not refusals
    moved_m = given_way[0].obstruction[0].pose.position_m - first
    assert 0.0 < np.hypot(*moved_m[:2]) <= 2.0
    house = ("house", first[0] - 5.0, -15.0, 12.0, 23.0, 6.0)
    runs, refusals = runs_on(
        protocol_scene(boxes=[house]), ["CPNCO-50"], vut, approaches=["west"]
    )
    assert not runs
    assert {refusal.reason for refusal in refusals} == {
        "house occupies the place of parked-car-small"
    }


def test_what_needs_a_road_that_is_missing_does_not_count_as_possible(vut):
    lanes = [
        lane for arm, at in ARMS.items() if arm != "north" for lane in lanes_of(arm, at)
    ]
    _, refusals = runs_on(
        build_scene(lanes), ["CPTAfs-50", "CPLA-50"], vut, approaches=["west"]
    )
    assert [(one.case.name, one.is_possible) for one in refusals] == [
        ("CPTAfs-50", False)
    ]


def test_a_turn_that_no_curve_makes_is_refused(vut):
    # The lane out bends away at once, back towards where the VUT came from.
    back = Lane(
        id="north-out-0",
        kind="driving",
        width_m=LANE_M,
        centreline_m=[[1.75, 11.5], [1.0, 13.0], [-6.0, 15.0], [-9.0, 14.0]],
    )
    lanes = [lane for arm, at in ARMS.items() for lane in lanes_of(arm, at)]
    lanes = [back if lane.id == "north-out-0" else lane for lane in lanes]
    with pytest.raises(CannotCarryError, match="lane"):
        staged("CPTAfs-50", vut, scene=build_scene(lanes), speed_kmh=20.0)
