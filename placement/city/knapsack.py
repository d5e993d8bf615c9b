"""The multiple-choice knapsack: one option of each group, the best sum within some limits.

Prices on the limits give a bound (Lagrangian relaxation), and by how much each option falls
short of its group's best. Only options that fall short by little can be in a better choice: they
are the core, which HiGHS solves (D. Pisinger, "A minimal algorithm for the multiple-choice
knapsack problem", 1995). A small problem is all core.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from ..optimiser.model import run_solver

CORE_OPTIONS = 4_000
"""Options that are handed to the solver at first; more where they can be in a better choice."""
_MAX_CORE = 40_000
_ROUNDING = 1.0e-9  # of sums, relative
_MAX_CUTS = 120
_UNIT_SUM = 1.0e5  # the solver's objective: its tolerance of 1e-6 is then 1e-11 of the sum


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Knapsack:
    """A problem: the highest sum of profits of one option per group, within limits."""

    group: IntArray  # (n,): ascending, 0, 1, 2
    profit: FloatArray  # (n,): of each option
    rows: FloatArray  # (m, n): what an option takes of each limit; negative: what it adds
    limits: FloatArray  # (m,): what all chosen options may take together

    @property
    def starts(self) -> IntArray:
        """First option of each group."""
        starts: IntArray = np.flatnonzero(np.diff(self.group, prepend=-1))
        return starts

    def is_within(self, chosen: IntArray) -> bool:
        """True if a choice, one option per group, keeps the limits but for rounding."""
        room = _ROUNDING * np.maximum(1.0, np.abs(self.rows[:, chosen]).sum(axis=1))
        return bool((self.rows[:, chosen].sum(axis=1) <= self.limits + room).all())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """Options that were chosen."""

    # (n_groups,): option of each group; None: nothing was found within the time, or `bound` is
    # minus infinity and nothing keeps the limits
    chosen: IntArray | None
    # objective, bound: sum of profits, and what no choice exceeds
    objective: float
    bound: float
    n_core: int  # options that the solver was handed


def solve_knapsack(
    problem: Knapsack,
    *,
    gap: float = 0.0,
    time_limit_s: float = 60.0,
    core_options: int = CORE_OPTIONS,
) -> Choice:
    """Choose one option of each group, up to a relative gap, within a time in seconds.

    `core_options` are handed to the solver at first; bounds hold for all choices.
    """
    end_s = now_s() + time_limit_s
    if len(problem.group) <= core_options:
        chosen, bound = _solve_core(
            problem, np.ones(len(problem.group), dtype=bool), gap=gap, end_s=end_s
        )
        return _choice(problem, chosen, bound, len(problem.group))
    prices = best_prices(problem, end_s=now_s() + 0.5 * time_limit_s)
    best, relaxed = priced_choice(problem, prices)
    at_prices = problem.profit - prices @ problem.rows
    short = at_prices[best][problem.group] - at_prices  # at least 0
    incumbent = best if problem.is_within(best) else None
    objective = -np.inf if incumbent is None else float(problem.profit[incumbent].sum())
    bound, size = relaxed, core_options
    while True:
        is_core, least_outside = _core(short, best, size)
        left_s = end_s - now_s()
        if objective >= bound - gap * abs(objective) - _tiny(bound) or left_s <= 0.0:
            break
        found, core_bound = _solve_core(problem, is_core, gap=gap, end_s=end_s)
        if found is not None and problem.profit[found].sum() > objective:
            incumbent, objective = found, float(problem.profit[found].sum())
        # A choice is in the core, or has an option outside, which falls short by as much.
        bound = min(bound, max(core_bound, relaxed - least_outside))
        size = int((short <= relaxed - objective + _tiny(relaxed)).sum())
        is_done = is_core.all() or least_outside > relaxed - objective
        if is_done or is_core.sum() >= _MAX_CORE:
            break
        size = min(max(size, 4 * int(is_core.sum())), _MAX_CORE)
    return _choice(problem, incumbent, bound, int(is_core.sum()))


def _choice(problem: Knapsack, chosen: IntArray | None, bound: float, n_core: int) -> Choice:
    objective = -np.inf if chosen is None else float(problem.profit[chosen].sum())
    if chosen is not None and bound <= objective + _tiny(objective):
        bound = objective
    return Choice(chosen=chosen, objective=objective, bound=bound, n_core=n_core)


def _tiny(amount: float) -> float:
    return _ROUNDING * max(1.0, abs(amount)) if np.isfinite(amount) else 0.0


# ---------- prices on the limits


def priced_choice(problem: Knapsack, prices: FloatArray) -> tuple[IntArray, float]:
    """The best option of each group at some prices, the first of equals, and the bound of these."""
    worth = problem.profit - prices @ problem.rows
    most = np.maximum.reduceat(worth, problem.starts)
    rows = np.flatnonzero(worth == most[problem.group])
    best: IntArray = rows[np.flatnonzero(np.diff(problem.group[rows], prepend=-1))]
    return best, float(most.sum() + prices @ problem.limits)


def best_prices(problem: Knapsack, *, end_s: float = np.inf) -> FloatArray:
    """Prices on the limits with the lowest bound, as far as the time goes, (m,).

    By cutting planes (Kelley, 1960), in units of each limit's own.
    """
    from scipy.optimize import linprog

    scale = np.abs(problem.profit).sum() / np.maximum(np.abs(problem.rows).sum(axis=1), 1.0e-300)
    n_rows, most = len(problem.limits), 10.0
    cuts, heights = [], []
    prices, lowest, best = np.zeros(n_rows), np.inf, np.zeros(n_rows)
    for _ in range(_MAX_CUTS):
        chosen, bound = priced_choice(problem, prices * scale)
        if bound < lowest:
            lowest, best = bound, prices
        # bound(p) >= bound + slope . (p - prices)
        slope = (problem.limits - problem.rows[:, chosen].sum(axis=1)) * scale
        cuts.append(np.append(slope, -1.0))
        heights.append(float(slope @ prices) - bound)
        solved = linprog(
            np.append(np.zeros(n_rows), 1.0),
            A_ub=np.array(cuts),
            b_ub=np.array(heights),
            bounds=[(0.0, most)] * n_rows + [(None, None)],
            method="highs",
        )
        if solved.x is None or now_s() > end_s:
            break
        prices = solved.x[:-1]
        if lowest - solved.x[-1] <= 1.0e-9 * max(1.0, abs(lowest)):
            if (prices < most - 1.0e-9).all() or most > 1.0e9:
                break
            most *= 100.0  # a limit that is hard to keep
    at_best: FloatArray = best * scale
    return at_best


def _core(short: FloatArray, best: IntArray, size: int) -> tuple[BoolArray, float]:
    """Options that fall short by least, and by how much the first one outside does.

    The best option of each group whose others are in the core is there, too; groups without others
    are settled.
    """
    others = np.ones(len(short), dtype=bool)
    others[best] = False
    rows = np.flatnonzero(others)
    is_core = np.zeros(len(short), dtype=bool)
    is_core[best] = True
    if len(rows) <= size:
        is_core[rows] = True
        return is_core, np.inf
    order = np.argpartition(short[rows], size)
    is_core[rows[order[:size]]] = True
    return is_core, float(short[rows[order[size]]])


# ---------- the core


def _solve_core(
    problem: Knapsack, is_core: BoolArray, *, gap: float, end_s: float
) -> tuple[IntArray | None, float]:
    """Best choice among the options of the core; what none of these exceeds."""
    import cvxpy as cp

    rows = np.flatnonzero(is_core)
    group = problem.group[rows]
    count = np.bincount(group, minlength=int(problem.group[-1]) + 1)
    is_open = count[group] > 1
    settled, free = rows[~is_open], rows[is_open]
    fixed = float(problem.profit[settled].sum())
    limits = problem.limits - problem.rows[:, settled].sum(axis=1)
    if not len(free):
        is_within = problem.is_within(settled)
        return (settled, fixed) if is_within else (None, -np.inf)
    groups, position = np.unique(problem.group[free], return_inverse=True)
    one_of_each = sp.csr_array(
        (np.ones(len(free)), (position, np.arange(len(free)))), shape=(len(groups), len(free))
    )
    profit = problem.profit[free]
    unit = max(float(np.abs(profit).sum()), 1.0e-300) / _UNIT_SUM
    total = max(abs(fixed + float(np.maximum.reduceat(profit, _first(position)).sum())), 1.0e-300)
    room = limits.copy()
    for _ in range(3):
        x = cp.Variable(len(free), boolean=True)
        constraints = [one_of_each @ x == 1.0]
        if len(room):
            size = np.maximum(np.abs(problem.rows[:, free]).max(axis=1), 1.0e-300)
            constraints.append((problem.rows[:, free] / size[:, None]) @ x <= room / size)
        stated = cp.Problem(cp.Maximize((profit / unit) @ x), constraints)
        # The solver's gap is relative to the part that is open, ours to the whole.
        part = max(abs(total - fixed), 1.0e-9 * total)
        answer = run_solver(
            stated,
            time_limit_s=max(end_s - now_s(), 0.1),
            gap=min(gap * total / part, 1.0),
        )
        bound = fixed + answer.bound * unit
        if not answer.is_found:
            return None, bound
        # Of each group the option that is nearest to 1: the solver's ones are nearly so.
        best = np.lexsort((-x.value, position))[_first(position)]
        chosen = np.sort(np.concatenate([settled, free[best]]))
        if problem.is_within(chosen):
            return chosen, max(bound, float(problem.profit[chosen].sum()))
        # Within the solver's tolerance, but not within ours: leave as much room as it took.
        over = problem.rows[:, chosen].sum(axis=1) - problem.limits
        room -= np.maximum(over, 0.0)
    return None, bound


def _first(position: IntArray) -> IntArray:
    first: IntArray = np.flatnonzero(np.diff(position, prepend=-1))
    return first
