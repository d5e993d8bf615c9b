"""The time limit holds for all stages together, by a clock that the test turns."""

import cvxpy as cp
import numpy as np
import pytest
from problems import random_problem
from small_tables import avoiding_problem

from placement.optimiser import (
    Effort,
    UnmetError,
    is_feasible,
    presolve,
    solve_placement,
)
from placement.optimiser.constants import Deadline
from placement.optimiser.model import MilpResult, SolverAnswer, run_solver
from placement.optimiser.problem import Objective
from placement.optimiser.proof import Search

LIMIT_S = 60.0
_CLOCKS = ("constants", "solve", "walk", "model")


class Clock:
    """A clock that stands still unless it is turned."""

    def __init__(self, monkeypatch):
        self.now_s = 0.0
        for module in _CLOCKS:
            monkeypatch.setattr(
                f"placement.optimiser.{module}.now_s", lambda: self.now_s
            )


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test moves."""
    return Clock(monkeypatch)


def knapsack():
    """A small problem for a solver of mixed-integer models."""
    x = cp.Variable(3, boolean=True)
    return cp.Problem(cp.Maximize(np.array([3.0, 2.0, 2.0]) @ x), [x.sum() <= 2.0])


def compile_for_s(seconds, clock, monkeypatch):
    """Let compiling take so long; the time limits that HiGHS is handed then."""
    handed = []
    compiled = cp.Problem.get_problem_data

    class Chain:
        def __init__(self, chain):
            self.chain = chain

        def solve_via_data(self, *given, solver_opts, **how):
            handed.append(solver_opts["time_limit"])
            return self.chain.solve_via_data(*given, solver_opts=solver_opts, **how)

        def __getattr__(self, name):
            return getattr(self.chain, name)

    def slow(problem, solver):
        clock.now_s += seconds
        data, chain, inverse = compiled(problem, solver)
        return data, Chain(chain), inverse

    monkeypatch.setattr(cp.Problem, "get_problem_data", slow)
    return handed


def test_highs_is_handed_what_compiling_leaves_of_the_time(clock, monkeypatch):
    handed = compile_for_s(20.0, clock, monkeypatch)

    answer = run_solver(knapsack(), time_limit_s=LIMIT_S)

    assert handed == [40.0]
    assert answer.is_finished
    assert answer.bound == pytest.approx(5.0)


def test_highs_is_not_asked_where_compiling_took_all_the_time(clock, monkeypatch):
    handed = compile_for_s(80.0, clock, monkeypatch)

    answer = run_solver(knapsack(), time_limit_s=LIMIT_S)
    expected = SolverAnswer(is_found=False, is_finished=False, bound=np.inf)

    assert handed == []
    assert answer == expected


def test_no_model_is_begun_that_takes_longer_to_state_than_the_time_left(
    clock, monkeypatch
):
    reduced = presolve(avoiding_problem(["110", "011", "101"], budget_units=2))
    n_cells = reduced.n_poses * reduced.n_frames

    monkeypatch.setattr(
        "placement.optimiser.constants.CELLS_PER_SECOND", n_cells / 10.0
    )
    late = Search(reduced, deadline=Deadline(9.0))

    assert late.look_for(Objective.APR, ()) == np.inf
    assert not late.proofs

    early = Search(reduced, deadline=Deadline(11.0))

    assert early.look_for(Objective.APR, ()) == pytest.approx(1.0)


@pytest.mark.long
def test_all_stages_together_take_no_longer_than_the_limit(clock, monkeypatch):
    """Each model takes all the time that it is given, and finds nothing."""

    def idle(_, objective, *, time_limit_s, **__):
        assert 0.0 < time_limit_s <= LIMIT_S - clock.now_s + 1e-9

        clock.now_s += time_limit_s
        is_minimised = objective is not None and objective.is_minimised
        if is_minimised:
            nothing = -np.inf
        else:
            nothing = np.inf

        return MilpResult(units=None, bound=nothing, is_finished=False)

    monkeypatch.setattr("placement.optimiser.proof.solve_window_model", idle)
    monkeypatch.setattr("placement.optimiser.constants.MAX_FEW_SETS", 0)
    monkeypatch.setattr("placement.optimiser.constants.MAX_SETS_OF_MONEY", 0)
    n_asked = 0
    for seed in range(60):
        clock.now_s = 0.0
        problem = random_problem(np.random.default_rng([60, seed]))
        try:
            effort = Effort(time_limit_s=LIMIT_S, workers=1)
            solution = solve_placement(problem, effort=effort)
        except UnmetError:
            pass
        else:
            assert is_feasible(problem, solution.pose_index), seed

        assert clock.now_s <= LIMIT_S + 1e-6, seed

        n_asked += clock.now_s > 0.0

    assert n_asked >= 8  # models were asked for
