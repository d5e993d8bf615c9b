"""What a user reads when wishes contradict each other."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_worlds import axis_of_runs

from geometry.study_scene import load_study_scene
from placement.candidates import CandidateGrid, build_candidates, load_candidate_grid
from placement.detection_table import pack_table
from placement.explain.conflicts import build_separation, find_refusal
from placement.layout import load_carlancap_layout
from placement.setting import Setting
from placement.wishes import Wishes, build_problem
from scenarios.aeb import load_aeb_rule

N_RUNS = 4
N_FRAMES = 6
SITES = ("corner-ne", "corner-nw", "corner-sw", "lamp-e1")


@pytest.fixture(scope="module")
def scene():
    """The study's junction."""
    return load_study_scene()


@pytest.fixture(scope="module")
def candidates(scene):
    """One pose at each of four sites, and the study's first two units."""
    grid = CandidateGrid(
        heights_m=[5.0],
        yaw_step_deg=360.0,
        pitches_deg=[-30.0],
        sensors=load_candidate_grid().sensors,
    )
    every = build_candidates(scene, grid, extra=load_carlancap_layout().units[:2])
    return tuple(c for c in every if c.site_id in SITES or c.id in ("RSU0", "RSU1"))


@pytest.fixture(scope="module")
def setting(scene):
    """Four runs of two cases."""
    axis = axis_of_runs(
        N_FRAMES * np.arange(N_RUNS + 1),
        np.tile(np.arange(1 - N_FRAMES, 1) / 10.0, N_RUNS),
        -0.1,
        ids="abcd",
    )
    axis = replace(axis, cases=("CPNA-25", "CPNA-25", "CBNA", "CBNA"))
    return Setting(
        scene=scene,
        runs=(),
        axis=axis,
        rule=load_aeb_rule(),
        detector=None,
        table_detector=None,
    )


@pytest.fixture(scope="module")
def problem_of(setting, candidates):
    """Pose i of the four sees run i and no other; the study's units see nothing."""
    detected = np.zeros((len(candidates), N_RUNS * N_FRAMES), dtype=bool)
    for row, candidate in enumerate(candidates):
        if not candidate.id.startswith("RSU"):
            run = SITES.index(candidate.site_id)
            detected[row, setting.axis.frames_of(run)] = True

    table = pack_table(tuple(c.id for c in candidates), setting.axis, detected)

    def build(wishes):
        return build_problem(setting, candidates, table, wishes=wishes)

    return build


@pytest.fixture(scope="module")
def refusal_of(problem_of, scene, candidates):
    """Finds what wishes are refused with."""

    def find(**wishes):
        wished = Wishes(**wishes)
        return find_refusal(
            problem_of(wished),
            wished,
            scene,
            candidates,
        )

    return find


TOGETHER = "got demands that no layout meets together; expected"
TOO_MUCH = "got a demand that no layout meets; expected"


@pytest.mark.long
@pytest.mark.parametrize(
    ("wishes", "text"),
    [
        (
            {"budget_units": 2, "target": 1.0},
            (
                f"`target` 1 and `budget` 2: {TOGETHER} one of them to give way:"
                " `target` 0.5 or `budget` 4"
            ),
        ),
        (
            {"budget_units": 3, "target": np.inf},
            (
                f"`target` max and `budget` 3: {TOGETHER} one of them to give way:"
                " `target` 0.75 or `budget` 4"
            ),
        ),
        ({"budget_eur": 1000.0}, f"`budget_cost` 1000: {TOO_MUCH} `budget_cost` 1500"),
        (
            {"budget_units": 1, "min_case_apr": 0.5},
            (
                "`min_case_apr` 0.5 in CPNA-25, `min_case_apr` 0.5 in CBNA and"
                f" `budget` 1: {TOGETHER} one of them to give way: `min_case_apr` 0 in"
                " CPNA-25 or `min_case_apr` 0 in CBNA or `budget` 2"
            ),
        ),
        (
            {
                "budget_units": 5,
                "target": 1.0,
                "existing": ("RSU0", "RSU1"),
            },
            (
                f"`target` 1 and `budget` 3: {TOGETHER} one of them to give way:"
                " `target` 0.75 or `budget` 4"
            ),
        ),
        (
            {"budget_units": 1, "forced_sites": ("corner-ne", "lamp-e1")},
            (
                f"`budget` 1 and `force_site` corner-ne,lamp-e1: {TOGETHER} one of them"
                " to give way: `budget` 2 or `force_site` without lamp-e1"
            ),
        ),
        (
            {
                "budget_units": 4,
                "target": 1.0,
                "separation_m": 30.0,
            },
            (
                f"`target` 1 and `separation_m` 30: {TOGETHER} one of them to give way:"
                " `target` 0.5 or `separation_m` 18.23"
            ),
        ),
    ],
)
def test_conflicts_are_told_by_the_fields_of_the_question(refusal_of, wishes, text):
    assert str(refusal_of(**wishes)) == text


def test_two_conflicts_are_both_told(refusal_of):
    refusal = refusal_of(
        budget_units=1,
        target=0.5,
        budget_eur=1000.0,
        forced_sites=("corner-ne", "lamp-e1"),
    )
    text = (
        f"`budget_cost` 1000: {TOO_MUCH} `budget_cost` 1500 (not enough by itself);"
        " besides, `target` 0.5 and `budget` 1: one of them to give way: `target`"
        " 0.25 (not enough by itself) or `budget` 2 (not enough by itself)"
    )

    assert str(refusal) == text


def test_what_can_be_met_is_not_refused(refusal_of):
    assert refusal_of(budget_units=2, target=0.5) is None


def test_separation_is_taken_apart_into_distances_and_capacities(
    problem_of, scene, candidates
):
    wishes = Wishes(budget_units=2, separation_m=40.0, site_capacity=3)
    problem = problem_of(wishes)
    limits = problem.limits

    separation = build_separation(problem, wishes, scene, candidates)

    assert len(separation.pair_distance_m) == len(limits.rivals) > 0
    assert (separation.pair_distance_m < 40.0).all()

    at = limits.site_index[[c.site_id in SITES for c in candidates]]

    assert (separation.site_capacity[at] == 3).all()
    assert (limits.site_capacity[at] == 1).all()

    none = Wishes(budget_units=2)

    assert build_separation(problem, none, scene, candidates) is None
