"""Random layouts, and an expert's rule of thumb."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from problems import questions
from tiny_worlds import unit_at

from geometry.junction import build_junction, mirrored
from geometry.study_scene import load_study_scene
from placement.baselines import (
    BaselineRows,
    find_corners,
    judge_proposals,
    middle_m,
    off_axis_deg,
    propose,
    random_sets,
)
from placement.candidates import build_candidates
from placement.detection_table import pack_table
from placement.layout import load_carlancap_layout
from placement.optimiser import Limits, PlacementProblem, apr
from placement.optimiser.allowed_sets import is_allowed
from placement.wishes import Wishes, build_limits

SCENE = load_study_scene()
# by eye on the study's plan: the lamp posts at the kerbs, not the signals beside
AT_CORNERS = {
    "east/north": "corner-ne",
    "south/east": "corner-se",
    "west/south": "corner-sw",
    "north/west": "corner-nw",
}


@pytest.fixture(scope="module")
def candidates():
    """Candidates of the scene."""
    return build_candidates(SCENE)


def limits_of(candidates, scene=SCENE, **wishes):
    """Limits of wishes."""
    wishes_given = Wishes(**({"budget_units": 3} | wishes))
    return build_limits(wishes_given, scene, candidates)


def drawn(candidates, limits, scene=SCENE, n_units=3, seed=0):
    """Layouts that are proposed."""
    rng = default_rng(seed)
    return propose(limits, candidates, scene, n_units=n_units, rng=rng)


# ---------- random layouts


@given(problem=questions(), n_units=st.integers(1, 4), seed=st.integers(0, 9))
def test_random_sets_are_within_all_limits(problem, n_units, seed):
    sets = random_sets(
        problem.limits,
        n_units,
        n=5,
        rng=default_rng(seed),
    )
    for units in sets:
        expected = sorted(set(units))

        assert len(units) == n_units
        assert list(units) == expected
        assert is_allowed(problem.limits, units)

    if not any(
        is_allowed(problem.limits, units)
        for units in combinations(range(problem.limits.n_poses), n_units)
    ):
        assert sets == ()


@pytest.mark.long
@given(problem=questions())
def test_every_allowed_set_is_drawn_sooner_or_later_and_no_other(problem):
    limits = problem.limits
    poses = range(limits.n_poses)
    pairs = combinations(poses, 2)

    allowed = {units for units in pairs if is_allowed(limits, units)}
    sets = random_sets(limits, 2, n=400, rng=default_rng(1))

    assert set(sets) == allowed


# ---------- corners and the middle


def test_the_corners_of_the_studys_junction_lie_between_its_arms_clockwise():
    corners = find_corners(build_junction(SCENE))

    assert [*corners] == [*AT_CORNERS]

    middle = middle_m(SCENE)[:2]
    places_m = corners.values()
    signs = [tuple(np.sign(corner - middle)) for corner in places_m]

    assert signs == [
        (1, 1),
        (1, -1),
        (-1, -1),
        (-1, 1),
    ]


def test_three_arms_have_a_corner_on_the_straight_side_and_one_arm_has_none():
    junction = build_junction(SCENE)
    arms_there = junction.arms.items()
    arms = {name: arm for name, arm in arms_there if name != "south"}

    three_armed = replace(junction, arms=arms)
    corners = find_corners(three_armed)

    assert [*corners] == ["east/north", "west/east", "north/west"]

    # Half way along the southern kerb, below the middle.
    straight = corners["west/east"]
    one_armed = replace(junction, arms={"east": arms["east"]})
    corners_of_one = find_corners(one_armed)
    middle = middle_m(SCENE)[:2]

    assert straight == pytest.approx(middle, abs=9.0)
    assert straight[1] < -7.0
    assert corners_of_one == {}


def test_in_a_mirror_corners_are_mirrored():
    """Kerbs are told by where they lie, not by the side on which traffic keeps."""
    plain, turned = (find_corners(one) for one in _both_ways())

    assert len(plain) == len(turned) == 4

    expected = {tuple((corner * [1.0, -1.0]).round(6)) for corner in plain.values()}
    found = {tuple(corner.round(6)) for corner in turned.values()}

    assert found == expected


def _both_ways():
    """The junction, and its mirror image."""
    junction = build_junction(SCENE)
    other = mirrored(junction)
    arms = [*other.arms.values()]
    order = arms[::-1]  # counter-clockwise again
    turned_arms = {arm.name: arm for arm in order}
    return junction, replace(other, arms=turned_arms)


def test_off_axis_is_the_angle_to_a_point(camera):
    def pose(yaw_deg, pitch_deg):
        return unit_at(
            "any",
            [0.0, 0.0, 10.0],
            yaw_deg=yaw_deg,
            pitch_deg=pitch_deg,
            sensor=camera,
        )

    poses = [
        pose(0, -45),
        pose(0, 0),
        pose(180, -45),
        pose(90, -45),
        pose(30, -90),
    ]

    point_m = np.array([10.0, 0.0, 0.0])
    found = off_axis_deg(poses, point_m)

    assert found == pytest.approx([0.0, 45.0, 90.0, 60.0, 45.0])


# ---------- the expert


def test_the_expert_looks_from_the_corner_posts_at_the_middle(candidates):
    """By hand: from each corner post along the diagonal, as the plan shows it."""
    proposals_drawn = drawn(candidates, limits_of(candidates))
    corners = proposals_drawn.corners
    rows_by_corner = corners.items()
    chosen = {name: candidates[row] for name, row in rows_by_corner}
    sites = {name: pose.site_id for name, pose in chosen.items()}

    assert sites == AT_CORNERS

    yaws = {name: pose.pose.yaw_deg for name, pose in chosen.items()}

    assert yaws == {
        "east/north": -135,
        "south/east": 135,
        "west/south": 45,
        "north/west": -45,
    }

    for name, pose in chosen.items():
        alike = [other for other in candidates if other.site_id == AT_CORNERS[name]]
        off_deg = off_axis_deg(alike, middle_m(SCENE))
        expected = off_deg.min()

        assert off_axis_deg([pose], middle_m(SCENE))[0] == pytest.approx(
            expected, abs=1e-6
        )


def test_two_corners_share_no_site_and_forbidden_ones_do_not_count(candidates):
    taken = drawn(
        candidates, limits_of(candidates, forbidden_sites=("corner-ne",))
    ).corners
    sites = [candidates[row].site_id for row in taken.values()]

    assert sites[0] == "signal-n"  # the next nearest
    assert len({*sites}) == 4

    few = replace(
        SCENE, sites=tuple(s for s in SCENE.sites if s.id in ("mast-n", "lamp-e1"))
    )

    poses = build_candidates(few)
    limits = limits_of(poses, few)
    proposals_drawn = drawn(poses, limits, few, n_units=2)
    taken = proposals_drawn.corners

    assert {name: poses[row].site_id for name, row in taken.items()} == {
        "east/north": "lamp-e1",
        "north/west": "mast-n",
    }


def problem_of(limits, seen, frame_axis, rule):
    """Poses that avoid the runs they see: of weight 1/2, 1/4, 1/4."""
    last_brake_time_s = np.zeros(3)
    axis = replace(frame_axis, last_brake_time_s=last_brake_time_s)
    detected = np.zeros((limits.n_poses, axis.n_frames), dtype=bool)
    for pose, runs in seen.items():
        for run in runs:
            detected[pose, axis.frames_of(run)] = True

    one_frame = replace(rule, n_confirmations=1, latency_s=0.0)
    numbers = range(limits.n_poses)
    ids = tuple(map(str, numbers))
    table = pack_table(ids, axis, detected)
    return PlacementProblem(
        table=table,
        limits=limits,
        fusion="any",
        rule=one_frame,
    )


def proposals(**changes):
    """Proposals by which four poses are compared."""
    corners = {"a": 0, "b": 1, "c": 2, "d": 3}
    plain = BaselineRows(
        n_units=2,
        random=((0, 1),),
        forced=(),
        corners=corners,
    )
    return replace(plain, **changes)


def test_the_corner_that_prevents_most_comes_first(frame_axis, rule):
    limits = Limits(
        site_index=[0, 1, 2, 3, 3],
        site_capacity=[1, 1, 1, 2],
        budget_units=2,
    )
    problem = problem_of(
        limits,
        {
            0: [1],
            1: [],
            2: [0, 1],
            3: [2],
            4: [0, 1, 2],
        },
        frame_axis,
        rule,
    )

    found = judge_proposals(problem, proposals())
    ratios = found.random.apr.tolist()
    both = apr(problem, (0, 1))

    # 3/4; of 1/4 the first.
    assert found.corners == ("c", "a")
    assert found.expert == (0, 2)
    assert ratios == [both] == [0.25]


def test_random_layouts_have_a_mean_in_every_sampled_world(frame_axis, rule):
    limits = Limits(site_index=[0, 1, 2, 3], site_capacity=[1] * 4)
    problem = problem_of(limits, {0: [0, 2], 1: [1]}, frame_axis, rule)
    # Weights 1/2 and 1/4; 1/4.
    sample_index = np.array([0, 0, 1])
    problem = replace(problem, sample_index=sample_index)
    sets = ((0,), (1,), (2,), (0, 1))

    sampled = proposals(random=sets)
    judged = judge_proposals(problem, sampled)
    random = judged.random
    means = pytest.approx([0.5, 0.5])

    assert random.apr.tolist() == [0.75, 0.25, 0.0, 1.0]
    # Of four sets two avoid the first run, two the second, two the third.
    assert random.mean_by_world == means

    cautious = replace(problem, tail=0.25)
    given_sets = proposals(random=sets)
    judged_worst = judge_proposals(cautious, given_sets)
    worst = judged_worst.random

    expected = [apr(replace(problem, tail=0.25), units) for units in sets]

    assert worst.apr.tolist() == expected


def test_the_expert_has_one_camera_for_each_corner_at_most(frame_axis, rule):
    limits = Limits(site_index=[0, 1, 2, 3], site_capacity=[1] * 4)
    problem = problem_of(limits, {}, frame_axis, rule)
    given_ = proposals(n_units=9)
    judged = judge_proposals(problem, given_)

    assert judged.expert == (0, 1, 2, 3)


def test_what_is_forced_comes_before_the_corners(frame_axis, rule):
    forced = [False, False, False, False, True, False]
    limits = Limits(
        site_index=[0, 1, 2, 3, 4, 5],
        site_capacity=[1] * 6,
        budget_units=3,
        is_forced=forced,
        is_forced_site=[False] * 5 + [True],
        rivals=[[0, 2]],
    )
    problem = problem_of(limits, {0: [0], 2: [0, 1]}, frame_axis, rule)

    given_ = proposals(n_units=3, forced=(5,))
    found = judge_proposals(problem, given_)

    assert found.expert == (2, 4, 5)
    assert found.corners == ("c",)

    # Nothing known at that site.
    unforced = proposals(n_units=3, forced=())
    unmet = judge_proposals(problem, unforced)

    assert unmet.expert == ()
    assert unmet.corners == ()


@given(problem=questions(), seed=st.integers(0, 9))
def test_the_expert_is_within_all_limits(problem, seed):
    rng = default_rng(seed)
    n_poses = problem.limits.n_poses
    order = rng.permutation(n_poses)
    first_rows = order[:4]
    rows = first_rows.tolist()
    sites = problem.limits.site_index.tolist()
    forced = tuple(
        sites.index(site)
        for site in np.flatnonzero(problem.limits.is_forced_site)
        if site in sites
    )
    corners = {f"corner {row}": row for row in rows}

    given_ = BaselineRows(
        n_units=3,
        random=(),
        forced=forced,
        corners=corners,
    )

    found = judge_proposals(problem, given_)

    assert found.random is None

    if found.expert:
        n_chosen = len(found.expert)
        assert is_allowed(problem.limits, found.expert)
        assert n_chosen <= 3 or problem.limits.is_forced.sum() > 3


def test_of_the_poses_that_occur_the_same_sets_come_out(frame_axis, rule):
    """A table of few rows says what one of all candidates says."""
    rng = default_rng(0)
    site_index = np.arange(9)
    limits = Limits(site_index=site_index, site_capacity=[1] * 9, budget_units=3)
    seen = {pose: np.flatnonzero(rng.random(3) < 0.4) for pose in range(9)}
    problem = problem_of(limits, seen, frame_axis, rule)
    given_ = BaselineRows(
        n_units=3,
        random=((1, 5, 7), (2, 5, 8)),
        forced=(),
        corners={"a": 7, "b": 1},
    )
    rows = given_.rows

    assert rows == (1, 2, 5, 7, 8)

    part = problem_of(
        limits.of_poses(np.array(rows)),
        {k: seen[row] for k, row in enumerate(rows)},
        frame_axis,
        rule,
    )
    whole = judge_proposals(problem, given_)

    among = given_.among(rows)
    of_part = judge_proposals(part, among)
    rows_of_part = [rows[row] for row in of_part.expert]

    assert rows_of_part == list(whole.expert)
    assert of_part.corners == whole.corners
    assert np.array_equal(of_part.random.apr, whole.random.apr)


def test_the_studys_own_poses_may_be_what_an_expert_takes(candidates):
    """They are candidates at the study's junction: RSU0 looks at the middle from the
    south-east.
    """
    poses = build_candidates(SCENE, extra=load_carlancap_layout().units)
    found = drawn(poses, limits_of(poses))
    corners = found.corners

    assert poses[corners["south/east"]].id == "RSU0"
