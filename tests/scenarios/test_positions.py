"""Encounters along the arms: where they are laid, how they move, at which speeds."""

import dataclasses
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from junctions import (
    ARM_M,
    ARMS,
    LANE_M,
    MOUTH_M,
    build_scene,
    lanes_of,
    protocol_scene,
    turned,
)
from oracles import distance_to_chain_m

from geometry.errors import InputError
from geometry.junction import build_junction, lane_length_m
from geometry.scene import Lane
from geometry.study_scene import load_study_scene
from scenarios.cases import load_case_sets, load_cases, select_cases
from scenarios.paths import StraightPath, TowedPath
from scenarios.positions import (
    AT_ZERO,
    Position,
    build_positions,
    is_bound,
    is_study_set,
    pick_positions,
    positions_of,
    read_along_arms,
    read_position,
    sort_positions,
    spread_speeds,
)
from scenarios.runs import FrameAxis, build_frame_axis, build_runs
from scenarios.staging import is_vehicle, load_way_rules
from scenarios.weights import default_weights

FREE = tuple(  # one of each kind: years and impact points are laid alike
    {
        case.family: name for name, case in load_cases().items() if not is_bound(case)
    }.values()
)
CROSSWALK_M = MOUTH_M - 2.0  # from the middle of the protocol's junction


@pytest.fixture(scope="module")
def vut(actors):
    return actors["vut"]


@pytest.fixture(scope="module")
def default_runs(vut, rule):
    cases = select_cases("default").cases
    positions = pick_positions("", "default")
    return build_runs(
        load_study_scene(), cases, vut=vut, rule=rule, positions=positions
    )


def laid(scene, name, position, vut, rule, *, speeds=(30.0,), approach="west"):
    """Runs of a case at one position, and why there are none."""
    case = replace(load_cases()[name], vut_speeds_kmh=speeds)
    return build_runs(
        scene,
        [case],
        vut=vut,
        rule=rule,
        approaches=[approach],
        positions=[position],
        is_spread=False,
    )


def impact_point(run):
    """Where the VRU's middle is at the impact."""
    motion = run.encounter.vru_motion
    return motion.path.at(motion.distance_m(0.0))[0]


def same_frames(one, other, *, by=(0.0, 0.0), tolerance_m=0.0):
    assert one.time_s.tolist() == other.time_s.tolist()
    for field in ("vut_position_m", "vru_position_m"):
        apart = getattr(one, field) - getattr(other, field) - by
        assert np.abs(apart).max() <= tolerance_m
    assert np.array_equal(one.vru_shape, other.vru_shape)


# Position 0


def test_the_default_set_holds_the_cases_of_the_study():
    assert load_case_sets()["default"] == load_case_sets()["study"]
    assert pick_positions("", "study") == pick_positions("0", "default") == (AT_ZERO,)
    assert pick_positions("", "default") == pick_positions("0,15,30,45", "study")
    assert is_study_set(" study")
    assert not is_study_set("study,CBNA")
    assert default_weights("study") == "run"
    assert default_weights("default") == "case"


# Quickly: the test above, and tests/placement/test_driving.py.
@pytest.mark.long
def test_the_default_question_has_four_to_six_hundred_runs_with_an_id_each(
    default_runs,
):
    runs, refusals = default_runs
    assert 450 <= len(runs) <= 600
    assert len({run.id for run in runs}) == len(runs)
    assert all(len(run.time_s) > 1 and run.time_s[-1] <= 0.0 for run in runs)
    laid_at = Counter(run.position for run in runs)
    assert set(laid_at) == {
        position.name for position in build_positions((0, 15, 30, 45))
    }
    # What is not driven is told.
    cases = select_cases("default").cases
    wanted = sum(
        len(spread_speeds(case.vut_speeds_kmh, position, turn=arm + number))
        for case in cases
        for arm in range(4)
        for number, position in enumerate(
            positions_of(case, build_positions((0.0, 15.0, 30.0, 45.0)))
        )
    )
    assert wanted == len(runs) + sum(len(refusal.speeds_kmh) for refusal in refusals)


# Where


@pytest.mark.long
@given(
    name=st.sampled_from(FREE),
    metres=st.floats(0.5, 120.0),
    is_behind=st.booleans(),
    speed_kmh=st.sampled_from([25.0, 45.0, 60.0]),
)
def test_on_straight_lanes_a_run_is_that_of_zero_moved_along(
    vut, rule, name, metres, is_behind, speed_kmh
):
    scene = protocol_scene()
    (here,), _ = laid(scene, name, AT_ZERO, vut, rule, speeds=(speed_kmh,))
    position = Position(is_behind=is_behind, distance_m=metres)
    runs, refusals = laid(scene, name, position, vut, rule, speeds=(speed_kmh,))
    if refusals:  # nobody parks in the junction
        assert is_behind
        assert metres < 15.0
        assert refusals[0].reason.endswith("would stand on the carriageway")
        return
    (there,) = runs
    by = np.array([2.0 * CROSSWALK_M + metres if is_behind else -metres, 0.0])
    same_frames(there, here, by=by, tolerance_m=1e-6)
    assert there.last_brake_time_s == pytest.approx(here.last_brake_time_s, abs=1e-6)
    if here.obstruction and not is_behind:
        for one, other in zip(there.obstruction, here.obstruction, strict=True):
            assert one.pose.position_m[:2] - other.pose.position_m[:2] == pytest.approx(
                by
            )
            assert one.pose.yaw_deg == pytest.approx(other.pose.yaw_deg)


@pytest.mark.parametrize(
    ("name", "approach"),
    [
        ("CPNA-25", "east"),
        ("CPFA-50", "north"),
        ("CPLA-50", "west"),
        ("CBLA-50", "south"),
    ],
)
def test_behind_the_vut_crosses_the_junction_to_the_other_arms_crosswalk(
    vut, rule, name, approach
):
    scene = load_study_scene()
    opposite = {"east": "west", "north": "south", "west": "east", "south": "north"}[
        approach
    ]
    arm = build_junction(scene).arms[opposite]
    for metres in (0.0, 15.0):
        position = Position(is_behind=True, distance_m=metres)
        (run,), _ = laid(
            scene, name, position, vut, rule, approach=approach, speeds=(60.0,)
        )
        beyond = arm.crosswalk.coordinates(impact_point(run))[1]
        side = np.sign(arm.crosswalk.coordinates(arm.exit_lanes[0].centreline_m[-1])[1])
        # Longitudinal: the VUT's front meets its rear there; crossing: its flank.
        assert side * beyond == pytest.approx(metres, abs=0.2)
        chain = np.concatenate(
            [
                build_junction(scene).arms[approach].entry_lanes[0].centreline_m,
                arm.exit_lanes[0].centreline_m,
            ]
        )
        on_map = slice(
            np.argmin(np.hypot(*(run.vut_position_m - chain[0]).T)) + 1, None
        )
        assert distance_to_chain_m(run.vut_position_m[on_map], chain).max() < 0.7


@pytest.mark.long
@given(
    name=st.sampled_from(FREE),
    metres=st.sampled_from([0.0, 15.0, 40.0]),
    aside_m=st.floats(-2.5, 2.5),  # beyond, the lane out lies on the oncoming one
    turned_deg=st.floats(-15.0, 15.0),
)
def test_the_vut_changes_smoothly_into_a_lane_that_is_not_in_line(
    vut, rule, name, metres, aside_m, turned_deg
):
    """The whole of the VUT's way stays in its lane, or between the lanes; its yaw never
    jumps.
    """
    assume(abs(aside_m) + abs(turned_deg) > 1.0)
    scene, exit_lane = _scene_with_exit(aside_m, turned_deg)
    position = Position(is_behind=True, distance_m=metres)
    runs, refusals = laid(scene, name, position, vut, rule, speeds=(25.0,))
    reasons = ("the lanes curve", "curves too sharply", "parked")
    for refusal in refusals:  # the rest may be too sharp, or parked cars on the road
        assert any(reason in refusal.reason for reason in reasons)
    for run in runs:
        motion = run.encounter.vut_motion
        distance = np.linspace(0.0, float(motion.distance_m(0.0)), 400)
        place, yaw_deg = motion.path.at(distance)
        # Where a car that comes towards it is too fast for the bend, both take it more
        # gently.
        if is_vehicle(run.encounter.vru):
            eased_m = load_way_rules().max_ease_aside_m
        else:
            eased_m = 0.0
        is_before = place[:, 0] < -MOUTH_M - 3.0
        off_m = np.abs(place[is_before, 1] + 0.5 * LANE_M).max(initial=0.0)
        assert off_m < max(0.1, eased_m)
        is_after = place[:, 0] > MOUTH_M + 6.0
        if is_after.any():
            off_m = distance_to_chain_m(place[is_after], exit_lane.centreline_m).max()
            assert off_m < max(0.2, eased_m + 0.1)
        turn = np.abs(np.diff(np.unwrap(np.radians(yaw_deg)))) / np.diff(distance)
        limit = load_way_rules().max_lateral_mps2
        assert turn.max() * motion.speed_mps**2 < 1.1 * limit


def _scene_with_exit(aside_m, turned_deg):
    """The protocol's junction with the lane out to the east elsewhere."""
    lanes = [lane for arm, bearing in ARMS.items() for lane in lanes_of(arm, bearing)]
    mouth = np.array([MOUTH_M, -0.5 * LANE_M + aside_m])
    exit_lane = Lane(
        id="east-out-0",
        kind="driving",
        width_m=LANE_M,
        centreline_m=np.array([mouth, mouth + turned([ARM_M, 0.0], turned_deg)]),
    )
    lanes = [exit_lane if lane.id == "east-out-0" else lane for lane in lanes]
    return build_scene(lanes), exit_lane


@pytest.mark.parametrize(("metres", "name"), [(15.0, "CPNA-75"), (30.0, "CPLA-50")])
def test_before_the_junction_a_lane_that_bends_is_followed(vut, rule, metres, name):
    radius_m = 60.0
    angle = np.linspace(0.0, 1.6, 60)
    # Into the junction from the west, out of a bend.
    bend = np.stack(
        [-MOUTH_M - radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle))], axis=1
    )
    lane = Lane(
        id="west-in-0",
        kind="driving",
        width_m=LANE_M,
        centreline_m=bend[::-1] - [0.0, 0.5 * LANE_M],
    )
    lanes = [lane for arm, bearing in ARMS.items() for lane in lanes_of(arm, bearing)]
    lanes = [lane if one.id == "west-in-0" else one for one in lanes]
    scene = build_scene([one for one in lanes if one.id != "west-out-0"])
    (here,), _ = laid(scene, name, AT_ZERO, vut, rule)
    (there,), _ = laid(scene, name, Position(distance_m=metres), vut, rule)
    assert isinstance(there.encounter.vut_motion.path, TowedPath)
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(lane.centreline_m, axis=0).T)))

    def station(point):
        fine = np.linspace(0.0, length[-1], 20_000)
        places = np.stack(
            [np.interp(fine, length, lane.centreline_m[:, k]) for k in (0, 1)], 1
        )
        return fine[np.hypot(*(places - point).T).argmin()]

    # Of 0 the lane ends 2 m before the crosswalk.
    assert length[-1] + 2.0 - station(impact_point(there)) == pytest.approx(
        metres + (2.0 - impact_point(here)[0] - MOUTH_M), abs=0.3
    )
    first = np.hypot(*(there.vut_position_m - lane.centreline_m[0]).T).argmin()
    mapped = there.vut_position_m[first:]
    assert distance_to_chain_m(mapped, lane.centreline_m).max() < 0.4


@pytest.mark.long
def test_the_lane_of_the_map_leads_through_the_junction(vut, rule):
    lanes = [
        lane
        for arm, bearing in ARMS.items()
        for lane in lanes_of(arm, bearing, n_lanes=2)
    ]
    chosen = next(lane for lane in lanes if lane.id == "east-out-1")
    entry = next(lane for lane in lanes if lane.id == "west-in-0")
    share = np.linspace(0.0, 1.0, 24)[:, None]
    begin = entry.centreline_m[-1]
    end = chosen.centreline_m[0]
    bulge = (
        begin
        + share * (end - begin)
        + np.array([0.0, 1.0]) * np.sin(np.pi * share) ** 2
    )
    through = Lane(id="through", kind="connecting", width_m=LANE_M, centreline_m=bulge)
    position = Position(is_behind=True, distance_m=20.0)
    (run,), _ = laid(
        build_scene([*lanes, through]), "CPFA-50", position, vut, rule, speeds=(35.0,)
    )
    inside = run.vut_position_m[np.abs(run.vut_position_m[:, 0]) < MOUTH_M - 4.0]
    assert distance_to_chain_m(inside, bulge).max() < 0.55  # it cuts the bends
    assert impact_point(run)[1] == pytest.approx(chosen.centreline_m[0, 1], abs=0.6)
    (straight,), _ = laid(build_scene(lanes), "CPFA-50", position, vut, rule)
    assert isinstance(straight.encounter.vut_motion.path, StraightPath)
    assert impact_point(straight)[1] == pytest.approx(entry.centreline_m[0, 1], abs=0.6)


# What is refused


def test_positions_beyond_the_mapped_lanes_are_refused_with_the_reason(vut, rule):
    lanes = [lane for arm, at in ARMS.items() for lane in lanes_of(arm, at, arm_m=40.0)]
    scene = build_scene(lanes)
    far = build_positions((0.0, 41.9, 42.1))
    case = replace(load_cases()["CPNA-25"], vut_speeds_kmh=(20.0,))
    runs, refusals = build_runs(
        scene,
        [case],
        vut=vut,
        rule=rule,
        positions=far,
        approaches=["west"],
        is_spread=False,
    )
    # The crosswalk lies 2 m inside the mouth.
    assert [run.position for run in runs] == ["0", "-41.9", "+0", "+41.9"]
    assert [(one.position, one.reason, one.is_possible) for one in refusals] == [
        ("-42.1", "the mapped lane does not reach that far", False),
        ("+42.1", "the mapped lane does not reach that far", False),
    ]
    runs, (refusal,) = laid(scene, "CBLA-50", Position(distance_m=15.0), vut, rule)
    assert not runs
    assert refusal.reason == "the VRU would set off before the mapped lane begins"


def test_without_a_road_ahead_nothing_is_behind(vut, rule):
    lanes = [
        lane for arm, at in ARMS.items() if arm != "east" for lane in lanes_of(arm, at)
    ]
    runs, (refusal,) = laid(
        build_scene(lanes),
        "CPNA-25",
        Position(is_behind=True, distance_m=0.0),
        vut,
        rule,
    )
    assert not runs
    assert refusal.reason == "no lane leads straight on out of the junction"
    assert not refusal.is_possible
    assert refusal.position == "+0"


@pytest.mark.long
def test_a_change_of_lanes_that_is_too_sharp_for_the_speed_is_refused(vut, rule):
    scene, _ = _scene_with_exit(9.0, 0.0)  # too far aside to be eased
    speeds = (10.0, 60.0)
    position = Position(is_behind=True, distance_m=15.0)
    runs, (refusal,) = laid(scene, "CPNA-25", position, vut, rule, speeds=speeds)
    assert [run.vut_speed_kmh for run in runs] == [10.0]
    assert refusal.speeds_kmh == (60.0,)
    assert re.fullmatch(
        r"the lanes curve: a lateral acceleration of 4 m/s\^2 allows [1-5][05] km/h"
        r" there",
        refusal.reason,
    )
    assert not refusal.is_possible


def test_cases_that_are_bound_to_the_junction_have_one_place():
    bound = {name for name, case in load_cases().items() if is_bound(case)}
    assert {name[:4] for name in bound} == {
        *("CPTA", "CBTA", "CBNA", "CBFA"),
        *("CCCs", "CMCs", "CCFt", "CMFt"),
    }
    for name in bound:
        assert positions_of(load_cases()[name], build_positions((15.0, 30.0))) == (
            AT_ZERO,
        )


# How often


@given(
    st.lists(st.integers(10, 90), min_size=3, max_size=20, unique=True).map(sorted),
    st.integers(0, 50),
)
def test_neighbours_take_turns_so_that_every_speed_is_driven(speeds, turn):
    position = Position(distance_m=15.0)
    driven = [
        speed
        for add in range(3)
        for speed in spread_speeds(speeds, position, turn=turn + add)
    ]
    assert sorted(driven) == speeds
    assert spread_speeds(speeds, AT_ZERO, turn=turn) == tuple(speeds)


# Names


@given(
    st.sampled_from(["+", "-", ""]), st.floats(0.0, 500.0).map(lambda x: round(x, 2))
)
def test_a_position_is_read_back_by_its_name(sign, metres):
    assume(sign or metres == 0.0)
    position = read_position(f"{sign}{metres:g}", "position")
    assert read_position(position.name, "position") == position
    assert (position.name == "0") == (metres == 0.0 and sign != "+")


def test_positions_are_sorted_as_the_vut_passes_them():
    names = [position.name for position in build_positions((0, 2.5, 15, 100))]
    assert sort_positions(names) == [
        "-100",
        "-15",
        "-2.5",
        "0",
        "+0",
        "+2.5",
        "+15",
        "+100",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "-15",
            (
                "got '-15'; expected metres along the arm, 0 to 500, with commas"
                " between, such as"
            ),
        ),
        ("nan", "got 'nan'; expected metres along"),
        ("0,,15", "got ''; expected metres along"),
        ("0,inf", "got 'inf'; expected metres along"),
        ("501", "got '501'; expected metres along the arm, 0 to 500"),
        ("-0", "got '-0'; expected metres along"),
        ("far", "got 'far'; expected metres along"),
        (
            "0,15,15.0",
            "got '0,15,15.0'; expected every distance once, and 15 is there twice",
        ),
        (",".join(map(str, range(10_000))), "got 10000 distances; expected at most 40"),
    ],
)
def test_distances_that_cannot_be_are_one_line(text, message):
    with pytest.raises(InputError) as caught:
        read_along_arms(text, "along_arms")
    assert str(caught.value).startswith(f"along_arms: {message}")


@pytest.mark.parametrize(
    "text", ["", "15", "+", "-", "+-3", "x", "-nan", "+501", "-15,-30"]
)
def test_what_is_no_position_is_told(text):
    with pytest.raises(InputError) as caught:
        read_position(text, "position")
    assert str(caught.value).startswith(
        f"position: got {text!r}; expected 0, or metres before it such as -15"
    )


def test_a_frame_axis_knows_where_each_run_is(vut, rule):
    before_15_m = Position(is_behind=False, distance_m=15.0)
    speeds = (20.0, 30.0)
    runs, _ = laid(protocol_scene(), "CPLA-50", before_15_m, vut, rule, speeds=speeds)
    assert [run.id for run in runs] == ["CPLA-50/west-15/20", "CPLA-50/west-15/30"]
    weight = np.full(len(runs), 1.0 / len(runs))
    axis = build_frame_axis(runs, weight)
    assert axis.positions == tuple(run.position for run in runs)
    fields = {
        field.name: getattr(axis, field.name) for field in dataclasses.fields(axis)
    }
    assert FrameAxis(**{**fields, "positions": ()}).positions == ("0",) * len(runs)
    for positions in (("0",), ("15",) * len(runs), ("-015",) * len(runs)):
        with pytest.raises(InputError, match="positions: got"):
            FrameAxis(**{**fields, "positions": positions})


# Joints of lanes that are not in line


@pytest.mark.long
def test_a_change_of_lanes_is_eased_only_where_it_would_be_too_fast(vut, rule):
    scene, _ = _scene_with_exit(2.0, 0.0)
    position = Position(is_behind=True, distance_m=15.0)
    slow, fast = laid(scene, "CPFA-50", position, vut, rule, speeds=(20.0, 60.0))[0]

    def aside_m(run):
        path = run.encounter.vut_motion.path
        points = path.course.points_m
        before = points[np.abs(points[:, 0] + MOUTH_M + 2.0) < 1.0]
        return np.abs(before[:, 1] + 0.5 * LANE_M).max()

    assert aside_m(slow) < 0.1 < aside_m(fast) < 0.5


def test_behind_a_lane_that_only_turns_the_next_one_leads_straight_on(vut, rule):
    lanes = [
        lane
        for arm, at in ARMS.items()
        for lane in lanes_of(arm, at, n_lanes=3, arm_m=70.0)
    ]
    lanes = [lane for lane in lanes if lane.id not in ("east-out-0", "east-out-1")]
    scene = build_scene(lanes)
    position = Position(is_behind=True, distance_m=15.0)
    (run,), _ = laid(scene, "CPFA-50", position, vut, rule, speeds=(100.0,))
    assert isinstance(run.encounter.vut_motion.path, StraightPath)
    assert run.vut_position_m[0, 1] == pytest.approx(
        -0.5 * LANE_M
    )  # the lane at the axis


def test_an_arm_far_aside_does_not_lie_ahead(vut, rule):
    lanes = [lane for arm, at in ARMS.items() for lane in lanes_of(arm, at)]
    moved = [
        (
            replace(lane, centreline_m=lane.centreline_m + [0.0, 26.0])
            if lane.id.startswith("east")
            else lane
        )
        for lane in lanes
    ]
    outline = np.array([[-11.5, -11.5], [11.5, -11.5], [11.5, 30.0], [-11.5, 30.0]])
    north = [turned([[0.0, 0.0]], 0.0)[0] + [0.0, 18.5]]
    scene = build_scene(
        [
            (
                replace(lane, centreline_m=lane.centreline_m + north[0])
                if lane.id.startswith("north")
                else lane
            )
            for lane in moved
        ],
        outline_m=outline,
    )
    position = Position(is_behind=True, distance_m=15.0)
    runs, (refusal,) = laid(scene, "CPNA-25", position, vut, rule)
    assert not runs
    assert refusal.reason == "no lane leads straight on out of the junction"
    assert not refusal.is_possible


# Beyond another junction, and where the map ends

NEXT_M = 15.0  # length of the arm to the west, up to another junction
ACROSS_M = 12.0  # of that one


def _followed_scene():
    """The protocol's junction; 15 m to the west lies another one, and the road goes
    on.
    """
    lanes = [
        lane for arm, at in ARMS.items() if arm != "west" for lane in lanes_of(arm, at)
    ]
    near = lanes_of("west", 180.0, arm_m=NEXT_M)
    pieces = []
    for lane in near:
        tip = lane.centreline_m[0 if lane.id == "west-in-0" else -1]
        beyond = tip - [ACROSS_M, 0.0]
        far = tip - [ACROSS_M + 200.0, 0.0]
        is_in = lane.id == "west-in-0"
        for name, kind, line in (
            ("through", "connecting", [beyond, tip] if is_in else [tip, beyond]),
            ("far", "driving", [far, beyond] if is_in else [beyond, far]),
        ):
            pieces.append(
                Lane(
                    id=f"{lane.id}-{name}",
                    kind=kind,
                    width_m=LANE_M,
                    centreline_m=np.array(line),
                )
            )
    return build_scene([*lanes, *near, *pieces])


def test_a_lane_is_followed_straight_on_through_another_junction(vut, rule):
    scene = _followed_scene()
    arm = build_junction(scene).arms["west"]
    assert [round(lane_length_m(lane)) for lane in (*arm.lanes_in, *arm.lanes_out)] == [
        227,
        227,
    ]
    for name in ("CPNA-25", "CBLA-50", "CPLA-50"):
        position = Position(distance_m=NEXT_M + ACROSS_M + 10.0)
        (run,), _ = laid(scene, name, position, vut, rule)
        (same,), _ = laid(protocol_scene(), name, position, vut, rule)
        same_frames(run, same, tolerance_m=1e-9)


def test_nobody_crosses_in_the_middle_of_another_junction(vut, rule):
    scene = _followed_scene()
    position = Position(distance_m=NEXT_M + 8.0)
    runs, (refusal,) = laid(scene, "CPNA-25", position, vut, rule)
    assert not runs
    assert refusal.reason == "another junction is there: nobody crosses in its middle"
    assert not refusal.is_possible
    assert laid(scene, "CBLA-50", position, vut, rule)[0]


def test_a_connecting_lane_behind_which_nothing_begins_is_no_part_of_an_arm():
    scene = _followed_scene()
    lanes = tuple(lane for lane in scene.lanes if not lane.id.endswith("-far"))
    arm = build_junction(replace(scene, lanes=lanes)).arms["west"]
    assert [lane_length_m(lane) for lane in arm.lanes_in] == pytest.approx([NEXT_M])


def test_where_the_map_ends_a_vru_sets_off_beyond_if_a_lane_is_assumed_there(vut, rule):
    lanes = [lane for arm, at in ARMS.items() for lane in lanes_of(arm, at, arm_m=40.0)]
    begin = np.array([-MOUTH_M - 40.0, -0.5 * LANE_M])
    assumed = Lane(
        id="beyond",
        kind="assumed",
        width_m=LANE_M,
        centreline_m=np.array([begin - [60.0, 0.0], begin]),
    )
    position = Position(distance_m=15.0)
    for scene, is_driven in (
        (build_scene(lanes), False),
        (build_scene([*lanes, assumed]), True),
    ):
        runs, refusals = laid(scene, "CBLA-50", position, vut, rule)
        assert bool(runs) == is_driven
        assert bool(refusals) != is_driven
        if runs:
            (same,), _ = laid(protocol_scene(), "CBLA-50", position, vut, rule)
            same_frames(runs[0], same, tolerance_m=1e-9)
        # But nobody is met where the map has no road.
        _, (refusal,) = laid(scene, "CPNA-25", Position(distance_m=45.0), vut, rule)
        assert refusal.reason == "the mapped lane does not reach that far"
        assert not refusal.is_possible


# Parked cars


def test_a_row_of_parked_cars_does_not_mind_a_bend_ahead_of_it(vut, rule):
    """Behind the place where the VRU crosses, the lane turns as sharply as a corner of
    a house.
    """
    corner = np.array([[-260.0, -1.75], [-20.0, -1.75], [-20.0, 12.0], [-11.5, 12.0]])
    lane = Lane(id="west-in-0", kind="driving", width_m=LANE_M, centreline_m=corner)
    others = [
        lane
        for arm, at in ARMS.items()
        if arm in ("east", "north")
        for lane in lanes_of(arm, at)
    ]
    scene = build_scene(
        [*others, lane],
        outline_m=np.array(
            [[-11.5, -11.5], [11.5, -11.5], [11.5, 14.0], [-11.5, 14.0]]
        ),
    )
    runs, refusals = laid(scene, "CPNCO-50", Position(distance_m=60.0), vut, rule)
    assert runs, refusals


def test_cars_park_on_spaces_that_a_wide_lane_has_beside_who_drives(vut, rule):
    lanes = [lane for arm, at in ARMS.items() for lane in lanes_of(arm, at)]
    wide = [
        replace(lane, width_m=12.0) if lane.id == "west-in-0" else lane
        for lane in lanes
    ]
    row = Lane(
        id="spaces",
        kind="parking",
        width_m=4.0,
        centreline_m=np.array([[-200.0, -5.5], [-15.0, -5.5]]),
    )
    position = Position(distance_m=30.0)
    runs, (refusal,) = laid(build_scene(wide), "CPNCO-50", position, vut, rule)
    assert not runs
    assert "would stand on the carriageway" in refusal.reason
    runs, refusals = laid(build_scene([*wide, row]), "CPNCO-50", position, vut, rule)
    assert runs, refusals


@pytest.mark.parametrize("n_points", [2, 3, 5])
@pytest.mark.parametrize("position", [AT_ZERO, Position(distance_m=15.0)])
def test_impact_points_take_turns_and_every_speed_is_driven_with_one(
    n_points, position
):
    speeds = tuple(10.0 * number for number in range(1, 7))
    driven = {speed: set() for speed in speeds}
    for turn in range(3 * n_points):
        everything = spread_speeds(speeds, position, turn=turn)
        parts = [
            spread_speeds(speeds, position, turn=turn, impact_turn=(number, n_points))
            for number in range(n_points)
        ]
        assert sorted(speed for part in parts for speed in part) == sorted(everything)
        for number, part in enumerate(parts):
            for speed in part:
                driven[speed].add(number)
    # every speed comes to every impact point
    assert all(numbers == set(range(n_points)) for numbers in driven.values())
