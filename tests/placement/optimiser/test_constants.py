"""Effort, deadlines, threads, and the table of numbers that steer."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems
from refusals import refused_with

from geometry.clock import now_s
from placement.optimiser import constants, presolve, solve_placement
from placement.optimiser.constants import (
    NEVER,
    TIME_SHARES,
    Deadline,
    Effort,
    common_step,
    deadline_in,
    share_out,
)
from placement.optimiser.front import pareto_front

FOLDER = Path(constants.__file__).parent


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"solver": "best"},
            "solver: got 'best'; expected one of auto, exact, relax, greedy",
        ),
        ({"time_limit_s": 0.0}, "time_limit: got 0.0; expected seconds, more than 0"),
        ({"gap": 1.0}, "gap: got 1.0; expected a share, 0 <= gap < 1"),
        ({"workers": 0}, "workers: got 0; expected threads, at least 1"),
    ],
)
def test_an_effort_says_what_is_wrong(change, message):
    with refused_with(message):
        Effort(**change)


@pytest.mark.parametrize("step", TIME_SHARES)
def test_a_step_takes_its_share_of_the_time_left(step):
    whole = deadline_in(100.0)
    assert whole.of(step).left_s() == pytest.approx(100.0 * TIME_SHARES[step], abs=1.0)
    assert whole.of(step).end_s <= whole.end_s


def test_no_time_is_left_behind_a_deadline_and_all_before_none():
    over = Deadline(now_s() - 1.0)

    assert over.is_over
    assert over.left_s() == 0.0
    assert over.of("walk").left_s() == 0.0
    assert not NEVER.is_over
    assert NEVER.of("walk").left_s() == np.inf


@given(count=st.integers(0, 300), workers=st.integers(1, 5), few=st.integers(0, 100))
def test_work_that_is_shared_out_is_done_once(count, workers, few):
    done = np.zeros(count, dtype=int)

    def work(begin, end):
        done[begin:end] += 1

    share_out(work, count, workers=workers, few=few)

    assert (done == 1).all()


@given(problem=problems(), workers=st.integers(1, 3))
def test_the_number_of_threads_changes_no_proven_value(problem, workers):
    reduced = presolve(problem, workers=workers)

    assert reduced.workers == workers
    assert reduced.with_workers(2).workers == 2
    assert reduced.with_workers(workers) is reduced

    one = solve_placement(problem, effort=Effort(workers=1))

    some = solve_placement(problem, reduced, effort=Effort(workers=workers))

    expected = [s.objective for s in some.certificate.stages]

    assert [s.objective for s in one.certificate.stages] == pytest.approx(expected)

    front = pareto_front(problem, max_units=1, effort=Effort(workers=workers))

    assert front.is_proven


@given(
    step=st.floats(1e-3, 1.0),
    counts=st.lists(st.integers(0, 50), min_size=1, max_size=8),
)
def test_whole_multiples_of_their_least_have_a_common_step(step, counts):
    amounts = step * np.array([1, *counts])
    assert common_step(amounts) == pytest.approx(step)
    assert common_step(np.append(amounts, 1.5 * step)) == 0.0


def test_only_the_table_has_numbers_that_steer():
    of_module = re.compile(r"^_?[A-Z][A-Z_]+ = [0-9(]", re.MULTILINE)
    found = {
        path.name: of_module.findall(path.read_text(encoding="utf-8"))
        for path in FOLDER.glob("*.py")
        if path.name != "constants.py"
    }
    mechanical = {
        "presolve.py": ["_WORDS_TOGETHER = 1"],  # at a time, no search
        "allowed_sets.py": ["CENTS = 1", "_MAX_CENTS = 2"],  # units of money
        "walk_kernels.py": [
            "DONE = 0",
            "PAUSED = 1",
            "FULL = 2",
            "AT_STOP = 3",
            "WHOLE = 0",
            "ON_FAILURE = 1",
        ],  # names of states
        "front.py": ["FIRST_STAGES = (", "DEFAULT_MAX_UNITS = 8"],  # what is asked
        "cost_front.py": ["_MAX_LEVELS = 2", "DEFAULT_MAX_POINTS = 4"],
        "problem.py": ["VALUE_OBJECTIVES = ("],
    }

    assert {name: names for name, names in found.items() if names} == mechanical
