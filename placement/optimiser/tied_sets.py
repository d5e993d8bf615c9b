"""Good sets by exchanges, and all sets that are as good as the best in the first stages.

The stages after the APR choose among sets that tie. Where the walk through all sets
(:mod:`placement.optimiser.cover_tree`) meets few of them, they are all valued, and every later
stage is proven at once. Where they are many, the APR that is left when units fail is asked for in
the walk, too; few sets are best in both.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.clock import now_s

from .bitsets import BestSet, SetValues, set_values
from .cover_tree import SetWalk
from .failures import least_left, least_left_with_each
from .limits import Limits, fitting, is_allowed
from .pair_walk import MAX_UNITS, PairWalk
from .presolve import ReducedProblem
from .problem import Measure
from .set_tree import (
    Links,
    Root,
    Rows,
    avoided_runs,
    build_links,
    build_rows,
    find_root,
    first_seen,
    link_bytes,
    weigh,
)
from .threads import share_out
from .tolerances import ROUNDING, SOLVER_TOLERANCE, TINY, TOLERANCE

MAX_WALK_UNITS = 16
_MAX_BYTES = 5 << 28  # of detections by chains
_MAX_TIED = 100_000
_BLOCK_SETS = 1 << 12
_FEW_POSES = 32  # that are looked at one by one
_MAX_PARTNERS = 32  # that are valued in all objectives
_N_RESTARTS = 40
_SEED = 1
_WORLD_ROUNDS = 12
_STEP_UP = 2.0 * TOLERANCE
_AT_ONCE_SHARE = 0.3  # of the time, for a walk by pairs to meet all ties
_NEAR = 0.009  # relative: what is proven at least, before ties are met


def can_walk(reduced: ReducedProblem) -> bool:
    """Whether best sets have as many units as allowed or are parts of such: no wishes or money."""
    limits = reduced.limits
    return (
        limits.budget_eur is None
        and not (limits.is_forced.any() or limits.is_forced_site.any() or len(limits.rivals))
        and not reduced.floors
        and not reduced.objectives[0].is_minimised
        and len(reduced.weight) > 0
        and 2 <= limits.max_units <= min(MAX_WALK_UNITS, reduced.n_poses)
        and link_bytes(reduced) <= _MAX_BYTES
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tied:
    """Sets that tie at the best value of a stage."""

    sets: IntArray | None  # (n, n_units): all of them; None: too many, or not all were looked at
    value: float  # the best that was found
    limit: float  # no set exceeds it
    is_finished: bool  # whether the value is proven


class SetSearch:
    """What it takes to exchange units of sets, and to walk through all sets."""

    def __init__(
        self, reduced: ReducedProblem, *, end_s: float = np.inf, links: Links | None = None
    ) -> None:
        self.reduced, self.end_s = reduced, end_s
        self.links: Links = build_links(reduced) if links is None else links
        self.n_units = reduced.limits.max_units
        self.survive = reduced.survive
        self._rows, self._words_of_world = _rows_by_world(reduced, self.links)
        self._root: Root | None = None
        self._run_weight: FloatArray | None = None
        self._pair_walk: PairWalk | None = None

    def with_limits(self, limits: Limits) -> "SetSearch":
        """The same for sets within other limits, by the same weights of worlds."""
        reduced = replace(self.reduced, limits=limits)
        other = SetSearch(reduced, end_s=self.end_s, links=self.links)
        other._run_weight = self.run_weight
        return other

    # ---------- values

    def shares_with_each(self, units: IntArray, poses: IntArray | None = None) -> FloatArray:
        """APR of a set together with each of some poses, by default of all, (n_poses,)."""
        if poses is not None and len(poses) <= _FEW_POSES:
            return self.shares(np.column_stack([np.tile(units, (len(poses), 1)), poses]))
        measure = self.reduced.measure
        share = measure.of_worlds(self._totals(measure.weight, units))
        return share if poses is None else share[poses]

    def _totals(self, weight: FloatArray, units: IntArray) -> FloatArray:
        """Weight of runs that a set avoids with each pose, by world, (n_poses, n_worlds)."""
        from .frame_kernels import first_live_windows

        reduced, rows = self.reduced, self._rows
        union = np.bitwise_or.reduce(reduced.words[units], axis=0, keepdims=True)
        first = np.empty((1, reduced.n_chains), dtype=np.int64)
        first_live_windows(union, reduced.chains, first)
        alone = avoided_runs(self.links, first)[0]
        open_rows = rows.bits((weight > 0.0) & ~alone)
        avoided = rows.avoided_with(reduced.detections.columns, union[0], open_rows)
        avoided |= rows.bits(alone)
        table = rows.table(weight)
        total = np.empty((reduced.n_poses, len(self._words_of_world)))

        def add(begin: int, end: int) -> None:
            for world, words in enumerate(self._words_of_world):
                of_bytes = table[8 * words.start : 8 * words.stop]
                total[begin:end, world] = weigh(avoided[begin:end, words], of_bytes)

        share_out(add, reduced.n_poses)
        return total

    def left_with_each(self, units: IntArray, n_failures: int, poses: IntArray) -> FloatArray:
        """APR that a set with each of some poses keeps when its worst units fail, (n_poses,)."""
        return least_left_with_each(
            self.reduced.limits,
            units,
            n_failures,
            poses=poses,
            with_each=lambda left: self.shares_with_each(left, poses),
            alone=lambda left: float(self.shares(left[None, :])[0]),
        )

    def shares(self, sets: IntArray, *, left_out: int = -1) -> FloatArray:
        """APR of sets, (n_sets,), without one of their units if that is not negative."""
        share = np.empty(len(sets))
        for start in range(0, len(sets), _BLOCK_SETS):
            part = slice(start, start + _BLOCK_SETS)
            first = first_seen(self.links, sets[part], left_out=left_out)
            share[part] = self.reduced.measure.of(avoided_runs(self.links, first))
        return share

    def left(self, sets: IntArray, n_failures: int) -> FloatArray:
        """APR that sets keep when their worst units fail, (n_sets,)."""
        if n_failures == 1 and self.reduced.limits.failing == "unit" and sets.shape[1]:
            kept = [self.shares(sets, left_out=unit) for unit in range(sets.shape[1])]
            smallest: FloatArray = np.min(kept, axis=0)
            return smallest
        return least_left(self.reduced.limits, sets, n_failures, self.shares)

    # ---------- exchanges

    def fill(self, units: IntArray) -> IntArray:
        """Add the poses that gain most, one by one, while there is room."""
        while len(units) < self.n_units:
            fits = fitting(self.reduced.limits, units)
            if not fits.any():
                break
            share = np.where(fits, self.shares_with_each(units), -np.inf)
            units = np.append(units, share.argmax())
        return units

    def climb(self, units: IntArray, *, end_s: float) -> IntArray:
        """Exchange one unit for another while that makes the set better in any stage."""
        value, idle, place = set_values(self.reduced, units[None, :])[0], 0, 0
        while idle < len(units) and (now_s() < end_s):
            rest = np.delete(units, place % len(units))
            partners = self._best_partners(rest)
            sets = np.column_stack([np.tile(rest, (len(partners), 1)), partners])
            values = set_values(self.reduced, sets)
            idle += 1
            if len(sets):
                row = values.best_row()
                if values[row].exceeds(value):
                    units, value, idle = sets[row], values[row], 0
            place = (place + 1) % len(units)
        return units

    def _spread(self, units: IntArray, *, end_s: float) -> IntArray:
        """Exchange units while the APR and what is left of it after a failure grow together.

        Where many sets have the best APR, the way to those that lose little leads through others.
        """
        value, idle, place = -np.inf, 0, 0
        while idle < len(units) and now_s() < end_s:
            rest = np.delete(units, place)
            fits = np.flatnonzero(fitting(self.reduced.limits, rest))
            share = self.shares_with_each(rest, fits)
            fits, share = fits[2.0 * share > value], share[2.0 * share > value]
            idle += 1
            if len(fits):
                total = share + self.left_with_each(rest, 1, fits)
                best = int(total.argmax())
                if total[best] > value + TOLERANCE:
                    units, value, idle = np.append(rest, fits[best]), total[best], 0
                    place -= 1  # those behind have moved up
            place = (place + 1) % len(units)
        return units

    def _best_partners(self, rest: IntArray) -> IntArray:
        """Poses that make the best sets with others, by the first stages."""
        best = np.flatnonzero(fitting(self.reduced.limits, rest))
        first: list[Callable[[], FloatArray]] = [
            lambda: self.shares_with_each(rest, best),
            lambda: self.left_with_each(rest, 1, best),
        ]
        if self.survive:
            first = [lambda: self.left_with_each(rest, self.survive, best), *first]
        for find in first:
            if len(best) > 1:
                value = find()
                best = best[value >= value.max() - TOLERANCE]
        return best[:_MAX_PARTNERS]

    def look(
        self, starts: Iterable[IntArray], *, limit: SetValues, end_s: float
    ) -> IntArray | None:
        """Best of local optima: of some starts, of the greedy set, of sets near the relaxed one.

        It ends at a set as good as `limit`, which none exceeds, or at `end_s` of
        `geometry.clock`, but completes the first start. None if no set is within the limits.
        """
        rng = np.random.default_rng(_SEED)
        best = BestSet()
        none = np.empty(0, dtype=np.int64)
        begin = [*starts, none]
        chance, idle = self._chance() + ROUNDING, 0
        for number in range(len(begin) + _N_RESTARTS):
            if best.units is not None and (idle > self.n_units or now_s() > end_s):
                break
            if number < len(begin):
                units = begin[number]
            elif number % 2 or best.units is None:
                units = self._drawn(rng, none, chance, self.n_units)
            else:
                n_out = int(rng.integers(1, max(2, self.n_units // 2 + 1)))
                units = self._drawn(rng, rng.permutation(best.units)[n_out:], chance, n_out - 1)
            units = self.fill(units)
            if not is_allowed(self.reduced.limits, units):
                continue
            if best.values is not None and best.values.first >= limit.first - TOLERANCE:
                units = self._spread(units, end_s=end_s)
            units = self.climb(units, end_s=end_s)
            before = best.units
            best.offer(units[None, :], set_values(self.reduced, units[None, :]))
            idle = idle + 1 if best.units is before else 0
            if best.values is not None and not limit.exceeds(best.values):
                break
        return best.units

    def _chance(self) -> FloatArray:
        """How promising poses are, (n_poses,)."""
        if not self.goes_by_pairs:
            return self.root.share
        alone = self.shares_with_each(np.empty(0, dtype=np.int64))
        share: FloatArray = alone**2 / max(float((alone**2).sum()), TINY)
        return share

    def _drawn(
        self, rng: np.random.Generator, units: IntArray, chance: FloatArray, n_more: int
    ) -> IntArray:
        for _ in range(n_more):
            fits = fitting(self.reduced.limits, units)
            if not fits.any():
                break
            weight = np.where(fits, chance, 0.0)
            units = np.append(units, rng.choice(len(weight), p=weight / weight.sum()))
        return units

    # ---------- the walk

    @property
    def root(self) -> Root:
        """Prices on runs for sets of as many units as allowed."""
        if self._root is None:
            self._root = find_root(
                self.links,
                self.reduced.limits,
                self.run_weight,
                n_units=self.n_units,
                end_s=self.end_s,
            )
        return self._root

    @property
    def run_weight(self) -> FloatArray:
        """Weights of runs whose sum bounds the APR of every set, and best of all such weights."""
        if self._run_weight is None:
            measure = self.reduced.measure
            self._run_weight = measure.weight if measure.is_mean else self._worst_weights()
        return self._run_weight

    @property
    def goes_by_pairs(self) -> bool:
        """Whether sets are gone through pair by pair: prices say little of drawn detections."""
        return len(self.reduced.measure.sample_weight) > 1 and self.n_units <= MAX_UNITS

    @property
    def apr_limit(self) -> float:
        """No set has a higher APR."""
        return self._rounded_down(self.root.limit)

    def _worst_weights(self) -> FloatArray:
        """Weights of runs whose sum is no less than the mean over the worst worlds, of any set.

        That mean is the least of all sums in which worlds weigh up to 1 / tail times what they
        weigh. Which sum bounds all sets best is played out: worlds answer all sets so far as well
        as they can, by a linear program, and the best set of their answer joins the others
        (column generation, Gilmore, Gomory 1961).
        """
        measure = self.reduced.measure
        reached: list[FloatArray] = []
        mean = measure.sample_weight
        for _ in range(_WORLD_ROUNDS):
            if now_s() > self.end_s:
                break
            of_runs = measure.weight * (mean / measure.sample_weight)[measure.sample_index]
            units = self._exchanged_by(of_runs, self._greedy_by(of_runs))
            row = measure.by_world(
                avoided_runs(self.links, first_seen(self.links, units[None, :]))
            )[0]
            if any(np.array_equal(row, other) for other in reached):
                break
            reached.append(row)
            mean = _least_favourable(measure, np.array(reached))
        result: FloatArray = measure.weight * (mean / measure.sample_weight)[measure.sample_index]
        return result

    def _exchanged_by(self, weight: FloatArray, units: IntArray) -> IntArray:
        """Exchange one unit for another while the weight of avoided runs grows."""
        value, idle, place = -np.inf, 0, 0
        while idle < len(units) and now_s() < self.end_s:
            rest = np.delete(units, place)
            fits = fitting(self.reduced.limits, rest)
            total = np.where(fits, self._totals(weight, rest).sum(axis=1), -np.inf)
            best, idle = int(total.argmax()), idle + 1
            if total[best] > value + TOLERANCE:
                units, value, idle = np.insert(rest, place, best), float(total[best]), 1
            place = (place + 1) % len(units)
        return units

    def _greedy_by(self, weight: FloatArray) -> IntArray:
        units = np.empty(0, dtype=np.int64)
        for _ in range(self.n_units):
            fits = fitting(self.reduced.limits, units)
            if not fits.any():
                break
            total = self._totals(weight, units).sum(axis=1)
            units = np.append(units, np.where(fits, total, -np.inf).argmax())
        return units

    def _rounded_down(self, limit: float) -> float:
        """A limit of shares; where all runs weigh the same, a whole number of them."""
        measure = self.reduced.measure
        if measure.step:
            limit = float(np.floor(limit / measure.step + SOLVER_TOLERANCE)) * measure.step
        return min(limit, measure.limit)

    def tied(
        self,
        units: IntArray,
        *,
        n_failures: int,
        least_apr: float | None,
        end_s: float,
        on_better: Callable[[IntArray], IntArray],
    ) -> Tied:
        """All sets as good as the best, by the APR when units fail, 0 for none.

        `units` is the best set so far; `least_apr` is what the whole set must reach, by default
        what must be left. `on_better` takes better sets and returns what they were improved to.
        The walk ends at `end_s` of `geometry.clock`.
        """
        weight = self.run_weight

        def value_of(sets: IntArray) -> FloatArray:
            return self.left(sets, n_failures) if n_failures else self.shares(sets)

        def walk_from(value: float) -> SetWalk | PairWalk:
            if self.goes_by_pairs and not n_failures:
                return self._pairs_from(value)
            return SetWalk(
                self.links,
                self.reduced.limits,
                weight,
                self.root,
                n_units=self.n_units,
                need=value if least_apr is None else least_apr,
                n_failures=n_failures,
                left=value,
                end_s=end_s,
            )

        def within(block: IntArray) -> IntArray:
            if least_apr is None or not len(block):
                return block
            return block[self.shares(block) >= least_apr - TOLERANCE]

        best = float(value_of(np.sort(units)[None, :])[0])
        # It takes much less to prove that nothing is better by a step, where values are so far
        # apart, or that little more would be left when units fail, than to meet all ties.
        # And of drawn detections, at first all that can be said is a limit a little above.
        step = (1.0 - SOLVER_TOLERANCE) * self.reduced.measure.step
        is_near = n_failures > 0 or self.goes_by_pairs or not self.reduced.measure.is_mean
        ahead = _NEAR * best if is_near else step
        if now_s() > end_s:
            limit = self.reduced.measure.limit
            return Tied(sets=None, value=best, limit=max(limit, best), is_finished=False)
        is_proven = ahead > 0.0 and not is_near
        tied, has_all = [np.empty((0, self.n_units), dtype=np.int64)], True

        def look(walk: SetWalk | PairWalk, end_s: float, ahead: float) -> None:
            """Take better sets, and where nothing more is asked for all that tie."""
            nonlocal best, tied, has_all
            for block in walk.blocks(end_s):
                block = within(block)
                value = value_of(block)
                if len(block) and value.max() > best + TOLERANCE:
                    better = on_better(block[value.argmax()])
                    best = max(float(value.max()), float(value_of(better[None, :])[0]))
                    need = best + ahead
                    walk.raise_needs(need if least_apr is None else least_apr, need)
                    tied, has_all = tied[:1], True
                if has_all:  # a walk by pairs does not meet again what it met for less
                    tied.append(block[value >= best - TOLERANCE])
                    has_all = sum(map(len, tied)) <= _MAX_TIED
                    if not has_all and not ahead:
                        if is_proven:
                            break
                        need = best + max(step, _STEP_UP)
                        walk.raise_needs(need if least_apr is None else least_apr, need)

        walk = walk_from(best + ahead)
        limit = self._rounded_down(walk.root_limit)
        if isinstance(walk, PairWalk):  # often there is time to meet all ties at once
            walk.go_on(best)
            look(walk, now_s() + _AT_ONCE_SHARE * (end_s - now_s()), 0.0)
        if not walk.is_finished and (is_proven or (is_near and limit >= best + ahead)):
            if isinstance(walk, PairWalk):
                walk.go_on(best + ahead)
            look(walk, end_s, ahead)
            if not walk.is_finished:
                limit = max(min(limit, self._left_limit(walk)), best)
                return Tied(sets=None, value=best, limit=limit, is_finished=False)
            limit = min(limit, self._rounded_down(best + ahead)) if is_near else best
            if now_s() > end_s:
                return Tied(sets=None, value=best, limit=limit, is_finished=is_proven)
            walk.is_finished = False
        if not walk.is_finished:
            if isinstance(walk, PairWalk):
                walk.go_on(best if has_all else best + _STEP_UP)
            else:
                walk = walk_from(best)
            look(walk, end_s, 0.0)
        is_proven |= walk.is_finished
        limit = min(limit, self._left_limit(walk))
        sets = np.unique(np.sort(np.concatenate(tied), axis=1), axis=0)
        return Tied(
            sets=sets if walk.is_finished and has_all else None,
            value=best,
            limit=best if is_proven else max(limit, best),
            is_finished=is_proven,
        )

    def _left_limit(self, walk: SetWalk | PairWalk) -> float:
        """No set that a walk did not meet is worth more, as far as it tells."""
        return self._rounded_down(walk.left_limit if isinstance(walk, PairWalk) else np.inf)

    def _pairs_from(self, need: float) -> PairWalk:
        """A walk pair by pair; what it takes is laid out once."""
        if self._pair_walk is None:
            self._pair_walk = PairWalk(
                self.reduced, self.links, self.run_weight, n_units=self.n_units, need=need
            )
        return self._pair_walk.again(need)

    def best_of(self, sets: IntArray, *, n_failures: int, value: float) -> IntArray | None:
        """Best of tied sets and of their parts that tie with them; None if there is none.

        A part is as good in the first stages only if a whole set is that has room for one more.
        """
        best = BestSet()
        while len(sets) and sets.shape[1] > 0:
            for start in range(0, len(sets), _BLOCK_SETS):
                part = sets[start : start + _BLOCK_SETS]
                best.offer(part, set_values(self.reduced, part))
            smaller = np.concatenate(
                [np.delete(sets, unit, axis=1) for unit in range(sets.shape[1])]
            )
            if not smaller.shape[1]:
                break
            smaller = np.unique(np.sort(smaller, axis=1), axis=0)
            left = self.left(smaller, n_failures) if n_failures else self.shares(smaller)
            sets = smaller[left >= value - TOLERANCE]
        return best.units


def _least_favourable(measure: Measure, reached: FloatArray) -> FloatArray:
    """Weights of worlds, (n_worlds,), that make the best of some sets worth the least.

    `reached`, (n_sets, n_worlds), is the weight of what each avoids by world. Worlds weigh up to
    1 / tail times what they weigh.
    """
    from scipy.optimize import linprog

    n_sets, n_worlds = reached.shape
    answer = linprog(
        np.append(np.zeros(n_worlds), 1.0),  # the best set's worth
        A_ub=np.column_stack([reached / measure.sample_weight, -np.ones(n_sets)]),
        b_ub=np.zeros(n_sets),
        A_eq=np.append(np.ones(n_worlds), 0.0)[None, :],
        b_eq=[1.0],
        bounds=[*((0.0, weight / measure.tail) for weight in measure.sample_weight), (None, None)],
    )
    if answer.x is None:
        return measure.sample_weight
    most = measure.sample_weight / measure.tail
    weight = np.clip(answer.x[:-1], 0.0, most)
    # Whatever the solver rounds, they sum to 1, and none is too large: the bound holds.
    room = most - weight
    short = 1.0 - weight.sum()
    weight = weight + short * room / room.sum() if short > 0.0 else weight / weight.sum()
    result: FloatArray = weight
    return result


def _rows_by_world(reduced: ReducedProblem, links: Links) -> tuple[Rows, list[slice]]:
    """Runs as bits, world after world, each from a new word on, and the words of each.

    Where the APR is a mean, all of them are one.
    """
    measure = reduced.measure
    of_run = np.zeros_like(measure.sample_index) if measure.is_mean else measure.sample_index
    parts, words, begin = [], [], 0
    for world in range(1 if measure.is_mean else len(measure.sample_weight)):
        runs = np.flatnonzero(of_run == world)
        n_words = -(-len(runs) // 64)
        parts.append(np.append(runs, np.full(64 * n_words - len(runs), -1)))
        words.append(slice(begin, begin + n_words))
        begin += n_words
    return build_rows(links, np.concatenate(parts)), words
