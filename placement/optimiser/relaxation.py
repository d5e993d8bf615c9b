"""Bounds close to those of the LP relaxation: subgradient steps, column generation, OSQP.

:func:`tighten` improves multipliers by deflected subgradient steps, :func:`generate_columns` bounds
all poses by working with few of them, and :func:`polish` takes multipliers that are nearly right to
the end by solving the relaxation with OSQP.

In the radius formulation (Cornuejols, Nemhauser, Wolsey 1980) a row has a level for each distinct
value; reaching a level needs a pose that has that value or more:

    maximise   sum of w[l] a[l]  -  epsilon / 2 * sum of x[c] ** 2
    such that  a[l] <= a[next level above] + sum of x[c] over poses whose value is level l
               sum of x[c] <= K,  per site <= capacity,  money <= budget,  0 <= a, x <= 1

where w[l] is the step from the next level below. A value stands in one constraint only, so that
the matrix is as sparse as the values. The small quadratic term makes x unique, which OSQP's
steps and a sweep over K like. What OSQP returns proves nothing by itself: its multipliers do, once
:func:`placement.optimiser.bounds.prove` has put them into the Lagrangian bound.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s

from .bounds import Bound, Coverage, ValueArray, prove
from .tolerances import COST_TOLERANCE_EUR, TINY

if TYPE_CHECKING:
    from scipy import sparse

_DEFLECTION = 0.7  # of the last direction that is kept
_CUT = 0.7
_SMALLEST_STEP = 1.0e-4
_MEMORY = 0.95  # of the shares: the last 20 steps or so
_LEAST = 1.0e-7  # relative; a bound that is better by less is no better
_COARSE_STEPS, _FINE_STEPS = 50, 200
_WAY_BACK = (0.6, 0.3)  # to the best multipliers so far, where new ones are no better

_limit = attrgetter("limit")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoolSizes:
    """How many poses column generation works with."""

    n_first: int = 1500  # to begin with
    n_more: int = 1000  # at most so many join in a round
    n_most: int = 3000  # no more are kept when others join
    n_rounds: int = 25  # at most


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tightened:
    """Multipliers after some steps."""

    bound: Bound  # the best
    # (n_poses,): how often each pose was picked of late: close to a relaxed solution.
    shares: FloatArray


def tighten(
    coverage: Coverage,
    multipliers: ValueArray,
    *,
    target: float,
    n_steps: int = 300,
    stop_below: float = -np.inf,
    first_length: float = 1.0,
    patience: int = 15,
    workers: int = 1,
) -> Tightened:
    """Lower the bound by subgradient steps that begin at `multipliers`, (n_rows,).

    The steps aim at `target`, such as the value of the best known set; the first takes the share
    `first_length` of the way. They end below `stop_below`, and are cut after `patience` steps
    without a better bound. Steps of Polyak (1969), along subgradients of which a share is carried
    over (Camerini, Fratta, Maffioli 1975). Averages of the picked sets tend to a relaxed solution
    (Barahona, Anbil 2000).
    """
    best = bound = prove(coverage, multipliers, workers=workers)
    shares = np.zeros(coverage.n_poses)
    direction = np.zeros(coverage.n_rows)
    length, n_idle = first_length, 0
    for step in range(n_steps):
        shares *= _MEMORY
        shares[bound.pick.poses] += (1.0 - _MEMORY) * bound.pick.shares
        if bound.limit < best.limit - _LEAST * abs(best.limit):
            best, n_idle = bound, 0
        elif step:
            n_idle += 1
        if best.limit < stop_below or length < _SMALLEST_STEP:
            break
        if n_idle > patience:
            bound, direction[:] = best, 0.0
            length, n_idle = length * _CUT, 0
        direction = _slope(coverage, bound) + _DEFLECTION * direction
        steepness = float(direction @ direction)
        if steepness < 1e-12:
            break
        move = length * max(bound.limit - target, 1e-6 * abs(target)) / steepness
        bound = prove(coverage, bound.multipliers - move * direction, workers=workers)
    if bound.limit < best.limit:
        best = bound
    total = shares.sum()
    if total > 0.0:
        shares = np.minimum(shares * (best.pick.shares.sum() / total), 1.0)
    return Tightened(bound=best, shares=shares)


def _slope(coverage: Coverage, bound: Bound) -> FloatArray:
    """A subgradient: by how much the limit changes with each multiplier, (n_rows,)."""
    picked = coverage.values[bound.pick.poses] > bound.multipliers
    slope: FloatArray = 1.0 - bound.pick.shares @ picked
    return slope


def first_multipliers(coverage: Coverage, chosen: IntArray) -> FloatArray:
    """Multipliers to begin with: a little below what a good set reaches."""
    start: FloatArray = 0.7 * coverage.level(chosen).astype(np.float64)
    return start


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """A bound over all poses, and the few poses that it rests on."""

    limit: float  # no feasible set is worth more: that of `bound`, or what all poses together reach
    bound: Bound  # for all poses
    pool: IntArray  # (n,): poses that were worked with at last, ascending
    shares: FloatArray  # (n,): their shares in a relaxed solution, roughly


def generate_columns(
    coverage: Coverage,
    incumbent: IntArray,
    *,
    multipliers: ValueArray | None = None,
    improve: Callable[[Coverage, Tightened], Tightened] | None = None,
    sizes: PoolSizes | None = None,
    tolerance: float = 2.0e-4,
    end_s: float = np.inf,
    workers: int = 1,
) -> Columns:
    """Bound all poses by working with few: price the others, add those that are too good.

    `improve` is called with the pool and its multipliers once few poses are left to join. The
    rounds end when one brings less than the relative `tolerance` and no pose outside the pool is
    too good, or at `end_s` of `geometry.clock`. Few steps are made while many poses still join,
    since multipliers that suit a poor pool too well are worth nothing outside it. Where new ones
    are no better for all poses than the best so far, points between the two are tried (in-out
    separation, Ben-Ameur, Neto 2007).
    """
    sizes = PoolSizes() if sizes is None else sizes
    slack = tolerance * max(coverage.value(incumbent), TINY)
    start = first_multipliers(coverage, incumbent) if multipliers is None else multipliers
    ceiling = np.maximum(coverage.values.max(axis=0, initial=0.0), coverage.floor)
    best = origin = prove(coverage, np.minimum(start, ceiling), workers=workers)
    pool = np.union1d(incumbent, worthiest(best.worth, sizes.n_first))
    shares = np.zeros(len(pool))
    n_new = coverage.n_poses
    for number in range(sizes.n_rounds):
        is_coarse = n_new > sizes.n_more // 4 and len(pool) < coverage.n_poses
        part = coverage.of_poses(pool)
        tightened = tighten(
            part,
            origin.multipliers,
            target=coverage.value(incumbent),
            n_steps=_COARSE_STEPS if is_coarse else _FINE_STEPS,
            workers=workers,
        )
        if improve is not None and not is_coarse:
            tightened = improve(part, tightened)
        shares = tightened.shares
        goal = tightened.bound.multipliers
        before, tried = best, [prove(coverage, goal, workers=workers)]
        for share in _WAY_BACK:
            if number == 0 or min(tried, key=_limit).limit <= before.limit - slack:
                break
            between = share * goal + (1.0 - share) * before.multipliers
            tried.append(prove(coverage, between, workers=workers))
        best = min([before, *tried], key=_limit)
        is_complete = tried[0].limit <= tightened.bound.limit + slack
        is_complete |= number > 0 and n_new == 0
        is_settled = not is_coarse and is_complete and before.limit - best.limit < slack
        if is_settled or number == sizes.n_rounds - 1 or now_s() > end_s:
            break
        origin = tried[0] if is_coarse else best
        inside = pool[tightened.bound.pick.poses]
        joining = np.union1d(
            _too_good(coverage, tried[0], inside, pool, sizes.n_more),
            _too_good(coverage, best, best.pick.poses, pool, sizes.n_more),
        )
        n_new = len(joining)
        kept = pool[worthiest(best.worth[pool], sizes.n_most)]
        pool = np.union1d(np.union1d(kept, joining), incumbent)
    limit = min(best.limit, float(ceiling.sum(dtype=np.float64)))
    return Columns(limit=limit, bound=best, pool=pool, shares=shares)


def _too_good(
    coverage: Coverage, bound: Bound, picked: IntArray, pool: IntArray, n_poses: int
) -> IntArray:
    """Poses outside a pool that are worth more than one that is picked: the worthiest of them.

    Where money is short, that is worth for money.
    """
    score = bound.worth
    if np.isfinite(coverage.supply.budget_eur):
        score = score / np.maximum(coverage.supply.prices_eur, COST_TOLERANCE_EUR)
    least = score[picked].min(initial=np.inf)
    outside = score.copy()
    outside[pool] = -np.inf
    top = worthiest(outside, n_poses)
    joining: IntArray = top[outside[top] >= max(least, TINY)]
    return joining


def worthiest(worth: FloatArray, n_poses: int) -> IntArray:
    """Poses with the most worth, ascending."""
    if n_poses >= len(worth):
        return np.arange(len(worth))
    top: IntArray = np.sort(np.argpartition(-worth, n_poses)[:n_poses])
    return top


# ---------- the relaxation by OSQP


_REGULARISATION = 1.0e-3  # of the largest step
_CHECK_STEPS = 50
_PENALTY, _OVERRELAXATION = 1.0, 1.8  # measured: two to five times fewer steps than OSQP's own
_TOLERANCE = 1.0e-5
_WAY = (0.2, 0.4, 0.6, 0.8, 1.0)
_SMALL_SHARE = 0.01
_LITTLE = 1.0e-5  # relative; a bound that is better by less is no better


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relaxed:
    """A relaxed solution and what it proves."""

    shares: FloatArray  # (n_poses,): x, 0..1; feasible within OSQP's tolerance
    bound: Bound  # proven by the repaired multipliers, for the poses that were relaxed
    is_solved: bool  # whether OSQP met its tolerance
    n_steps: int  # of OSQP


class Relaxation:
    """The relaxation on some poses, set up and factorised once, solved for one K after another."""

    def __init__(self, coverage: Coverage, *, tolerance: float = _TOLERANCE) -> None:
        """Set up for some thousand poses at most: the factor grows with their square.

        `tolerance` is that of OSQP, absolute and relative, when the largest step of a level is 1.
        """
        import osqp
        from scipy import sparse

        self._coverage = coverage
        self._levels = _Levels(coverage)
        levels, supply = self._levels, coverage.supply
        n_poses, n_levels = coverage.n_poses, len(levels.step)
        self._scale = 1.0 / float(levels.step.max()) if n_levels else 1.0
        sites, site = np.unique(supply.site_index, return_inverse=True)
        every = np.arange(n_poses)
        prices = supply.prices_eur
        has_money = np.isfinite(supply.budget_eur) and bool(prices.any())
        price_scale = 1.0 / prices.max() if has_money else 1.0
        choice = sparse.vstack(
            [
                sparse.csc_matrix(np.ones((1, n_poses))),
                sparse.csc_matrix((np.ones(n_poses), (site, every)), shape=(len(sites), n_poses)),
                sparse.csc_matrix(prices[None, :] * (price_scale if has_money else 0.0)),
            ]
        )
        padded = sparse.hstack([choice, sparse.csc_matrix((choice.shape[0], n_levels))])
        matrix = sparse.vstack([levels.matrix(), padded, sparse.eye(n_poses + n_levels)], "csc")
        self._upper = np.concatenate(
            [
                np.zeros(n_levels),
                [supply.max_units],
                supply.site_capacity[sites],
                [supply.budget_eur * price_scale if has_money else 1.0],
                np.ones(n_poses + n_levels),
            ]
        ).astype(np.float64)
        lower = np.full(len(self._upper), -np.inf)
        lower[-(n_poses + n_levels) :] = 0.0
        quadratic = sparse.diags(
            np.concatenate([np.full(n_poses, _REGULARISATION), np.zeros(n_levels)]), format="csc"
        )
        self._solver = osqp.OSQP()
        self._solved_status = osqp.SolverStatus.OSQP_SOLVED
        self._solver.setup(
            quadratic,
            np.concatenate([np.zeros(n_poses), -self._scale * levels.step]),
            matrix,
            lower,
            self._upper,
            verbose=False,
            eps_abs=tolerance,
            eps_rel=tolerance,
            check_termination=_CHECK_STEPS,
            rho=_PENALTY,
            alpha=_OVERRELAXATION,
        )

    def start_at(self, shares: FloatArray, bound: Bound) -> None:
        """Let the next solution begin at rough shares x, (n_poses,), and a bound's multipliers."""
        levels = self._levels
        earned = levels.earned(bound.multipliers.astype(np.float64))
        least = bound.worth[bound.pick.poses].min(initial=np.inf)
        duals = np.zeros(len(self._upper))
        duals[: len(levels.step)] = earned
        duals[len(levels.step)] = least if np.isfinite(least) else 0.0
        poses = slice(len(duals) - len(levels.step) - len(shares), len(duals) - len(levels.step))
        duals[poses] = bound.worth - duals[len(levels.step)]
        duals[len(duals) - len(levels.step) :] = levels.step - earned + levels.next_below(earned)
        self._solver.warm_start(
            x=np.concatenate([shares, levels.reached_by(shares)]), y=self._scale * duals
        )

    def solve(self, max_units: int, *, max_steps: int = 500) -> Relaxed:
        """Solve for a number of units, from where the last solution stands.

        The bound holds whether OSQP has converged within `max_steps` or not.
        """
        levels, n_poses = self._levels, self._coverage.n_poses
        self._upper[len(levels.step)] = max_units
        self._solver.update(u=self._upper)
        self._solver.update_settings(max_iter=max_steps)
        result = self._solver.solve(raise_error=False)
        coverage = self._coverage.with_units(max_units)
        duals = np.maximum(np.nan_to_num(np.asarray(result.y)), 0.0) / self._scale
        bounds = [
            prove(coverage, multipliers)
            for multipliers in (
                levels.multipliers_of_rows(duals[: len(levels.step)]),
                levels.multipliers_of_limits(duals[len(duals) - len(levels.step) :]),
            )
        ]
        return Relaxed(
            shares=np.clip(np.nan_to_num(np.asarray(result.x)[:n_poses]), 0.0, 1.0),
            bound=min(bounds, key=lambda bound: bound.limit),
            is_solved=bool(result.info.status_val == self._solved_status),
            n_steps=int(result.info.iter),
        )


def polish(
    coverage: Coverage,
    tightened: Tightened,
    *,
    n_core: int = 500,
    n_rounds: int = 4,
    n_steps: int = 300,
    max_values: int = 100_000,
) -> Tightened:
    """Take multipliers that are nearly right to those of the LP relaxation; the bound never rises.

    OSQP is given the `n_core` worthiest of some thousand poses, fewer if these have more than
    `max_values` values above zero, since its factor grows with them. Multipliers that suit the core
    are wrong for the other poses: the best point on the way to them is taken (the bound is convex),
    and poses that are too good at their end join the core: in-out separation (Ben-Ameur, Neto
    2007).
    """
    best, shares = tightened.bound, tightened.shares
    if not coverage.values.size:
        return tightened
    row_share = float((coverage.values[::7] > coverage.floor).mean())
    n_core = min(n_core, int(max_values / max(row_share * coverage.n_rows, 1.0)))
    core = np.union1d(worthiest(best.worth, n_core), np.flatnonzero(shares > _SMALL_SHARE))
    for _ in range(n_rounds):
        part = coverage.of_poses(core)
        relaxation = Relaxation(part)
        relaxation.start_at(shares[core], prove(part, best.multipliers))
        relaxed = relaxation.solve(coverage.supply.max_units, max_steps=n_steps)
        shares = np.zeros(coverage.n_poses)
        shares[core] = relaxed.shares
        before, goal = best, relaxed.bound.multipliers
        on_the_way = [
            prove(coverage, (1.0 - share) * before.multipliers + share * goal) for share in _WAY
        ]
        best = min([before, *on_the_way], key=lambda bound: bound.limit)
        gain = before.limit - best.limit
        is_complete = on_the_way[-1].limit <= relaxed.bound.limit * (1.0 + _LITTLE)
        if is_complete and gain <= _LITTLE * abs(best.limit):
            break
        for bound in (best, on_the_way[-1]):
            core = np.union1d(core, worthiest(bound.worth, n_core // 4))
    return Tightened(bound=best, shares=shares)


def relaxation_text() -> str:
    """What the bounds rest on, for a certificate."""
    return f"Lagrangian relaxation with OSQP {version('osqp')}"


class _Levels:
    """Distinct values of each row beyond what is reached, from the highest down."""

    def __init__(self, coverage: Coverage) -> None:
        self.floor = coverage.floor.astype(np.float64)
        self.n_poses = coverage.n_poses
        row, pose = np.nonzero(coverage.floor[:, None] < coverage.values.T)
        value = coverage.values[pose, row].astype(np.float64) - self.floor[row]
        order = np.lexsort((-value, row))
        row, self.pose, value = row[order], pose[order], value[order]
        is_new_row = np.diff(row, prepend=-1) != 0
        is_new = is_new_row | (np.diff(value, prepend=np.inf) != 0.0)
        self.level: IntArray = np.cumsum(is_new) - 1  # of every entry
        self.row: IntArray = row[is_new]
        self.value: FloatArray = value[is_new]
        self.is_top = is_new_row[is_new]
        self.step: FloatArray = self.value - self.next_below(self.value)

    def next_below(self, per_level: FloatArray) -> FloatArray:
        """What stands at the next level of the same row; 0 at the lowest."""
        below: FloatArray = np.zeros(len(per_level))
        below[:-1] = np.where(self.is_top[1:], 0.0, per_level[1:])
        return below

    def earned(self, multipliers: FloatArray) -> FloatArray:
        """What a pose earns at each level beyond the multipliers."""
        earned: FloatArray = np.maximum(self.value + (self.floor - multipliers)[self.row], 0.0)
        return earned

    def reached_by(self, shares: FloatArray) -> FloatArray:
        """How much of each level poses in parts reach, 0..1."""
        at_level = np.bincount(self.level, weights=shares[self.pose], minlength=len(self.value))
        total = np.cumsum(at_level)
        before = (total - at_level)[self.is_top]
        number = np.cumsum(self.is_top) - 1
        reached: FloatArray = np.minimum(total - before[number], 1.0)
        return reached

    def matrix(self) -> "sparse.csc_matrix":
        """``a[l] - a[above] - sum of x``, (n_levels, n_poses + n_levels)."""
        from scipy import sparse

        n_levels = len(self.step)
        every = np.arange(n_levels)
        lower = every[~self.is_top]
        rows = np.concatenate([self.level, every, lower])
        columns = np.concatenate([self.pose, self.n_poses + every, self.n_poses + lower - 1])
        entries = np.concatenate(
            [-np.ones(len(self.level)), np.ones(n_levels), -np.ones(len(lower))]
        )
        shape = (n_levels, self.n_poses + n_levels)
        return sparse.csc_matrix((entries, (rows, columns)), shape=shape)

    def multipliers_of_rows(self, duals: FloatArray) -> FloatArray:
        """Lambda from the constraints: a pose of level l earns its value less lambda there."""
        multipliers = self.floor.copy()
        top = self.is_top
        multipliers[self.row[top]] += np.maximum(self.value[top] - duals[top], 0.0)
        return multipliers

    def multipliers_of_limits(self, duals: FloatArray) -> FloatArray:
        """Lambda from the limits a <= 1: their duals add up to it."""
        return self.floor + np.bincount(self.row, weights=duals, minlength=len(self.floor))
