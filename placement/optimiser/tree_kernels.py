"""Machine code of the tree of sets: what a set is worth, bounds of a node, the walk itself.

Detections are laid out by chains: bit k of the words of chain g in phase i says whether a pose sees
the i-th frame of the chain's k-th window. A set sees a window if every phase has its bit in the
union. A chain is then worth ``worth[g, k]`` with k its first window seen.

Everything here works on plain arrays; :mod:`placement.optimiser.set_tree` says what they hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .presolve import WordArray

ByteArray = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

FINISHED, PAUSED, FULL = 0, 1, 2
_DEFLECTION = 0.7
_CUT = 0.6
_MEMORY = 0.97  # of the shares
_PATIENCE = 6


class Forest(NamedTuple):
    """What stays the same during a walk."""

    phases: WordArray  # (n_phases, n_poses, n_words)
    start: IntArray  # (n_chains + 1,): first word of each chain
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
    where: IntArray  # (4,): depth, whether its node is new, sets found, candidates looked at
    chosen: IntArray  # (n_units,)
    union: WordArray  # (n_units + 1, n_phases, n_words)
    n_covering: ByteArray  # (n_units + 1, n_rows): units that cover each row
    price: FloatArray  # (n_units + 1, n_units + 2, n_rows)
    room: IntArray  # (n_units + 1, n_sites)
    candidate: IntArray  # (n_units, n_poses)
    gain: FloatArray  # (n_units, 2, n_poses): of each candidate, for the first two rewards
    fixed: FloatArray  # (n_units, 2)
    n_candidates: IntArray  # (n_units,)
    position: IntArray  # (n_units,)
    cover: Float32Array  # (n_rows, n_poses): working space
    gain_now: FloatArray  # (n_poses,): working space


@kernel
def lowest_bit(word: np.uint64) -> int:
    """Place of the lowest bit of a word that is not 0."""
    lowest = word & (~word + np.uint64(1))
    place = 0
    if lowest & np.uint64(0xFFFFFFFF00000000):
        place += 32
    if lowest & np.uint64(0xFFFF0000FFFF0000):
        place += 16
    if lowest & np.uint64(0xFF00FF00FF00FF00):
        place += 8
    if lowest & np.uint64(0xF0F0F0F0F0F0F0F0):
        place += 4
    if lowest & np.uint64(0xCCCCCCCCCCCCCCCC):
        place += 2
    if lowest & np.uint64(0xAAAAAAAAAAAAAAAA):
        place += 1
    return place


@kernel
def has_bit(words: WordArray, number: int) -> int:
    """One bit of words, 0 or 1."""
    return int((words[number >> 6] >> np.uint64(number & 63)) & np.uint64(1))


@kernel
def join(phases: WordArray, pose: int, union: WordArray, joined: WordArray) -> None:
    """What a union and a pose see together."""
    for phase in range(phases.shape[0]):
        for word in range(phases.shape[2]):
            joined[phase, word] = union[phase, word] | phases[phase, pose, word]


@kernel
def first_window(
    phases: WordArray, pose: int, union: WordArray, begin: int, end: int, none: int
) -> int:
    """First window of a chain, in words begin .. end - 1, that a union and a pose see together."""
    for word in range(begin, end):
        seen = ~np.uint64(0)
        for phase in range(phases.shape[0]):
            seen &= phases[phase, pose, word] | union[phase, word]
        if seen != 0:
            return 64 * (word - begin) + lowest_bit(seen)
    return none


@kernel
def lay_out(words: WordArray, frames: IntArray, place: IntArray, phases: WordArray) -> None:
    """Bits of the frames of all windows, (n_phases, n_links), to the places of these windows."""
    for phase in range(len(frames)):
        for pose in range(len(words)):
            for link in range(len(place)):
                frame, bit = frames[phase, link], place[link]
                seen = (words[pose, frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1)
                phases[phase, pose, bit >> 6] |= seen << np.uint64(bit & 63)


@kernel
def first_windows(
    phases: WordArray, start: IntArray, asked: WordArray, none: int, first: IntArray
) -> None:
    """First window of each chain of which each pose sees the frame asked for, (n_poses, n_chains).

    `asked` has a bit for every phase of a window: seen is the window if one of those is.
    """
    for pose in range(phases.shape[1]):
        for chain in range(len(start) - 1):
            first[pose, chain] = none
            for word in range(start[chain], start[chain + 1]):
                seen = np.uint64(0)
                for phase in range(phases.shape[0]):
                    seen |= phases[phase, pose, word] & asked[phase, word]
                if seen != 0:
                    first[pose, chain] = 64 * (word - start[chain]) + lowest_bit(seen)
                    break


@kernel
def set_links(
    phases: WordArray, start: IntArray, sets: IntArray, left_out: int, none: int, first: IntArray
) -> None:
    """First window of each chain that each set sees, one of its units left out, (n_sets, n_chains).

    A negative number leaves none out.
    """
    n_phases = phases.shape[0]
    for row in range(len(sets)):
        for chain in range(len(start) - 1):
            first[row, chain] = none
            for word in range(start[chain], start[chain + 1]):
                seen = ~np.uint64(0)
                for phase in range(n_phases):
                    union = np.uint64(0)
                    for unit in range(sets.shape[1]):
                        if unit != left_out:
                            union |= phases[phase, sets[row, unit], word]
                    seen &= union
                if seen != 0:
                    first[row, chain] = 64 * (word - start[chain]) + lowest_bit(seen)
                    break


@kernel
def first_whole_windows(
    unions: WordArray, window_frames: IntArray, links: IntArray, start: IntArray, first: IntArray
) -> None:
    """First window of each chain that each union sees as a whole, (n_unions, n_chains).

    The links of chain g are windows ``links[start[g] : start[g + 1]]``; their number where none is
    seen.
    """
    for row in range(len(unions)):
        union = unions[row]
        for chain in range(len(start) - 1):
            place = start[chain]
            while place < start[chain + 1]:
                frames = window_frames[links[place]]
                seen = np.uint64(1)
                for frame in frames:
                    seen &= union[frame >> 6] >> np.uint64(frame & 63)
                if seen != 0:
                    break
                place += 1
            first[row, chain] = place - start[chain]


@kernel
def lose_little(
    words: WordArray,
    sets: IntArray,
    with_failures: bool,
    window_frames: IntArray,
    links: IntArray,
    start: IntArray,
    lost: FloatArray,
    most_lost: float,
    kept: BoolArray,
) -> None:
    """Whether sets lose no more than so much: all their units, or whichever one of them fails.

    ``lost[g, k]`` is what is lost in chain g if the k-th of its windows is the first that is seen.
    Few sets are looked at as a whole: the chains at which others before failed come first.
    """
    n_chains = len(start) - 1
    order = np.arange(n_chains)
    union = np.empty(words.shape[1], dtype=np.uint64)
    for row in range(len(sets)):
        kept[row] = most_lost >= 0.0
        for case in range(sets.shape[1] if with_failures else 1):
            failed = case if with_failures else -1
            union[:] = 0
            for unit in range(sets.shape[1]):
                if unit != failed:
                    union |= words[sets[row, unit]]
            total = 0.0
            for rank in range(n_chains):
                chain = order[rank]
                place = start[chain]
                while place < start[chain + 1]:
                    seen = np.uint64(1)
                    for frame in window_frames[links[place]]:
                        seen &= union[frame >> 6] >> np.uint64(frame & 63)
                    if seen != 0:
                        break
                    place += 1
                total += lost[chain, place - start[chain]]
                if total > most_lost:
                    kept[row] = False
                    before = rank // 2  # nearer to the front, not all the way: some fail by chance
                    order[rank], order[before] = order[before], chain
                    break
            if not kept[row]:
                break


@kernel
def totals_with_each(
    phases: WordArray,
    start: IntArray,
    worth: FloatArray,
    union: WordArray,
    total: FloatArray,
) -> None:
    """What a union is worth together with each pose, by several sums, (n_poses, n_sums).

    `worth` has a table for each sum, (n_sums, n_chains, longest + 1).
    """
    none = worth.shape[2] - 1
    n_sums = worth.shape[0]
    for pose in range(phases.shape[1]):
        for number in range(n_sums):
            total[pose, number] = 0.0
        for chain in range(len(start) - 1):
            first = first_window(phases, pose, union, start[chain], start[chain + 1], none)
            for number in range(n_sums):
                total[pose, number] += worth[number, chain, first]


@kernel
def reaches(forest: Forest, largest: float, pose: int, union: WordArray, need: float) -> bool:
    """Whether a union and a pose are worth a need; it is given up as soon as too much is lost."""
    none = forest.worth.shape[1] - 1
    left = largest - need
    for chain in forest.chains:
        first = first_window(
            forest.phases, pose, union, forest.start[chain], forest.start[chain + 1], none
        )
        left -= forest.worth[chain, 0] - forest.worth[chain, first]
        if left < 0.0:
            return False
    return True


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
    sort_falling(walk.gain[depth, 0], walk.gain[depth, 1], candidate, n)
    return True


@kernel
def keeps_without(forest: Forest, largest: float, walk: Walk, last: int, need: float) -> bool:
    """Whether the chosen units and a last one keep a need when any one of them fails."""
    n_units = len(walk.chosen)
    if not reaches(forest, largest, walk.chosen[0], walk.union[n_units - 1], need):
        return False  # without the last one
    union = np.empty(walk.union[0].shape, dtype=np.uint64)
    for failed in range(n_units - 1):
        for phase in range(union.shape[0]):
            for word in range(union.shape[1]):
                union[phase, word] = 0
        for unit in range(n_units - 1):
            if unit != failed:
                join(forest.phases, walk.chosen[unit], union, union)
        if not reaches(forest, largest, last, union, need):
            return False
    return True


@kernel
def grow(
    forest: Forest, walk: Walk, n_failures: int, exact_failures: bool, max_work: int, out: IntArray
) -> int:
    """Go on with a walk through all sets that meet the needs, until `max_work` or `out` is full.

    Sets are written to `out`, (n, n_units). Needs may be raised between calls.
    """
    n_units = len(walk.chosen)
    largest = 0.0
    for chain in forest.chains:
        largest += forest.worth[chain, 0]
    begun = walk.where[3]
    while walk.where[0] >= 0:
        depth = walk.where[0]
        left = n_units - depth
        if walk.where[1] == 1:
            if walk.where[3] - begun > max_work:
                return PAUSED
            walk.where[1] = 0
            if not look_at_node(forest, walk, n_failures):
                walk.where[0] -= 1
            continue
        place, n = walk.position[depth], walk.n_candidates[depth]
        bound = walk.fixed[depth, 0]
        for later in range(place, min(place + left, n)):
            bound += walk.gain[depth, 0, later]
        if place + left > n or bound < walk.needs[0]:
            walk.where[0] -= 1
            continue
        if len(out) - walk.where[2] < n:
            return FULL
        walk.position[depth] += 1
        pose = walk.candidate[depth, place]
        walk.chosen[depth] = pose
        join(forest.phases, pose, walk.union[depth], walk.union[depth + 1])
        for site in range(walk.room.shape[1]):
            walk.room[depth + 1, site] = walk.room[depth, site]
        walk.room[depth + 1, forest.site[pose]] -= 1
        if left > 2:
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
            walk.where[0] += 1
            walk.where[1] = 1
            continue
        for later in range(place + 1, n):
            gain = walk.gain[depth]
            if walk.fixed[depth, 0] + gain[0, place] + gain[0, later] < walk.needs[0]:
                break
            left_on_average = walk.fixed[depth, 1] + gain[1, place] + gain[1, later]
            if n_failures > 0 and left_on_average < walk.needs[1]:
                continue
            other = walk.candidate[depth, later]
            if walk.room[depth + 1, forest.site[other]] <= 0:
                continue
            walk.where[3] += 1
            if not reaches(forest, largest, other, walk.union[depth + 1], walk.needs[0]):
                continue
            if exact_failures and not keeps_without(forest, largest, walk, other, walk.needs[3]):
                continue
            for unit in range(n_units - 1):
                out[walk.where[2], unit] = walk.chosen[unit]
            out[walk.where[2], n_units - 1] = other
            walk.where[2] += 1
    return FINISHED
