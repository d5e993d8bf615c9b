"""Covering problems, solved and proven: LSCP and MCLP.

LSCP, the location set covering problem: at least cost, cover everything, or enough. MCLP, the
maximal covering location problem: within a budget, cover as much as possible. Presolve, a good
answer without proof, then the proof: by exact search where the budget is a few columns, else by a
mixed-integer solver, part by part where the problem falls apart. Every objective is counted on the
full instance; a solver's word is never taken for it.

In the models x_c = 1 says that column c is chosen, y_r that row r is covered. Only x has to be
whole: for given x every y is bounded by zeros and ones alone. Constraints are single matrix
inequalities: what cvxpy needs to state a model grows with their number, not with their rows.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError

from ...layout import relative_gap
from ..model import run_solver, solver_text
from .instance import (
    TOLERANCE,
    CoveringBudget,
    CoveringInstance,
    build_covering_instance,
    check_effort,
    is_whole,
    needed_weight,
    simplify_budget,
)
from .presolve import (
    CoveringPresolve,
    ReducedCovering,
    independent_components,
    presolve_full_cover,
    presolve_weighted_cover,
)
from .search import (
    MAX_UNITS,
    SURE_UNITS,
    cover_cheaply,
    cover_much,
    drop_redundant,
    least_cost_bound,
    most_weight_bound,
    search_best_columns,
)

if TYPE_CHECKING:  # it takes two seconds to import: done where a model is stated
    import cvxpy as cp

__all__ = [
    "CoveringInstance",
    "CoveringSolution",
    "build_covering_instance",
    "check_solver",
    "solve_lscp",
    "solve_mclp",
]

AUTO, GREEDY, HIGHS = "auto", "greedy", "HIGHS"
"""What proves soonest; no proof; the mixed-integer solver."""

_LARGEST_SUM = 1.0e6  # of an objective's coefficients: solvers' tolerances are absolute, 1e-6
# What the exact search may take of the time before it is the solver's turn.
_SEARCH_SHARE = 0.5
_BRANCHED_SEARCH_S = 20.0
_ROUNDS, _ROUNDS_WITHOUT_PROOF = 50, 400
_SOLVER_TOLERANCE = 1.0e-6  # of proven bounds, relative
_MIN_PART = 100  # columns: smaller independent parts are solved together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MilpAnswer:
    """What a solver knows when it stops."""

    chosen: IntArray | None  # (n,): best columns found; None if none were
    bound: float  # least cost, or most weight, that its search leaves possible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoveringSolution:
    """An answer to a covering problem, and how good it is.

    Attributes
    ----------
    chosen : (n,) int
        Indices of columns, ascending.
    objective : float
        LSCP: their cost. MCLP: the weight that they cover.
    bound : float
        LSCP: no answer costs less. MCLP: none covers more.
    gap : float
        Relative distance of the two, as HiGHS defines it.
    cost : float
        Of the columns chosen.
    covered_weight, coverable_weight, total_weight : float
        Of the rows that they cover, that all columns together cover, of all rows.
    solver : str
        What found and proved it.
    seconds : float
        From instance to answer, presolve and model building included. [s]
    presolve : CoveringPresolve
        What dropped out.
    """

    chosen: IntArray
    objective: float
    bound: float
    gap: float
    cost: float
    covered_weight: float
    coverable_weight: float
    total_weight: float
    solver: str
    seconds: float
    presolve: CoveringPresolve

    @property
    def is_proven(self) -> bool:
        """Whether the objective is proven to be the best there is."""
        return self.gap == 0.0


def solve_lscp(
    instance: CoveringInstance,
    *,
    target: float | None = None,
    solver: str = AUTO,
    time_limit_s: float = math.inf,
    gap: float = 0.0,
) -> CoveringSolution:
    """Least cost that covers everything that can be covered, or a share of the weight.

    The `target` is a share of the weight of all rows, 0 to 1; without it every row with weight that
    any column covers is covered. The `solver` is "auto" (what proves soonest), "greedy" (no proof)
    or "HIGHS" (the mixed-integer solver alone). When the time is up, the best answer found is given
    with its bound; a relative `gap` is good enough. Raises InputError if the target is out of
    reach, or there is no such solver.
    """
    began_s = time.perf_counter()
    check_effort(time_limit_s=time_limit_s, gap=gap)
    solver = check_solver(solver)
    needed = needed_weight(instance, target)
    reduced = (
        presolve_full_cover(instance)
        if needed is None
        else presolve_weighted_cover(instance, minds_cost=True)
    )
    bound, columns, names = 0.0, [reduced.essential], []
    parts = _parts(reduced) if needed is None else [np.arange(reduced.instance.n_columns)]
    for part in parts:
        left_s = time_limit_s - (time.perf_counter() - began_s)
        answer, name = _cover_part(reduced.instance, part, needed, solver, left_s, gap)
        bound += answer.bound
        columns.append(reduced.column_index[answer.chosen])
        names.append(name)
    chosen = drop_redundant(
        instance.covers,
        instance.cost,
        instance.weight,
        np.sort(np.concatenate(columns)),
        needed_weight=instance.coverable_weight if needed is None else needed,
    )
    cost = float(instance.cost[chosen].sum())
    bound += float(instance.cost[reduced.essential].sum())
    if is_whole(instance.cost):
        bound = max(bound, float(np.ceil(bound - _SOLVER_TOLERANCE * max(1.0, abs(bound)))))
    if bound >= cost * (1.0 - _SOLVER_TOLERANCE):
        bound = cost
    return _solution(instance, chosen, cost, bound, reduced.statistics, names, began_s)


def solve_mclp(
    instance: CoveringInstance,
    *,
    budget_units: int | None = None,
    budget_cost: float | None = None,
    solver: str = AUTO,
    time_limit_s: float = math.inf,
    gap: float = 0.0,
) -> CoveringSolution:
    """Most weight that at most so many columns, or so much money, covers; one of the two is given.

    Fewer columns are chosen where more would add nothing. The other arguments are those of
    :func:`solve_lscp`. Raises InputError if there is no budget, it buys nothing, or there is no
    such solver.
    """
    began_s = time.perf_counter()
    check_effort(time_limit_s=time_limit_s, gap=gap)
    solver = check_solver(solver)
    budget = simplify_budget(instance, CoveringBudget(units=budget_units, cost=budget_cost))
    reduced = presolve_weighted_cover(
        instance, minds_cost=budget.cost is not None, money=budget.money
    )
    left = reduced.instance
    units = left.n_columns if budget.units is None else min(budget.units, left.n_columns)
    found = cover_much(left.covers, left.cost, left.weight, budget)
    best, names = left.covered_weight(found), list[str]()
    bound = most_weight_bound(left.covers, left.cost, left.weight, budget)

    def take(columns: IntArray | None, new_bound: float) -> None:
        nonlocal found, best, bound
        bound = min(bound, new_bound)
        if columns is not None and budget.allows(left.cost[columns]):
            weight = left.covered_weight(columns)
            if weight > best:
                found, best = columns, weight

    def is_open() -> bool:
        return bound > best * (1.0 + gap + TOLERANCE)

    def left_s() -> float:
        return time_limit_s - (time.perf_counter() - began_s)

    if is_open() and solver == AUTO and budget.cost is None and units <= MAX_UNITS:
        search_s = _SEARCH_SHARE * left_s()
        result = search_best_columns(
            left.covers,
            left.weight,
            n_units=units,
            start=found,
            time_limit_s=search_s if units <= SURE_UNITS else min(search_s, _BRANCHED_SEARCH_S),
            gap=gap,
        )
        if result is not None:
            take(result.chosen, result.bound)
            names.append("exact search")
    if is_open() and solver != GREEDY and left_s() > 0.0:
        answer = cover_most_weight(
            left.covers, left.cost, left.weight, budget, time_limit_s=left_s(), gap=gap
        )
        take(answer.chosen, answer.bound)
        names.append(solver_text())
    chosen = np.sort(reduced.column_index[found])
    covered = instance.covered_weight(chosen)
    if is_whole(instance.weight):
        bound = min(bound, float(np.floor(bound + _SOLVER_TOLERANCE * max(1.0, bound))))
    if bound <= covered * (1.0 + _SOLVER_TOLERANCE):
        bound = covered
    names = names or [GREEDY if units else "presolve"]
    return _solution(instance, chosen, covered, bound, reduced.statistics, names, began_s)


def _cover_part(
    instance: CoveringInstance,
    part: IntArray,
    needed: float | None,
    solver: str,
    time_limit_s: float,
    gap: float,
) -> tuple[MilpAnswer, str]:
    """Least cost for a part of a reduced instance: its columns, what it costs at least, by whom."""
    covers, cost, weight = instance.covers[part], instance.cost[part], instance.weight
    if needed is None:
        rows = np.unique(covers.indices)
        covers, weight = covers[:, rows], np.ones(len(rows))
    enough = float(weight.sum()) if needed is None else needed
    began_s = time.perf_counter()
    found = cover_cheaply(
        covers,
        cost,
        weight,
        needed_weight=enough,
        n_rounds=_ROUNDS_WITHOUT_PROOF if solver == GREEDY else _ROUNDS,
        time_limit_s=time_limit_s,
    )
    least, bound = float(cost[found].sum()), 0.0
    if len(found):
        bound = least_cost_bound(covers, cost, weight, needed_weight=enough)
    is_open = least > bound * (1.0 + gap + TOLERANCE)
    left_s = time_limit_s - (time.perf_counter() - began_s)
    if solver == GREEDY or not is_open or left_s <= 0.0:
        return MilpAnswer(chosen=part[found], bound=min(bound, least)), GREEDY
    answer = cover_at_least_cost(
        covers, cost, weight, needed_weight=needed, time_limit_s=left_s, gap=gap
    )
    if answer.chosen is not None and cost[answer.chosen].sum() < least:
        covered = np.unique(covers[answer.chosen].indices)
        if weight[covered].sum() >= enough - TOLERANCE * weight.sum():
            found, least = answer.chosen, float(cost[answer.chosen].sum())
    bound = min(max(bound, answer.bound), least)
    return MilpAnswer(chosen=part[found], bound=bound), solver_text()


def _parts(reduced: ReducedCovering) -> list[IntArray]:
    """Columns that can be solved by themselves; those of small parts together, first."""
    n_parts, part = independent_components(reduced.instance.covers)
    size = np.bincount(part, minlength=n_parts)
    is_small = size < _MIN_PART
    together = np.flatnonzero(is_small[part])
    alone = [np.flatnonzero(part == each) for each in np.flatnonzero(~is_small)]
    alone.sort(key=len)
    return [together, *alone] if len(together) else alone


def _solution(
    instance: CoveringInstance,
    chosen: IntArray,
    objective: float,
    bound: float,
    presolve: CoveringPresolve,
    names: list[str],
    began_s: float,
) -> CoveringSolution:
    return CoveringSolution(
        chosen=chosen,
        objective=objective,
        bound=bound,
        # Relative to the objective: what is small may just be in large units.
        gap=relative_gap(1.0, bound / objective) if objective > 0.0 else relative_gap(0.0, bound),
        cost=float(instance.cost[chosen].sum()),
        covered_weight=instance.covered_weight(chosen),
        coverable_weight=instance.coverable_weight,
        total_weight=float(instance.weight.sum()),
        solver=", ".join(dict.fromkeys(names)) or "presolve",
        seconds=time.perf_counter() - began_s,
        presolve=presolve,
    )


# ---------- models


def check_solver(name: str) -> str:
    """The name of a solver as covering problems know it: "auto", "greedy" or "HIGHS".

    Raises InputError: there is no such solver.
    """
    if name in (AUTO, GREEDY):
        return name
    if name.upper() != HIGHS:
        raise InputError("--solver", name, f"a solver that is installed: {HIGHS}")
    return HIGHS


def cover_at_least_cost(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    *,
    needed_weight: float | None,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Location set covering [1]_: least cost for which every row, or enough weight, is covered.

    `covers` is (n_columns, n_rows). Every row must be covered if `needed_weight` is None. The
    solver may stop at the relative `gap`.

    References
    ----------
    .. [1] C. Toregas, R. Swain, C. ReVelle, L. Bergman, "The location of emergency service
       facilities", Operations Research 19, 1971.
    """
    import cvxpy as cp

    x = cp.Variable(covers.shape[0], boolean=True)
    times_covered = _by_row(covers) @ x
    if needed_weight is None:
        constraints = [times_covered >= 1.0]
    else:
        y = cp.Variable(covers.shape[1], bounds=[0.0, 1.0])
        unit = float(weight.max())
        constraints = [times_covered - y >= 0.0, (weight / unit) @ y >= needed_weight / unit]
    unit = _unit(cost)
    answer = _solve(-(cost / unit) @ x, constraints, x, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=-answer.bound * unit)


def cover_most_weight(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    budget: CoveringBudget,
    *,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Maximal covering [1]_: most weight that a number of columns, or some money, covers.

    `budget`: what may be chosen.

    References
    ----------
    .. [1] R. L. Church, C. ReVelle, "The maximal covering location problem", Papers of the
       Regional Science Association 32, 1974.
    """
    import cvxpy as cp

    x = cp.Variable(covers.shape[0], boolean=True)
    y = cp.Variable(covers.shape[1], bounds=[0.0, 1.0])
    constraints = [_by_row(covers) @ x - y >= 0.0]
    if budget.units is not None:
        constraints.append(cp.sum(x) <= budget.units)
    if budget.cost is not None:
        unit = max(float(cost.max()), budget.cost) or 1.0
        constraints.append((cost / unit) @ x <= budget.cost / unit)
    unit = _unit(weight)
    answer = _solve((weight / unit) @ y, constraints, x, time_limit_s, gap)
    return MilpAnswer(chosen=answer.chosen, bound=answer.bound * unit)


def _by_row(covers: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(covers.T).astype(np.float64)


def _unit(coefficients: FloatArray) -> float:
    """What to divide an objective by; whole numbers of an ordinary size stay whole."""
    total = float(coefficients.sum())
    return 1.0 if is_whole(coefficients) and total <= _LARGEST_SUM else total / _LARGEST_SUM


def _solve(
    objective: cp.Expression,
    constraints: list[Any],
    x: cp.Variable,
    time_limit_s: float,
    gap: float,
) -> MilpAnswer:
    """Maximise; every model here has a solution, so that one without has failed."""
    import cvxpy as cp

    problem = cp.Problem(cp.Maximize(objective), constraints)
    answer = run_solver(problem, time_limit_s=time_limit_s, gap=gap)
    if not answer.is_found:
        bound = np.inf if answer.is_finished else answer.bound
        return MilpAnswer(chosen=None, bound=bound)
    return MilpAnswer(chosen=np.flatnonzero(x.value > 0.5), bound=answer.bound)
