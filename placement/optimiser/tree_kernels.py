"""Machine code of the tree of sets: what a set is worth, bounds of a node, the walk itself.

Detections are laid out by chains: bit k of the words of chain g in phase i says whether a pose sees
the i-th frame of the chain's k-th window. A set sees a window if every phase has its bit in the
union. Behind the phases there is a row for tails, if there are any: bit t says whether a pose sees
the chain's t-th tail. The first one that the union lacks ends most windows; the first of the others
that is seen is the first live one. A chain is then worth ``worth[g, k]`` with k that window.

Everything here works on plain arrays; :mod:`placement.optimiser.set_tree` says what they hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .presolve import Chains, WordArray

ByteArray = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

FINISHED, PAUSED, FULL = 0, 1, 2
_DEFLECTION = 0.7
_CUT = 0.6
_MEMORY = 0.97  # of the shares
_PATIENCE = 6


class Layout(NamedTuple):
    """Detections by chains."""

    # (n_phases, n_poses, n_words), and a row more if there are tails; padding behind the tails is
    # set.
    bits: WordArray
    n_phases: int
    start: IntArray  # (n_chains + 1,): first word of each chain
    tail_links: IntArray  # (n_tails,): windows that need each tail, falling in each chain
    tail_start: IntArray  # (n_chains + 1,): tails of each chain


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
    where: IntArray  # (4,): depth, whether its node is new, sets found, candidates looked at
    chosen: IntArray  # (n_units,)
    union: WordArray  # (n_units + 1, n_phases or one more, n_words)
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
def join(bits: WordArray, pose: int, union: WordArray, joined: WordArray) -> None:
    """What a union and a pose see together."""
    for row in range(bits.shape[0]):
        for word in range(bits.shape[2]):
            joined[row, word] = union[row, word] | bits[row, pose, word]


@kernel
def first_window(layout: Layout, pose: int, union: WordArray, chain: int, none: int) -> int:
    """First live window of a chain that a union and a pose see together."""
    bits, n_phases = layout.bits, layout.n_phases
    begin, end = layout.start[chain], layout.start[chain + 1]
    lowest = 0
    tail, n_tails = layout.tail_start[chain], layout.tail_start[chain + 1]
    if tail < n_tails:
        for word in range(begin, end):
            unseen = ~(bits[n_phases, pose, word] | union[n_phases, word])
            if unseen != 0:
                lowest = layout.tail_links[tail + 64 * (word - begin) + lowest_bit(unseen)]
                break
    mask = ~np.uint64(0) << np.uint64(lowest & 63)
    for word in range(begin + (lowest >> 6), end):
        seen = mask
        for phase in range(n_phases):
            seen &= bits[phase, pose, word] | union[phase, word]
        if seen != 0:
            return 64 * (word - begin) + lowest_bit(seen)
        mask = ~np.uint64(0)
    return none


@kernel
def lay_out(words: WordArray, frames: IntArray, place: IntArray, bits: WordArray) -> None:
    """Detections in some frames to the places of these in words, (n_poses, n_words)."""
    for pose in range(len(words)):
        for number in range(len(place)):
            frame, bit = frames[number], place[number]
            seen = (words[pose, frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1)
            bits[pose, bit >> 6] |= seen << np.uint64(bit & 63)


@kernel
def first_windows(
    layout: Layout, tails: WordArray, asked: WordArray, none: int, first: IntArray
) -> None:
    """First window of each chain of which each pose sees what is asked for, (n_poses, n_chains).

    `asked` has a bit for every phase of a window, and one for its tail in `tails`: seen is the
    window if one of those is.
    """
    for pose in range(layout.bits.shape[1]):
        for chain in range(len(layout.start) - 1):
            first[pose, chain] = none
            for word in range(layout.start[chain], layout.start[chain + 1]):
                seen = tails[pose, word] & asked[layout.n_phases, word]
                for phase in range(layout.n_phases):
                    seen |= layout.bits[phase, pose, word] & asked[phase, word]
                if seen != 0:
                    first[pose, chain] = 64 * (word - layout.start[chain]) + lowest_bit(seen)
                    break


@kernel
def ask_for_tails(
    layout: Layout, seen_of_tail: FloatArray, seen: FloatArray, asked_bits: WordArray
) -> None:
    """Ask every window for the tail that is seen least of those that it needs.

    `seen_of_tail`, (n_tails,), is how much of each is seen; `seen`, (64 n_words,), becomes that of
    the tail that a window is asked for, and `asked_bits`, (n_poses, n_words), who sees that.
    """
    asked_bits[:] = 0
    for chain in range(len(layout.start) - 1):
        first, last = layout.tail_start[chain], layout.tail_start[chain + 1]
        begin = layout.start[chain]
        least, tail = first, first
        while tail < last:
            if seen_of_tail[tail] < seen_of_tail[least]:
                least = tail
            n_links = layout.tail_links[tail]
            tail += 1
            fewer = layout.tail_links[tail] if tail < last else 0
            if fewer == n_links:
                continue
            word, bit = begin + ((least - first) >> 6), np.uint64((least - first) & 63)
            for link in range(fewer, n_links):
                place = begin + (link >> 6)
                seen[64 * begin + link] = seen_of_tail[least]
                for pose in range(layout.bits.shape[1]):
                    has = (layout.bits[layout.n_phases, pose, word] >> bit) & np.uint64(1)
                    asked_bits[pose, place] |= has << np.uint64(link & 63)


@kernel
def set_links(layout: Layout, sets: IntArray, left_out: int, none: int, first: IntArray) -> None:
    """First live window of each chain for each set, one unit left out, (n_sets, n_chains).

    A negative number leaves none out.
    """
    nothing = np.zeros((layout.bits.shape[0], layout.bits.shape[2]), dtype=np.uint64)
    union = nothing.copy()
    for row in range(len(sets)):
        union[:] = nothing
        last = -1
        for unit in range(sets.shape[1]):
            if unit != left_out:
                if last >= 0:
                    join(layout.bits, sets[row, last], union, union)
                last = unit
        for chain in range(len(layout.start) - 1):
            if last < 0:
                first[row, chain] = none
            else:
                first[row, chain] = first_window(layout, sets[row, last], union, chain, none)


@kernel
def has_frame(union: WordArray, frame: int) -> bool:
    """Whether a union has a merged frame."""
    return (union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1) != 0


@kernel
def first_live_link(union: WordArray, chains: Chains, chain: int) -> int:
    """First live window of a chain that a union of merged frames sees; their number if none."""
    begin, end = chains.start[chain], chains.start[chain + 1]
    place = begin
    for tail in range(chains.tail_start[chain], chains.tail_start[chain + 1]):
        if not has_frame(union, chains.tail_frame[tail]):
            place += chains.tail_links[tail]
            break
    while place < end:
        is_seen = True
        for frame in chains.window_frames[chains.window[place]]:
            is_seen &= has_frame(union, frame)
        if is_seen:
            break
        place += 1
    return place - begin


@kernel
def first_live_windows(unions: WordArray, chains: Chains, first: IntArray) -> None:
    """First live window of each chain for each union of merged frames, (n_unions, n_chains).

    The number of the chain's windows where none is live.
    """
    for row in range(len(unions)):
        for chain in range(len(chains.start) - 1):
            first[row, chain] = first_live_link(unions[row], chains, chain)


@kernel
def drop_lost_windows(seen: WordArray, frames: WordArray, chains: Chains) -> None:
    """Clear windows that are not live; bits along sets: (n_links, n_words), (n_frames, n_words)."""
    held = np.empty(seen.shape[1], dtype=np.uint64)
    for chain in range(len(chains.start) - 1):
        held[:] = ~np.uint64(0)
        tail, last = chains.tail_start[chain], chains.tail_start[chain + 1]
        for number in range(chains.start[chain + 1] - chains.start[chain] - 1, -1, -1):
            while tail < last and chains.tail_links[tail] > number:
                held &= frames[chains.tail_frame[tail]]
                tail += 1
            seen[chains.start[chain] + number] &= held


@kernel
def lose_little(
    words: WordArray,
    sets: IntArray,
    with_failures: bool,
    chains: Chains,
    lost: FloatArray,
    most_lost: float,
    kept: BoolArray,
) -> None:
    """Whether sets lose no more than so much: all their units, or whichever one of them fails.

    ``lost[g, k]`` is what is lost in chain g if the k-th of its windows is the first live one. Few
    sets are looked at as a whole: the chains at which others before failed come first.
    """
    n_chains = len(chains.start) - 1
    order = np.arange(n_chains)
    union = np.empty(words.shape[1], dtype=np.uint64)
    for row in range(len(sets)):
        kept[row] = most_lost >= 0.0
        for case in range(sets.shape[1] if with_failures else 1):
            failed = case if with_failures else -1
            for word in range(len(union)):
                union[word] = 0
            for unit in range(sets.shape[1]):
                if unit != failed:
                    of_unit = words[sets[row, unit]]
                    for word in range(len(union)):
                        union[word] |= of_unit[word]
            total = 0.0
            for rank in range(n_chains):
                chain = order[rank]
                total += lost[chain, first_live_link(union, chains, chain)]
                if total > most_lost:
                    kept[row] = False
                    before = rank // 2  # nearer to the front, not all the way: some fail by chance
                    order[rank], order[before] = order[before], chain
                    break
            if not kept[row]:
                break


@kernel
def totals_with_each(
    layout: Layout, worth: FloatArray, union: WordArray, total: FloatArray
) -> None:
    """What a union is worth together with each pose, by several sums, (n_poses, n_sums).

    `worth` has a table for each sum, (n_sums, n_chains, longest + 1).
    """
    none = worth.shape[2] - 1
    n_sums = worth.shape[0]
    for pose in range(layout.bits.shape[1]):
        for number in range(n_sums):
            total[pose, number] = 0.0
        for chain in range(len(layout.start) - 1):
            first = first_window(layout, pose, union, chain, none)
            for number in range(n_sums):
                total[pose, number] += worth[number, chain, first]


@kernel
def reaches(forest: Forest, largest: float, pose: int, union: WordArray, need: float) -> bool:
    """Whether a union and a pose are worth a need; it is given up as soon as too much is lost."""
    none = forest.worth.shape[1] - 1
    left = largest - need
    for chain in forest.chains:
        first = first_window(forest.layout, pose, union, chain, none)
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
        return n
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
def keeps_without(forest: Forest, largest: float, walk: Walk, last: int, need: float) -> bool:
    """Whether the chosen units and a last one keep a need when any one of them fails."""
    n_units = len(walk.chosen)
    if not reaches(forest, largest, walk.chosen[0], walk.union[n_units - 1], need):
        return False  # without the last one
    union = np.empty(walk.union[0].shape, dtype=np.uint64)
    for failed in range(n_units - 1):
        union[:] = 0
        for unit in range(n_units - 1):
            if unit != failed:
                join(forest.layout.bits, walk.chosen[unit], union, union)
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
        place, n, group = walk.position[depth], walk.n_candidates[depth], walk.group[depth]
        if place + left > n:
            walk.where[0] -= 1
            continue
        if place == group:  # nothing covers that row any more
            for later in range(group, n):
                walk.candidate[depth, later - group] = walk.candidate[depth, later]
            walk.n_candidates[depth] = n - group
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
        later = place
        while later + 1 < n:
            later += 1
            gain = walk.gain[depth]
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
