"""Cases on junctions as maps have them: lanes that bend, arms askew, cycleways, things
beside.
"""

from dataclasses import replace

import numpy as np
import pytest
import shapely
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
from scenario_lanes import arm_lanes, build_lane, exchanged, pose_at

from geometry.footprints import footprint_corners
from geometry.junction import build_junction
from geometry.scene import strips_of
from scenarios.cases import load_cases
from scenarios.paths import CoursePath, StraightPath, TowedPath
from scenarios.positions import Position
from scenarios.protocol import stage_by_protocol
from scenarios.staging import CannotCarryError, NoRoadError

RADIUS_M = 60.0


def bent(lane, *, radius_m=RADIUS_M, straight_m=0.0):
    """A lane of the western arm on a circle about a point south of the road, from the
    mouth on.
    """
    ahead, left = lane.centreline_m.T
    along = np.arange(0.0, 120.0, 2.0)
    curve = np.maximum(along - straight_m, 0.0) / radius_m
    radius = radius_m + left[0]
    straight = np.minimum(along, straight_m)
    west_m = MOUTH_M + straight + radius * np.sin(curve)
    north_m = radius * np.cos(curve) - radius_m
    places = np.stack([-west_m, north_m], axis=-1)
    if ahead[-1] > ahead[0]:
        places = places[::-1]
    return replace(lane, centreline_m=places)


def curved_scene(**bend):
    """The protocol's junction with a western arm that bends."""
    west = [bent(lane, **bend) for lane in lanes_of("west", 180.0)]
    return build_scene([*arm_lanes(without=["west"]), *west])


CURVED = curved_scene()
PLAIN = protocol_scene()
NAMED = {lane.id: lane for lane in PLAIN.lanes}


def with_lanes(*lanes, **fields):
    """The protocol's junction with further lanes."""
    return replace(PLAIN, lanes=(*PLAIN.lanes, *lanes), **fields)


def staged(name, vut, *, scene=CURVED, approach="west", speed_kmh=None):
    """The encounter of a case, by default at its lowest speed."""
    case = load_cases()[name]
    staging = stage_by_protocol(
        case,
        build_junction(scene),
        approach,
        vut_speed_kmh=speed_kmh or case.vut_speeds_kmh[0],
        vut=vut,
    )
    return staging.encounter


@pytest.mark.parametrize("name", case_names())
def test_every_case_is_driven_along_a_lane_that_bends(vut, name):
    """The front keeps to the mapped lane, and the impact point is still the case's."""
    # Nothing faster is driven round this bend.
    case = load_cases()[name]
    speed_kmh = min(case.vut_speeds_kmh[0], 50.0)
    encounter = staged(name, vut, speed_kmh=speed_kmh)
    motion = encounter.vut_motion

    assert isinstance(motion.path, TowedPath)

    driven_m = float(motion.distance_m(0.0))
    distances = np.linspace(0.0, driven_m, 60)
    stations = motion.path.start_m + distances
    front, _ = motion.path.course.at(stations)
    mapped_m = 118.0 / RADIUS_M * (RADIUS_M - 0.5 * LANE_M)
    # Turns begin up to so far before the mouth.
    is_before = front[:, 0] < -MOUTH_M - 14.0
    is_mapped = is_before & (stations > 15.0 - mapped_m)

    if is_mapped.any():
        off_m = distance_to_chain_m(front[is_mapped], curved_entry())
        assert off_m.max() < 0.05

    if case.impact_face == "front" and case.kind != "turning":
        position, yaw_deg = pose_at(motion)
        point, vru_deg = pose_at(encounter.vru_motion)
        if case.kind != "longitudinal":
            point = point + turned([case.vru_reference_m, 0.0], vru_deg)
        to_the_left = turned([0.0, 1.0], yaw_deg)
        left_m = float((point - position) @ to_the_left)
        share = (case.impact_percent - 50.0) / 100.0
        wanted_m = share * vut.width_m
        # A long body's middle lies farther ahead, round the bend.
        tolerance_m = 0.12
        if case.vru.length_m >= 2.0:
            tolerance_m = 0.2

        assert left_m == pytest.approx(wanted_m, abs=tolerance_m)


def curved_entry():
    """Centreline of the lane from the west, out of the bend."""
    (lane,) = (lane for lane in CURVED.lanes if lane.id == "west-in-0")
    return lane.centreline_m


def test_whoever_moves_ahead_on_a_lane_that_bends_stays_in_it(vut):
    """The cyclist's way begins in the bend, and turns by more than 20 degrees."""
    encounter = staged("CBLA-50", vut, speed_kmh=45.0)
    path = encounter.vru_motion.path

    assert isinstance(path, CoursePath)

    ridden_m = float(encounter.vru_motion.distance_m(0.0))
    distances = np.linspace(0.0, ridden_m, 50)
    position, yaw_deg = path.at(distances)
    is_before = position[:, 0] < -MOUTH_M
    off_m = distance_to_chain_m(position[is_before], curved_entry())

    assert off_m.max() < 0.05
    assert np.ptp(yaw_deg) > 20.0


def test_a_lane_that_bends_only_far_away_is_driven_straight(vut):
    """Short drives begin behind the bend, long ones in it."""
    scene = curved_scene(straight_m=70.0)
    straight = staged(
        "CPNA-25",
        vut,
        scene=PLAIN,
        speed_kmh=40.0,
    )
    same = staged(
        "CPNA-25",
        vut,
        scene=scene,
        speed_kmh=40.0,
    )

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
    far = staged(
        "CBLA-50",
        vut,
        scene=scene,
        speed_kmh=45.0,
    )
    assert isinstance(far.vut_motion.path, TowedPath)


@pytest.mark.parametrize("bearing_deg", [35.0, 55.0, 125.0])
def test_turns_lead_into_arms_that_lie_askew_and_pedestrians_cross_them_squarely(
    vut, bearing_deg
):
    """The turn ends in the arm's direction; the crosswalk lies across the arm."""
    north = lanes_of("north", bearing_deg)
    lanes = [*arm_lanes(without=["north", "east"]), *north]
    rim = [turned([MOUTH_M, 0.0], angle_deg) for angle_deg in range(0, 360, 10)]
    scene = build_scene(lanes, outline_m=np.array(rim))
    encounter = staged("CPTAfs-50", vut, scene=scene)
    path = encounter.vut_motion.path
    turned_m = path.straight_m + path.turn.length_m
    _, tangent_deg = front_axle_at(path, turned_m)

    assert tangent_deg == pytest.approx(bearing_deg)

    across_deg = encounter.vru_motion.path.yaw_deg - bearing_deg
    if abs(bearing_deg - 90.0) > 30.0:
        across = np.radians(across_deg)
        assert np.cos(across) == pytest.approx(0.0, abs=1e-9)


def test_a_turn_follows_the_junctions_own_lane_where_there_is_one(vut):
    """Lanes within the junction say which ways there are."""
    angle = np.radians(np.linspace(-90.0, 0.0, 20))
    radius_m = MOUTH_M + 0.5 * LANE_M
    on_circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    arc = radius_m * on_circle
    arc += [-MOUTH_M, MOUTH_M]
    scene = with_lanes(build_lane("through", arc, kind="connecting"))
    arms = build_junction(scene).arms
    plain_arms = build_junction(PLAIN).arms

    assert arms.keys() == plain_arms.keys()

    encounter = staged("CPTAfs-50", vut, scene=scene)
    path = encounter.vut_motion.path

    assert isinstance(path, TowedPath)

    front, _ = path.course.at(np.linspace(0.0, 20.0, 30))
    off_m = distance_to_chain_m(front, arc)

    assert off_m.max() < 0.15

    # Where the map has lanes through the junction, no other way is driven.
    told = "the map has no lane from the west to the south"
    with pytest.raises(NoRoadError, match=told):
        staged("CPTAns-50", vut, scene=scene)


def quarter_circle(radius_m, *, before, after, n_points=60):
    """A lane to the left: straight on from a lane, a quarter of a circle, straight into
    another.
    """
    begin = before.centreline_m[-1]
    end = after.centreline_m[0]
    angle = np.linspace(-0.5 * np.pi, 0.0, n_points)
    middle = np.array([end[0] - radius_m, begin[1] + radius_m])
    on_circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    arc = middle + radius_m * on_circle
    line = without_repeats([[begin], arc, [end]])
    return build_lane("turn", line, kind="connecting"), middle


def without_repeats(parts):
    """Points of parts one after the other, each place once."""
    line = np.concatenate(parts)
    steps_m = np.linalg.norm(np.diff(line, axis=0), axis=-1)
    is_new = np.append(True, steps_m > 1.0e-6)
    return line[is_new]


def left_turn(radius_m):
    """The protocol's junction with a quarter of a circle from the west to the north."""
    turn, middle = quarter_circle(
        radius_m,
        before=NAMED["west-in-0"],
        after=NAMED["north-out-0"],
    )
    return with_lanes(turn), middle


@pytest.mark.parametrize("radius_m", [5.5, 8.0, 13.0])
def test_a_turning_car_stays_within_a_centimetre_of_a_connecting_lane(vut, radius_m):
    """Compared with the circle itself, not with the chords between its points."""
    scene, middle = left_turn(radius_m)
    path = staged("CPTAfs-50", vut, scene=scene).vut_motion.path
    front, _ = path.course.at(np.arange(-20.0, 50.0, 0.05))
    x, y = (front - middle).T
    # Straight before the circle, on it, and straight behind it.
    off_m = np.abs(np.hypot(x, y) - radius_m)
    off_m = np.where(x < 0.0, np.abs(y + radius_m), off_m)
    is_beyond = (x >= 0.0) & (y > 0.0)
    off_m = np.where(is_beyond, np.abs(x - radius_m), off_m)

    assert off_m.max() < 0.01

    position, yaw_deg = path.at(np.arange(0.0, 40.0, 0.5))
    yaw = np.radians(yaw_deg)
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    axle = position + vut.front_axle_ahead_m * ahead
    off_m = distance_to_chain_m(axle, path.course.points_m[::5])

    # The front axle drags the rear one along the course.
    assert off_m.max() < 0.001


TWO_LANES = arm_lanes(n_lanes=2)


@pytest.mark.parametrize(
    ("begins", "ends"),
    [
        ("west-in-0", "north-out-1"),
        ("west-in-1", "north-out-0"),
    ],
)
def test_a_turning_car_takes_the_lane_from_which_the_junction_leads(vut, begins, ends):
    """Of two lanes, the one whose end the connecting lane begins at."""
    named = {lane.id: lane for lane in TWO_LANES}
    turn, _ = quarter_circle(9.0, before=named[begins], after=named[ends])
    scene = build_scene([*TWO_LANES, turn])
    path = staged("CPTAfs-50", vut, scene=scene).vut_motion.path
    front, _ = path.course.at(np.linspace(-10.0, 30.0, 80))
    driven = (named[begins], turn, named[ends])
    chain = without_repeats([lane.centreline_m for lane in driven])
    off_m = distance_to_chain_m(front, chain)

    assert off_m.max() < 0.01


def test_without_a_lane_from_which_the_junction_leads_no_lane_is_followed(vut):
    """Between lanes that nothing connects, the car takes the protocol's curve."""
    scene = build_scene(TWO_LANES)
    encounter = staged("CPTAfs-50", vut, scene=scene)

    assert not isinstance(encounter.vut_motion.path, TowedPath)


# 3.5 and 6.2 m/s^2 to the side.
@pytest.mark.parametrize(
    ("speed_kmh", "follows"),
    [
        (15.0, True),
        (20.0, False),
    ],
)
def test_a_connecting_lane_too_sharp_for_the_speed_is_left_for_the_protocols_curve(
    vut, speed_kmh, follows
):
    scene, _ = left_turn(5.0)
    encounter = staged(
        "CPTAfs-50",
        vut,
        scene=scene,
        speed_kmh=speed_kmh,
    )
    assert isinstance(encounter.vut_motion.path, TowedPath) == follows


def test_nobody_takes_the_junctions_own_lanes_for_another_junction(lay):
    """The way may lead over them, and no next junction begins there."""
    begin = NAMED["west-in-0"].centreline_m[-1]
    end = NAMED["east-out-0"].centreline_m[0]
    through = build_lane("through", [begin, end], kind="connecting")
    # The crosswalk lies so deep in the junction that 5 m before it is still inside.
    inside = build_junction(PLAIN).arms["west"].crosswalk
    ends = np.array([inside.at(-9.0), inside.at(9.0)])
    deep = ends + [8.0, 0.0]
    scene = with_lanes(through, crosswalks_m=deep[None])
    before = [Position(distance_m=5.0)]
    runs, refusals = lay(
        scene,
        ["CPNA-25"],
        approaches=["west"],
        positions=before,
    )

    assert runs
    assert not refusals


def cycleway(off_m):
    """A track for cyclists beside the southern arm, so far off the junction's end."""
    line = NAMED["south-in-0"].centreline_m + [4.5, -off_m]
    return build_lane(
        "track",
        line,
        kind="cycling",
        width_m=2.0,
    )


def test_cyclists_ride_on_the_arms_cycleway(vut):
    """A cycleway is no lane for cars, but cyclists prefer it."""
    track = cycleway(0.0)
    scene = with_lanes(track)
    south = build_junction(scene).arms["south"]

    assert [lane.id for lane in south.cycleways_in] == ["track"]
    assert [lane.id for lane in south.lanes_in] == ["south-in-0"]

    encounter = staged("CBNA-50", vut, scene=scene)
    rides = encounter.vru_motion.path
    east_m, _ = track.centreline_m[0]

    assert rides.start_m[0] == pytest.approx(east_m)


@pytest.mark.parametrize(
    ("off_m", "n_found"),
    [
        (0.0, 1),
        (4.0, 1),
        (8.0, 0),
    ],
)
def test_a_cycleway_may_end_a_little_beside_the_junctions_outline(off_m, n_found):
    scene = with_lanes(cycleway(off_m))
    arms = build_junction(scene).arms
    counts = {name: len(arm.cycleways_in) for name, arm in arms.items()}

    assert counts == dict.fromkeys(ARMS, 0) | {"south": n_found}
    assert not any(arm.cycleways_out for arm in arms.values())


def test_cyclists_do_not_ride_between_the_lanes_of_one_direction_and_the_other(vut):
    south = lanes_of("south", 270.0, n_lanes=2)
    scene = build_scene([*arm_lanes(without=["south"]), *south])
    encounter = staged("CBNA-50", vut, scene=scene)
    path = encounter.vru_motion.path

    # 0.75 m inside the edge of the outer lane: two lanes of 3.5 m.
    assert path.start_m[0] == pytest.approx(2.0 * LANE_M - 0.75)


def test_a_cyclist_comes_from_a_road_that_exists(vut):
    """Whoever rides ahead or behind on the VUT's own arm still does."""
    scene = build_scene(arm_lanes(without=["east"]))
    told = "no lane lies ahead from which the cyclist could come"

    with pytest.raises(NoRoadError, match=told):
        staged("CBTAfo-50", vut, scene=scene)

    assert staged("CBTAfs-100", vut, scene=scene)


@pytest.mark.long
@pytest.mark.parametrize("name", ["CPNCO-50", "CBNA", "CBNA-50", "CBFA-50", "CBNAO-50"])
@pytest.mark.parametrize("scene", [PLAIN, CURVED], ids=["straight", "curved"])
def test_obstructions_stand_outside_the_carriageway(lay, name, scene):
    """But for a strip 0.1 m wide: lanes that bend are chords."""
    runs, refusals = lay(scene, [name], approaches=["west"])
    assert all(one.reason.startswith("the lanes curve") for one in refusals)

    carriageway = shapely.union_all(strips_of(scene.lanes))
    for run in runs:
        for body in run.obstruction:
            corners = footprint_corners(
                body.pose.position_m[:2],
                body.pose.yaw_deg,
                length_m=body.actor.length_m,
                width_m=body.actor.width_m,
            )
            on_road = shapely.Polygon(corners).intersection(carriageway)
            assert on_road.area <= 0.1 * body.actor.length_m + 1e-6


@pytest.mark.long
def test_parked_cars_give_way_to_a_pole_and_a_house_that_leaves_no_room_is_named(lay):
    def park(*boxes):
        scene = protocol_scene(boxes=boxes)
        return lay(scene, ["CPNCO-50"], approaches=["west"])

    def first_place_m(runs):
        first = runs[0].obstruction[0]
        return first.pose.position_m[:2]

    free, _ = park()
    place_m = first_place_m(free)
    east_m, north_m = place_m
    pole = ("pole", east_m + 1.9, north_m, 0.2, 0.2, 4.0)
    given_way, refusals = park(pole)

    assert not refusals

    moved_m = first_place_m(given_way) - place_m
    assert 0.0 < np.linalg.norm(moved_m) <= 2.0

    house = ("house", east_m - 5.0, -15.0, 12.0, 23.0, 6.0)
    runs, refusals = park(house)

    assert not runs

    reasons = {refusal.reason for refusal in refusals}
    assert reasons == {"house occupies the place of parked-car-small"}


def test_what_needs_a_road_that_is_missing_does_not_count_as_possible(lay):
    """Another case on the same arm is driven."""
    scene = build_scene(arm_lanes(without=["north"]))
    _, refusals = lay(scene, ["CPTAfs-50", "CPLA-50"], approaches=["west"])
    (refusal,) = refusals

    assert refusal.case.name == "CPTAfs-50"
    assert not refusal.is_possible


def test_a_turn_that_no_curve_makes_is_refused(vut):
    # The lane out bends away at once, back towards where the VUT came from.
    line = np.array(
        [
            [1.75, 11.5],
            [1.0, 13.0],
            [-6.0, 15.0],
            [-9.0, 14.0],
        ]
    )
    back = build_lane("north-out-0", line)
    scene = build_scene(exchanged(arm_lanes(), back))

    with pytest.raises(CannotCarryError, match="lane"):
        staged(
            "CPTAfs-50",
            vut,
            scene=scene,
            speed_kmh=20.0,
        )
