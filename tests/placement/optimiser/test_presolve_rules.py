"""Every rule of presolve alone, on random problems, against the enumeration of
``oracle``.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from all_layouts import MINIMISED, sets_of_size, sign_of
from changes import changed
from numpy.random import default_rng
from oracle import TIE, TIE_EUR, Oracle
from problems import kinds_of, random_problem

from placement.detection_table import pack_table
from placement.optimiser import Limits, PlacementProblem, presolve
from placement.optimiser.bitsets import set_values
from placement.optimiser.presolve import ALL_RULES, Rule, find_needless, presolve_freely
from placement.optimiser.problem import Objective
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

TAKES_USABLE = {Rule.NEEDLESS_POSES, Rule.DOMINATED_POSES}
"""Rules that take it for granted that poses are usable."""
N_PROBLEMS = 30
N_LONG = 200
"""So many problems in the long group."""
SUBSETS = [
    {rule} | ({Rule.UNUSABLE_POSES} & ALL_RULES) for rule in sorted(TAKES_USABLE)
]
ALONE = [
    *({rule} for rule in sorted(Rule) if rule not in TAKES_USABLE),
    *SUBSETS,
    set(ALL_RULES),
    ALL_RULES - {Rule.NEEDLESS_POSES},
    ALL_RULES - {Rule.DOMINATED_POSES},
    set(),
]


@cache
def drawn(number):
    """A random problem and its enumeration, which all rules share."""
    problem = random_problem(default_rng([17, number]))
    return problem, Oracle(problem)


@cache
def drawn_freely(number):
    """A random problem that asks for nothing but the best, and its enumeration."""
    problem = random_problem(default_rng([18, number]))
    problem = replace(problem, floors=(), goal="best")
    return problem, Oracle(problem)


def best_by_stage(oracle, layouts):
    """Best value of every stage among layouts that tie in all stages before."""
    best = []
    rivals = list(layouts.values())

    for name in oracle.names:
        sign = sign_of(name)
        tie = TIE_EUR if name in MINIMISED else TIE
        most = max(sign * values[name] for values in rivals)
        best.append(sign * most)
        rivals = [values for values in rivals if sign * values[name] >= most - tie]

    return best


def check_stages(oracle, reduced):
    """Check that the poses left reach the best value of every stage; False: no
    layout.
    """
    if not oracle.layouts:
        return False

    left = set(reduced.pose_index.tolist())
    among_left = {
        poses: values
        for poses, values in oracle.layouts.items()
        if left.issuperset(poses)
    }

    assert among_left, "no layout is left"

    expected = best_by_stage(oracle, oracle.layouts)
    got = best_by_stage(oracle, among_left)

    assert got == pytest.approx(expected, abs=TIE_EUR, rel=0.0), oracle.names

    return True


EACH_RULE = pytest.mark.parametrize(
    "rules", ALONE, ids=lambda rules: " and ".join(sorted(rules)) or "none"
)


@EACH_RULE
def test_the_rules_change_the_best_value_of_no_stage(rules):
    seen = check_rules(rules, range(N_PROBLEMS))
    assert {"tail, pose adds nothing", "floor", "survive", "levels", "car sees"} <= seen


@pytest.mark.long
@EACH_RULE
def test_the_rules_change_the_best_value_of_no_stage_of_many(rules):
    check_rules(rules, range(N_PROBLEMS, N_LONG))


def check_rules(rules, numbers):
    """Check what is left of some problems; return their kinds."""
    n_met = 0
    seen = set()

    for number in numbers:
        problem, oracle = drawn(number)
        reduced = presolve(problem, rules=rules)
        if check_stages(oracle, reduced):
            n_met += 1
            seen |= kinds_of(problem)

    assert n_met > len(numbers) / 3

    return seen


@EACH_RULE
def test_the_rules_change_the_value_of_no_layout_of_what_is_left(rules):
    check_values(rules, range(N_PROBLEMS // 2))


@pytest.mark.long
@EACH_RULE
def test_the_rules_change_the_value_of_no_layout_of_many(rules):
    check_values(rules, range(N_PROBLEMS // 2, N_LONG))


def check_values(rules, numbers):
    """Presolving keeps the value of every layout that matters."""
    for number in numbers:
        problem, oracle = drawn_freely(number)
        reduced = presolve(problem, rules=rules)
        for n_units in (1, 2):
            sets = sets_of_size(reduced.n_poses, n_units)
            if not len(sets):
                continue
            values = set_values(reduced, sets)
            layouts = [tuple(reduced.pose_index[units].tolist()) for units in sets]
            expected = [oracle.values(poses) for poses in layouts]
            for name in oracle.names:
                got = values.of(Objective(name))
                wanted = [of_layout[name] for of_layout in expected]
                assert got == pytest.approx(wanted, abs=TIE), (number, name)


def tie_of_margins(price_eur):
    """Two worlds, of which the worse counts, where no pose avoids anything.

    In the other one the car avoids a run with a large margin, and pose 0 avoids one
    more with a small one. Pose 1 adds nothing; it may cost more.
    """
    time_s = np.tile(np.arange(-5, 1) / 10.0, 3)
    axis = FrameAxis(
        run_ids=("lost", "early", "late"),
        cases=("CPNA-50",) * 3,
        approaches=("north",) * 3,
        weathers=("day",) * 3,
        vut_speed_kmh=np.full(3, 30.0),
        weight=np.full(3, 1.0 / 3.0),
        last_brake_time_s=[-0.01, -0.01, -0.01],
        run_start=[0, 6, 12, 18],
        time_s=time_s,
    )
    detected = np.zeros((2, 18), dtype=bool)
    detected[0, 14:17] = True  # avoids "late"
    seen = np.zeros(18, dtype=bool)
    seen[6:12] = True  # avoids "early"
    return PlacementProblem(
        table=pack_table(("0", "1"), axis, detected),
        limits=Limits(
            site_index=[0, 1],
            site_capacity=[1, 1],
            budget_units=1,
            unit_cost_eur=price_eur,
        ),
        fusion="any",
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=2,
            frame_rate_hz=10.0,
            track_memory_s=np.inf,
        ),
        sample_index=np.array([0, 1, 1]),
        tail=0.3,
        seen_by_vut=seen,
    )


@pytest.mark.parametrize(
    "price_eur",
    [
        [1.0, 1.0],
        [1.0, 2.0],
        [2.0, 1.0],
    ],
)
def test_a_pose_that_adds_nothing_stays_where_it_has_the_largest_margin(price_eur):
    problem = tie_of_margins(price_eur)

    reduced = presolve(problem)

    assert 1 in reduced.pose_index
    assert check_stages(Oracle(problem), reduced)


def test_the_cheapest_of_the_poses_that_add_nothing_stays():
    problem = random_problem(default_rng(3))
    n_poses = 4
    detected = np.zeros((n_poses, problem.table.axis.n_frames), dtype=bool)

    table = pack_table(tuple("abcd"), problem.table.axis, detected)
    problem = replace(
        problem,
        table=table,
        limits=Limits(
            site_index=np.arange(n_poses),
            site_capacity=np.ones(n_poses, dtype=int),
            unit_cost_eur=[4.0, 2.0, 1.0, 3.0],
            is_forbidden=[False, False, True, False],
        ),
        floors=(),
        goal="best",
    )

    assert presolve(problem).pose_index.tolist() == [1]

    is_forced_site = np.array([False, False, False, True])
    asked = changed(problem, "limits.is_forced_site", is_forced_site)

    assert presolve(asked).pose_index.tolist() == [1, 3]
    assert not find_needless(presolve(asked)).any()


def test_what_is_presolved_for_any_question_has_all_usable_poses():
    for number in range(20):
        problem = random_problem(default_rng([19, number]))
        reduced = presolve_freely(problem)
        assert reduced.n_poses == problem.table.n_poses
