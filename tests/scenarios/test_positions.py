"""Encounters along the arms: where they are laid, how they move, at which speeds."""

import dataclasses
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st
from junctions import (
    ARM_M,
    LANE_M,
    MOUTH_M,
    build_scene,
    lanes_of,
    protocol_scene,
    turned,
)
from oracles import distance_to_chain_m
from scenario_lanes import arm_lanes, build_lane, exchanged

from geometry.errors import InputError
from geometry.junction import build_junction, lane_length_m
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
from scenarios.runs import FrameAxis, build_frame_axis
from scenarios.staging import is_vehicle, load_way_rules
from scenarios.weights import default_weights

CASES = load_cases()
# One of each kind: years and impact points are laid alike.
FREE = {case.family: name for name, case in CASES.items() if not is_bound(case)}
CROSSWALK_M = MOUTH_M - 2.0  # from the middle of the protocol's junction
OPPOSITE = {
    "east": "west",
    "north": "south",
    "west": "east",
    "south": "north",
}


@pytest.fixture(scope="module")
def laid(lay):
    """A function that lays a case at one position, such as "-15" or "+20".

    It returns runs, and why there are none.
    """

    def build(scene, name, position, *, speeds=(30.0,), approach="west"):
        if isinstance(position, str):
            position = read_position(position, "position")
        return lay(
            scene,
            [name],
            speeds_kmh=speeds,
            approaches=[approach],
            positions=[position],
            is_spread=False,
        )

    return build


def impact_point(run):
    """Where the VRU's middle is at the impact."""
    motion = run.encounter.vru_motion
    place, _ = motion.path.at(motion.distance_m(0.0))
    return place


def lane_of(scene, name):
    """The lane of a scene that has an id."""
    (lane,) = (lane for lane in scene.lanes if lane.id == name)
    return lane


def assert_same_frames(one, other, *, by=(0.0, 0.0), tolerance_m=0.0):
    """Bodies of one run are where those of another one are, moved by a vector."""
    assert one.time_s.tolist() == other.time_s.tolist()
    for field in ("vut_position_m", "vru_position_m"):
        apart = getattr(one, field) - getattr(other, field) - by
        assert np.abs(apart).max() <= tolerance_m
    assert np.array_equal(one.vru_shape, other.vru_shape)


# Position 0


def test_the_default_set_holds_the_cases_of_the_study():
    """At four distances from the crosswalk, of which the study has only the first."""
    sets = load_case_sets()
    assert sets["default"] == sets["study"]

    four = pick_positions("0,15,30,45", "study")
    assert pick_positions("", "study") == (AT_ZERO,)
    assert pick_positions("0", "default") == (AT_ZERO,)
    assert pick_positions("", "default") == four

    assert is_study_set(" study")
    assert not is_study_set("study,CBNA")
    assert default_weights("study") == "run"
    assert default_weights("default") == "case"


# Quickly: the test above, and tests/placement/test_driving.py.
@pytest.mark.long
def test_the_default_question_has_four_to_six_hundred_runs_with_an_id_each(lay):
    """Every speed that is wanted is a run or refused."""
    cases = select_cases("default").cases
    every = pick_positions("", "default")
    runs, refusals = lay(load_study_scene(), cases, positions=every)

    ids = {run.id for run in runs}

    assert 450 <= len(runs) <= 600
    assert len(ids) == len(runs)

    for run in runs:
        assert len(run.time_s) > 1
        assert run.time_s[-1] <= 0.0

    laid_at = {run.position for run in runs}
    names = {position.name for position in every}

    assert laid_at == names

    # What is not driven is told.
    wanted = 0
    for case in cases:
        for arm in range(4):
            for number, position in enumerate(positions_of(case, every)):
                speeds_kmh = spread_speeds(
                    case.vut_speeds_kmh,
                    position,
                    turn=arm + number,
                )
                wanted += len(speeds_kmh)

    n_refused = sum(len(refusal.speeds_kmh) for refusal in refusals)
    assert wanted == len(runs) + n_refused


# Where


@pytest.mark.long
@given(
    name=st.sampled_from(list(FREE.values())),
    metres=st.floats(0.5, 120.0),
    is_behind=st.booleans(),
    speed_kmh=st.sampled_from([25.0, 45.0, 60.0]),
)
def test_on_straight_lanes_a_run_is_that_of_zero_moved_along(
    laid, name, metres, is_behind, speed_kmh
):
    """Before the junction and behind it, bodies beside included."""
    scene = protocol_scene()
    (here,), _ = laid(scene, name, "0", speeds=(speed_kmh,))
    position = Position(is_behind=is_behind, distance_m=metres)
    runs, refusals = laid(
        scene,
        name,
        position,
        speeds=(speed_kmh,),
    )

    if refusals:  # nobody parks in the junction
        assert is_behind
        assert metres < 15.0
        assert refusals[0].reason.endswith("would stand on the carriageway")
        return

    (there,) = runs
    by = np.array([-metres, 0.0])
    if is_behind:
        by = np.array([2.0 * CROSSWALK_M + metres, 0.0])

    assert_same_frames(
        there,
        here,
        by=by,
        tolerance_m=1e-6,
    )
    last_s = here.last_brake_time_s
    assert there.last_brake_time_s == pytest.approx(last_s, abs=1e-6)

    if here.obstruction and not is_behind:
        for one, other in zip(there.obstruction, here.obstruction, strict=True):
            moved = one.pose.position_m[:2] - other.pose.position_m[:2]
            assert moved == pytest.approx(by)
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
@pytest.mark.parametrize("metres", [0, 15])
def test_behind_the_vut_crosses_the_junction_to_the_other_arms_crosswalk(
    laid, name, approach, metres
):
    """On its way it keeps to the lanes in and out of the junction."""
    scene = load_study_scene()
    arms = build_junction(scene).arms
    arm = arms[OPPOSITE[approach]]
    (run,), _ = laid(
        scene,
        name,
        f"+{metres}",
        approach=approach,
        speeds=(60.0,),
    )
    leaving = arm.exit_lanes[0].centreline_m
    points = np.array([impact_point(run), leaving[-1]])
    beyond_m, exit_m = arm.crosswalk.coordinates(points)[:, 1]

    # Longitudinal: the VUT's front meets its rear there; crossing: its flank.
    assert np.sign(exit_m) * beyond_m == pytest.approx(metres, abs=0.2)

    entering = arms[approach].entry_lanes[0].centreline_m
    chain = np.concatenate([entering, leaving])
    away_m = np.linalg.norm(run.vut_position_m - chain[0], axis=-1)
    first = np.argmin(away_m) + 1

    assert distance_to_chain_m(run.vut_position_m[first:], chain).max() < 0.7


@pytest.mark.long
@given(
    name=st.sampled_from(list(FREE.values())),
    metres=st.sampled_from([0, 15, 40]),
    aside_m=st.floats(-2.5, 2.5),  # beyond, the lane out lies on the oncoming one
    turned_deg=st.floats(-15.0, 15.0),
)
def test_the_vut_changes_smoothly_into_a_lane_that_is_not_in_line(
    laid, name, metres, aside_m, turned_deg
):
    """The whole of the VUT's way stays in its lane, or between the lanes; its yaw never
    jumps.
    """
    assume(abs(aside_m) + abs(turned_deg) > 1.0)
    scene = scene_with_exit(aside_m, turned_deg)
    exit_m = lane_of(scene, "east-out-0").centreline_m
    runs, refusals = laid(
        scene,
        name,
        f"+{metres}",
        speeds=(25.0,),
    )
    reasons = ("the lanes curve", "curves too sharply", "parked")

    for refusal in refusals:  # the rest may be too sharp, or parked cars on the road
        assert any(reason in refusal.reason for reason in reasons)

    rules = load_way_rules()
    for run in runs:
        motion = run.encounter.vut_motion
        distance = np.linspace(0.0, float(motion.distance_m(0.0)), 400)
        place, yaw_deg = motion.path.at(distance)
        # Where a car that comes towards it is too fast for the bend, both take it more
        # gently.
        eased_m = 0.0
        if is_vehicle(run.encounter.vru):
            eased_m = rules.max_ease_aside_m
        before = place[place[:, 0] < -MOUTH_M - 3.0]
        off_m = np.abs(before[:, 1] + 0.5 * LANE_M).max(initial=0.0)

        assert off_m < max(0.1, eased_m)

        after = place[place[:, 0] > MOUTH_M + 6.0]
        if len(after):
            off_m = distance_to_chain_m(after, exit_m).max()
            assert off_m < max(0.2, eased_m + 0.1)

        yaw = np.unwrap(np.radians(yaw_deg))
        turn = np.abs(np.diff(yaw)) / np.diff(distance)

        assert turn.max() * motion.speed_mps**2 < 1.1 * rules.max_lateral_mps2


def scene_with_exit(aside_m, turned_deg):
    """The protocol's junction with the lane out to the east elsewhere."""
    mouth = np.array([MOUTH_M, -0.5 * LANE_M + aside_m])
    end = mouth + turned([ARM_M, 0.0], turned_deg)
    lane = build_lane("east-out-0", [mouth, end])
    return build_scene(exchanged(arm_lanes(), lane))


@pytest.mark.parametrize(
    ("metres", "name"),
    [
        (15.0, "CPNA-75"),
        (30.0, "CPLA-50"),
    ],
)
def test_before_the_junction_a_lane_that_bends_is_followed(laid, metres, name):
    """Distances are counted along the lane, not as the crow flies."""
    # Into the junction from the west, out of a bend.
    radius_m = 60.0
    angle = np.linspace(1.6, 0.0, 60)
    x = -MOUTH_M - radius_m * np.sin(angle)
    y = radius_m * (1.0 - np.cos(angle)) - 0.5 * LANE_M
    line = np.stack([x, y], axis=1)
    lanes = exchanged(arm_lanes(), build_lane("west-in-0", line))
    scene = build_scene([one for one in lanes if one.id != "west-out-0"])
    (here,), _ = laid(scene, name, "0")
    (there,), _ = laid(scene, name, f"-{metres}")

    assert isinstance(there.encounter.vut_motion.path, TowedPath)

    # Of 0 the lane ends 2 m before the crosswalk.
    chain = shapely.LineString(line)
    point = shapely.Point(impact_point(there))
    left_m = chain.length + 2.0 - chain.project(point)
    east_m, _ = impact_point(here)
    left_of_0_m = 2.0 - east_m - MOUTH_M

    assert left_m == pytest.approx(metres + left_of_0_m, abs=0.3)

    away_m = np.linalg.norm(there.vut_position_m - line[0], axis=-1)
    first = away_m.argmin()

    assert distance_to_chain_m(there.vut_position_m[first:], line).max() < 0.4


@pytest.mark.long
def test_the_lane_of_the_map_leads_through_the_junction(laid):
    """It bulges by a metre, and leads to the other lane of two."""
    plain = build_scene(arm_lanes(n_lanes=2))
    begin = lane_of(plain, "west-in-0").centreline_m[-1]
    end = lane_of(plain, "east-out-1").centreline_m[0]
    share = np.linspace(0.0, 1.0, 24)[:, None]
    aside = np.array([0.0, 1.0]) * np.sin(np.pi * share) ** 2
    bulge = begin + share * (end - begin) + aside
    through = build_lane("through", bulge, kind="connecting")
    scene = build_scene([*plain.lanes, through])
    (run,), _ = laid(
        scene,
        "CPFA-50",
        "+20",
        speeds=(35.0,),
    )
    east_m = run.vut_position_m[:, 0]
    inside = run.vut_position_m[np.abs(east_m) < MOUTH_M - 4.0]

    assert distance_to_chain_m(inside, bulge).max() < 0.55  # it cuts the bends
    assert impact_point(run)[1] == pytest.approx(end[1], abs=0.6)

    (straight,), _ = laid(plain, "CPFA-50", "+20")
    assert isinstance(straight.encounter.vut_motion.path, StraightPath)
    assert impact_point(straight)[1] == pytest.approx(begin[1], abs=0.6)


# What is refused


def test_positions_beyond_the_mapped_lanes_are_refused_with_the_reason(lay, laid):
    """Lanes are 40 m long; the crosswalk lies 2 m inside of their ends."""
    scene = build_scene(arm_lanes(arm_m=40.0))
    runs, refusals = lay(
        scene,
        ["CPNA-25"],
        speeds_kmh=(20.0,),
        positions=build_positions((0.0, 41.9, 42.1)),
        approaches=["west"],
        is_spread=False,
    )

    # The crosswalk lies 2 m inside the mouth.
    assert [run.position for run in runs] == ["0", "-41.9", "+0", "+41.9"]
    assert [one.position for one in refusals] == ["-42.1", "+42.1"]

    for one in refusals:
        assert one.reason == "the mapped lane does not reach that far"
        assert not one.is_possible

    runs, (refusal,) = laid(scene, "CBLA-50", "-15")

    assert not runs
    assert refusal.reason == "the VRU would set off before the mapped lane begins"


def shifted(lanes, **by_m):
    """Lanes, of which those of some arms are moved."""
    moved = []
    for lane in lanes:
        by = by_m.get(lane.id.partition("-")[0], [0.0, 0.0])
        moved.append(replace(lane, centreline_m=lane.centreline_m + by))
    return moved


FAR_ASIDE = build_scene(
    shifted(arm_lanes(), east=[0.0, 26.0], north=[0.0, 18.5]),
    outline_m=np.array(
        [
            [-11.5, -11.5],
            [11.5, -11.5],
            [11.5, 30.0],
            [-11.5, 30.0],
        ]
    ),
)


@pytest.mark.parametrize(
    "scene",
    [
        build_scene(arm_lanes(without=["east"])),
        FAR_ASIDE,
    ],
)
@pytest.mark.parametrize("position", ["+0", "+15"])
def test_without_a_road_ahead_nothing_is_behind(laid, scene, position):
    """There is no lane out, or it lies too far aside to be straight on."""
    runs, (refusal,) = laid(scene, "CPNA-25", position)
    assert not runs
    assert refusal.reason == "no lane leads straight on out of the junction"
    assert not refusal.is_possible
    assert refusal.position == position


@pytest.mark.long
def test_a_change_of_lanes_that_is_too_sharp_for_the_speed_is_refused(laid):
    scene = scene_with_exit(9.0, 0.0)  # too far aside to be eased
    runs, (refusal,) = laid(
        scene,
        "CPNA-25",
        "+15",
        speeds=(10.0, 60.0),
    )

    assert [run.vut_speed_kmh for run in runs] == [10.0]
    assert refusal.speeds_kmh == (60.0,)
    assert not refusal.is_possible

    told = (
        r"the lanes curve: a lateral acceleration of 4 m/s\^2 allows [1-5][05] km/h"
        r" there"
    )
    assert re.fullmatch(told, refusal.reason)


def test_cases_that_are_bound_to_the_junction_have_one_place():
    """Turns, and whoever comes from another arm."""
    bound = {name: case for name, case in CASES.items() if is_bound(case)}
    families = {name[:4] for name in bound}
    positions = build_positions((15.0, 30.0))

    assert families == {"CPTA", "CBTA", "CBNA", "CBFA", "CCCs", "CMCs", "CCFt", "CMFt"}

    for case in bound.values():
        assert positions_of(case, positions) == (AT_ZERO,)


# How often


@given(
    st.lists(
        st.integers(10, 90),
        min_size=3,
        max_size=20,
        unique=True,
    ).map(sorted),
    st.integers(0, 50),
)
def test_neighbours_take_turns_so_that_every_speed_is_driven(speeds, turn):
    """Away from the junction each position has a third of the speeds."""
    position = Position(distance_m=15.0)
    driven = []
    for add in range(3):
        driven += spread_speeds(speeds, position, turn=turn + add)

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
    """-0 is no position of its own."""
    names = [position.name for position in build_positions((0, 2.5, 15, 100))]
    in_order = ["-100", "-15", "-2.5", "0", "+0", "+2.5", "+15", "+100"]
    assert sort_positions(names) == in_order


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

    told = str(caught.value)
    assert told.startswith(f"along_arms: {message}")


@pytest.mark.parametrize(
    "text", ["", "15", "+", "-", "+-3", "x", "-nan", "+501", "-15,-30"]
)
def test_what_is_no_position_is_told(text):
    with pytest.raises(InputError) as caught:
        read_position(text, "position")

    told = str(caught.value)
    expected = "expected 0, or metres before it such as -15"
    assert told.startswith(f"position: got {text!r}; {expected}")


def test_a_frame_axis_knows_where_each_run_is(laid):
    """Without positions all runs are at 0."""
    runs, _ = laid(
        protocol_scene(),
        "CPLA-50",
        "-15",
        speeds=(20.0, 30.0),
    )
    assert [run.id for run in runs] == ["CPLA-50/west-15/20", "CPLA-50/west-15/30"]

    axis = build_frame_axis(runs, np.full(2, 0.5))
    assert axis.positions == ("-15", "-15")

    names = [field.name for field in dataclasses.fields(axis)]
    fields = {name: getattr(axis, name) for name in names}

    assert FrameAxis(**fields | {"positions": ()}).positions == ("0", "0")

    for positions in (("0",), ("15", "15"), ("-015", "-015")):
        with pytest.raises(InputError, match="positions: got"):
            FrameAxis(**fields | {"positions": positions})


# Joints of lanes that are not in line


@pytest.mark.long
def test_a_change_of_lanes_is_eased_only_where_it_would_be_too_fast(laid):
    """The faster car is farther off the middle of its lane before the mouth."""
    scene = scene_with_exit(2.0, 0.0)
    runs, _ = laid(
        scene,
        "CPFA-50",
        "+15",
        speeds=(20.0, 60.0),
    )

    aside_m = []
    for run in runs:
        points = run.encounter.vut_motion.path.course.points_m
        east_m, north_m = points.T
        is_before = np.abs(east_m + MOUTH_M + 2.0) < 1.0
        off_m = np.abs(north_m[is_before] + 0.5 * LANE_M)
        aside_m.append(off_m.max())

    slow_m, fast_m = aside_m

    assert slow_m < 0.1 < fast_m < 0.5


def test_behind_a_lane_that_only_turns_the_next_one_leads_straight_on(laid):
    """Of three lanes in, only the one at the axis has a lane out opposite."""
    lanes = arm_lanes(n_lanes=3, arm_m=70.0)
    lanes = [lane for lane in lanes if lane.id not in ("east-out-0", "east-out-1")]
    scene = build_scene(lanes)
    (run,), _ = laid(
        scene,
        "CPFA-50",
        "+15",
        speeds=(100.0,),
    )

    assert isinstance(run.encounter.vut_motion.path, StraightPath)
    # The lane at the axis.
    assert run.vut_position_m[0, 1] == pytest.approx(-0.5 * LANE_M)


# Beyond another junction, and where the map ends

NEXT_M = 15.0  # length of the arm to the west, up to another junction
ACROSS_M = 12.0  # of that one


def followed_scene():
    """The protocol's junction; 15 m to the west lies another one, and the road goes
    on.
    """
    pieces = []
    near = lanes_of("west", 180.0, arm_m=NEXT_M)
    for lane in near:
        is_in = lane.id == "west-in-0"
        tip = lane.centreline_m[-1]
        if is_in:
            tip = lane.centreline_m[0]
        beyond = tip - [ACROSS_M, 0.0]
        far = beyond - [200.0, 0.0]

        for name, kind, line in (
            ("through", "connecting", [tip, beyond]),
            ("far", "driving", [beyond, far]),
        ):
            if is_in:
                line = line[::-1]
            pieces.append(build_lane(f"{lane.id}-{name}", line, kind=kind))

    return build_scene([*arm_lanes(without=["west"]), *near, *pieces])


@pytest.mark.parametrize("name", ["CPNA-25", "CBLA-50", "CPLA-50"])
def test_a_lane_is_followed_straight_on_through_another_junction(laid, name):
    """The run is the same as on a lane without one."""
    scene = followed_scene()
    arm = build_junction(scene).arms["west"]
    lanes = (*arm.lanes_in, *arm.lanes_out)

    assert [round(lane_length_m(lane)) for lane in lanes] == [227, 227]

    position = f"-{NEXT_M + ACROSS_M + 10.0}"
    (run,), _ = laid(scene, name, position)
    (same,), _ = laid(protocol_scene(), name, position)

    assert_same_frames(run, same, tolerance_m=1e-9)


def test_nobody_crosses_in_the_middle_of_another_junction(laid):
    """Along the lane, a cyclist may still be met there."""
    scene = followed_scene()
    position = f"-{NEXT_M + 8.0}"
    runs, (refusal,) = laid(scene, "CPNA-25", position)

    assert not runs
    assert refusal.reason == "another junction is there: nobody crosses in its middle"
    assert not refusal.is_possible
    assert laid(scene, "CBLA-50", position)[0]


def test_a_connecting_lane_behind_which_nothing_begins_is_no_part_of_an_arm():
    """It leads nowhere that is mapped."""
    scene = followed_scene()
    lanes = tuple(lane for lane in scene.lanes if not lane.id.endswith("-far"))
    arm = build_junction(replace(scene, lanes=lanes)).arms["west"]

    assert [lane_length_m(lane) for lane in arm.lanes_in] == pytest.approx([NEXT_M])


@pytest.mark.parametrize("is_assumed", [False, True])
def test_where_the_map_ends_a_vru_sets_off_beyond_if_a_lane_is_assumed_there(
    laid, is_assumed
):
    lanes = arm_lanes(arm_m=40.0)
    begin = np.array([-MOUTH_M - 40.0, -0.5 * LANE_M])
    if is_assumed:
        line = [begin - [60.0, 0.0], begin]
        lanes.append(build_lane("beyond", line, kind="assumed"))
    scene = build_scene(lanes)
    runs, refusals = laid(scene, "CBLA-50", "-15")

    assert bool(runs) == is_assumed
    assert bool(refusals) != is_assumed

    if runs:
        (same,), _ = laid(protocol_scene(), "CBLA-50", "-15")
        assert_same_frames(runs[0], same, tolerance_m=1e-9)

    # But nobody is met where the map has no road.
    _, (refusal,) = laid(scene, "CPNA-25", "-45")

    assert refusal.reason == "the mapped lane does not reach that far"
    assert not refusal.is_possible


# Parked cars


def test_a_row_of_parked_cars_does_not_mind_a_bend_ahead_of_it(laid):
    """Behind the place where the VRU crosses, the lane turns as sharply as a corner of
    a house.
    """
    corner = np.array(
        [
            [-260.0, -1.75],
            [-20.0, -1.75],
            [-20.0, 12.0],
            [-11.5, 12.0],
        ]
    )
    scene = build_scene(
        [*arm_lanes(without=["west", "south"]), build_lane("west-in-0", corner)],
        outline_m=np.array(
            [
                [-11.5, -11.5],
                [11.5, -11.5],
                [11.5, 14.0],
                [-11.5, 14.0],
            ]
        ),
    )
    runs, refusals = laid(scene, "CPNCO-50", "-60")

    assert runs, refusals


def test_cars_park_on_spaces_that_a_wide_lane_has_beside_who_drives(laid):
    """Without spaces they would stand on the lane itself."""
    own = lane_of(protocol_scene(), "west-in-0")
    wide = exchanged(arm_lanes(), replace(own, width_m=12.0))
    runs, (refusal,) = laid(build_scene(wide), "CPNCO-50", "-30")

    assert not runs
    assert "would stand on the carriageway" in refusal.reason

    line = np.array(
        [
            [-200.0, -5.5],
            [-15.0, -5.5],
        ]
    )
    row = build_lane(
        "spaces",
        line,
        kind="parking",
        width_m=4.0,
    )
    runs, refusals = laid(build_scene([*wide, row]), "CPNCO-50", "-30")

    assert runs, refusals


@pytest.mark.parametrize("n_points", [2, 3, 5])
@pytest.mark.parametrize("position", [AT_ZERO, Position(distance_m=15.0)])
def test_impact_points_take_turns_and_every_speed_is_driven_with_one(
    n_points, position
):
    """Three turns each: positions away from 0 have a third of the speeds."""
    speeds = tuple(10.0 * number for number in range(1, 7))
    driven = {speed: set() for speed in speeds}

    for turn in range(3 * n_points):
        everything = spread_speeds(speeds, position, turn=turn)
        found = []
        for number in range(n_points):
            part = spread_speeds(
                speeds,
                position,
                turn=turn,
                impact_turn=(number, n_points),
            )
            found += part
            for speed in part:
                driven[speed].add(number)
        assert sorted(found) == sorted(everything)

    # Every speed comes to every impact point.
    every = set(range(n_points))
    for numbers in driven.values():
        assert numbers == every
