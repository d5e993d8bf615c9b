"""Covering problems, solved and proven: LSCP and MCLP.

LSCP, the location set covering problem: at least cost, cover everything, or enough. MCLP, the
maximal covering location problem: within a budget, cover as much as possible. Presolve, a good
answer without proof, then the proof: by exact search where the budget is a few columns, else by a
mixed-integer solver, part by part where the problem falls apart. Every objective is counted on the
full instance; a solver's word is never taken for it.

Where every row is to be covered, a local search goes on while the mixed-integer solver works. What
it finds counts only where the time is up before there is a proof, so that proven answers are the
same at every speed.
"""

from __future__ import annotations

import logging
import math
import time
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError

from ...layout import relative_gap
from ...memory import available_bytes, check_fits, gib
from ..tolerances import ROUNDING, SOLVER_TOLERANCE
from .instance import (
    CoveringBudget,
    CoveringInstance,
    build_covering_instance,
    check_effort,
    is_whole,
    needed_weight,
    simplify_budget,
)
from .model import MilpAnswer, cover_at_least_cost, cover_most_weight, solver_text
from .presolve import (
    CoveringPresolve,
    ReducedCovering,
    independent_components,
    presolve_full_cover,
    presolve_weighted_cover,
)
from .row_weighting import SLICE, LagrangianBound, RowWeighting, lagrangian_bound
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

__all__ = [
    "CoveringInstance",
    "CoveringSolution",
    "build_covering_instance",
    "check_solver",
    "solve_lscp",
    "solve_mclp",
]

_log = logging.getLogger(__name__)

AUTO, GREEDY, HIGHS = "auto", "greedy", "HIGHS"
"""What proves soonest; no proof; the mixed-integer solver."""

# What the exact search may take of the time before it is the solver's turn.
_SEARCH_SHARE = 0.5
_BRANCHED_SEARCH_S = 20.0
_ROUNDS, _ROUNDS_WITHOUT_PROOF = 50, 400
ROW_WEIGHTING = "row weighting"
_LARGE = 20_000  # entries of the matrix from which on the local search comes before the solver
_HEAD_START_S = 2.0  # of the solver, where it may be done before the compiler is loaded
_WORK_PER_ENTRY = 2000  # of the local search where it comes first, or alone
_BOUND_SHARE = 0.1  # of the time
_LOOK_S = 0.05
_MODEL_BYTES = 300  # of the solver's memory for each entry of the matrix; measured: 200 to 240
_MIN_PART = 100  # columns: smaller independent parts are solved together


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
    if solver == HIGHS:
        _check_memory(reduced.instance, solver)
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
        bound = max(bound, float(np.ceil(bound - SOLVER_TOLERANCE * max(1.0, abs(bound)))))
    if bound >= cost * (1.0 - SOLVER_TOLERANCE):
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
        return bound > best * (1.0 + gap + ROUNDING)

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
    if solver == HIGHS:
        _check_memory(left, solver)
    if is_open() and solver != GREEDY and left_s() > 0.0 and _fits(left.covers):
        answer = cover_most_weight(
            left.covers, left.cost, left.weight, budget, time_limit_s=left_s(), gap=gap
        )
        take(answer.chosen, answer.bound)
        names.append(solver_text())
    chosen = np.sort(reduced.column_index[found])
    covered = instance.covered_weight(chosen)
    if is_whole(instance.weight):
        bound = min(bound, float(np.floor(bound + SOLVER_TOLERANCE * max(1.0, bound))))
    if bound <= covered * (1.0 + SOLVER_TOLERANCE):
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
        covers = covers[:, np.unique(covers.indices)]
        answer, name = _cover_all(covers, cost, solver, time_limit_s, gap)
    else:
        answer, name = _cover_enough(covers, cost, weight, needed, solver, time_limit_s, gap)
    assert answer.chosen is not None  # there is always a first answer
    return MilpAnswer(chosen=part[answer.chosen], bound=answer.bound), name


def _cover_enough(
    covers: sp.csr_array,
    cost: FloatArray,
    weight: FloatArray,
    needed: float,
    solver: str,
    time_limit_s: float,
    gap: float,
) -> tuple[MilpAnswer, str]:
    """Least cost that covers a weight."""
    began_s = time.perf_counter()
    found = cover_cheaply(
        covers,
        cost,
        weight,
        needed_weight=needed,
        n_rounds=_ROUNDS_WITHOUT_PROOF if solver == GREEDY else _ROUNDS,
        time_limit_s=time_limit_s,
    )
    least, bound = float(cost[found].sum()), 0.0
    if len(found):
        bound = least_cost_bound(covers, cost, weight, needed_weight=needed)
    is_open = least > bound * (1.0 + gap + ROUNDING)
    left_s = time_limit_s - (time.perf_counter() - began_s)
    if solver == GREEDY or not is_open or left_s <= 0.0 or not _fits(covers):
        return MilpAnswer(chosen=found, bound=min(bound, least)), GREEDY
    answer = cover_at_least_cost(
        covers, cost, weight, needed_weight=needed, time_limit_s=left_s, gap=gap, start=found
    )
    if answer.chosen is not None and cost[answer.chosen].sum() < least:
        covered = np.unique(covers[answer.chosen].indices)
        if weight[covered].sum() >= needed - ROUNDING * weight.sum():
            found, least = answer.chosen, float(cost[answer.chosen].sum())
    return MilpAnswer(chosen=found, bound=min(max(bound, answer.bound), least)), solver_text()


class _FullCover:
    """The least cost that covers every row, while it is looked for."""

    def __init__(
        self, covers: sp.csr_array, cost: FloatArray, time_limit_s: float, gap: float
    ) -> None:
        self.covers = covers
        self.cost = cost
        self.gap = gap
        self.deadline_s = time.perf_counter() + time_limit_s
        self.bound = self.round_up(
            least_cost_bound(
                covers, cost, np.ones(covers.shape[1]), needed_weight=float(covers.shape[1])
            )
        )
        self.found = np.arange(len(cost))
        self.least = float(cost.sum())
        self.search: RowWeighting | None = None

    def round_up(self, bound: float) -> float:
        """What a bound says: sums of whole costs are whole."""
        if not is_whole(self.cost):
            return bound
        return float(np.ceil(bound - SOLVER_TOLERANCE * max(1.0, abs(bound))))

    def take(self, columns: IntArray) -> None:
        """Note a cover, if it is one, and cheaper than what is known."""
        cost = float(self.cost[columns].sum())
        if (
            cost < self.least
            and np.unique(self.covers[columns].indices).size == (self.covers.shape[1])
        ):
            self.found, self.least = columns, cost

    def left_s(self) -> float:
        return self.deadline_s - time.perf_counter()

    def is_open(self) -> bool:
        return self.least > self.bound * (1.0 + self.gap + ROUNDING)

    def search_first(self) -> None:
        """Local search as far as the size is worth it; it does not stop without a cover."""
        self.search = RowWeighting(self.covers, self.cost)
        most = _WORK_PER_ENTRY * self.covers.nnz
        while self.search.cost == np.inf or (
            self.search.work < most and self.is_open() and self.left_s() > 0.0
        ):
            self.search.go_on(min(SLICE, most))
            self.take(self.search.best)

    def search_alone(self) -> None:
        """Local search until the time is up, or the bound is met."""
        search = self.search or RowWeighting(self.covers, self.cost)
        while self.is_open() and self.left_s() > 0.0:
            search.go_on()
            self.take(search.best)

    def search_beside(self, began_s: float) -> bool:
        """Local search while the solver works; whether it should go on."""
        if self.search is None:
            if time.perf_counter() < began_s + _HEAD_START_S:
                time.sleep(_LOOK_S)
                return True
            self.search = RowWeighting(self.covers, self.cost)
        self.search.go_on()
        return self.search.cost > self.bound * (1.0 + self.gap + ROUNDING)

    def raise_bound(self) -> LagrangianBound:
        relaxed = lagrangian_bound(
            self.covers,
            self.cost,
            known_cost=self.least,
            time_limit_s=max(0.0, _BOUND_SHARE * self.left_s()),
        )
        self.bound = min(max(self.bound, self.round_up(relaxed.bound)), self.least)
        return relaxed

    def worth_a_look(self, relaxed: LagrangianBound) -> IntArray:
        """Columns of the cover that is known, and those that a cheaper one can have."""
        least_step = 1.0 if is_whole(self.cost) else 0.0
        limit = self.least - least_step + SOLVER_TOLERANCE * self.least
        is_kept = relaxed.bound + relaxed.reduced_cost <= limit
        is_kept[self.found] = True
        return np.flatnonzero(is_kept)


def _cover_all(
    covers: sp.csr_array, cost: FloatArray, solver: str, time_limit_s: float, gap: float
) -> tuple[MilpAnswer, str]:
    """Least cost that covers every row."""
    n_columns, n_rows = covers.shape
    if n_rows == 0:
        return MilpAnswer(chosen=np.empty(0, dtype=np.int64), bound=0.0), GREEDY
    cover, columns = _FullCover(covers, cost, time_limit_s, gap), np.arange(n_columns)
    if solver == GREEDY or (solver == AUTO and covers.nnz >= _LARGE):
        cover.search_first()
        if cover.is_open():
            relaxed = cover.raise_bound()
            columns = cover.worth_a_look(relaxed)
    else:
        rounds_s = max(0.0, cover.left_s())
        weight = np.ones(n_rows)
        cover.take(
            cover_cheaply(
                covers,
                cost,
                weight,
                needed_weight=float(n_rows),
                n_rounds=_ROUNDS,
                time_limit_s=rounds_s,
            )
        )
    name = GREEDY if cover.search is None else ROW_WEIGHTING
    if solver == GREEDY or not cover.is_open() or cover.left_s() <= 0.0:
        return MilpAnswer(chosen=cover.found, bound=cover.bound), name
    if solver == AUTO and not _fits(covers[columns]):
        cover.search_alone()
        return MilpAnswer(chosen=cover.found, bound=min(cover.bound, cover.least)), ROW_WEIGHTING
    began_s = time.perf_counter()
    answer = cover_at_least_cost(
        covers[columns],
        cost[columns],
        np.ones(n_rows),
        needed_weight=None,
        time_limit_s=cover.left_s(),
        gap=gap,
        start=np.searchsorted(columns, cover.found),
        meanwhile=(lambda: cover.search_beside(began_s)) if solver == AUTO else None,
    )
    if answer.chosen is not None:
        cover.take(columns[answer.chosen])
    cover.bound = max(cover.bound, cover.round_up(answer.bound))
    if cover.is_open() and cover.search is not None:
        cover.take(cover.search.best)
    names = [solver_text()] if cover.search is None else [ROW_WEIGHTING, solver_text()]
    return MilpAnswer(chosen=cover.found, bound=min(cover.bound, cover.least)), ", ".join(names)


def _fits(covers: sp.csr_array) -> bool:
    """Whether there is memory for the solver; tells where there is not."""
    needed, free = _MODEL_BYTES * covers.nnz, available_bytes()
    if needed > free:
        _log.warning(
            "no proof by HiGHS: it takes about %s of memory, and %s are free",
            *(gib(needed), gib(free)),
        )
    return needed <= free


def _check_memory(instance: CoveringInstance, solver: str) -> None:
    """Refuse what a mixed-integer solver has no memory for, where nothing else can answer.

    Raises InputError: it says what is needed, and how to need less.
    """
    check_fits(
        "--solver",
        f"{solver} with {instance.covers.nnz:,} entries of a matrix",
        _MODEL_BYTES * instance.covers.nnz,
        "--solver greedy, or fewer rows or columns",
    )


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


def check_solver(name: str) -> str:
    """The name of a solver as covering problems know it: "auto", "greedy" or "HIGHS".

    Raises InputError: there is no such solver.
    """
    if name in (AUTO, GREEDY):
        return name
    if name.upper() != HIGHS:
        raise InputError("--solver", name, f"a solver that is installed: {HIGHS}")
    return HIGHS
