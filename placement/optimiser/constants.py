"""Numbers that steer the optimiser, and how its work is shared out to threads.

Tolerances, shares of the time, sizes, steps. Three kinds must not be mixed up:
what counts as equal is part of what "best" means; what rounding or a solver may
err by says how far a bound can be believed; all others change how long an
answer takes and how good it is when the time is up, never whether a proof
holds.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from math import lcm
from typing import Literal, get_args

import numpy as np

from geometry.arrays import FloatArray
from geometry.clock import now_s
from geometry.errors import InputError, check_one_of

# ---------- ties: what counts as equal
# Shares and times that differ by no more are equal: they carry rounding noise
TOLERANCE = 1.0e-9
# The layout found may be a tie worse than the best, and another a tie worse than it.
TIES_OF_TIES = 2.0
FAR_APART = 2.0 * TIES_OF_TIES * TOLERANCE
"""Values that differ by more never tie, not even by way of others between them."""
# Weights are looked at as fractions, such as a twentieth of a third, with no larger
# one.
MOST_DENOMINATOR = 10**6
# Sums of prices that differ by no more are equal
COST_TOLERANCE_EUR = 1.0e-6

# ---------- how far a computed number can be believed
# Relative: sums of float64 values in another order, and exchanges that gain no more
# than that.
ROUNDING = 1.0e-9
# HiGHS meets rows, whole numbers and gaps up to this, relative to the sums it is
# handed.
SOLVER_TOLERANCE = 1.0e-6
# Sum to which an objective's coefficients are scaled: HiGHS's tolerances are
# absolute.
SOLVER_SUM = 1.0e4
# Of the mean weight: rows that hold an earlier stage are relaxed by it, well above
# HiGHS's own tolerance: asked for the last digit it called feasible problems
# infeasible. Answers are checked.
HELD_SLACK = 1.0e-3
# A float64 up to 1 that is a fraction: it has the fraction's first digits
EXACT = 1.0e-15
# Keeps a sum of nothing from being divided by
TINY = 1.0e-300
# A common step is clearly larger than a solver's error if no value is more steps than
# this.
MOST_STEPS = 1.0e5
# Added to a value to ask for more, where values have no common step
STEP_UP = 2.0 * TOLERANCE

# ---------- time
TIME_SHARES = {
    # Searches settle early; what they miss is found by the walk.
    "first set": 0.1,
    # A tenth of that suffices for the sizes below.
    "few sets": 0.5,
    # What it leaves is for the relaxation and HiGHS.
    "walk": 0.6,
    # All later stages depend on it.
    "least cost": 0.8,
    # Nothing else bounds drawn detections as well.
    "worlds": 0.9,
    # Settles within seconds.
    "relaxation": 0.5,
    # Where sites fail; in most cases that is the answer.
    "as if units failed": 0.6,
    # Most points leave some of it to those after them.
    "point of a front": 0.5,
    # HiGHS is handed a model in as long again.
    "model stated": 0.5,
}
"""Share of the time left that a step may take, by step."""
# HiGHS is given no more: eleven days
LONGEST_S = 1.0e6
# Left to a step when the time is up, so that every answer has a layout
LEAST_S = 1.0e-3
# Bytes that a walk looks at between two looks at the clock: some hundredths of a
# second.
WALK_WORK = 30_000_000
# Time of a thread for sets that are valued, between two looks at the clock. [s]
SPELL_S = 0.1

# ---------- sizes up to which a method is used
# Detections in a table that is still solved as a whole: 125 MB, presolved in seconds.
MAX_BITS = 1_000_000_000
# Poses x merged frames in a model of HiGHS: it takes some bytes for each
MAX_CELLS = 1 << 28
# Sets that are valued one by one: a second or two; more where money is short, as no
# walk does.
MAX_FEW_SETS = 60_000
MAX_SETS_OF_MONEY = 1_000_000
# Measured: two to three times as many; where less time is left, fewer sets are few.
FEW_SETS_PER_SECOND = 30_000
# Sets of sites behind which walks go: tens of seconds to find out what all poses reach
MAX_SITE_SETS = 200_000
# Sets whose limits are looked at to find out how many are allowed
MAX_GROWN_SETS = 20_000_000
# Sets whose limits are looked at at a time: some 100 MB
GROWN_TOGETHER = 1 << 19
# A walk through sets of more units does not end
MAX_WALK_UNITS = 16
# Units of sets that are gone through pair by pair: two or three
MAX_PAIR_UNITS = 3
# Sets that tie and are kept, to choose among them in later stages
MAX_TIED = 100_000
# Of a large table, those among which a layout is looked for: they gain most
POOL_POSES = 400
# Of a large table's pool, each time that no layout of it meets the demands.
POOL_GROWTH = 4
# Poses x merged frames of a model that is stated and compiled in a second; measured.
CELLS_PER_SECOND = 2.4e6
# Seconds to compile a model for HiGHS over those to state it; cvxpy: measured 2.1.
COMPILED_TO_STATED = 2.5
# Sets that are valued at a time: their margins stay in the cache
BLOCK_SETS = 1 << 12
# Fewer tasks are not worth threads
FEW_TASKS = 64
# Sets that are looked at whatever is asked
MANY_SETS = 1 << 12

# ---------- first sets
# Of restarts
SEED = 1
# At most so many; they end after one more than units without a better set
N_RESTARTS = 40
# Poses that are valued in all objectives one by one; for more, bits along the poses
# are faster.
FEW_PARTNERS = 32

# ---------- Lagrangian bound
# First price of a row, as a share of its weight: near what it is at the end
PRICE_START = 0.3
# First step, as a share of the way to a bound of 0 (Polyak's rule with that target).
STEP_LENGTH = 0.7
# Share of the last direction that is kept (Camerini, Fratta, Maffioli 1975)
DEFLECTION = 0.7
# Steps are cut by this share after so many without a better bound
STEP_CUT = 0.6
PATIENCE = 6
# Share of what was picked before, in averages that tend to a relaxed solution
MEMORY = 0.97
# In the first round, and in rounds that begin with good prices
FIRST_STEPS = 250
LATER_STEPS = 120
# Rounds in which windows are asked for the frame seen least; most settle before
ASK_ROUNDS = 8
# Of one set of sites: most are bounded well enough by the first
SITE_STEPS = (30, 120)
# Relative: a round that lowers the bound by less is the last one
SETTLED = 1.0e-5
# Frames whose shares agree to so many places are alike: the first is asked for
SHARE_DIGITS = 3
# Poses with less are no part of a relaxed solution
SMALL_SHARE = 1.0e-3
# Prices of the whole APR that are tried where units fail: the best is near one of
# them.
FAILURE_PRICES = (0.0, 0.3, 1.0, 3.0)
# OSQP is handed so many poses, fewer if these cover more rows: its factor grows with
# them.
CORE_POSES = 500
CORE_BITS = 100_000
# Cores, each with those poses that were too good for the one before; OSQP's steps in
# each.
POLISH_ROUNDS = 4
POLISH_STEPS = 300
# Points between old and new prices that are tried (in-out separation, Ben-Ameur, Neto
# 2007).
POLISH_WAY = (0.2, 0.4, 0.6, 0.8, 1.0)
# Makes the relaxed solution unique, as OSQP's steps like it; the bound is repaired
# anyway.
OSQP_REGULARISATION = 1.0e-3
# Measured: two to five times fewer steps than with OSQP's own.
OSQP_TOLERANCE = 1.0e-5
OSQP_PENALTY = 1.0
OSQP_OVERRELAXATION = 1.8

# ---------- walks
# Relative: where ties are many, first it is proven that no set is better by more
NEAR = 0.009
# Relative: the first of such proofs where worlds are sampled; each next one is of
# half as much.
NEAR_IN_WORLDS = 0.02
# A walk for the best takes so many times as long as one for what is better by that;
# measured.
ALL_TIMES_NEAR = 6.0
# Sets of sites that are bounded before a walk goes behind those that are left
BLOCK_SITES = 256
# Nodes of this depth are handed out to threads
STOP_DEPTH = 2
# Sets of classes that a walk finds before they are valued
OUT_SETS = 1 << 8
# Poses of a class, on average, where worlds are sampled; how many are compared in one
# go.
CLASS_POSES = 12
MAX_LIKE_POSES = 2000
# Runs in which most is lost: by them pairs are found out that lose too much
HARD_ROWS = 512
# Pairs of poses next to a class that are valued with each of its poses at once
FEW_PAIRS = 200
# A run is hard if so many poses drawn at random are likely to lose it together
TOGETHER = 16


# ---------- effort, threads, the clock
SolverName = Literal["auto", "exact", "relax", "greedy"]
# Threads by default
WORKERS = os.cpu_count() or 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How hard to try.

    Attributes
    ----------
    solver : {"auto", "exact", "relax", "greedy"}
        "greedy": search only, bounded by what all poses together reach; "relax":
        the bounds of relaxations, too; "exact": walks and mixed-integer models,
        too, until the time is up; "auto": the same, but of a table that is too
        large the most promising poses alone.
    time_limit_s : float
        For all stages together; presolve and the first layout are finished in any
        case. When it is up, the best layout found is kept and the gaps say what is
        not proven. [s]
    gap : float
        Relative gap at which a stage counts as settled.
    workers : int
        Threads, at least 1; they change no result that is proven.
    """

    solver: SolverName = "auto"
    time_limit_s: float = 60.0
    gap: float = 0.0
    workers: int = WORKERS

    def __post_init__(self) -> None:
        check_one_of("solver", self.solver, get_args(SolverName))
        if not self.time_limit_s > 0.0:
            raise InputError("time_limit", self.time_limit_s, "seconds, more than 0")
        if not 0.0 <= self.gap < 1.0:
            raise InputError("gap", self.gap, "a share, 0 <= gap < 1")
        if self.workers < 1:
            raise InputError("workers", self.workers, "threads, at least 1")

    @property
    def is_exact(self) -> bool:
        """True if walks and models may prove what relaxations do not."""
        return self.solver in ("auto", "exact")

    def until(self, deadline: "Deadline") -> "Effort":
        """The same effort for the time left, or for hardly any."""
        return replace(self, time_limit_s=max(deadline.left_s(), LEAST_S))


@dataclass(frozen=True, slots=True)
class Deadline:
    """When an answer is due, and how the time until then is split.

    Attributes
    ----------
    end_s : float
        An instant of :mod:`geometry.clock`. [s]
    """

    end_s: float

    def left_s(self) -> float:
        """Time left, in seconds; not negative."""
        return max(self.end_s - now_s(), 0.0)

    @property
    def is_over(self) -> bool:
        """True if no time is left."""
        return now_s() >= self.end_s

    def of(self, step: str) -> "Deadline":
        """Deadline of a step, one of :data:`TIME_SHARES`."""
        return Deadline(now_s() + TIME_SHARES[step] * self.left_s())


def deadline_in(seconds: float) -> Deadline:
    """Deadline in so many seconds."""
    return Deadline(now_s() + seconds)


NEVER = Deadline(np.inf)


def share_out(
    work: Callable[[int, int], None], count: int, *, workers: int, few: int = FEW_TASKS
) -> None:
    """Call ``work(begin, end)`` for parts of 0 .. `count`, one in each thread.

    What is less than `few` is done at once. Kernels let other threads run.

    Parameters
    ----------
    work : callable
        Takes the first and the end of a part.
    count : int
        How much there is to do.
    workers : int
        Threads.
    few : int
        Less than that is not worth threads.
    """
    if count < few or workers == 1:
        work(0, count)
        return
    bounds = [count * number // workers for number in range(workers + 1)]
    with ThreadPoolExecutor(workers) as threads:
        list(threads.map(work, bounds[:-1], bounds[1:]))


# ---------- arithmetic of bounds
def common_step(amounts: FloatArray) -> float:
    """Least of some amounts, if all are whole multiples of it; else 0.

    Nor is there a step where the amounts sum up to more than :data:`MOST_STEPS` of it.

    >>> common_step(np.array([0.25, 0.0, 0.75])), common_step(np.array([0.25, 0.6]))
    (0.25, 0.0)
    """
    positive = amounts[amounts > 0.0]
    if not len(positive) or positive.sum() > MOST_STEPS * positive.min():
        return 0.0
    count = positive / positive.min()
    is_whole = np.abs(count - count.round()) <= ROUNDING * count
    if is_whole.all():
        return float(positive.min())
    return 0.0


def are_sums_apart(amounts: FloatArray) -> bool:
    """True if no two sums of some of the amounts differ by little, but by rounding.

    Amounts are looked at as fractions: sums differ by multiples of their common
    denominator's inverse, which must exceed :data:`FAR_APART`.

    >>> are_sums_apart(np.array([1 / 3, 1 / 6, 0.5]))
    True
    >>> are_sums_apart(np.array([1.0, 1e-9]))
    False
    """
    denominator = 1
    for amount in np.unique(amounts).tolist():
        fraction = Fraction(amount).limit_denominator(MOST_DENOMINATOR)
        # A weight of 1e-300 is no zero.
        is_lost = fraction == 0 and amount != 0.0
        if is_lost or abs(float(fraction) - amount) > EXACT * max(1.0, amount):
            return False
        denominator = lcm(denominator, fraction.denominator)
        if denominator * FAR_APART > 1.0:
            return False
    return True


def settle(value: float, bound: float, limit: float, *, step: float = 0.0) -> float:
    """Upper bound of a stage from what a solver says.

    Parameters
    ----------
    value : float
        Value of the best set so far.
    bound : float
        What the solver says.
    limit : float
        An upper bound that holds without it.
    step : float
        All possible values are whole multiples of it, where it is not 0: then a
        bound proves the value that it exceeds by less than a step. Else it proves
        the value that it equals.
    """
    error = SOLVER_TOLERANCE * max(1.0, abs(value))
    if bound < value - error:
        # The solver errs: a set with this value is at hand.
        return limit
    if bound <= value + max(TOLERANCE, step - error):
        return value
    return min(limit, bound)
