"""Machine code of the tree of sets: bounds of a node, and the walk itself.

Everything here works on plain arrays; :mod:`placement.optimiser.set_tree` says what they hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .chain_kernels import Layout, join, lost_with, open_chains
from .presolve import WordArray

ByteArray = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

DONE, PAUSED, FULL = 0, 1, 2
_DEFLECTION = 0.7
_CUT = 0.6
_MEMORY = 0.97  # of the shares
_PATIENCE = 6


class Forest(NamedTuple):
    """What stays the same during a walk."""

    layout: Layout
    worth: FloatArray  # (n_chains, longest + 1): by the first window seen
    chains: IntArray  # (n_chains,): the chains that most sets lose come first
    covers: WordArray  # (n_poses, n_row_words): rows that each pose covers
    weight: FloatArray  # (n_rows,)
    site: IntArray  # (n_poses,)
    # (3, n_units + 2): what a row is worth by the number of units that cover it: for the set, for
    # what is left on average when units fail, and for what is left without one certain unit.
    rewards: FloatArray
    steps: IntArray  # (n_units,): subgradient steps of a node at each depth


class Walk(NamedTuple):
    """Where a walk stands."""

    needs: FloatArray  # (4,): of each reward; and what must be left, exactly, without any one unit
    # (5,): depth, whether its node is new, sets found, candidates looked at; and the candidate of
    # the root before which the walk ends.
    where: IntArray
    chosen: IntArray  # (n_units,)
    union: WordArray  # (n_units + 1, n_words, n_phases or one more)
    n_covering: ByteArray  # (n_units + 1, n_rows): units that cover each row
    price: FloatArray  # (n_units + 1, n_units + 2, n_rows)
    room: IntArray  # (n_units + 1, n_sites)
    candidate: IntArray  # (n_units, n_poses)
    gain: FloatArray  # (n_units, 2, n_poses): of each candidate, for the first two rewards
    fixed: FloatArray  # (n_units, 2)
    n_candidates: IntArray  # (n_units,)
    position: IntArray  # (n_units,)
    group: IntArray  # (n_units,): candidates that are gone through before a node is looked at again
    cover: Float32Array  # (n_rows, n_poses): working space
    gain_now: FloatArray  # (n_poses,): working space


@kernel
def has_bit(words: WordArray, number: int) -> int:
    """One bit of words, 0 or 1."""
    return int((words[number >> 6] >> np.uint64(number & 63)) & np.uint64(1))


@kernel
def price_candidates(cover: Float32Array, n: int, price: FloatArray, gain: FloatArray) -> None:
    """Prices of the rows that each candidate covers, summed."""
    for place in range(n):
        gain[place] = 0.0
    for row in range(len(price)):
        if price[row] > 0.0:
            of_row = cover[row]
            amount = price[row]
            for place in range(n):
                gain[place] += amount * of_row[place]


@kernel
def pick_best(
    gain: FloatArray,
    n: int,
    candidate: IntArray,
    site: IntArray,
    room: IntArray,
    n_units: int,
    picked: IntArray,
) -> tuple[float, int]:
    """Candidates that gain most and have room at their sites: their sum and number."""
    total, n_picked = 0.0, 0
    for _ in range(n_units):
        best, most = -1, 0.0
        for place in range(n):
            if gain[place] > most:
                here = site[candidate[place]]
                left = room[here]
                for earlier in range(n_picked):
                    if picked[earlier] == place:
                        left = 0
                    elif site[candidate[picked[earlier]]] == here:
                        left -= 1
                if left > 0:
                    best, most = place, gain[place]
        if best < 0:
            break
        picked[n_picked] = best
        n_picked += 1
        total += most
    return total, n_picked


@kernel
def row_limit(
    reward: FloatArray, weight: float, count: int, left: int, price: float
) -> tuple[float, int]:
    """Most that a row is worth after paying for each further unit that covers it; how many do."""
    most, units = weight * reward[count], 0
    for more in range(1, left + 1):
        value = weight * reward[count + more] - more * price
        if value > most:
            most, units = value, more
    return most, units


@kernel
def tighten_node(
    cover: Float32Array,
    n: int,
    candidate: IntArray,
    site: IntArray,
    room: IntArray,
    weight: FloatArray,
    reward: FloatArray,
    count: ByteArray,
    left: int,
    price: FloatArray,
    need: float,
    n_steps: int,
    gain: FloatArray,
    share: FloatArray,
) -> tuple[float, float]:
    """Lower a node's bound by subgradient steps on the prices; it ends below the need.

    Returns the bound and what of it the rows hold without any candidate; `price` and `gain` are
    those of the bound, `share` how often each candidate was picked of late, unless it is empty.
    """
    n_rows = len(price)
    best, best_fixed = np.inf, 0.0
    best_price = np.empty(n_rows)
    slope, units = np.zeros(n_rows), np.zeros(n_rows, dtype=np.int64)
    picked = np.empty(max(left, 1), dtype=np.int64)
    length, idle = 0.7, 0
    for step in range(n_steps + 1):
        fixed = 0.0
        for row in range(n_rows):
            most = weight[row] * (reward[count[row] + 1] - reward[count[row]])
            price[row] = min(max(price[row], 0.0), most)
            value, units[row] = row_limit(reward, weight[row], count[row], left, price[row])
            fixed += value
        price_candidates(cover, n, price, gain)
        total, n_picked = pick_best(gain, n, candidate, site, room, left, picked)
        if len(share) > 0:
            for place in range(n):
                share[place] *= _MEMORY
            for number in range(n_picked):
                share[picked[number]] += 1.0 - _MEMORY
        if fixed + total < best * (1.0 - 1.0e-12):
            best, best_fixed, idle = fixed + total, fixed, 0
            for row in range(n_rows):
                best_price[row] = price[row]
        else:
            idle += 1
        if best < need or step == n_steps:
            break
        if idle > _PATIENCE:
            for row in range(n_rows):
                price[row], slope[row] = best_price[row], 0.0
            length, idle = length * _CUT, 0
            continue
        steepness = 0.0
        for row in range(n_rows):
            rise = -float(units[row])
            for number in range(n_picked):
                rise += cover[row, picked[number]]
            slope[row] = rise + _DEFLECTION * slope[row]
            steepness += slope[row] * slope[row]
        if steepness < 1.0e-12:
            break
        move = length * max(fixed + total - need, 1.0e-3 * abs(need)) / steepness
        for row in range(n_rows):
            price[row] -= move * slope[row]
    for row in range(n_rows):
        price[row] = best_price[row]
    price_candidates(cover, n, price, gain)
    return best, best_fixed


@kernel
def fill_cover(covers: WordArray, candidate: IntArray, n: int, cover: Float32Array) -> None:
    """Rows that candidates cover as numbers 0 and 1, (n_rows, n)."""
    for row in range(cover.shape[0]):
        word, bit = row >> 6, np.uint64(row & 63)
        for place in range(n):
            cover[row, place] = np.float32((covers[candidate[place], word] >> bit) & np.uint64(1))


@kernel
def sort_falling(key: FloatArray, other: FloatArray, value: IntArray, n: int) -> None:
    """Sort entries by falling keys, equal ones by rising values (Shell's method)."""
    gap = 1
    while 3 * gap + 1 < n:
        gap = 3 * gap + 1
    while gap > 0:
        for last in range(gap, n):
            k, o, v = key[last], other[last], value[last]
            place = last
            while place >= gap and (
                key[place - gap] < k or (key[place - gap] == k and value[place - gap] > v)
            ):
                key[place] = key[place - gap]
                other[place] = other[place - gap]
                value[place] = value[place - gap]
                place -= gap
            key[place], other[place], value[place] = k, o, v
        gap //= 3


@kernel
def look_at_node(forest: Forest, walk: Walk, n_failures: int) -> bool:
    """Bound the node at hand, drop candidates that cannot help; whether something is left."""
    depth = walk.where[0]
    n_units = len(walk.chosen)
    left = n_units - depth
    candidate, gain = walk.candidate[depth], walk.gain_now
    n = walk.n_candidates[depth]
    n_rows = len(forest.weight)
    count = np.empty(n_rows, dtype=np.uint8)
    for row in range(n_rows):
        count[row] = walk.n_covering[depth, row]
    share = np.empty(0)
    picked = np.empty(left, dtype=np.int64)
    fill_cover(forest.covers, candidate, n, walk.cover)
    is_saturated = False
    n_checks = 1 if n_failures == 0 else 2 + depth
    for check in range(n_checks):
        kind = min(check, 2)
        if check >= 2:  # without one of the units: what covers rows is fewer
            unit = walk.chosen[check - 2]
            for row in range(n_rows):
                count[row] = walk.n_covering[depth, row] - has_bit(forest.covers[unit], row)
        walk.where[3] += n
        bound, fixed = tighten_node(
            walk.cover,
            n,
            candidate,
            forest.site,
            walk.room[depth],
            forest.weight,
            forest.rewards[kind],
            count,
            left,
            walk.price[depth, check],
            walk.needs[kind],
            forest.steps[depth] if check < 2 else forest.steps[depth] // 2,
            gain,
            share,
        )
        if bound < walk.needs[kind]:
            return False
        if check == 0:
            # What is left after failures has prices that tell.
            is_saturated = 2.0 * bound > forest.weight.sum() + walk.needs[0]
        others, _ = pick_best(gain, n, candidate, forest.site, walk.room[depth], left - 1, picked)
        if check < 2:
            walk.fixed[depth, check] = fixed
        n_kept = 0
        for place in range(n):
            if fixed + others + gain[place] >= walk.needs[kind]:
                candidate[n_kept] = candidate[place]
                for earlier in range(min(check, 2)):
                    walk.gain[depth, earlier, n_kept] = walk.gain[depth, earlier, place]
                if check < 2:
                    walk.gain[depth, check, n_kept] = gain[place]
                n_kept += 1
        if n_kept < left:
            return False
        if n_kept < n and check + 1 < n_checks:
            fill_cover(forest.covers, candidate, n_kept, walk.cover)
        n = n_kept
    walk.n_candidates[depth] = n
    walk.position[depth] = 0
    group = n
    if is_saturated:
        group = hardest_row_first(forest, walk, depth)
    sort_falling(walk.gain[depth, 0], walk.gain[depth, 1], candidate, group)
    sort_falling(
        walk.gain[depth, 0, group:], walk.gain[depth, 1, group:], candidate[group:], n - group
    )
    walk.group[depth] = group
    return True


@kernel
def hardest_row_first(forest: Forest, walk: Walk, depth: int) -> int:
    """Put the candidates first that cover the row which fewest cover; how many they are.

    Where all rows can be covered in parts, prices say little. But the row is covered by one of
    these poses, or lost: its loss adds up with others.
    """
    n = walk.n_candidates[depth]
    candidate, gain = walk.candidate[depth], walk.gain[depth]
    hardest, fewest = -1, n
    for row in range(len(forest.weight)):
        if walk.n_covering[depth, row] == 0 and forest.weight[row] > 0.0:
            n_covering = 0
            for place in range(n):
                n_covering += has_bit(forest.covers[candidate[place]], row)
            if 0 < n_covering < fewest:
                hardest, fewest = row, n_covering
    if hardest < 0:
        return int(n)
    group = 0
    for place in range(n):
        if has_bit(forest.covers[candidate[place]], hardest) != 0:
            candidate[group], candidate[place] = candidate[place], candidate[group]
            for check in range(2):
                amount = gain[check, group]
                gain[check, group] = gain[check, place]
                gain[check, place] = amount
            group += 1
    return group


@kernel
def most_beside(gain: FloatArray, place: int, group: int, n: int, n_others: int) -> float:
    """Sum of the largest gains behind a place, in two parts that fall: up to `group`, and on."""
    one, other, total = place + 1, max(group, place + 1), 0.0
    for _ in range(n_others):
        if one < group and (other >= n or gain[one] >= gain[other]):
            total += gain[one]
            one += 1
        elif other < n:
            total += gain[other]
            other += 1
    return total


@kernel
def loses_more(
    forest: Forest,
    pose: int,
    union: WordArray,
    chains: IntArray,
    n: int,
    most: float,
    first: IntArray,
) -> bool:
    """Whether a union and a pose lose more in some chains."""
    layout = forest.layout
    lost = lost_with(
        layout.bits[pose],
        union,
        layout.n_phases,
        layout.start,
        layout.tail_links,
        layout.tail_start,
        forest.worth,
        chains,
        n,
        most,
        first,
    )
    return lost > most


@kernel
def add_last(
    forest: Forest, walk: Walk, n_failures: int, exact_failures: bool, largest: float, out: IntArray
) -> None:
    """Write to `out` the sets of the chosen units and one more that meet the needs."""
    n_units = len(walk.chosen)
    depth = n_units - 2
    place, n, group = walk.position[depth] - 1, walk.n_candidates[depth], walk.group[depth]
    layout, union, gain = forest.layout, walk.union[n_units - 1], walk.gain[depth]
    n_chains = len(forest.chains)
    first = np.empty(n_chains, dtype=np.int64)
    # Without one of the units each, the last row with all: what still is lost there.
    still = np.empty((n_units, n_chains), dtype=np.int64)
    n_still = np.full(n_units, -1)
    without = np.zeros((n_units - 1 if exact_failures else 0, *union.shape), dtype=np.uint64)
    order = np.arange(n_units - 1)
    later = place
    while later + 1 < n:
        later += 1
        if walk.fixed[depth, 0] + gain[0, place] + gain[0, later] < walk.needs[0]:
            if later >= group:
                break
            later = group - 1  # the others may still gain more
            continue
        left_on_average = walk.fixed[depth, 1] + gain[1, place] + gain[1, later]
        if n_failures > 0 and left_on_average < walk.needs[1]:
            continue
        other = walk.candidate[depth, later]
        if walk.room[depth + 1, forest.site[other]] <= 0:
            continue
        if n_still[n_units - 1] < 0:
            if exact_failures and loses_more(
                forest,
                walk.chosen[0],
                union,
                forest.chains,
                n_chains,
                largest - walk.needs[3],
                first,
            ):
                return  # when the last one fails
            n_still[n_units - 1] = open_chains(
                layout, forest.worth, union, forest.chains, still[n_units - 1]
            )
        walk.where[3] += 1
        if loses_more(
            forest,
            other,
            union,
            still[n_units - 1],
            n_still[n_units - 1],
            largest - walk.needs[0],
            first,
        ):
            continue
        is_kept = True
        for rank in range(n_units - 1 if exact_failures else 0):
            failed = order[rank]
            if n_still[failed] < 0:
                for unit in range(n_units - 1):
                    if unit != failed:
                        join(layout.bits, walk.chosen[unit], without[failed], without[failed])
                n_still[failed] = open_chains(
                    layout, forest.worth, without[failed], forest.chains, still[failed]
                )
            walk.where[3] += 1
            if loses_more(
                forest,
                other,
                without[failed],
                still[failed],
                n_still[failed],
                largest - walk.needs[3],
                first,
            ):
                is_kept = False
                order[rank], order[0] = order[0], failed  # it tells the most
                break
        if is_kept:
            for unit in range(n_units - 1):
                out[walk.where[2], unit] = walk.chosen[unit]
            out[walk.where[2], n_units - 1] = other
            walk.where[2] += 1


@kernel
def grow(
    forest: Forest, walk: Walk, n_failures: int, exact_failures: bool, max_work: int, out: IntArray
) -> int:
    """Go on with a walk through all sets that meet the needs, until `max_work` or `out` is full.

    Sets are written to `out`, (n, n_units). Needs may be raised at any time.
    """
    n_units = len(walk.chosen)
    largest = forest.worth[:, 0].sum()
    begun = walk.where[3]
    while walk.where[0] >= 0:
        depth = walk.where[0]
        left = n_units - depth
        place, n, group = walk.position[depth], walk.n_candidates[depth], walk.group[depth]
        if depth == 0 and place >= walk.where[4]:
            return DONE
        if walk.where[3] - begun > max_work:
            return PAUSED
        if walk.where[1] == 1:
            walk.where[1] = 0
            if not look_at_node(forest, walk, n_failures):
                walk.where[0] -= 1
            continue
        if place + left > n:
            walk.where[0] -= 1
            continue
        if place == group:  # nothing covers that row any more
            for later in range(group, n):
                walk.candidate[depth, later - group] = walk.candidate[depth, later]
            walk.n_candidates[depth] = n - group
            walk.position[depth] = 0
            walk.where[1] = 1
            continue
        of_first = walk.gain[depth, 0]
        bound = walk.fixed[depth, 0] + of_first[place]
        if bound + most_beside(of_first, place, group, n, left - 1) < walk.needs[0]:
            walk.position[depth] = group
            if group == n:
                walk.where[0] -= 1
            continue
        if len(out) - walk.where[2] < n:
            return FULL
        walk.position[depth] += 1
        pose = walk.candidate[depth, place]
        walk.chosen[depth] = pose
        join(forest.layout.bits, pose, walk.union[depth], walk.union[depth + 1])
        for site in range(walk.room.shape[1]):
            walk.room[depth + 1, site] = walk.room[depth, site]
        walk.room[depth + 1, forest.site[pose]] -= 1
        if left == 2:
            add_last(forest, walk, n_failures, exact_failures, largest, out)
            continue
        for row in range(len(forest.weight)):
            covered = has_bit(forest.covers[pose], row)
            walk.n_covering[depth + 1, row] = walk.n_covering[depth, row] + covered
            for check in range(2 + depth):
                walk.price[depth + 1, check, row] = walk.price[depth, check, row]
            walk.price[depth + 1, 2 + depth, row] = walk.price[depth, 0, row]
        n_left = 0
        for later in range(place + 1, n):
            other = walk.candidate[depth, later]
            if walk.room[depth + 1, forest.site[other]] > 0:
                walk.candidate[depth + 1, n_left] = other
                n_left += 1
        walk.n_candidates[depth + 1] = n_left
        walk.position[depth + 1] = 0
        walk.where[0] += 1
        walk.where[1] = 1
    return DONE
