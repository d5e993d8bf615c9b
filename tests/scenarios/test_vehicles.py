"""Cases with cars and motorcyclists: the protocol's poses, closed forms, what is
refused.
"""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dragged import has_contact
from hypothesis import given
from hypothesis import strategies as st
from junctions import MOUTH_M, build_scene, lanes_of, protocol_scene, turned
from refusals import refused_with
from scenario_lanes import arm_lanes, pose_at
from strategies import KMH, numbers

from geometry.errors import InputError
from geometry.junction import build_junction
from geometry.study_scene import load_study_scene
from placement.question import Question
from placement.setting import drive
from scenarios.aeb import last_brake_time_s, load_aeb_rule
from scenarios.cases import (
    at_vru_speed,
    load_cases,
    load_unlaid_cases,
    pick_cases,
    select_cases,
)
from scenarios.paths import Motion, StraightPath
from scenarios.protocol import stage_by_protocol
from scenarios.staging import CannotCarryError, NoRoadError

FILE = Path(__file__).parents[1] / "golden" / "euroncap_junction.toml"
GOLDEN = tomllib.loads(FILE.read_text(encoding="utf-8"))
JUNCTION = build_junction(protocol_scene())
RULE = load_aeb_rule()
CROSSING = tuple(GOLDEN["crossing"])


@pytest.fixture(scope="module")
def golf(vut):
    """The VUT that the files assume."""
    size = GOLDEN["turning"]["vut"]
    rear_m = size["middle_ahead_of_rear_axle_m"]
    return replace(
        vut,
        name="golf",
        length_m=size["length_m"],
        width_m=size["width_m"],
        wheelbase_m=size["wheelbase_m"],
        front_axle_ahead_m=size["wheelbase_m"] - rear_m,
    )


def stage(name, vut, speed_kmh, vru_kmh, *, approach="west", junction=JUNCTION):
    """A case at its speeds, with the bodies beside."""
    (case,) = pick_cases(name, "cases", case_range="extended")
    case = at_vru_speed(case, vru_kmh)
    return stage_by_protocol(
        case,
        junction,
        approach,
        vut_speed_kmh=speed_kmh,
        vut=vut,
    )


def ahead(yaw_deg):
    """Unit vector in a direction."""
    return turned([1.0, 0.0], yaw_deg)


# ---------- poses at the impact
@pytest.mark.parametrize("name", CROSSING)
@pytest.mark.parametrize(
    ("speed_kmh", "vru_kmh"),
    [
        (20, 60),
        (40, 40),
        (60, 20),
        (80, 30),
    ],
)
def test_crossing_vehicles_meet_where_the_protocol_says(golf, name, speed_kmh, vru_kmh):
    """At every speed in the same place."""
    golden = GOLDEN["crossing"][name]
    encounter = stage(name, golf, speed_kmh, vru_kmh).encounter
    motion = encounter.vru_motion
    vut, _ = pose_at(encounter.vut_motion)
    vru, vru_yaw_deg = pose_at(motion)

    assert vut == pytest.approx(golden["vut_middle_m"], abs=1e-4)
    assert vru == pytest.approx(golden["vru_middle_m"], abs=1e-4)
    assert vru_yaw_deg == pytest.approx(golden["vru_yaw_deg"])
    # At its speed for the protocol's 3.5 s.
    assert motion.speed_mps == pytest.approx(vru_kmh * KMH)
    assert motion.start_time_s == pytest.approx(-3.5, abs=1e-6)
    assert motion.acceleration_distance_m == 0.0


@pytest.mark.parametrize("name", ["CCFtap", "CMFtap"])
def test_vehicles_ahead_of_a_turning_vut_meet_where_the_protocol_says(golf, name):
    """The files give the VUT's rear axle and the target's front, by both speeds."""
    turning = GOLDEN["turning"]
    rear_m = turning["vut"]["middle_ahead_of_rear_axle_m"]
    golden = {key: np.array(table) for key, table in turning[name].items()}

    for row, speed_kmh in enumerate(turning["vut_speeds_kmh"]):
        for column, vru_kmh in enumerate(turning["vru_speeds_kmh"]):
            encounter = stage(name, golf, speed_kmh, vru_kmh).encounter
            vut, yaw_deg = pose_at(encounter.vut_motion)
            vru, vru_yaw_deg = pose_at(encounter.vru_motion)
            x, y = vut - rear_m * ahead(yaw_deg)
            front = vru + 0.5 * encounter.vru.length_m * ahead(vru_yaw_deg)
            expected = {key: table[row, column] for key, table in golden.items()}

            assert x == pytest.approx(expected["vut_rear_axle_x_m"], abs=2e-4)
            assert y == pytest.approx(expected["vut_rear_axle_y_m"], abs=2e-4)
            assert yaw_deg == pytest.approx(expected["vut_yaw_deg"], abs=1e-3)

            place = [expected["vru_front_x_m"], 1.75]
            assert front == pytest.approx(place, abs=2e-4)


@pytest.mark.parametrize("family", ["CCCscp", "CMCscp"])
@pytest.mark.parametrize("side", ["far", "near"])
def test_three_cars_are_parked_where_the_protocol_says(golf, family, side):
    """A large one and two small ones, all parallel to the VUT's lane."""
    golden = GOLDEN["parked"][side]
    parked = stage(f"{family}-{side}", golf, 40, 60).obstruction
    names = ("large", "small", "small_2")

    for name, body in zip(names, parked, strict=True):
        size = np.array([body.actor.length_m, body.actor.width_m])
        middle = body.pose.position_m[:2]
        low = middle - 0.5 * size
        high = middle + 0.5 * size
        x, y = np.stack([low, high], axis=1)

        assert body.actor.name == f"parked-car-{name.removesuffix('_2')}"
        assert x == pytest.approx(golden[f"{name}_x_m"], abs=1e-6)
        assert y == pytest.approx(golden[f"{name}_y_m"], abs=1e-6)
        assert body.pose.yaw_deg == pytest.approx(0.0, abs=1e-9)


def test_where_one_of_both_is_faster_than_60_kmh_no_cars_are_parked(golf):
    """The protocol parks them for slow runs alone."""
    slow = stage("CCCscp-far", golf, 60, 60)
    fast_vut = stage("CCCscp-far", golf, 70, 20)
    fast_target = stage("CCCscp-far", golf, 20, 80)

    assert slow.obstruction
    assert not fast_vut.obstruction
    assert not fast_target.obstruction


BRAKING = GOLDEN["braking"]
BRAKING_S = dict(
    zip(BRAKING["vut_speeds_kmh"], BRAKING["time_braking_to_impact_s"], strict=True)
)


@pytest.mark.parametrize(("speed_kmh", "braking_s"), BRAKING_S.items())
@pytest.mark.parametrize("name", ["CCRb-2026-50", "CMRb-25"])
def test_a_vehicle_ahead_brakes_so_long_before_the_impact_as_the_protocol_says(
    golf, name, speed_kmh, braking_s
):
    """The VUT follows a second behind at the same speed until then."""
    encounter = stage(name, golf, speed_kmh, speed_kmh).encounter
    motion = encounter.vru_motion

    assert motion.brake_time_s == pytest.approx(-braking_s, abs=6e-4)

    vut, _ = pose_at(encounter.vut_motion, motion.brake_time_s)
    vru, _ = pose_at(motion, motion.brake_time_s)
    ahead_m, _ = vru - vut
    lengths_m = encounter.vut.length_m + encounter.vru.length_m
    gap_m = ahead_m - 0.5 * lengths_m

    assert gap_m == pytest.approx(speed_kmh * KMH, abs=1e-5)  # a second behind
    assert motion.start_time_s <= motion.brake_time_s - 1.0 + 1e-6


# ---------- the last moment, in closed form
@pytest.mark.parametrize("name", CROSSING)
@pytest.mark.parametrize("speed_kmh", [20.0, 60.0])
@pytest.mark.parametrize("vru_kmh", [20.0, 60.0])
def test_the_last_moment_of_a_straight_crossing_is_its_closed_form(
    golf, name, speed_kmh, vru_kmh
):
    """Stop short of the other one's strip, or get there no sooner than it has left
    one's own.
    """
    encounter = stage(name, golf, speed_kmh, vru_kmh).encounter
    vru = encounter.vru
    v = speed_kmh * KMH
    u = vru_kmh * KMH
    a = RULE.deceleration_mps2
    if vru.name == "car":
        left_s = (0.75 * vru.length_m + 0.5 * golf.width_m) / u
        beyond_m = 0.0  # at the impact, of the front behind the strip's near edge
    else:
        left_s = (vru.length_m + golf.width_m) / u
        beyond_m = 0.1 * golf.length_m + 0.5 * vru.width_m
    driven_m = beyond_m + v * left_s
    braked_s = np.sqrt(2.0 * driven_m / a)
    stands_s = v / a
    if braked_s <= stands_s:
        last_s = left_s - braked_s
    else:
        last_s = -(beyond_m / v + 0.5 * stands_s)

    assert last_brake_time_s(encounter, RULE) == pytest.approx(last_s, abs=2e-5)


@pytest.mark.parametrize(
    ("name", "speed_kmh", "vru_kmh"),
    [
        ("CCRs-2026-50", 50.0, 0.0),
        ("CCRs-2026-m25", 30.0, 0.0),
        ("CMRs-90", 20.0, 0.0),
        ("CCRm-2026-50", 80.0, 20.0),
        ("CCRm-2026-125", 130.0, 70.0),
        ("CCFhos-2026-50", 50.0, 50.0),
        ("CCFhos-2026-25", 80.0, 70.0),
    ],
)
def test_the_last_moment_behind_and_ahead_of_a_steady_vehicle_is_its_closed_form(
    golf, name, speed_kmh, vru_kmh
):
    """Behind: until both are equally fast. Ahead: until the VUT stands."""
    v = speed_kmh * KMH
    u = vru_kmh * KMH
    a = RULE.deceleration_mps2
    # Until the VUT is as slow as the one ahead; until it stands, while the other one
    # comes on.
    last_s = -0.5 * (v - u) / a
    if name.startswith("CCFhos"):
        stop_m = 0.5 * v**2 / a
        come_m = u * v / a
        last_s = -(stop_m + come_m) / (v + u)
    encounter = stage(name, golf, speed_kmh, vru_kmh).encounter

    assert last_brake_time_s(encounter, RULE) == pytest.approx(last_s, abs=2e-5)


@given(
    speed_kmh=numbers(20.0, 90.0),
    deceleration_mps2=numbers(1.0, 8.0),
    headway_s=numbers(0.6, 2.0),
    final_kmh=numbers(0.0, 10.0),
)
def test_behind_a_vehicle_that_brakes_the_last_moment_is_the_last_one(
    golf, speed_kmh, deceleration_mps2, headway_s, final_kmh
):
    """A millisecond later they touch."""
    case = load_cases()["CCRb-2026-50"]
    braking = replace(
        case.braking,
        deceleration_mps2=deceleration_mps2,
        headway_s=headway_s,
        final_speed_kmh=final_kmh,
    )
    case = replace(case, braking=braking, vru_speed_kmh=speed_kmh)
    staging = stage_by_protocol(
        case,
        JUNCTION,
        "west",
        vut_speed_kmh=speed_kmh,
        vut=golf,
    )
    encounter = staging.encounter
    last_s = last_brake_time_s(encounter, RULE)

    assert last_s < 0.0
    assert not has_contact(encounter, last_s, RULE)
    assert has_contact(encounter, last_s + 1e-3, RULE)


# ---------- motion
@given(
    speed_mps=numbers(1.0, 40.0),
    deceleration_mps2=numbers(0.5, 9.0),
    share=st.floats(0.0, 0.95),
    start_s=numbers(-9.0, -1.0),
    after_s=numbers(0.0, 5.0),
    acceleration_m=st.one_of(st.just(0.0), numbers(0.1, 5.0)),
    until_s=numbers(0.0, 12.0),
)
def test_the_distance_of_a_motion_that_brakes_is_the_area_under_its_speed(
    speed_mps, deceleration_mps2, share, start_s, after_s, acceleration_m, until_s
):
    """Summed up in 4,000 steps: speeding up, steady, braking, steady again."""
    up_to_speed_s = 2.0 * acceleration_m / speed_mps
    brake_s = start_s + up_to_speed_s + after_s
    final_mps = share * speed_mps
    motion = Motion(
        path=StraightPath(start_m=[0.0, 0.0], yaw_deg=0.0),
        speed_mps=speed_mps,
        start_time_s=start_s,
        acceleration_distance_m=acceleration_m,
        brake_time_s=brake_s,
        deceleration_mps2=deceleration_mps2,
        final_speed_mps=final_mps,
    )
    step_s = until_s / 4000
    middles = step_s * (np.arange(4000) + 0.5)
    gained_mps = np.full(4000, speed_mps)
    if acceleration_m > 0.0:
        gained = np.minimum(middles / up_to_speed_s, 1.0)
        gained_mps = speed_mps * gained
    braked_s = start_s + middles - brake_s
    lost_mps = deceleration_mps2 * np.maximum(braked_s, 0.0)
    slowed_mps = np.maximum(gained_mps - lost_mps, final_mps)
    speed = np.where(braked_s < 0.0, gained_mps, slowed_mps)

    area_m = speed.sum() * step_s
    steepest = max(motion.acceleration_mps2, deceleration_mps2)
    distance_m = float(motion.distance_m(start_s + until_s))

    assert distance_m == pytest.approx(area_m, abs=steepest * step_s**2 + 1e-9)


def test_a_motion_may_stand_where_it_is():
    """At 0 m/s there is no time in which it speeds up."""
    path = StraightPath(start_m=[1.0, 2.0], yaw_deg=90.0)
    motion = Motion(path=path, speed_mps=0.0, start_time_s=-4.0)
    driven_m = motion.distance_m([-9.0, 0.0, 9.0])

    assert (driven_m == 0.0).all()
    assert motion.acceleration_mps2 == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"deceleration_mps2": 0.0},
            "motion.deceleration_mps2: got 0.0; expected > 0 m/s^2",
        ),
        (
            {"final_speed_mps": 9.0},
            "motion.final_speed_mps: got 9.0; expected 0 <= it < speed_mps",
        ),
        ({"brake_time_s": -4.5}, "motion.brake_time_s: got -4.5; expected from -4 on"),
        (
            {"speed_mps": -1.0},
            "motion.speed_mps: got -1.0; expected > 0 metres per second",
        ),
    ],
)
def test_a_motion_that_brakes_says_what_is_wrong(change, message):
    good = {
        "path": StraightPath(start_m=[0.0, 0.0], yaw_deg=0.0),
        "speed_mps": 8.0,
        "start_time_s": -4.0,
        "brake_time_s": -2.0,
        "deceleration_mps2": 4.0,
    }
    with refused_with(message):
        Motion(**good | change)


# ---------- on other junctions
def refusal(name, vut, lanes, *, speed_kmh=20, vru_kmh=20):
    """Why a case finds no road on a junction of these lanes."""
    junction = build_junction(build_scene(lanes))
    with pytest.raises(CannotCarryError) as caught:
        stage(
            name,
            vut,
            speed_kmh,
            vru_kmh,
            junction=junction,
        )

    assert isinstance(caught.value, NoRoadError)
    return str(caught.value)


@pytest.mark.parametrize(
    ("arm", "name", "reason"),
    [
        ("north", "CCCscp-far", "no lane leads into the junction from the far side"),
        ("north", "CMCscp-near", "no road leads straight across from the near side"),
        ("south", "CCCscp-near", "no lane leads into the junction from the near side"),
        ("south", "CCCscp-far", "no road leads straight across from the far side"),
        ("east", "CCFtap", "no lane leads towards the VUT from straight ahead"),
    ],
)
def test_a_junction_without_a_crossing_road_carries_no_crossing_traffic(
    golf, arm, name, reason
):
    """The target needs a lane in, and one straight across from it."""
    assert refusal(name, golf, arm_lanes(without=[arm])) == reason


def bent_road(*, radius_m):
    """The protocol's junction with a northern arm that turns right behind its mouth."""
    lanes = arm_lanes(without=["north"])
    along = np.append(0.0, np.linspace(4.0, 120.0, 60))
    angle = np.maximum(along - 8.0, 0.0) / radius_m
    north = MOUTH_M + np.minimum(along, 8.0) + radius_m * np.sin(angle)

    for lane in lanes_of("north", 90.0):
        east = lane.centreline_m[0, 0] + radius_m * (1.0 - np.cos(angle))
        line = np.stack([east, north], axis=-1)
        if lane.id.startswith("north-in"):
            line = line[::-1]
        lanes.append(replace(lane, centreline_m=line))

    return lanes


def test_a_target_that_its_lanes_bend_is_too_slow_for_is_refused(golf):
    """In a bend of 30 m, 60 km/h is too fast and 30 km/h is not."""
    lanes = bent_road(radius_m=30.0)
    told = refusal(
        "CCCscp-far",
        golf,
        lanes,
        vru_kmh=60,
    )

    assert told == (
        "the lanes curve: a lateral acceleration of 4 m/s^2 allows the target"
        " 35 km/h there"
    )

    junction = build_junction(build_scene(lanes))
    slow = stage(
        "CCCscp-far",
        golf,
        20,
        30,
        junction=junction,
    )
    motion = slow.encounter.vru_motion

    assert motion.speed_mps == pytest.approx(30 * KMH)


def test_parked_cars_that_do_not_fit_are_refused_with_the_reason(lay):
    """The case is possible on this junction, but for the wall."""
    case = replace(load_cases()["CCCscp-near"], pairs_kmh=((30.0, 30.0),))
    # A wall all along the kerb of the western arm.
    wall = ("wall", -40.0, -6.0, 60.0, 4.5, 2.0)
    scene = protocol_scene(boxes=[wall])
    runs, refusals = lay(
        scene,
        [case],
        speeds_kmh=(30.0,),
        approaches=["west"],
    )
    (refused,) = refusals

    assert not runs
    assert refused.reason == "wall occupies the place of parked-car-large"
    assert refused.speeds_text == "30x30"
    assert refused.is_possible


def test_both_speeds_stand_in_a_runs_id(lay):
    """By the VUT's speed first, then by the target's."""
    scene = protocol_scene()
    speeds = (30.0, 40.0)
    runs, refused = lay(
        scene,
        ["CCCscp-far"],
        speeds_kmh=speeds,
        approaches=["north"],
    )
    ids = []
    vru_speeds_kmh = []
    for vut_kmh in (30, 40):
        for vru_kmh in (20, 30, 40, 50, 60):
            ids.append(f"CCCscp-far/north/{vut_kmh}x{vru_kmh}")
            vru_speeds_kmh.append(vru_kmh)

    assert not refused
    assert [run.id for run in runs] == ids
    assert [run.case.vru_speed_kmh for run in runs] == vru_speeds_kmh
    assert {run.road_user for run in runs} == {"car"}


# ---------- cases in the words of a user
def names(text, **choice):
    """Names of the cases that a text picks."""
    return [case.name for case in select_cases(text, **choice).cases]


def count(text, case_range):
    """Runs of some cases on one approach, at one place."""
    cases = select_cases(text, case_range=case_range).cases
    n_runs = 0
    for case in cases:
        for vut_kmh in case.vut_speeds_kmh:
            n_runs += len(case.vru_speeds_kmh(vut_kmh))

    return n_runs


@pytest.mark.parametrize(
    ("text", "standard", "extended"),
    [
        ("CCCscp", 50, 16),
        ("CMCscp", 50, 16),
        ("CCFtap", 9, 7),
        ("CMFtap", 9, 7),
        ("CCRs-2026", 25, 10),
        ("CCRs-FCW-2026", 15, 6),
        ("CCRm-2026", 55, 22),
        ("CCRb-2026", 30, 47),
        ("CCFhos-2026", 18, 14),
        ("CMRs", 15, 10),
        ("CMRs-FCW", 9, 6),
        ("CMRb", 18, 37),
    ],
)
def test_the_grids_have_as_many_runs_as_the_protocols(text, standard, extended):
    """The protocol's own counts; the extended range comes on top."""
    assert count(text, "standard") == standard
    assert count(text, "extended") == standard + extended


def test_the_year_tells_the_versions_of_a_case_apart():
    """Without a year it is the older one."""
    assert names("CPNA") == ["CPNA-25", "CPNA-75"]
    assert names("CPNA-2026") == ["CPNA-2026-25", "CPNA-2026-50", "CPNA-2026-75"]

    extended = names("CPNA-2026", case_range="extended")

    assert extended[-2:] == ["CPNA-2026-10", "CPNA-2026-90"]
    # Named in full.
    assert names("CPNA-2026-10") == ["CPNA-2026-10"]

    case = load_cases()["CPNA-2026-25"]

    assert case.vut_speeds_kmh == (10, 20, 30, 40, 50, 60)
    assert case.family == "CPNA"


def test_only_vulnerable_road_users_are_protected_unless_all_are():
    """A motorcyclist is one; somebody in a car is not."""
    protected = names("junction", protect="vru")
    assert protected == ["CMCscp-far", "CMCscp-near", "CMFtap"]

    some = select_cases("junction", protect="vru")
    every = select_cases("junction", protect="all")

    assert {case.road_user for case in some.unprotected} == {"car"}
    assert not every.unprotected

    told = "protect: got 'vru'; expected all, where every case asked for meets a car"
    with refused_with(told):
        select_cases("CCCscp", protect="vru")


def test_speeds_of_both_are_picked_in_pairs():
    """Only cases that have two speeds have such pairs."""
    selection = select_cases("CCCscp-far,CPNA-25", speeds="30x50,40x20")
    (case,) = selection.cases

    assert case.pairs_kmh == ((30.0, 50.0), (40.0, 20.0))

    speeds = [case.vru_speeds_kmh(vut_kmh) for vut_kmh in case.vut_speeds_kmh]
    assert speeds == [(50.0,), (20.0,)]
    assert [case.name for case in selection.left_out] == ["CPNA-25"]

    told = "speeds: got 30x55; expected speeds that go together"
    with pytest.raises(InputError, match=told):
        select_cases("CCCscp-far", speeds="30x55")


def test_cases_that_cannot_be_laid_are_named_and_refused_with_their_reason(lay):
    """They can be asked for, so that the answer says why they are not driven."""
    named = load_unlaid_cases()
    assert set(named) >= {"CPRA-Cm", "CPRA-Cs", "CCFhol", "SfS-CCCscp", "SfS-CMFtap"}
    assert not set(named) & set(load_cases())

    cases = pick_cases("CPRA,CCFhol,SfS", "cases")
    asked = {case.name for case in cases}
    runs, refused = lay(protocol_scene(), cases)

    assert not runs
    assert {one.case.name for one in refused} == asked

    for one in refused:
        assert one.reason == named[one.case.name].not_laid
        assert not one.is_possible


@pytest.mark.long
def test_cases_that_are_left_out_count_every_pair_of_speeds():
    """By default only vulnerable road users count, which leaves out those in cars."""
    question = Question(cases="junction", approaches="north")
    drives = drive(question, load_study_scene())

    assert {run.road_user for run in drives.runs} == {"motorcycle"}

    counts = {one.case.name: len(one.speeds_kmh) for one in drives.left_out}
    assert counts == {"CCCscp-far": 25, "CCCscp-near": 25, "CCFtap": 9}
    assert not any(one.is_possible for one in drives.left_out)


def test_only_in_all_impact_points_take_turns():
    """Of five impact points, each has every fifth run; in smaller sets each has all."""
    cases = {case.name: case for case in pick_cases("all", "cases")}
    turns = []
    for point in (0, 25, 50, 75, 100):
        turns.append(cases[f"CCRs-2026-{point}"].impact_turn)

    assert turns == [(number, 5) for number in range(5)]
    assert cases["CPNA-2026-50"].impact_turn == cases["CPFA-50"].impact_turn == (0, 1)

    for name in ("default", "study", "protocol-4.5.1", "junction", "protocol-2026"):
        picked = pick_cases(name, "cases")
        assert {case.impact_turn for case in picked} == {(0, 1)}
