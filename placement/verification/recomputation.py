"""Recompute the worth of sets of poses from a saved problem, without the optimiser's code.

Shared with :mod:`placement.optimiser` are only the problem as it lies in a file and the
names of the objectives. Frames are gone through one after the other; there is no
presolve, no window and no model. To be read against ``docs/method.md``.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray

from ..layout import Stage
from ..optimiser.problem import Objective

if TYPE_CHECKING:
    from ..optimiser import Floor, PlacementProblem


# ---------- values
# shares and times that differ by no more are equal: they carry rounding noise
EPSILON = 1.0e-9
EPSILON_EUR = 1.0e-6  # so are sums of prices

_BLOCK_BYTES = 1 << 22


def stage_names(problem: "PlacementProblem") -> tuple[Objective, ...]:
    """Objectives of a problem in order: those of a goal or of failures first, then the five."""
    order = [Objective.APR, Objective.APR_ONE_FAILED]
    order += [Objective.SMALLEST_MARGIN, Objective.MEAN_MARGIN]
    if problem.survive:
        order.insert(0, Objective.APR_SURVIVED)
    if problem.goal == "fewest":
        order.insert(0, Objective.UNITS)
    order.insert(0 if problem.goal == "cheapest" else len(order), Objective.COST)
    return tuple(order)


def stage_values(
    problem: "PlacementProblem", objective: Objective, sets: IntArray
) -> FloatArray:
    """Values of sets of poses in a stage: (n_sets, n_units) distinct rows -> (n_sets,)."""
    if objective is Objective.UNITS:
        return np.full(len(sets), float(sets.shape[1]))
    if objective is Objective.COST:
        return costs_eur(problem, sets)
    values: dict[Objective, Callable[[IntArray], FloatArray]] = {
        Objective.APR_SURVIVED: lambda block: _left(problem, block, problem.survive),
        Objective.APR_ONE_FAILED: lambda block: _left(problem, block, 1),
        Objective.APR: lambda block: _apr(problem, margins_s(problem, block)),
        Objective.SMALLEST_MARGIN: lambda block: _smallest_s(
            problem, margins_s(problem, block)
        ),
        Objective.MEAN_MARGIN: lambda block: _mean_s(
            problem, margins_s(problem, block)
        ),
    }
    return _of_blocks(problem, sets, values[objective])


def margins_s(problem: "PlacementProblem", sets: IntArray) -> FloatArray:
    """Margins of all runs for sets of poses: (n_sets, n_units) -> (n_sets, n_runs).

    That is last brake time - (confirmation + latency); minus infinity where that is too
    late or there is no confirmation. The VUT, if it sees, is one unit more, also where
    there is no other.
    """
    packed = problem.table.packed
    n_units = sets.shape[1]
    if problem.seen_by_vut is not None:
        vut = np.packbits(problem.seen_by_vut, bitorder="little")[None, :]
        packed = np.concatenate([packed, vut])
        n_units = n_units + 1
        sets = np.column_stack([sets, np.full(len(sets), len(packed) - 1)])
    if n_units == 0:
        return np.full((len(sets), problem.table.axis.n_runs), -np.inf)
    if problem.fusion == "single":  # each for itself: the first to confirm counts
        poses, where = np.unique(sets, return_inverse=True)
        alone = _margins_of_bits(problem, packed[poses])
        return np.asarray(alone[where.reshape(sets.shape)].max(axis=1))
    bits = packed[sets[:, 0]].copy()
    for unit in range(1, n_units):
        bits |= packed[sets[:, unit]]
    return _margins_of_bits(problem, bits)


def margins_of_all_s(problem: "PlacementProblem", poses: IntArray) -> FloatArray:
    """Margins if all of some poses were mounted at once, whatever the limits, (n_runs,)."""
    if problem.fusion == "any":
        return np.asarray(margins_s(problem, poses[None, :])[0])
    everything = np.full(problem.table.axis.n_runs, -np.inf)
    for block in _blocks(problem, poses[:, None]):
        everything = np.maximum(everything, margins_s(problem, block).max(axis=0))
    return everything


def costs_eur(problem: "PlacementProblem", sets: IntArray) -> FloatArray:
    """Price of sets: each unit, and each site once, in euros: (n_sets, n_units) -> (n_sets,)."""
    limits = problem.limits
    total = np.zeros(len(sets))
    for unit in range(sets.shape[1]):
        pose = sets[:, unit]
        total += limits.unit_cost_eur[pose]
        site = limits.site_index[pose]
        is_paid = np.zeros(len(sets), dtype=bool)
        for earlier in range(unit):
            is_paid |= limits.site_index[sets[:, earlier]] == site
        total += np.where(is_paid, 0.0, limits.site_cost_eur[site])
    return total


def limit_checks(problem: "PlacementProblem", sets: IntArray) -> dict[str, BoolArray]:
    """Which sets are within each limit, (n_sets,) by the name of the limit."""
    limits = problem.limits
    n_units = sets.shape[1]
    sites = limits.site_index[sets]
    everyone = np.ones(len(sets), dtype=bool)
    if limits.budget_units is None:
        most = np.inf
    else:
        most = limits.budget_units
    checks = {"units": everyone & (1 <= n_units <= most)}
    if limits.budget_eur is not None:
        checks["money"] = costs_eur(problem, sets) <= limits.budget_eur + EPSILON_EUR
    checks["site capacity"] = everyone.copy()
    for unit in range(n_units):
        beside: IntArray = (sites == sites[:, unit : unit + 1]).sum(axis=1)
        checks["site capacity"] &= beside <= limits.site_capacity[sites[:, unit]]
    for name, present, flags in (
        ("forced units", sets, limits.is_forced),
        ("forced sites", sites, limits.is_forced_site),
    ):
        if flags.any():
            checks[name] = everyone.copy()
            for each in np.flatnonzero(flags):
                checks[name] &= (present == each).any(axis=1)
    if limits.is_forbidden.any():
        checks["forbidden units"] = ~limits.is_forbidden[sets].any(axis=1)
    if len(limits.rivals):
        checks["rival sites"] = everyone.copy()
        for one, other in limits.rivals:
            both = (sites == one).any(axis=1) & (sites == other).any(axis=1)
            checks["rival sites"] &= ~both
    return checks


def floor_values(
    problem: "PlacementProblem", floor: "Floor", sets: IntArray
) -> FloatArray:
    """Share of a floor that sets reach after the failures that it allows for, (n_sets,)."""
    return _of_blocks(
        problem, sets, lambda block: _left(problem, block, floor.n_failures, floor)
    )


def _left(
    problem: "PlacementProblem",
    sets: IntArray,
    n_failures: int,
    floor: "Floor | None" = None,
) -> FloatArray:
    """Smallest ratio that is left when any so many units, or whole sites, fail, (n_sets,).

    Failing more never leaves more: the sites of any so many units are all that need be
    tried.
    """
    if n_failures > sets.shape[1]:
        return _apr(problem, margins_s(problem, sets[:, :0]), floor)
    if problem.limits.failing == "site":
        at = problem.limits.site_index[sets]
    else:
        at = sets
    smallest = np.full(len(sets), np.inf)
    for chosen in combinations(range(sets.shape[1]), n_failures):
        has_failed = (at[:, :, None] == at[:, None, list(chosen)]).any(axis=2)
        patterns, which = np.unique(has_failed, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = which.ravel() == number
            left = _apr(problem, margins_s(problem, sets[rows][:, ~pattern]), floor)
            smallest[rows] = np.minimum(smallest[rows], left)
    return smallest


def _apr(
    problem: "PlacementProblem", margin_s: FloatArray, floor: "Floor | None" = None
) -> FloatArray:
    """Weight of the avoided runs; of a floor's own runs, or of the worst worlds on average."""
    is_avoided: BoolArray = margin_s > -np.inf
    weight = problem.table.axis.weight
    if floor is not None and floor.is_counted is not None:
        counted = np.where(floor.is_counted, weight, 0.0)
        return np.asarray((is_avoided * (counted / counted.sum())).sum(axis=1))
    if problem.tail == 1.0:
        return np.asarray((is_avoided * weight).sum(axis=1))
    # Rockafellar and Uryasev (2000): the mean of the worst share `tail` of the worlds
    # is the largest t - E[(t - ratio)+] / tail over all t, and a world's own ratio is
    # such a t.
    world = np.zeros(len(weight), np.int64)
    if problem.sample_index is not None:
        world = problem.sample_index
    n_worlds = int(world.max()) + 1
    chance = np.array([weight[world == index].sum() for index in range(n_worlds)])
    chance = chance / chance.sum()
    ratio = np.stack(
        [
            (is_avoided * weight)[:, world == index].sum(axis=1)
            for index in range(n_worlds)
        ],
        axis=1,
    )
    ratio = ratio / chance
    best = np.full(len(margin_s), -np.inf)
    for index in range(n_worlds):
        threshold = ratio[:, index]
        shortfall = np.maximum(threshold[:, None] - ratio, 0.0) @ chance
        best = np.maximum(best, threshold - shortfall / problem.tail)
    return best


def _smallest_s(problem: "PlacementProblem", margin_s: FloatArray) -> FloatArray:
    """Smallest margin of the avoided runs that have weight; 0 where there is none, (n_sets,)."""
    counts = (margin_s > -np.inf) & (problem.table.axis.weight > 0.0)
    smallest = np.where(counts, margin_s, np.inf).min(axis=1)
    return np.where(counts.any(axis=1), smallest, 0.0)


def _mean_s(problem: "PlacementProblem", margin_s: FloatArray) -> FloatArray:
    """Mean margin of the avoided runs by their weights; 0 where there is none, (n_sets,)."""
    counts = np.where(margin_s > -np.inf, problem.table.axis.weight, 0.0)
    total = counts.sum(axis=1)
    summed = (counts * np.where(counts > 0.0, margin_s, 0.0)).sum(axis=1)
    return np.where(total > 0.0, summed / np.where(total > 0.0, total, 1.0), 0.0)


def _margins_of_bits(
    problem: "PlacementProblem", bits: NDArray[np.uint8]
) -> FloatArray:
    """Margins if the frames with set bits are seen: (n, n_bytes) -> (n, n_runs).

    A track is born with the last of n frames in a row, and dies when it is not seen for
    longer than its memory, be it by the next frame that is seen or by the last moment.
    """
    axis = problem.table.axis
    rule = problem.rule
    moment_s = axis.last_brake_time_s - rule.latency_s
    run_of_frame = np.repeat(np.arange(axis.n_runs), np.diff(axis.run_start))
    is_in_time = (
        axis.time_s <= moment_s[run_of_frame] + EPSILON
    )  # times of a run ascend
    length = np.bincount(run_of_frame[is_in_time], minlength=axis.n_runs)
    order = np.argsort(
        -length, kind="stable"
    )  # runs that have a frame come before all others
    start = axis.run_start[order]
    last_s = axis.last_brake_time_s[order]
    moment_s = moment_s[order]
    margin_s = np.full((len(bits), axis.n_runs), -np.inf)
    in_a_row = np.zeros((len(bits), axis.n_runs), dtype=np.int32)
    seen_s = np.full((len(bits), axis.n_runs), -np.inf)  # when last
    for position in range(int(length.max())):
        runs = slice(int(np.count_nonzero(length > position)))
        frame = start[runs] + position
        time_s = axis.time_s[frame]
        is_seen = (bits[:, frame // 8] & (1 << frame % 8).astype(np.uint8)) > 0
        in_a_row[:, runs] = (in_a_row[:, runs] + 1) * is_seen
        is_late = time_s - seen_s[:, runs] > rule.track_memory_s + EPSILON
        alive_s = np.where(is_late & is_seen, -np.inf, margin_s[:, runs])
        left_s = last_s[runs] - (time_s + rule.latency_s)
        # The first confirmation of a track leaves the most time.
        confirms = in_a_row[:, runs] >= rule.n_confirmations
        margin_s[:, runs] = np.maximum(alive_s, np.where(confirms, left_s, -np.inf))
        seen_s[:, runs] = np.where(is_seen, time_s, seen_s[:, runs])
    margin_s[seen_s < moment_s - rule.track_memory_s - EPSILON] = -np.inf
    return margin_s[:, np.argsort(order)]


def _blocks(problem: "PlacementProblem", sets: IntArray) -> Iterator[IntArray]:
    """Sets, as many at a time as fit into a moderate piece of memory."""
    axis = problem.table.axis
    per_set = problem.table.packed.shape[1] + 64 * axis.n_runs
    size = max(1, _BLOCK_BYTES // per_set)
    for start in range(0, len(sets), size):
        yield sets[start : start + size]


def _of_blocks(
    problem: "PlacementProblem",
    sets: IntArray,
    values: Callable[[IntArray], FloatArray],
) -> FloatArray:
    if not len(sets):
        return np.zeros(0)
    return np.concatenate([values(block) for block in _blocks(problem, sets)])


# ---------- simple limits
def usable_poses(problem: "PlacementProblem") -> IntArray:
    """Poses that some layout can contain."""
    limits = problem.limits
    has_room = limits.site_capacity[limits.site_index] > 0
    return np.asarray(np.flatnonzero(has_room & ~limits.is_forbidden))


def most_units(problem: "PlacementProblem") -> int:
    """No layout has more units."""
    limits = problem.limits
    usable = usable_poses(problem)
    most = sum(
        min(
            int(limits.site_capacity[site]),
            int((limits.site_index[usable] == site).sum()),
        )
        for site in np.unique(limits.site_index[usable])
    )
    if limits.budget_units is not None:
        most = min(most, limits.budget_units)
    if limits.budget_eur is not None:
        spent = np.cumsum(np.sort(limits.unit_cost_eur[usable]))
        most = min(most, int((spent <= limits.budget_eur + EPSILON_EUR).sum()))
    return most


def simple_limits(
    problem: "PlacementProblem", stages: Sequence[Stage]
) -> dict[Objective, float]:
    """Limit of each objective that no layout exceeds, by a look at all poses at once.

    All usable poses together avoid every run that any layout avoids, with the largest
    margin. If the layout that `stages` claim avoids as much, every layout as good
    avoids the very same runs, so that their margins bound it.
    """
    limits = problem.limits
    weight = problem.table.axis.weight
    usable = usable_poses(problem)
    margin_s = margins_of_all_s(problem, usable)
    counts = (margin_s > -np.inf) & (weight > 0.0)
    most_apr = float(_apr(problem, margin_s[None, :])[0])
    smallest_s = mean_s = (
        float(margin_s[counts].max(initial=-np.inf)) if counts.any() else 0.0
    )
    claimed = {stage.name: stage.objective for stage in stages}
    if (
        counts.any()
        and problem.tail == 1.0
        and claimed.get(Objective.APR, 0.0) >= most_apr - EPSILON
    ):
        smallest_s = float(margin_s[counts].min())
        mean_s = float(np.average(margin_s[counts], weights=weight[counts]))
    most = most_units(problem)
    nobody = np.empty((1, 0), dtype=np.int64)
    of_vut = float(
        _apr(problem, margins_s(problem, nobody))[0]
    )  # when all units have failed
    forced = np.flatnonzero(limits.is_forced)
    price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
    least_eur = float(price[usable].min(initial=np.inf))
    if len(forced):
        least_eur = float(costs_eur(problem, forced[None, :])[0])
    n_open = int(limits.is_forced_site.sum()) - int(
        limits.is_forced_site[np.unique(limits.site_index[forced])].sum()
    )
    return {
        Objective.UNITS: float(max(1, len(forced) + n_open)),
        Objective.COST: least_eur,
        Objective.APR: most_apr,
        Objective.APR_SURVIVED: most_apr if most > problem.survive else of_vut,
        Objective.APR_ONE_FAILED: most_apr if most > 1 else of_vut,
        Objective.SMALLEST_MARGIN: smallest_s,
        Objective.MEAN_MARGIN: mean_s,
    }


# ---------- other sets
class BestOther(NamedTuple):
    """The best of the sets that are as good as the layout in all stages before; NaN if none is."""

    name: Objective
    value: float
    poses: tuple[int, ...]


def n_sets_of_all(problem: "PlacementProblem") -> int:
    """How many sets :func:`all_sets` goes through."""
    n_usable = len(usable_poses(problem))
    return sum(math.comb(n_usable, size) for size in range(1, most_units(problem) + 1))


def all_sets(problem: "PlacementProblem") -> Iterator[IntArray]:
    """All sets of usable poses that are not too large, (n_sets, n_units) for each size."""
    usable = usable_poses(problem)
    for size in range(1, most_units(problem) + 1):
        yield np.array(list(combinations(usable.tolist(), size)), dtype=np.int64)


def neighbours(problem: "PlacementProblem", rows: Sequence[int]) -> Iterator[IntArray]:
    """The layout, and all sets with one unit left out, exchanged or added, size by size."""
    layout = np.array(rows, dtype=np.int64)
    others = np.setdiff1d(usable_poses(problem), layout)
    fewer = [np.delete(layout, index) for index in range(len(layout))]
    if len(layout) > 1:
        yield np.array(fewer)
    exchanged = [_with_each(left, others) for left in fewer]
    yield np.concatenate([layout[None, :], *exchanged])
    yield _with_each(layout, others)


def n_neighbours(problem: "PlacementProblem", rows: Sequence[int]) -> int:
    """How many sets :func:`neighbours` goes through."""
    n_others = len(np.setdiff1d(usable_poses(problem), rows))
    if len(rows) > 1:
        n_fewer = len(rows)
    else:
        n_fewer = 0
    return n_fewer + 1 + (len(rows) + 1) * n_others


def best_others(
    problem: "PlacementProblem", stages: Sequence[Stage], families: Iterator[IntArray]
) -> list[BestOther]:
    """Best value of each claimed stage among families of sets, each (n_sets, n_units).

    Sets that are not allowed, or miss a floor, are left out; so are, from each stage
    on, those that are not as good in it as what is claimed.
    """
    alive = []
    for sets in families:
        kept = sets[np.logical_and.reduce(list(limit_checks(problem, sets).values()))]
        for floor in problem.floors:
            kept = kept[floor_values(problem, floor, kept) >= floor.share - EPSILON]
        alive.append(kept)
    best = []
    for stage in stages:
        objective = Objective(stage.name)
        if objective.is_minimised:
            sign = -1.0
        else:
            sign = 1.0
        found = BestOther(objective, math.nan, ())
        still_alive = []
        for sets in (one for one in alive if len(one)):
            value = stage_values(problem, objective, sets)
            first = int(np.argmax(sign * value))
            if (
                not found.poses
                or objective.excess(float(value[first]), found.value) > 0.0
            ):
                found = BestOther(
                    objective, float(value[first]), tuple(sets[first].tolist())
                )
            is_as_good = sign * value >= sign * stage.objective - objective.tolerance
            still_alive.append(sets[is_as_good])
        best.append(found)
        alive = still_alive
    return best


def _with_each(units: IntArray, others: IntArray) -> IntArray:
    """Some units together with each of other poses in turn, (n_others, n_units + 1)."""
    return np.column_stack([np.tile(units, (len(others), 1)), others])
