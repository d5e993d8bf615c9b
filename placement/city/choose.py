"""Choice of what each junction gets, with bounds.

The sum over all junctions is the best one, objective by objective. APR by the
junctions' weights; APR if at each junction the unit needed most fails; smallest
time to spare; its mean over the accidents prevented; cost. Each stage holds
those before it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s
from geometry.errors import InputError

from ..layout import Certificate, Stage
from ..optimiser.constants import COST_TOLERANCE_EUR, TOLERANCE
from ..optimiser.model import run_solver, solver_text
from ..optimiser.problem import Objective
from ..optimiser.solve import build_stage
from .fronts import Options

# ---------- the multiple-choice knapsack
#
# Prices on the limits give a bound (Lagrangian relaxation), and by how much each option
# falls short of its group's best. Only options that fall short by little can be in a
# better choice: they are the core, which HiGHS solves (D. Pisinger, "A minimal
# algorithm for the multiple-choice knapsack problem", 1995). A small problem is all
# core.


CORE_OPTIONS = 4_000
"""Options that the solver gets at first; more where they can be in a better choice."""
_MAX_CORE = 40_000
# Of sums, relative.
_ROUNDING = 1.0e-9
_MAX_CUTS = 120
# The solver's objective: its tolerance of 1e-6 is then 1e-11 of the sum.
_UNIT_SUM = 1.0e5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Knapsack:
    """Multiple-choice knapsack: one option per group, within limits.

    The sum of the profits is maximised.

    Attributes
    ----------
    group : (n,) int
        Ascending, 0, 1, 2 ..
    profit : (n,) float
        Of each option.
    rows : (m, n) float
        What an option takes of each limit; negative: what it adds.
    limits : (m,) float
        What all chosen options may take together.
    """

    group: IntArray
    profit: FloatArray
    rows: FloatArray
    limits: FloatArray

    @property
    def starts(self) -> IntArray:
        """First option of each group."""
        return np.asarray(np.flatnonzero(np.diff(self.group, prepend=-1)))

    def is_within(self, chosen: IntArray) -> bool:
        """True if a choice, one option per group, keeps the limits but for rounding."""
        room = _ROUNDING * np.maximum(1.0, np.abs(self.rows[:, chosen]).sum(axis=1))
        return bool((self.rows[:, chosen].sum(axis=1) <= self.limits + room).all())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnapsackChoice:
    """Options that were chosen.

    Attributes
    ----------
    chosen : (n_groups,) int, optional
        Option of each group; None: nothing was found within the time, or
        `bound` is minus infinity and nothing keeps the limits.
    objective, bound : float
        Sum of profits, and what no choice exceeds.
    """

    chosen: IntArray | None
    objective: float
    bound: float


def solve_knapsack(
    problem: Knapsack,
    *,
    gap: float = 0.0,
    time_limit_s: float = 60.0,
    core_options: int = CORE_OPTIONS,
) -> KnapsackChoice:
    """Choose one option of each group.

    Parameters
    ----------
    problem : Knapsack
        At least one option in each group.
    gap : float
        Relative distance of objective and bound at which it is good enough.
    time_limit_s : float
        For all of it. [s]
    core_options : int
        Options that the solver is handed at first.

    Returns
    -------
    choice : KnapsackChoice
        Bounds hold for all choices, whatever the core.
    """
    # A small problem is all core.
    end_s = now_s() + time_limit_s
    if len(problem.group) <= core_options:
        chosen, bound = _solve_core(
            problem, np.ones(len(problem.group), dtype=bool), gap=gap, end_s=end_s
        )
        return _choice(problem, chosen, bound)
    # Prices give a first bound, and often a first choice.
    prices = best_prices(problem, end_s=now_s() + 0.5 * time_limit_s)
    best, relaxed, short = _shortfalls(problem, prices)
    if problem.is_within(best):
        incumbent = best
    else:
        incumbent = None
    if incumbent is None:
        objective = -np.inf
    else:
        objective = float(problem.profit[incumbent].sum())
    bound = relaxed
    size = core_options
    # Enlarge the core until the gap is closed or the time is up.
    while True:
        is_core, least_outside = _core(short, best, size)
        left_s = end_s - now_s()
        if objective >= bound - gap * abs(objective) - _tiny(bound) or left_s <= 0.0:
            break
        found, core_bound = _solve_core(problem, is_core, gap=gap, end_s=end_s)
        if found is not None and problem.profit[found].sum() > objective:
            incumbent = found
            objective = float(problem.profit[found].sum())
        # A choice is in the core, or has an option outside, which falls short by as
        # much.
        bound = min(bound, max(core_bound, relaxed - least_outside))
        size = int((short <= relaxed - objective + _tiny(relaxed)).sum())
        is_done = is_core.all() or least_outside > relaxed - objective
        if is_done or is_core.sum() >= _MAX_CORE:
            break
        size = min(max(size, 4 * int(is_core.sum())), _MAX_CORE)
    return _choice(problem, incumbent, bound)


def _choice(problem: Knapsack, chosen: IntArray | None, bound: float) -> KnapsackChoice:
    """A choice with its value; a bound within rounding is that value."""
    if chosen is None:
        objective = -np.inf
    else:
        objective = float(problem.profit[chosen].sum())
    if chosen is not None and bound <= objective + _tiny(objective):
        bound = objective
    return KnapsackChoice(chosen=chosen, objective=objective, bound=bound)


def _tiny(amount: float) -> float:
    if np.isfinite(amount):
        return _ROUNDING * max(1.0, abs(amount))
    return 0.0


# ---------- prices on the limits
def priced_choice(problem: Knapsack, prices: FloatArray) -> tuple[IntArray, float]:
    """Best option of each group at some prices, and the bound of these.

    Of equal options the first one is taken.
    """
    # Profit less what an option takes at these prices.
    worth = problem.profit - prices @ problem.rows
    most = np.maximum.reduceat(worth, problem.starts)
    rows = np.flatnonzero(worth == most[problem.group])
    best: IntArray = rows[np.flatnonzero(np.diff(problem.group[rows], prepend=-1))]
    return best, float(most.sum() + prices @ problem.limits)


def _shortfalls(
    problem: Knapsack, prices: FloatArray
) -> tuple[IntArray, float, FloatArray]:
    """Best options and bound at some prices, and every shortfall.

    See :func:`priced_choice`. A shortfall, (n,), is that to the best option of the
    group.
    """
    best, bound = priced_choice(problem, prices)
    worth = problem.profit - prices @ problem.rows
    return best, bound, worth[best][problem.group] - worth


def best_prices(problem: Knapsack, *, end_s: float = np.inf) -> FloatArray:
    """Prices on the limits with the lowest bound, as far as the time goes, (m,).

    By cutting planes (Kelley, 1960), in units of each limit's own.
    """
    from scipy.optimize import linprog

    # Prices in units of each limit, so that all are of one size.
    scale = np.abs(problem.profit).sum() / np.maximum(
        np.abs(problem.rows).sum(axis=1), 1.0e-300
    )
    n_rows = len(problem.limits)
    most = 10.0
    cuts = []
    heights = []
    prices = np.zeros(n_rows)
    lowest = np.inf
    best = np.zeros(n_rows)
    # Each round cuts off prices that cannot have a lower bound.
    for _ in range(_MAX_CUTS):
        chosen, bound = priced_choice(problem, prices * scale)
        if bound < lowest:
            lowest = bound
            best = prices
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
            # A limit that is hard to keep.
            most *= 100.0
    return np.asarray(best * scale)


def _core(short: FloatArray, best: IntArray, size: int) -> tuple[BoolArray, float]:
    """Options with the least shortfall, and that of the first one outside.

    The best option of each group whose others are in the core is there, too; groups
    without others are settled.
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
    # Groups with a single option are settled.
    count = np.bincount(group, minlength=int(problem.group[-1]) + 1)
    is_open = count[group] > 1
    settled = rows[~is_open]
    free = rows[is_open]
    fixed = float(problem.profit[settled].sum())
    limits = problem.limits - problem.rows[:, settled].sum(axis=1)
    if not len(free):
        is_within = problem.is_within(settled)
        if is_within:
            return (settled, fixed)
        return (None, -np.inf)
    groups, position = np.unique(problem.group[free], return_inverse=True)
    # Rows: groups that are open; columns: their options.
    one_of_each = sp.csr_array(
        (np.ones(len(free)), (position, np.arange(len(free)))),
        shape=(len(groups), len(free)),
    )
    profit = problem.profit[free]
    # Scale the objective to the solver's tolerance.
    unit = max(float(np.abs(profit).sum()), 1.0e-300) / _UNIT_SUM
    total = max(
        abs(fixed + float(np.maximum.reduceat(profit, _first(position)).sum())),
        1.0e-300,
    )
    room = limits.copy()
    # Solve again with less room if rounding breaks a limit.
    for _ in range(3):
        x = cp.Variable(len(free), boolean=True)
        constraints = [one_of_each @ x == 1.0]
        if len(room):
            size = np.maximum(np.abs(problem.rows[:, free]).max(axis=1), 1.0e-300)
            constraints.append(
                (problem.rows[:, free] / size[:, None]) @ x <= room / size
            )
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
        # Of each group the option that is nearest to 1: the solver's ones are nearly
        # so.
        best = np.lexsort((-x.value, position))[_first(position)]
        chosen = np.sort(np.concatenate([settled, free[best]]))
        if problem.is_within(chosen):
            return chosen, max(bound, float(problem.profit[chosen].sum()))
        # Within the solver's tolerance, but not within ours: leave as much room as it
        # took.
        over = problem.rows[:, chosen].sum(axis=1) - problem.limits
        room -= np.maximum(over, 0.0)
    return None, bound


def _first(position: IntArray) -> IntArray:
    return np.asarray(np.flatnonzero(np.diff(position, prepend=-1)))


# ---------- the choice
# Scale of rows that hold an earlier stage: the solver's tolerance is 1e-6.
_HELD = 1.0e5
# Of the time, for the first stage and its bound.
_STAGES_SHARE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class District:
    """Junctions that shall reach an APR together.

    Attributes
    ----------
    name : str
        Name of the district.
    junctions : (n,) int
        Its junctions, by number.
    least_apr : float
        Of their accidents together, by weight.
    """

    name: str
    junctions: IntArray
    least_apr: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityWishes:
    """What a city asks of all junctions together.

    Attributes
    ----------
    budget_units : int, optional
        At most so many new units.
    budget_eur : float, optional
        At most so much money. [EUR]
    districts : sequence of District
        Each reaches its APR.
    least_apr : (n_junctions,) float, optional
        APR that each junction reaches by itself; by default 0.
    """

    budget_units: int | None = None
    budget_eur: float | None = None
    districts: Sequence[District] = field(default_factory=tuple)
    least_apr: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityChoice:
    """What each junction gets.

    Attributes
    ----------
    rows : (n_junctions,) int
        Row of the options, for each junction.
    certificate : Certificate
        A stage for each objective. The bound of the first holds for all layouts of all
        junctions, those of the others for the points of the fronts.
    bound_of_points : float
        What no choice among the points exceeds in the first stage: what is between this
        and the first stage's bound is what the fronts leave open.
    """

    rows: IntArray
    certificate: Certificate
    bound_of_points: float


def choose(
    options: Options,
    weight: FloatArray,
    wishes: CityWishes,
    *,
    bounds: Options | None = None,
    names: Sequence[str] = (),
    gap: float = 0.0,
    time_limit_s: float = 60.0,
) -> CityChoice:
    """The best choice of one option for each junction.

    Parameters
    ----------
    options : Options
        Points of the junctions' fronts.
    weight : (n_junctions,) float
        Of each junction's accidents; their sum is not 0.
    wishes : CityWishes
        Budgets, and what has to be reached.
    bounds : Options, optional
        See :func:`placement.city.fronts.stack_bounds`; by default the points, which are
        then taken for all that there is.
    names : sequence of str
        Of the junctions, for messages.
    gap : float
        Relative gap at which a stage counts as settled.
    time_limit_s : float
        For all stages. [s]

    Returns
    -------
    choice : CityChoice
        With its certificate.

    Raises
    ------
    InputError
        A least APR cannot be reached, or not within the budgets; the message says what
        it takes.
    """
    end_s = now_s() + time_limit_s
    share = weight / weight.sum()
    _check_reach(options, share, wishes, names)
    began_s = now_s()
    rows = np.flatnonzero(_may_be(options, wishes))
    left = options.taken(rows)
    # First stage: APR by the weights of the junctions.
    problem = _problem(left, share, wishes, profit=share[left.junction] * left.apr)
    found = solve_knapsack(problem, gap=gap, time_limit_s=_STAGES_SHARE * time_limit_s)
    if found.chosen is None:
        raise _unmet(options, share, wishes)
    # Bounds of all layouts, not only of the fronts' points.
    highest = found.bound
    if bounds is not None:
        beside = bounds.taken(np.flatnonzero(_may_be(bounds, wishes)))
        most = solve_knapsack(
            _problem(beside, share, wishes, profit=share[beside.junction] * beside.apr),
            gap=gap,
            time_limit_s=max(0.5 * (end_s - now_s()), 1.0),
        )
        highest = most.bound
    stages = [build_stage(Objective.APR, found.objective, highest, now_s() - began_s)]
    # Options that can be in a choice with at least this objective, by their prices.
    _, relaxed, short = _shortfalls(problem, best_prices(problem))
    room = max(relaxed, found.bound) - found.objective + 1.0e-7 * max(1.0, abs(relaxed))
    keep = short <= room
    # Later stages choose among these and hold the first one.
    later = _Later(
        options=left.taken(np.flatnonzero(keep)),
        rows=rows[keep],
        share=share,
        wishes=wishes,
        gap=gap,
        end_s=end_s,
        held=[],
        chosen=(np.cumsum(keep) - 1)[found.chosen],
    )
    stages += later.solve(found.objective)
    return CityChoice(
        rows=later.rows[later.chosen],
        certificate=Certificate(stages=tuple(stages), solver=solver_text()),
        bound_of_points=found.bound,
    )


def city_values(
    options: Options, rows: IntArray, weight: FloatArray
) -> dict[Objective, float]:
    """Worth of a choice, objective by objective; 0 where nothing is prevented."""
    taken = options.taken(rows)
    share = weight / weight.sum()
    prevented = share * taken.apr
    counts = taken.apr > TOLERANCE
    total = float(prevented.sum())
    return {
        Objective.APR: total,
        Objective.APR_ONE_FAILED: float(share @ taken.apr_one_failed),
        Objective.SMALLEST_MARGIN: (
            float(taken.smallest_margin_s[counts].min(initial=np.inf))
            if counts.any()
            else 0.0
        ),
        Objective.MEAN_MARGIN: (
            float(prevented @ taken.mean_margin_s) / total if total else 0.0
        ),
        Objective.COST: float(taken.cost_eur.sum()),
    }


# ---------- the problem
def _may_be(options: Options, wishes: CityWishes) -> BoolArray:
    """Options that each junction's own wishes allow, whatever the others get."""
    may: BoolArray = np.ones(len(options), dtype=bool)
    if wishes.least_apr is not None:
        may &= options.apr >= wishes.least_apr[options.junction] - TOLERANCE
    return may


def _problem(
    options: Options, share: FloatArray, wishes: CityWishes, *, profit: FloatArray
) -> Knapsack:
    """Knapsack of options within a city's wishes."""
    rows: list[FloatArray] = []
    limits: list[float] = []
    if wishes.budget_units is not None:
        rows.append(options.units.astype(np.float64))
        limits.append(float(wishes.budget_units))
    if wishes.budget_eur is not None:
        rows.append(options.cost_eur)
        limits.append(wishes.budget_eur + COST_TOLERANCE_EUR)
    for district in wishes.districts:
        part, is_in = _part(district, share)
        rows.append(-_HELD * (part * is_in)[options.junction] * options.apr)
        limits.append(-_HELD * (district.least_apr - TOLERANCE))
    return Knapsack(
        group=options.junction,
        profit=profit,
        rows=np.array(rows).reshape(len(rows), len(options)),
        limits=np.array(limits),
    )


def _part(district: District, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share of each junction in a district's accidents, and which belong to it."""
    is_in = np.zeros(len(share))
    is_in[district.junctions] = 1.0
    total = float(share @ is_in)
    return share / total if total > 0.0 else is_in / max(is_in.sum(), 1.0), is_in


# ---------- the stages after the first
@dataclass(slots=True, kw_only=True, eq=False)
class _Later:
    """The stages after the first, and what they hold.

    Attributes
    ----------
    options : Options
        Options that can still be chosen.
    rows : int
        Of all options, those of these.
    share : (n_junctions,) float
        Share of each junction in all accidents.
    wishes : CityWishes
        Budgets, and what has to be reached.
    gap : float
        Relative gap at which a stage counts as settled.
    end_s : float
        When the time is up, on the clock of `now_s`. [s]
    held : list of (float, float)
        Rows of at least so much, in shares.
    chosen : (n_junctions,) int
        Option chosen so far, for each junction.
    """

    options: Options
    rows: IntArray
    share: FloatArray
    wishes: CityWishes
    gap: float
    end_s: float
    held: list[tuple[FloatArray, float]]
    chosen: IntArray

    def solve(self, apr: float) -> list[Stage]:
        """Solve the stages one after the other."""
        by_weight = self.share[self.options.junction]
        self.held.append((by_weight * self.options.apr, apr))
        one_failed = self._most(
            Objective.APR_ONE_FAILED, by_weight * self.options.apr_one_failed
        )
        smallest = self._smallest_margin()
        # At a given APR, the sum of prevented accidents by their time to spare says the
        # same.
        # Fewer than before.
        prevented = self.share[self.options.junction] * self.options.apr
        mean = self._most(
            Objective.MEAN_MARGIN, prevented * self.options.mean_margin_s, unit=apr
        )
        cost = self._most(Objective.COST, -self.options.cost_eur, unit=-1.0)
        return [one_failed, smallest, mean, cost]

    def _knapsack(
        self, profit: FloatArray, rows: IntArray | slice = slice(None)
    ) -> Knapsack:
        """Knapsack of some options that holds the stages before."""
        whole = _problem(self.options, self.share, self.wishes, profit=profit)
        least = [-_HELD * (value - TOLERANCE) for _, value in self.held]
        return Knapsack(
            group=whole.group[rows],
            profit=profit[rows],
            rows=np.vstack([whole.rows, *(-_HELD * row for row, _ in self.held)])[
                :, rows
            ],
            limits=np.append(whole.limits, least),
        )

    def _solve(self, problem: Knapsack, gap: float = 0.0) -> KnapsackChoice:
        time_limit_s = max(0.5 * (self.end_s - now_s()), 1.0)
        return solve_knapsack(problem, gap=gap, time_limit_s=time_limit_s)

    def _most(
        self, objective: Objective, profit: FloatArray, *, unit: float = 1.0
    ) -> Stage:
        """Maximise a profit, in units of `unit`, and hold its value."""
        began_s = now_s()
        found = self._solve(self._knapsack(profit), self.gap)
        if found.chosen is not None and found.objective > profit[self.chosen].sum():
            self.chosen = found.chosen
        value = float(profit[self.chosen].sum())
        if objective is not Objective.COST:
            self.held.append((profit, value))
        # Nothing is prevented: there is no time to spare.
        if unit == 0.0:
            return build_stage(objective, 0.0, 0.0, now_s() - began_s)
        return build_stage(
            objective, value / unit, found.bound / unit, now_s() - began_s
        )

    def _smallest_margin(self) -> Stage:
        """Maximise the smallest margin, by bisection.

        Options with less are left out, as many as possible.
        """
        began_s = now_s()
        margin_s = self.options.smallest_margin_s
        counts = self.options.apr > TOLERANCE

        def reached() -> float:
            values = city_values(self.options, self.chosen, self.share)
            return values[Objective.SMALLEST_MARGIN]

        value = reached()
        # Margins that could be reached; bisect for the highest of them.
        levels = np.unique(margin_s[counts & (margin_s > value + TOLERANCE)])
        profit = np.zeros(len(self.options))
        low = 0
        # Levels below low can be kept, those from high on cannot.
        high = len(levels)
        if len(levels):
            bound = float(levels[-1])
        else:
            bound = value
        while low < high and now_s() < self.end_s:
            middle = (low + high) // 2
            rows = np.flatnonzero(~counts | (margin_s >= levels[middle] - TOLERANCE))
            found = None
            if len(np.unique(self.options.junction[rows])) == self.options.n_junctions:
                answer = self._solve(self._knapsack(profit, rows))
                found = answer.chosen
                if found is None and answer.bound > -np.inf:
                    # The time was up.
                    break
            if found is None:
                high = middle
                if middle:
                    bound = float(levels[middle - 1])
                else:
                    bound = value
            else:
                self.chosen = rows[found]
                low = middle + 1
        value = reached()
        # Later stages go on with the options that are left.
        keep = np.flatnonzero(~counts | (margin_s >= value - TOLERANCE))
        # Go on with these alone.
        self.chosen = np.searchsorted(keep, self.chosen)
        self.options = self.options.taken(keep)
        self.rows = self.rows[keep]
        self.held = [(row[keep], least) for row, least in self.held]
        return build_stage(Objective.SMALLEST_MARGIN, value, bound, now_s() - began_s)


# ---------- what cannot be met
def _check_reach(
    options: Options, share: FloatArray, wishes: CityWishes, names: Sequence[str]
) -> None:
    """Refuse what no budget could reach."""
    starts = np.flatnonzero(np.diff(options.junction, prepend=-1))
    most = np.maximum.reduceat(options.apr, starts)
    if wishes.least_apr is not None:
        short = np.flatnonzero(most < wishes.least_apr - TOLERANCE)
        if len(short):
            first = int(short[0])
            if names:
                name = names[first]
            else:
                name = str(first)
            raise InputError(
                "areas: min_apr",
                float(wishes.least_apr[first]),
                f"at most {_floor(most[first])}, what the best layout found reaches at"
                f" {name}",
            )
    for district in wishes.districts:
        part, is_in = _part(district, share)
        reach = float((part * is_in) @ most)
        if reach < district.least_apr - TOLERANCE:
            expected = (
                f"at most {_floor(reach)}, what can be reached in {district.name}"
            )
            raise InputError("min_district_apr", district.least_apr, expected)


def _unmet(options: Options, share: FloatArray, wishes: CityWishes) -> InputError:
    """The error of wishes that the budgets do not allow: what they take at least."""
    # The least that the demands take, without budgets.
    in_money = wishes.budget_eur is not None
    free = replace(wishes, budget_eur=None, budget_units=None)
    left = options.taken(np.flatnonzero(_may_be(options, free)))
    if in_money:
        taken = left.cost_eur
    else:
        taken = left.units.astype(np.float64)
    found = solve_knapsack(_problem(left, share, free, profit=-taken))
    if in_money:
        option = "budget_eur"
    else:
        option = "budget_units"
    if in_money:
        got = wishes.budget_eur
    else:
        got = wishes.budget_units
    if found.chosen is None:
        return InputError(option, got, "least APRs that can be met together")
    least = -found.objective
    if in_money:
        amount = f"{least:,.0f} EUR"
    else:
        amount = f"{least:.0f} units"
    if in_money and wishes.budget_units is not None:
        also = " and more units"
    else:
        also = ""
    return InputError(
        option, got, f"at least {amount}{also}, to reach the APRs asked for"
    )


def _floor(share: float) -> str:
    return f"{np.floor(share * 10_000.0 + 1.0e-6) / 10_000.0:g}"


# ---------- the city's own front
@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A step at which a junction gets more.

    With the steps before, it is the most for the money that they take.

    Attributes
    ----------
    junction : int
        Number of the junction.
    row : int
        Of the options: what it has from here on.
    taken : float
        By all junctions together: euros or units.
    apr : float
        Of all junctions together.
    """

    junction: int
    row: int
    taken: float
    apr: float


def city_front(options: Options, weight: FloatArray, *, by_cost: bool) -> list[Step]:
    """The city's front by money or units: who joins, or gets more, at each step.

    Each step's choice is the best one of all for what it takes, as every choice is that
    is best at some price [1]_; between two steps there are other choices, which the
    knapsack finds.

    Parameters
    ----------
    options : Options
        Points of the junctions' fronts; the first of each takes nothing.
    weight : (n_junctions,) float
        Of each junction's accidents.
    by_cost : bool
        Whether euros are counted; else units.

    References
    ----------
    .. [1] H. Everett, "Generalized Lagrange multiplier method", 1963.
    """
    share = weight / weight.sum()
    if by_cost:
        taken = options.cost_eur
    else:
        taken = options.units.astype(np.float64)
    # First row of each junction, and the end.
    starts = [
        *np.flatnonzero(np.diff(options.junction, prepend=-1)).tolist(),
        len(options),
    ]
    rises: list[tuple[float, int, int, int]] = []
    # Upper hull of each junction: the steepest rise from each point on.
    for junction, (begin, end) in enumerate(pairwise(starts)):
        at = begin
        while True:
            more = np.arange(begin, end)
            more = more[
                (taken[more] > taken[at]) & (options.apr[more] > options.apr[at])
            ]
            if not len(more):
                break
            slope = (options.apr[more] - options.apr[at]) / (taken[more] - taken[at])
            steepest = np.flatnonzero(slope >= slope.max() * (1.0 - 1.0e-12))
            best = int(more[steepest[np.argmax(taken[more[steepest]])]])
            rises.append(
                (-float(slope.max()) * float(share[junction]), junction, at, best)
            )
            at = best
    steps = []
    base = starts[:-1]
    spent = float(taken[base].sum())
    apr = float(share @ options.apr[base])
    # All rises in order of what they gain for what they take.
    for _, junction, before, row in sorted(rises):
        spent += float(taken[row] - taken[before])
        apr += float(share[junction] * (options.apr[row] - options.apr[before]))
        steps.append(Step(junction=junction, row=row, taken=spent, apr=apr))
    return steps


# ---------- years in which units are mounted
_MAX_BINARIES = 3_000
_PHASES_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Phases:
    """When the junctions are ready.

    Attributes
    ----------
    year : (n,) int
        From 1; 0 where nothing is mounted.
    gain_years : float
        Sum over junctions of gain times the years, up to the last one, in which it is
        there.
    bound : float
        What no other order exceeds.
    """

    year: IntArray
    gain_years: float
    bound: float


def plan_phases(
    units: IntArray, gain: FloatArray, *, units_per_year: int, years: int | None = None
) -> Phases:
    """Spread units over years so that gain times years is largest.

    At most `units_per_year` are mounted in a year. A junction counts from the year
    in which its last unit is mounted. Solved as a mixed-integer model, or for
    thousands of junctions by the largest gain per unit first (Smith, 1956), with
    the bound where units may be divided. `units` and `gain`, (n,), are those of
    each junction. Raises InputError if the years, by default as many as it takes,
    do not suffice.
    """
    total = int(units.sum())
    needed = -(-total // units_per_year)
    n_years = max(needed if years is None else years, 1)
    if needed > n_years:
        expected = (
            f"at least {needed}, for {total} units, at most {units_per_year} of them a"
            " year"
        )
        raise InputError("years", years, expected)
    rows = np.flatnonzero(units > 0)
    year = np.zeros(len(units), dtype=np.int64)
    # A good order by rule; a model where it is small enough.
    year[rows], bound = _in_order(units[rows], gain[rows], units_per_year, n_years)
    if 0 < len(rows) * n_years <= _MAX_BINARIES and n_years > 1:
        found, proven = _solve(units[rows], gain[rows], units_per_year, n_years)
        before = _gain_years(year[rows], gain[rows], n_years)
        if found is not None and _gain_years(found, gain[rows], n_years) > before:
            year[rows] = found
        bound = min(bound, proven)
    value = _gain_years(year[rows], gain[rows], n_years)
    if bound <= value + 1.0e-7 * max(1.0, value):
        bound = value
    return Phases(year=year, gain_years=value, bound=bound)


def _gain_years(year: IntArray, gain: FloatArray, n_years: int) -> float:
    if len(gain):
        return float(gain @ (n_years + 1 - year))
    return 0.0


def _in_order(
    units: IntArray, gain: FloatArray, units_per_year: int, n_years: int
) -> tuple[IntArray, float]:
    """Years if the largest gain per unit comes first, and a bound.

    The bound is the sum where parts of a junction gain parts of it.
    """
    order = np.argsort(-gain / units, kind="stable")
    end = np.cumsum(units[order])
    year = np.empty(len(units), dtype=np.int64)
    year[order] = -(-end // units_per_year)
    worth = 0.0
    # Parts of a junction gain parts of it, year by year.
    for number in range(1, n_years + 1):
        mounted = (number * units_per_year - (end - units[order])) / units[order]
        worth += float(gain[order] @ np.clip(mounted, 0.0, 1.0))
    return year, worth


def _solve(
    units: IntArray, gain: FloatArray, units_per_year: int, n_years: int
) -> tuple[IntArray | None, float]:
    """Years by a mixed-integer model, and its bound; None if not found."""
    import cvxpy as cp

    n = len(units)
    # Junction by junction, its year.
    x = cp.Variable(n * n_years, boolean=True)
    # Each junction is ready in one year.
    one_each = sp.kron(sp.eye_array(n), np.ones((1, n_years)), format="csr")
    # Up to each year, no more units are mounted than there were years for.
    until = np.tril(np.ones((n_years, n_years)))
    ready = sp.csr_array(np.kron(units.astype(np.float64)[None], until))
    most = units_per_year * np.arange(1.0, n_years + 1.0)
    unit = max(float(gain.sum()), 1.0e-300) / 1.0e4
    worth = np.kron(gain / unit, np.arange(n_years, 0, -1.0))
    answer = run_solver(
        cp.Problem(cp.Maximize(worth @ x), [one_each @ x == 1.0, ready @ x <= most]),
        time_limit_s=_PHASES_S,
    )
    if not answer.is_found:
        return None, np.inf
    return 1 + x.value.reshape(n, n_years).argmax(axis=1), answer.bound * unit
