"""Cases on Euro NCAP's own junction: the protocol's numbers come out."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_names import case_names
from dragged import front_axle_at
from hypothesis import given
from hypothesis import strategies as st
from junctions import ARMS, build_scene, lanes_of, protocol_scene, turned
from scenario_lanes import arm_lanes, pose_at

from geometry.junction import build_junction
from scenarios.cases import load_cases
from scenarios.protocol import stage_by_protocol
from scenarios.staging import CannotCarryError, impact_offset_m

FILE = Path(__file__).parents[1] / "golden" / "euroncap_vru.toml"
GOLDEN = tomllib.loads(FILE.read_text(encoding="utf-8"))
CROSSING = GOLDEN["crossing"]
JUNCTION = build_junction(protocol_scene())
LINE_X_M = -9.5  # where the western arm is crossed: origin of the path frame
LANE_Y_M = -1.75


@pytest.fixture(scope="module")
def golf(vut):
    """The VUT that the files assume."""
    return replace(vut, name="golf", **GOLDEN["vut"])


def stage(name, golf, *, speed_kmh=None, approach="west", junction=JUNCTION):
    """A case, by default at its lowest speed, with the bodies beside."""
    case = load_cases()[name]
    speed_kmh = speed_kmh or case.vut_speeds_kmh[0]
    return stage_by_protocol(
        case,
        junction,
        approach,
        vut_speed_kmh=speed_kmh,
        vut=golf,
    )


def off_deg(one_deg, other_deg):
    """Difference of two directions, -180 to 180."""
    return (one_deg - other_deg + 180.0) % 360.0 - 180.0


def origin_of(golden):
    """Origin of the frame in which a file counts."""
    if golden["frame"] == "path":
        return np.array([LINE_X_M, LANE_Y_M])
    return np.zeros(2)


def front_of(encounter):
    """Middle of the VUT's front at the impact."""
    position, yaw_deg = pose_at(encounter.vut_motion)
    half_m = 0.5 * encounter.vut.length_m
    return position + turned([half_m, 0.0], yaw_deg)


def point_ahead(position, yaw_deg, by_m):
    """The point so far ahead of a body's middle."""
    return position + turned([by_m, 0.0], yaw_deg)


@pytest.mark.parametrize("name", CROSSING)
@pytest.mark.parametrize("speed_kmh", [10.0, 35.0, 60.0])
def test_crossing_bodies_meet_where_the_protocol_says(golf, name, speed_kmh):
    """Both bodies' places at the impact are those in the protocol's files."""
    golden = CROSSING[name]
    origin = origin_of(golden)
    encounter = stage(name, golf, speed_kmh=speed_kmh).encounter
    front_m = front_of(encounter) - origin
    vru, vru_yaw_deg = pose_at(encounter.vru_motion)
    vru_m = vru - origin
    speed_mps = speed_kmh / 3.6

    assert front_m == pytest.approx(golden["vut_front_m"], abs=1e-5)
    assert vru_m == pytest.approx(golden["vru_middle_m"], abs=1e-5)
    assert vru_yaw_deg == pytest.approx(golden["vru_yaw_deg"])
    assert encounter.vut_motion.speed_mps == pytest.approx(speed_mps)


@pytest.mark.parametrize("name", [n for n in CROSSING if n.startswith("CP")])
def test_crossing_pedestrians_take_the_protocols_time(golf, name):
    """From setting off to the impact."""
    motion = stage(name, golf).encounter.vru_motion
    golden_s = CROSSING[name]["time_start_to_impact_s"]
    # The facts count from the hip where CPFA's files count from the box: 0.06 m.
    assert -motion.start_time_s == pytest.approx(golden_s, abs=6e-4)


@pytest.mark.parametrize("name", [n for n in CROSSING if n.startswith("CB")])
def test_crossing_bicycles_start_where_the_files_say_and_keep_their_last_speed(
    golf, name
):
    """They speed up evenly, and then ride steadily up to the impact."""
    golden = CROSSING[name]
    motion = stage(name, golf).encounter.vru_motion

    assert motion.path.start_m == pytest.approx(golden["vru_start_m"], abs=1e-3)

    acceleration = motion.speed_mps**2 / (2.0 * motion.acceleration_distance_m)
    assert acceleration == pytest.approx(golden["acceleration_mps2"], abs=5e-4)

    gaining_s = 2.0 * motion.acceleration_distance_m / motion.speed_mps
    steady_s = -(motion.start_time_s + gaining_s)

    assert steady_s == pytest.approx(golden["steady_time_s"], abs=1e-6)


@pytest.mark.parametrize("name", [n for n, g in CROSSING.items() if "bodies" in g])
def test_obstructions_stand_at_the_protocols_gaps(golf, name):
    """Edges of parked cars, not their middles: the protocol measures between edges."""
    golden = CROSSING[name]
    parked = {body.actor.name: body for body in stage(name, golf).obstruction}

    assert parked.keys() == golden["bodies"].keys()

    for actor_name, box in golden["bodies"].items():
        body = parked[actor_name]
        along_and_across_m = [body.actor.length_m, body.actor.width_m]
        size = turned(along_and_across_m, body.pose.yaw_deg)
        half_x, half_y = 0.5 * np.abs(size)
        x, y = body.pose.position_m[:2] - origin_of(golden)

        # The files place reference points: a gap of 0.2 m comes out as 0.22.
        assert [x - half_x, x + half_x] == pytest.approx(box["x_m"], abs=0.021)
        assert [y - half_y, y + half_y] == pytest.approx(box["y_m"], abs=0.021)


@pytest.mark.parametrize("name", GOLDEN["longitudinal"])
def test_whoever_is_ahead_sets_off_at_the_protocols_trigger_gap(golf, name):
    """The gap is from the VUT's front to the rear of the one ahead."""
    golden = GOLDEN["longitudinal"][name]
    speeds_kmh = golden["vut_speeds_kmh"]
    gaps_m = golden["trigger_gap_m"]
    until_impact_s = golden["time_start_to_impact_s"]

    assert list(load_cases()[name].vut_speeds_kmh) == speeds_kmh

    for speed_kmh, gap_m in zip(speeds_kmh, gaps_m, strict=True):
        encounter = stage(name, golf, speed_kmh=speed_kmh).encounter
        start_s = encounter.vru_motion.start_time_s

        assert -start_s == pytest.approx(until_impact_s, abs=1e-6)

        vut, _ = pose_at(encounter.vut_motion, start_s)
        vru, _ = pose_at(encounter.vru_motion, start_s)
        ahead_m, left_m = vru - vut
        half_m = 0.5 * (encounter.vut.length_m + encounter.vru.length_m)

        assert ahead_m - half_m == pytest.approx(gap_m, abs=6e-4)
        assert left_m == pytest.approx(golden["vru_left_m"], abs=1e-9)


@pytest.mark.parametrize("name", GOLDEN["turning"])
def test_turns_lead_over_the_pedestrians_line_where_the_protocol_says(golf, name):
    """The front axle follows the protocol's curve, which is measured there."""
    golden = GOLDEN["turning"][name]
    speeds_kmh = golden["vut_speeds_kmh"]

    assert list(load_cases()[name].vut_speeds_kmh) == speeds_kmh

    for index, speed_kmh in enumerate(speeds_kmh):
        encounter = stage(name, golf, speed_kmh=speed_kmh).encounter
        walk = encounter.vru_motion.path
        turned_deg = off_deg(walk.yaw_deg, golden["vru_yaw_deg"])

        assert walk.start_m == pytest.approx(golden["vru_start_m"], abs=1e-6)
        assert abs(turned_deg) < 1e-9

        path = encounter.vut_motion.path
        begin, _ = front_axle_at(path, path.straight_m)

        assert begin == pytest.approx(golden["curve_start_m"][index], abs=2e-4)

        driven_m = path.straight_m + golden["path_after_curve_start_m"][index]
        line, _ = front_axle_at(path, driven_m)

        assert line == pytest.approx(golden["line_crossing_m"][index], abs=2e-4)


@pytest.mark.parametrize("name", GOLDEN["cbta"]["y_m"])
def test_bicycles_beside_a_turning_vut_ride_on_the_protocols_line(golf, name):
    """They have been at their speed for the protocol's distance at the impact."""
    motion = stage(name, golf).encounter.vru_motion
    _, north_m = motion.path.start_m

    assert north_m == pytest.approx(GOLDEN["cbta"]["y_m"][name])

    golden_deg = GOLDEN["cbta"]["yaw_deg"][name]
    turned_deg = off_deg(motion.path.yaw_deg, golden_deg)

    assert abs(turned_deg) < 1e-9

    steady_m = motion.distance_m(0.0) - motion.acceleration_distance_m
    # A corner may touch a moment before the foremost point does.
    tolerance_m = 0.02
    if name.endswith("side"):
        tolerance_m = 0.4
    golden_m = GOLDEN["cbta"]["steady_distance_m"]

    assert steady_m == pytest.approx(golden_m, abs=tolerance_m)


def meets_the_front(case):
    """The point at which a case meets the front is a share of the width."""
    return case.impact_face == "front" and case.family not in ("CCFtap", "CMFtap")


@pytest.mark.parametrize("name", case_names(meets_the_front))
def test_every_case_meets_the_front_at_its_share_of_the_width(golf, name):
    """50 % is the middle of the front."""
    case = load_cases()[name]
    encounter = stage(name, golf).encounter
    vut, yaw_deg = pose_at(encounter.vut_motion)
    vru, vru_yaw_deg = pose_at(encounter.vru_motion)
    point = point_ahead(vru, vru_yaw_deg, case.vru_reference_m)
    if case.kind == "longitudinal":
        point = vru
    left_m = (point - vut) @ turned([0.0, 1.0], yaw_deg)
    expected_m = impact_offset_m(case, golf)
    # Where a corner touches a moment early, the point is still that moment's way off.
    tolerance_m = 1e-5
    if case.kind == "turning":
        tolerance_m = 0.02

    assert left_m == pytest.approx(expected_m, abs=tolerance_m)


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("CBTAfs-side", 1),
        ("CBTAns-side", -1),
    ],
)
def test_side_impacts_meet_the_side_at_their_share_of_the_length(golf, name, side):
    """A quarter of the length ahead of the VUT's middle."""
    encounter = stage(name, golf).encounter
    vut, yaw_deg = pose_at(encounter.vut_motion)
    vru, vru_yaw_deg = pose_at(encounter.vru_motion)
    nose = point_ahead(vru, vru_yaw_deg, 0.5 * encounter.vru.length_m)
    ahead_m, left_m = turned(nose - vut, -yaw_deg)
    apart_m = side * left_m - 0.5 * golf.width_m

    # The VUT is still turning: a corner of the bicycle's box touches before its
    # foremost point.
    assert apart_m == pytest.approx(0.125, abs=0.125)
    assert ahead_m == pytest.approx(0.25 * golf.length_m, abs=0.2)


@pytest.mark.parametrize("name", case_names())
def test_every_approach_of_a_symmetric_junction_gives_the_same_run_turned(golf, name):
    """All arms are alike, so that only the direction differs."""
    west = stage(name, golf, approach="west").encounter
    times_s = np.linspace(-6.0, 0.0, 7)

    for approach in ("east", "north", "south"):
        other = stage(name, golf, approach=approach).encounter
        angle_deg = ARMS[approach] - ARMS["west"]
        for motion, image in (
            (west.vut_motion, other.vut_motion),
            (west.vru_motion, other.vru_motion),
        ):
            position, yaw_deg = motion.path.at(motion.distance_m(times_s))
            there, there_deg = image.path.at(image.distance_m(times_s))
            moved = turned(position, angle_deg)
            turned_deg = off_deg(yaw_deg + angle_deg, there_deg)
            assert moved == pytest.approx(there, abs=1e-6)
            assert np.abs(turned_deg).max() < 1e-6


def refusal(name, golf, lanes, **speed):
    """Why a case cannot be carried by a junction of these lanes."""
    junction = build_junction(build_scene(lanes))
    with pytest.raises(CannotCarryError) as caught:
        stage(
            name,
            golf,
            junction=junction,
            **speed,
        )
    return str(caught.value)


WITHOUT_WEST = arm_lanes(without=["west"])
ONE_WAY = [*WITHOUT_WEST, *lanes_of("west", 180.0, has_in=False)]
SHORT = [*WITHOUT_WEST, *lanes_of("west", 180.0, arm_m=10.0)]
LEFT = arm_lanes(without=["south"])
RIGHT = arm_lanes(without=["north"])


@pytest.mark.parametrize(
    ("name", "lanes", "reason"),
    [
        ("CPTAfs-50", RIGHT, "no lane leads out of the junction on the far side"),
        ("CPTAns-50", LEFT, "no lane leads out of the junction on the near side"),
        ("CBNA-50", LEFT, "no lane leads into the junction from the near side"),
        ("CPNA-25", ONE_WAY, "no lane leads into the junction from the west"),
        # 31.5 m to ride and half a bicycle; 2 m of them inside the mouth.
        (
            "CBLA-50",
            SHORT,
            "the VRU would set off 20.4 m before the mapped lane begins",
        ),
    ],
)
def test_a_junction_without_the_lane_that_a_case_needs_cannot_carry_it(
    golf, name, lanes, reason
):
    """Which lane is missing is said from where the VUT comes."""
    assert refusal(name, golf, lanes) == reason


def test_a_turn_that_ends_beyond_the_mapped_lane_cannot_be_carried(golf):
    """The lane out of the junction is 2 m long."""
    lanes = [*RIGHT, *lanes_of("north", 90.0, arm_m=2.0)]
    told = refusal(
        "CPTAfs-50",
        golf,
        lanes,
        speed_kmh=20.0,
    )
    assert "would end beyond the mapped lane north-out-0" in told


def test_a_wall_hides_the_studys_cyclist_until_17_m_before_without_published_starts(
    golf,
):
    case = load_cases()["CBNA"]
    staging = stage("CBNA", golf, speed_kmh=40.0)
    (wall,) = staging.obstruction
    length_m, thickness_m, height_m = case.obstruction.wall_size_m

    assert wall.actor.length_m == length_m
    assert wall.actor.width_m == thickness_m
    assert wall.actor.height_m == height_m

    # Along the cyclist's way, 1 m beside its box, on the side from which the VUT comes.
    x = 0.41 - 0.25 - 1.0 - 0.5 * thickness_m
    y = LANE_Y_M - 17.0 - 0.5 * length_m

    assert wall.pose.position_m[:2] == pytest.approx([x, y])
    assert abs(off_deg(wall.pose.yaw_deg, 90.0)) < 1e-9


@given(
    percent=st.floats(0.0, 100.0),
    speed_kmh=st.floats(5.0, 80.0),
    vru_speed_kmh=st.floats(2.0, 20.0),
    name=st.sampled_from(["CPNA-25", "CPNCO-50", "CPFA-50"]),
)
def test_from_the_other_side_a_run_is_the_mirror_image(
    golf, percent, speed_kmh, vru_speed_kmh, name
):
    """Near and far side swap, and the impact point is counted from the other corner."""
    case = replace(
        load_cases()[name],
        impact_percent=percent,
        vru_speed_kmh=vru_speed_kmh,
    )
    other_side = {"near": "far", "far": "near"}[case.vru_side]
    other = replace(case, impact_percent=100.0 - percent, vru_side=other_side)
    staged, mirrored = (
        stage_by_protocol(
            one,
            JUNCTION,
            "west",
            vut_speed_kmh=speed_kmh,
            vut=golf,
        )
        for one in (case, other)
    )

    times_s = np.linspace(-5.0, 0.0, 11)

    for who in ("vut_motion", "vru_motion"):
        motion = getattr(staged.encounter, who)
        mirror = getattr(mirrored.encounter, who)
        position, yaw_deg = motion.path.at(motion.distance_m(times_s))
        image, image_yaw_deg = mirror.path.at(mirror.distance_m(times_s))

        mirrored_deg = -np.asarray(yaw_deg)
        turned_deg = off_deg(mirrored_deg, image_yaw_deg)

        assert in_mirror(position) == pytest.approx(image, abs=1e-5)
        assert np.abs(turned_deg).max() < 1e-9

    for body, image in zip(staged.obstruction, mirrored.obstruction, strict=True):
        place = in_mirror(body.pose.position_m[:2])
        assert place == pytest.approx(image.pose.position_m[:2])


def in_mirror(position):
    """Places seen in a mirror along the middle of the VUT's lane."""
    return position * [1.0, -1.0] + [0.0, 2.0 * LANE_Y_M]
