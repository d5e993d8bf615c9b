"""``place-rsus solve``: read a problem, solve and prove it."""

import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from placement.optimiser import (
    Effort,
    Floor,
    Limits,
    PlacementProblem,
    apr,
    cost_eur,
    solve_placement,
    sturdy_problem,
)
from placement.optimiser.constants import SolverName
from placement.verification.instances import load_problem

from ..language import mark, trn
from ..progress import StageProgress
from ..results.record import Record, StageRecord, build_stage_records

HIGHS = "HIGHS"
_SEARCHES = ("auto", "exact", "relax", "greedy")
_TARGETS = ("target", "--target")
"""Names of the floor that the command line's target takes the place of."""
GIVEN_UP = "give_up"
"""Name of the floor of :func:`placement.optimiser.sturdy_problem`."""
_GOALS = {
    "best": "the best layout",
    "fewest": "the fewest units",
    "cheapest": "the least cost",
}


class PlacementSolution(Record, frozen=True, kw_only=True):
    """A placement problem solved, with its frames and windows."""

    file: str
    problem: str
    goal: str
    fusion: str
    question: tuple[str, ...]
    replaced: tuple[str, ...]
    objective: float
    bound: float
    gap: float
    chosen: tuple[int, ...]
    numbered_from: int
    chosen_names: tuple[str, ...]
    seconds: float
    is_proven: bool
    solver: str
    cost: float
    stages: tuple[StageRecord, ...]
    columns: int
    rows: int
    presolve_effect: str


def run_solve(
    path: Path,
    *,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
    track_memory_s: float | None,
    solver: str,
    time_limit_s: float,
    gap: float,
    progress: StageProgress,
) -> PlacementSolution:
    """Read a placement problem, such as ``instance.npz``, and solve it.

    Budget, target (infinity: all that can be avoided) or memory of tracks are in place
    of the file's own; all its other demands hold. Raises InputError if the file is
    damaged, or the question has no answer.
    """
    progress(mark("read"), 0, 0)
    own = problem = load_problem(path)
    if track_memory_s is not None:
        try:
            rule = replace(problem.rule, track_memory_s=track_memory_s)
        except InputError as error:
            raise InputError("--track-memory", error.got, error.expected) from None
        problem = replace(problem, rule=rule)
    problem = _asked(problem, budget_units, budget_cost, target)
    if solver.upper() == HIGHS:
        solver = "exact"
    if solver not in _SEARCHES:
        raise InputError("--solver", solver, f"one of {', '.join(_SEARCHES)}, {HIGHS}")
    effort = Effort(solver=cast(SolverName, solver), time_limit_s=time_limit_s, gap=gap)
    began_s = time.perf_counter()
    given_up = [floor for floor in own.floors if floor.name == GIVEN_UP]
    if given_up and problem is not own:
        progress(Phrase("solve: {goal}", goal=GIVEN_UP), 0, 0)
        problem = _given_up_anew(own, problem, given_up[0].share, effort)
    solution = solve_placement(
        problem,
        effort=effort,
        on_stage=lambda stage: progress(Phrase("solve: {goal}", goal=stage), 0, 0),
    )
    first = solution.certificate.stages[0]
    return PlacementSolution(
        file=path.name,
        problem="placement",
        goal=problem.goal,
        fusion=problem.fusion,
        question=question_words(problem),
        replaced=_replaced_words(own, problem),
        objective=first.objective,
        bound=first.bound,
        gap=first.gap,
        chosen=tuple(solution.pose_index),
        numbered_from=0,
        chosen_names=tuple(
            problem.table.pose_ids[pose] for pose in solution.pose_index
        ),
        seconds=round(time.perf_counter() - began_s, 4),
        is_proven=solution.certificate.is_proven,
        solver=solution.certificate.solver,
        cost=cost_eur(problem.limits, solution.pose_index),
        stages=build_stage_records(solution.certificate),
        columns=problem.table.n_poses,
        rows=problem.table.axis.n_frames,
        presolve_effect=str(solution.presolve),
    )


def _asked(
    problem: PlacementProblem,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
) -> PlacementProblem:
    """The problem with the budget or target of the command line.

    All else stays as the file asks it, but the number of units, where a target is
    reached with the fewest of them.
    """
    limits = problem.limits
    for option, value in (("--budget", budget_units), ("--budget-cost", budget_cost)):
        if value is not None and problem.goal != "best":
            asks = f"a file that asks for {_GOALS[problem.goal]}"
            expected = "--target, or a file that asks for the best layout"
            raise InputError(option, Unquoted(f"it for {asks}"), expected)
    if budget_units is not None:
        limits = replace(limits, budget_units=budget_units)
    if budget_cost is not None:
        limits = replace(limits, budget_eur=budget_cost)
    if limits is not problem.limits:
        problem = replace(problem, limits=limits)
    if target is None:
        return problem
    usable = np.flatnonzero(~limits.is_forbidden).tolist()
    if target == np.inf:
        share = min(apr(problem, usable), 1.0)
    else:
        share = target
    if not 0.0 <= share <= 1.0:
        raise InputError("--target", target, "max, or a share of the runs, 0 to 1")
    own = [floor for floor in problem.floors if floor.name in _TARGETS]
    n_failures = max((floor.n_failures for floor in own), default=0)
    floor = Floor(name="--target", share=share, n_failures=n_failures)
    others = [floor for floor in problem.floors if floor.name not in _TARGETS]
    if problem.goal == "cheapest":
        return replace(problem, floors=(*others, floor))
    limits = replace(limits, budget_units=None)
    return replace(problem, limits=limits, goal="fewest", floors=(*others, floor))


def _given_up_anew(
    own: PlacementProblem, asked: PlacementProblem, share: float, effort: Effort
) -> PlacementProblem:
    """The problem that gives up as much of its highest APR as the file of its own.

    A file holds the least APR, `share`, that was left of its own budget's highest. With
    another budget the highest differs, and so does the least; a target is no highest,
    and nothing is given up of it. Raises InputError if the file's highest is not found
    within the time limit.
    """
    before = _without_giving_up(own)
    plain = _without_giving_up(asked)
    if plain.goal != "best" or plain.limits.max_units < 2:
        return plain
    highest = solve_placement(before, effort=effort, n_stages=1)
    if not highest.certificate.is_proven:
        got = Unquoted(f"{effort.time_limit_s:g} s")
        raise InputError("--time-limit", got, "more, to find what the file gives up")
    give_up = apr(before, highest.pose_index) - share
    now_highest = solve_placement(plain, effort=effort, n_stages=1)
    return sturdy_problem(plain, now_highest, give_up)


def _without_giving_up(problem: PlacementProblem) -> PlacementProblem:
    """The problem of the highest APR that a problem of `sturdy_problem` came from."""
    floors = tuple(floor for floor in problem.floors if floor.name != GIVEN_UP)
    return replace(problem, survive=0, floors=floors)


def question_words(problem: PlacementProblem) -> tuple[str, ...]:
    """What a problem asks, a phrase for each demand."""
    words = [_GOALS[problem.goal]]
    if problem.survive:
        failure = _failure_words(problem, problem.survive)
        words.append(f"first the highest APR that is left when {failure}")
    words += _limit_words(problem.limits)
    n_runs = problem.table.axis.n_runs
    for floor in problem.floors:
        least = f"{floor.name}: an APR of at least {100.0 * floor.share:.6g} %"
        if floor.is_counted is not None:
            least += f" in {int(floor.is_counted.sum())} of {n_runs} runs"
        if floor.n_failures:
            least += f", also when {_failure_words(problem, floor.n_failures)}"
        words.append(least)
    if problem.sample_index is not None:
        n_worlds = int(problem.sample_index.max()) + 1
        if problem.tail == 1.0:
            counted = "the mean"
        else:
            counted = f"the worst {100.0 * problem.tail:g} %"
        words.append(f"APR: {counted} of {n_worlds} sampled worlds")
    return tuple(words)


def _failure_words(problem: PlacementProblem, n_failures: int) -> str:
    part = problem.limits.failing
    if n_failures == 1:
        return f"any {part} fails"
    return f"any {n_failures} {part}s fail"


def _limit_words(limits: Limits) -> list[str]:
    words = []
    if limits.budget_units is not None:
        words.append(trn("at most {n} unit", "at most {n} units", limits.budget_units))
    if limits.budget_eur is not None:
        words.append(f"at most {limits.budget_eur:,.2f} EUR")
    existing = int(limits.is_forced.sum())
    if existing:
        words.append(
            trn(
                "{n} existing unit",
                "{n} existing units",
                existing,
            )
        )
    forbidden = int(limits.is_forbidden.sum())
    if forbidden:
        words.append(
            trn(
                "{n} pose that may not be used",
                "{n} poses that may not be used",
                forbidden,
            )
        )
    forced_sites = int(limits.is_forced_site.sum())
    if forced_sites:
        words.append(
            trn(
                "{n} site that must carry a unit",
                "{n} sites that must carry a unit",
                forced_sites,
            )
        )
    rivals = len(limits.rivals)
    if rivals:
        words.append(
            trn(
                "{n} pair of sites too near to each other",
                "{n} pairs of sites too near to each other",
                rivals,
            )
        )
    return words


def _replaced_words(own: PlacementProblem, asked: PlacementProblem) -> tuple[str, ...]:
    """Demands of the file that the command line has taken the place of."""
    kept = question_words(asked)
    replaced = [words for words in question_words(own) if words not in kept]
    if own.rule != asked.rule:
        replaced.append(f"tracks that live for {own.rule.track_memory_s:g} s")
    return tuple(replaced)
