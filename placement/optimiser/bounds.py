"""Second rung: the Lagrangian bound of all sets of so many units, polished by OSQP.

Any frame or tail of each window may be *asked for*: a set avoids a run only if one of
its poses sees what one of the run's windows is asked for. That makes the problem a
maximal covering problem of no lower value, in which a pose *covers* a run. Prices p >=
0 on runs bound all its sets,

    f(S) <= sum over r of max(0, w[r] - p[r]) + max over S of sum over c in S of sum of
    p[r] over r
            that c covers,

(Cornuejols, Fisher, Nemhauser 1977), and the second part separates by poses. Money has
a price, too: with mu, poses are worth mu times their price less, and the budget is
worth mu times itself. OSQP's multipliers are prices; whatever it returns proves nothing
by itself: the formula does.

Margins are rows, too: to see a window or one before it is worth by how much its margin
exceeds the next one's. What is left when N of K units fail is no more than what is left
on average, and of the ways to fail the share C(K - n, N - n) / C(K, N) takes all n
poses that cover a run: a concave reward G(n) takes the place of G(1) = 1, and the same
prices bound it.
"""

from dataclasses import dataclass, replace
from importlib.metadata import version
from math import comb
from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.phrases import Phrase

from . import constants
from .allowed_sets import Choice, build_choice
from .bitsets import union_apr, unions_of
from .constants import NEVER, Deadline, share_out
from .greedy import forced_units
from .presolve import ReducedProblem, distinct_rows, transposed, unpack_words
from .problem import Objective, WordArray


class Rows(NamedTuple):
    """Rows of the covering problem: a window is seen among the first of a chain.

    Attributes
    ----------
    chain : (n_rows,) int
        Chain of each row.
    last : (n_rows,) int
        How many of its first windows count.
    weight : (n_rows,) float
        Worth of the row.
    """

    chain: IntArray
    last: IntArray
    weight: FloatArray

    def of(self, some: IntArray | BoolArray | slice) -> "Rows":
        """Some of the rows."""
        return Rows(self.chain[some], self.last[some], self.weight[some])


def run_rows(reduced: ReducedProblem) -> Rows:
    """A row for each run, with its weight."""
    return Rows(reduced.run_chain, reduced.last, reduced.weight)


def margin_rows(reduced: ReducedProblem) -> Rows:
    """Rows whose covered sum is that of weights times margins.

    There is a row for each window in time: it is worth what its margin exceeds the
    next one's by, times the run's weight.
    """
    margin = np.where(reduced.margin_s > -np.inf, reduced.margin_s, 0.0)
    step = np.maximum(margin[:, :-1] - margin[:, 1:], 0.0) * reduced.weight[:, None]
    run, link = np.nonzero(step)
    return Rows(reduced.run_chain[run], link + 1, step[run, link])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Root:
    """A covering problem of no lower value than the windows', and prices on its rows.

    Attributes
    ----------
    covers : (n_poses, n_row_words) uint64
        Rows that each pose covers.
    weight : (n_rows,) float
        Weight of each row; rows that the same poses cover are one.
    price : (n_rows,) float
        Lagrangian prices.
    reached : float
        What VUT and forced poses are worth, in none of the rows.
    limit : float
        No set is worth more.
    share : (n_poses,) float
        How often each pose was picked of late: near a relaxed solution.
    choice : Choice
        Poses that may be chosen, and how many.
    """

    covers: WordArray
    weight: FloatArray
    price: FloatArray
    reached: float
    limit: float
    share: FloatArray
    choice: Choice

    def gains(self, price: FloatArray | None = None) -> FloatArray:
        """Sum of the prices of what each pose covers, by default own, (n_poses,)."""
        if price is None:
            price = self.price
        covered_bytes = self.covers.view(np.uint8)
        gain = np.zeros(len(self.covers))
        for place, worth in enumerate(byte_table(price, self.covers)):
            gain += worth[covered_bytes[:, place]]
        return gain


def byte_table(weight: FloatArray, rows: WordArray) -> FloatArray:
    """Worth of each value of each byte of bits along rows, (n_bytes, 256).

    :func:`placement.optimiser.walk_kernels.weigh_bytes` finds it for some of the rows.
    """
    n_bytes = 8 * rows.shape[1]
    of_bit = np.zeros((n_bytes, 8))
    of_bit.flat[: len(weight)] = weight
    table = np.zeros((n_bytes, 256))
    # Values that have this bit as their highest are those before them, and the bit.
    for bit in range(8):
        n_before = 1 << bit
        before = table[:, :n_before]
        table[:, n_before : 2 * n_before] = before + of_bit[:, bit, None]
    return table


def find_root(
    reduced: ReducedProblem, rows: Rows, *, n_units: int, deadline: Deadline = NEVER
) -> Root:
    """Ask for the frames, window by window, that bound sets of so many units best.

    Windows are asked for what the poses picked so far see least, again and again,
    and the best round is taken.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    rows : Rows
        What is covered: runs, or margins.
    n_units : int
        Units of a set, the forced ones among them.
    deadline : Deadline
        When it is over, no other round begins; the first one is completed.
    """
    choice = build_choice(reduced.limits, n_units)
    union = unions_of(reduced, forced_units(reduced)[None, :])[0]
    is_alone = is_covered_by(reduced, union, rows)
    reached = float(rows.weight[is_alone].sum())
    rows = rows.of(~is_alone)
    # To begin with, the frames that fewest poses see; what is picked counts far more.
    n_seeing = np.bitwise_count(reduced.columns).sum(axis=1)
    seen = n_seeing / (1.0e3 * max(reduced.n_poses, 1))
    price = constants.PRICE_START * rows.weight
    best: Root | None = None
    for number in range(constants.ASK_ROUNDS):
        # What each row's windows are asked for now, and who covers the row then. Rows
        # that the same poses cover are one.
        scale = max(float(seen.max(initial=0.0)), constants.TINY)
        rounded = np.round(seen / scale, constants.SHARE_DIGITS)
        coverers = coverers_of(reduced, rows, union, rounded)
        index, row = distinct_rows(coverers)
        of_rows = np.zeros(len(index))
        of_price = np.zeros(len(index))
        np.add.at(of_rows, row, rows.weight)
        np.add.at(of_price, row, price)
        covers = transposed(coverers[index], reduced.n_poses, workers=reduced.workers)
        root = Root(
            covers=covers,
            weight=of_rows,
            price=of_price,
            reached=reached,
            limit=np.inf,
            share=np.zeros(reduced.n_poses),
            choice=choice,
        )
        steps = constants.FIRST_STEPS
        if number:
            steps = constants.LATER_STEPS
        root = tightened(root, reward_of(choice.n_units, 0), n_steps=steps)
        is_settled = False
        if best is not None:
            is_settled = root.limit > best.limit * (1.0 - constants.SETTLED)
        if best is None or root.limit < best.limit:
            best = root
        if (is_settled and number > 2) or deadline.is_over:
            break
        # The next round begins with the prices of this one, and asks for frames that
        # the poses picked so far see least.
        total = np.maximum(root.weight[row], constants.TINY)
        price = root.price[row] * (rows.weight / total)
        used = np.flatnonzero(root.share > constants.SMALL_SHARE)
        of_used = unpack_words(reduced.words[used], reduced.n_frames)
        seen = seen + np.minimum(root.share[used] @ of_used, 1.0)
    assert best is not None
    return best


def coverers_of(
    reduced: ReducedProblem,
    rows: Rows,
    union: WordArray,
    seen: FloatArray,
    *,
    columns: WordArray | None = None,
) -> WordArray:
    """Poses that cover each row next to a union of frames, (n_rows, n_pose_words).

    Parameters
    ----------
    reduced : ReducedProblem
        Windows and poses.
    rows : Rows
        The rows.
    union : (n_words,) uint64
        Frames that are seen already: they are not asked for.
    seen : (n_frames,) float
        How much each frame is seen. Of the frames and tails that are missing, each
        window is asked for the one that is seen least.
    columns : (n_frames, n_words) uint64, optional
        Bits along other units than the poses.
    """
    from .walk_kernels import ask_for_least_seen, cover_rows

    chains = reduced.chains
    asked = np.empty(len(chains.window), dtype=np.int64)
    ask_for_least_seen(chains, np.unique(rows.chain), union, seen, asked)
    workers = 1
    if columns is None:
        columns = reduced.columns
        workers = reduced.workers
    coverers = np.empty((len(rows.chain), columns.shape[1]), dtype=np.uint64)

    def cover(begin: int, end: int) -> None:
        cover_rows(
            columns, chains.start, asked, rows.chain, rows.last, begin, end, coverers
        )

    share_out(cover, len(rows.chain), workers=workers)
    return coverers


def is_covered_by(reduced: ReducedProblem, union: WordArray, rows: Rows) -> BoolArray:
    """Rows of which a union of frames sees a live window, (n_rows,)."""
    from .bit_kernels import first_live_windows

    first = np.empty((1, reduced.n_chains), dtype=np.int64)
    first_live_windows(union[None, :], reduced.chains, first)
    return np.asarray(first[0][rows.chain] < rows.last)


def reward_of(n_units: int, n_failures: int) -> FloatArray:
    """Mean worth of a row by the number of units that cover it, (n_units + 2,).

    Of the ways in which units fail, it is the share that leaves one of those that
    cover: 1 - C(K - n, N - n) / C(K, N) where n of K units cover it and N fail.
    """
    reward: FloatArray = np.minimum(np.arange(n_units + 2.0), 1.0)
    if n_failures > n_units:
        return reward
    n_ways = comb(n_units, n_failures)
    for n_covering in range(1, n_failures + 1):
        n_lost = comb(n_units - n_covering, n_failures - n_covering)
        reward[n_covering] -= n_lost / n_ways
    return reward


def tightened(root: Root, reward: FloatArray, *, n_steps: int) -> Root:
    """Better prices for a root by subgradient steps.

    Without steps, its prices stay, and the limit is what they prove.
    """
    from .walk_kernels import tighten_prices

    choice = root.choice
    price = root.price.copy()
    share = np.zeros(len(root.covers))
    by_byte = np.ascontiguousarray(root.covers.view(np.uint8).T)
    how = np.array(
        [
            constants.STEP_LENGTH,
            constants.STEP_CUT,
            constants.DEFLECTION,
            constants.MEMORY,
            constants.PATIENCE,
        ]
    )
    limit = tighten_prices(
        by_byte, choice, root.weight, reward, price, n_steps, how, share
    )
    # Shares sum up to the units; rounding makes the limit a little larger.
    share *= choice.n_units / max(float(share.sum()), constants.TINY)
    limit = (root.reached + limit) * (1.0 + constants.ROUNDING)
    return replace(root, price=price, limit=limit, share=share)


def failure_limit(
    root: Root, n_failures: int, least: float, *, deadline: Deadline = NEVER
) -> float:
    """Upper bound of what sets worth `least` keep on failure, and are worth without.

    Parameters
    ----------
    root : Root
        Covering problem of the runs.
    n_failures : int
        Units that fail.
    least : float
        Only sets that are worth so much without failures are bounded.
    deadline : Deadline
        No other price is tried behind it.
    """
    limit = root.limit
    if not n_failures:
        return limit
    n_units = root.choice.n_units
    # Prices of the APR of all units, which makes up for what it exceeds `least` by.
    for amount in constants.FAILURE_PRICES:
        if deadline.is_over:
            break
        reward = reward_of(n_units, n_failures) + amount * reward_of(n_units, 0)
        trial = tightened(root, reward, n_steps=constants.FIRST_STEPS)
        limit = min(limit, trial.limit + amount * (root.reached - least))
    return limit


def relax(
    reduced: ReducedProblem, worth: Objective, *, deadline: Deadline = NEVER
) -> tuple[float, FloatArray | None]:
    """Upper bound of all sets within the limits, and shares of poses.

    Wishes are left out, which only makes the bound higher.

    Parameters
    ----------
    reduced : ReducedProblem
        The problem.
    worth : Objective
        ``APR``, or ``MEAN_MARGIN`` for the sum of weights times margins.
    deadline : Deadline
        See :func:`find_root`.

    Returns
    -------
    limit : float
        No set is worth more; infinite where the problem is too large.
    share : (n_poses,) float, optional
        Shares of poses near a relaxed solution; None where there are none.
    """
    n_units = reduced.limits.max_units
    if not len(reduced.weight) or n_units < 1:
        return 0.0, None
    if worth is Objective.APR:
        rows = run_rows(reduced)
    else:
        rows = margin_rows(reduced)
    if len(rows.chain) * reduced.n_poses > constants.MAX_CELLS:
        return np.inf, None
    root = polished(find_root(reduced, rows, n_units=n_units, deadline=deadline))
    limit = root.limit
    if worth is Objective.APR:
        # All poses together are a limit, too.
        everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
        of_all = float(union_apr(reduced, everything)[0])
        limit = min(rounded_down(reduced, limit), of_all)
    return limit, root.share


def rounded_down(reduced: ReducedProblem, limit: float) -> float:
    """Upper bound of the APR, rounded down to a value that a set can have.

    Where all weights are multiples of one step, so are all values.
    """
    step = reduced.measure.step
    if step:
        limit = float(np.floor(limit / step + constants.SOLVER_TOLERANCE)) * step
    return min(limit, reduced.measure.limit)


def relaxation_text() -> Phrase:
    """Name and version of the relaxation, for a certificate."""
    return Phrase("Lagrangian relaxation with OSQP {osqp}", osqp=version("osqp"))


def polished(root: Root) -> Root:
    """Prices near those of the linear relaxation; the limit never rises.

    OSQP is handed a core of poses that gain most. Of the way to its prices the best
    point is taken; poses that gain too much at its end join the core.
    """
    n_units = root.choice.n_units
    best = root
    share = root.share
    if not len(root.weight) or n_units < 1:
        return root
    reward = reward_of(n_units, 0)
    n_bits = np.bitwise_count(root.covers).sum(axis=1)
    n_by_bits = int(constants.CORE_BITS / max(float(n_bits.mean()), 1.0))
    n_core = min(constants.CORE_POSES, n_by_bits)
    of_share = np.flatnonzero(share > constants.SMALL_SHARE)
    core = np.union1d(_worthiest(root.gains(), n_core), of_share)
    for _ in range(constants.POLISH_ROUNDS):
        price, of_core = _relaxed(best, core, share[core])
        share = np.zeros(len(root.covers))
        share[core] = of_core
        # The best point between the old prices and OSQP's.
        before = best
        for way in constants.POLISH_WAY:
            between = (1.0 - way) * before.price + way * price
            trial = tightened(replace(best, price=between), reward, n_steps=0)
            if trial.limit < best.limit:
                best = replace(trial, share=share)
        if best.limit > before.limit * (1.0 - constants.SETTLED):
            break
        # Poses that gain too much, by either prices, join the core.
        for of_root in (best.price, price):
            core = np.union1d(core, _worthiest(root.gains(of_root), n_core // 4))
    return best


def _worthiest(gain: FloatArray, n_poses: int) -> IntArray:
    """The poses that gain most, ascending, (n_poses,)."""
    return np.sort(np.argsort(-gain, kind="stable")[:n_poses])


def _relaxed(
    root: Root, core: IntArray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Multipliers of rows and shares of poses in the relaxation on some poses.

    Maximise sum of w a - epsilon / 2 sum of x ** 2 such that a[r] <= sum of x over
    poses that cover r, sum of x <= K, per site <= room, money <= what is left,
    0 <= a, x <= 1.

    Parameters
    ----------
    root : Root
        The covering problem, with prices to begin with.
    core : (n_core,) int
        Poses that are looked at.
    share : (n_core,) float
        Shares to begin with.

    Returns
    -------
    price : (n_rows,) float
        OSQP's multipliers, from 0 to the weight.
    shares : (n_core,) float
        x, from 0 to 1.
    """
    import osqp
    from scipy import sparse

    choice = root.choice
    n_rows = len(root.weight)
    n_core = len(core)
    scale = 1.0 / float(root.weight.max())
    bits = unpack_words(root.covers[core], n_rows)
    covers = sparse.csc_matrix(bits.T.astype(np.float64))
    # Rows of the limits on x: number of units, room at each site, money.
    sites, site = np.unique(choice.site[core], return_inverse=True)
    at_site = np.arange(len(sites))[:, None] == site
    of_choice = [np.ones((1, n_core)), at_site.astype(np.float64)]
    upper = [[choice.n_units], choice.room[sites]]
    if len(choice.cost):
        of_choice.append(choice.cost[core][None, :])
        upper.append([1.0])
    choices = sparse.csc_matrix(np.concatenate(of_choice))
    # The variables are x, then a: what covers each row, the limits, and the bounds.
    no_rows = sparse.csc_matrix((choices.shape[0], n_rows))
    matrix = sparse.vstack(
        [
            sparse.hstack([-covers, sparse.eye(n_rows)]),
            sparse.hstack([choices, no_rows]),
            sparse.eye(n_core + n_rows),
        ],
        "csc",
    )
    is_open = choice.is_open[core].astype(np.float64)
    most = np.concatenate([np.zeros(n_rows), *upper, is_open, np.ones(n_rows)])
    least = np.full(len(most), -np.inf)
    least[-(n_core + n_rows) :] = 0.0
    quadratic = np.concatenate(
        [np.full(n_core, constants.OSQP_REGULARISATION), np.zeros(n_rows)]
    )
    solver = osqp.OSQP()
    solver.setup(
        sparse.diags(quadratic, format="csc"),
        np.concatenate([np.zeros(n_core), -scale * root.weight]),
        matrix,
        least,
        most,
        verbose=False,
        eps_abs=constants.OSQP_TOLERANCE,
        eps_rel=constants.OSQP_TOLERANCE,
        rho=constants.OSQP_PENALTY,
        alpha=constants.OSQP_OVERRELAXATION,
        max_iter=constants.POLISH_STEPS,
    )
    # It begins at the root's prices, and what the shares cover by them.
    duals = np.zeros(len(most))
    duals[:n_rows] = scale * root.price
    reached = np.minimum(np.asarray(covers @ share), 1.0)
    solver.warm_start(x=np.concatenate([share, reached]), y=duals)
    result = solver.solve(raise_error=False)
    price = np.nan_to_num(np.asarray(result.y))[:n_rows] / scale
    shares = np.clip(np.nan_to_num(np.asarray(result.x)[:n_core]), 0.0, 1.0)
    return np.clip(price, 0.0, root.weight), shares
