"""Machine code of the tree of covers: bounds of a node, the walk itself, and what it leaves.

Everything here works on plain arrays; :mod:`placement.optimiser.cover_tree` says what they hold.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .chain_kernels import Layout, join, lost_with, lowest_bit
from .problem import WordArray
from .root_kernels import ByteArray, weigh_bytes, weight_of

DONE, PAUSED, FULL, AT_STOP = 0, 1, 2, 3


class Covers(NamedTuple):
    """What stays the same during a walk."""

    covers: WordArray  # (n_poses, n_row_words): rows that each pose covers
    coverers: WordArray  # (n_rows, n_pose_words): poses that cover each row
    rows: ByteArray  # (n_poses, n_bytes): `covers` by bytes, lowest bits first
    weight: FloatArray  # (n_rows,)
    price: FloatArray  # (n_rows,): at most the weight
    site: IntArray  # (n_poses,)
    copies: IntArray  # (n_poses,): how often a pose may be chosen


class Walk(NamedTuple):
    """Where a walk stands; arrays have a place for each depth."""

    # (5,): depth; whether its node is new; sets found; bytes looked at; depth behind which the
    # walk began.
    where: IntArray
    may_lose: FloatArray  # (2,): weight of rows that all units, and all but the failed, may lose
    chosen: IntArray  # (n_units,)
    once: WordArray  # (n_units + 1, n_row_words): rows that a unit covers
    twice: WordArray  # the same, that two do
    gone: WordArray  # the same, that nothing covers any more
    lost: FloatArray  # (n_units + 1,): what those weigh
    is_open: BoolArray  # (n_units + 1, n_poses): candidates
    room: IntArray  # (n_units + 1, n_sites)
    queue: IntArray  # (n_units, n_poses): candidates that are tried, one after the other
    n_queued: IntArray  # (n_units,)
    position: IntArray  # (n_units,)
    gain: FloatArray  # (n_poses,): working space
    beside: FloatArray  # (n_poses,): working space
    table: FloatArray  # (n_bytes, 256): working space
    used: IntArray  # (n_bytes,): working space
    best: IntArray  # (n_units,): working space


@kernel
def add_gains(
    covers: Covers,
    weight: FloatArray,
    rows: WordArray,
    walk: Walk,
    gain: FloatArray,
) -> float:
    """Add to each candidate what it covers of some rows; what they weigh."""
    is_open = walk.is_open[walk.where[0]]
    n_used = weigh_bytes(weight, rows, walk.table, walk.used)
    for pose in range(len(gain)):
        if is_open[pose]:
            gain[pose] += weight_of(covers.rows[pose], walk.table, walk.used, n_used)
            walk.where[3] += n_used
    walk.where[3] += 64 * n_used
    total = 0.0
    for word in range(len(rows)):
        left = rows[word]
        while left:
            total += weight[64 * word + lowest_bit(left)]
            left &= left - np.uint64(1)
    return total


@kernel
def drop_hopeless(
    gain: FloatArray, is_open: BoolArray, n_more: int, need: float, best: IntArray
) -> bool:
    """Drop candidates that cannot gain enough with others; whether some are left.

    `n_more` candidates together have to gain `need`; with none to choose nothing is dropped.
    """
    if n_more <= 0:
        return need <= 0.0
    most, least = 0.0, 0.0
    for number in range(n_more):
        highest, pose = -1.0, -1
        for other in range(len(gain)):
            if is_open[other] and gain[other] > highest:
                is_new = True
                for before in range(number):
                    is_new &= best[before] != other
                if is_new:
                    highest, pose = gain[other], other
        if pose < 0:
            break
        best[number], least = pose, highest
        most += highest
    if most < need:
        return False
    # Whatever is not among the best takes the place of the last of them.
    for pose in range(len(gain)):
        if is_open[pose] and gain[pose] < least and most - least + gain[pose] < need:
            is_open[pose] = False
    return True


@kernel
def count_bits(word: np.uint64) -> int:
    """Number of bits of a word (Warren, Hacker's Delight, 5-1)."""
    pairs = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    fours = (pairs & np.uint64(0x3333333333333333)) + (
        (pairs >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    eights = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((eights * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def give_up_rows(covers: Covers, walk: Walk, rows: WordArray) -> int:
    """Find the rows that are not covered, those lost that nothing can cover; the hardest of them.

    That is the row which fewest candidates cover; -1 if all are covered.
    """
    depth = walk.where[0]
    once, gone = walk.once[depth], walk.gone[depth]
    candidates = np.zeros(covers.coverers.shape[1], dtype=np.uint64)
    for pose in range(walk.is_open.shape[1]):
        if walk.is_open[depth, pose]:
            candidates[pose >> 6] |= np.uint64(1) << np.uint64(pose & 63)
    hardest, fewest = -1, len(walk.gain) + 1
    rows[:] = 0
    for row in range(len(covers.weight)):
        word, mask = row >> 6, np.uint64(1) << np.uint64(row & 63)
        if (once[word] | gone[word]) & mask:
            continue
        n_covering = 0
        for place in range(len(candidates)):
            n_covering += count_bits(candidates[place] & covers.coverers[row, place])
        if n_covering == 0:
            gone[word] |= mask
            walk.lost[depth] += covers.weight[row]
            continue
        rows[word] |= mask
        if n_covering < fewest:
            hardest, fewest = row, n_covering
    return hardest


@kernel
def look_at_node(covers: Covers, walk: Walk, n_failures: int) -> bool:
    """Bound the node at hand, drop candidates that cannot help, queue some; whether any is left.

    Those queued cover the row that fewest cover, best first. When they have been tried, that row is
    lost, and the node is looked at again.
    """
    depth = walk.where[0]
    left = len(walk.chosen) - depth
    is_open, gain, beside = walk.is_open[depth], walk.gain, walk.beside
    rows = np.empty(walk.once.shape[1], dtype=np.uint64)
    hardest = give_up_rows(covers, walk, rows)
    walk.n_queued[depth] = walk.position[depth] = 0
    lost = walk.lost[depth]
    if lost > walk.may_lose[0]:
        return False
    gain[:] = 0.0
    total = lost + add_gains(covers, covers.price, rows, walk, gain)
    if not drop_hopeless(gain, is_open, left, total - walk.may_lose[0], walk.best):
        return False
    gain[:] = 0.0
    total = lost + add_gains(covers, covers.weight, rows, walk, gain)
    if not drop_hopeless(gain, is_open, left, total - walk.may_lose[0], walk.best):
        return False
    if n_failures > 0:
        # Units fail that are still to come; or one of those chosen, and others to come.
        need = total - walk.may_lose[1]
        if not drop_hopeless(gain, is_open, left - n_failures, need, walk.best):
            return False
        for number in range(depth):
            of_unit = covers.covers[walk.chosen[number]]
            for word in range(len(rows)):
                rows[word] = of_unit[word] & ~walk.twice[depth, word]
            for pose in range(len(gain)):
                beside[pose] = gain[pose]
            need = total + add_gains(covers, covers.weight, rows, walk, beside) - walk.may_lose[1]
            if not drop_hopeless(beside, is_open, left - n_failures + 1, need, walk.best):
                return False
    queue, n_queued, is_any = walk.queue[depth], 0, False
    for pose in range(len(gain)):
        if not is_open[pose]:
            continue
        is_any = True
        if hardest >= 0 and (covers.rows[pose, hardest >> 3] >> (hardest & 7)) & 1 == 0:
            continue
        place = n_queued
        while place > 0 and gain[queue[place - 1]] < gain[pose]:
            queue[place] = queue[place - 1]
            place -= 1
        queue[place] = pose
        n_queued += 1
    walk.n_queued[depth] = n_queued
    return is_any


@kernel
def grow(
    covers: Covers, walk: Walk, n_failures: int, stop: int, max_work: int, out: IntArray
) -> int:
    """Go on with a walk through all sets that lose little, until `max_work` or `out` is full.

    Sets are written to `out`, (n, n_units). Nodes of depth `stop` are not looked into: the walk
    pauses at each.
    """
    n_poses, n_units = walk.is_open.shape[1], len(walk.chosen)
    begun, base = walk.where[3], walk.where[4]
    while walk.where[0] >= base:
        depth = walk.where[0]
        if walk.where[3] - begun > max_work:
            return PAUSED
        if walk.where[1] == 1:
            if depth == stop:
                return AT_STOP
            walk.where[1] = 0
            if not look_at_node(covers, walk, n_failures):
                walk.where[0] -= 1
                continue
        place = walk.position[depth]
        if place == walk.n_queued[depth]:
            walk.where[1] = 1  # none of these candidates any more
            continue
        pose = walk.queue[depth, place]
        walk.chosen[depth] = pose
        if depth + 1 == n_units:
            if walk.where[2] == len(out):
                return FULL
            for unit in range(n_units):
                out[walk.where[2], unit] = walk.chosen[unit]
            walk.where[2] += 1
            walk.position[depth] += 1
            walk.is_open[depth, pose] = False
            continue
        walk.position[depth] += 1
        after = depth + 1
        for other in range(n_poses):
            walk.is_open[after, other] = walk.is_open[depth, other]
        walk.is_open[depth, pose] = False
        n_same = 0
        for unit in range(after):
            n_same += walk.chosen[unit] == pose
        if n_same >= covers.copies[pose]:
            walk.is_open[after, pose] = False
        here = covers.site[pose]
        for site in range(walk.room.shape[1]):
            walk.room[after, site] = walk.room[depth, site]
        walk.room[after, here] -= 1
        if walk.room[after, here] <= 0:
            for other in range(n_poses):
                if covers.site[other] == here:
                    walk.is_open[after, other] = False
        for word in range(walk.once.shape[1]):
            of_pose = covers.covers[pose, word]
            walk.twice[after, word] = walk.twice[depth, word] | (walk.once[depth, word] & of_pose)
            walk.once[after, word] = walk.once[depth, word] | of_pose
            walk.gone[after, word] = walk.gone[depth, word]
        walk.lost[after] = walk.lost[depth]
        walk.where[0] = after
        walk.where[1] = 1
    return DONE


@kernel
def loses_more(
    layout: Layout,
    union: WordArray,
    worth: FloatArray,
    chains: IntArray,
    most: float,
    first: IntArray,
) -> bool:
    """Whether a union loses more than so much."""
    lost = lost_with(
        union,
        union,
        layout.n_phases,
        layout.start,
        layout.tail_links,
        layout.tail_start,
        worth,
        chains,
        len(chains),
        most,
        first,
    )
    return lost > most


@kernel
def can_keep(
    layout: Layout,
    bits: WordArray,
    worth: FloatArray,
    chains: IntArray,
    may_lose: FloatArray,
    with_failures: bool,
    union: WordArray,
    first: IntArray,
) -> bool:
    """Whether units, (n_units, n_words, n_phases or more), lose little, also without each one."""
    n_units = len(bits)
    for failed in range(n_units, -1 if with_failures else n_units - 1, -1):
        union[:] = 0
        for unit in range(n_units):
            if unit != failed:
                join(bits, unit, union, union)
        most = may_lose[0] if failed == n_units else may_lose[1]
        if loses_more(layout, union, worth, chains, most, first):
            return False
    return True


@kernel
def put(every: WordArray, row: int, bits: WordArray, place: int) -> None:
    """A row of words, (n_words, n_phases or more), to its place among others."""
    for word in range(bits.shape[1]):
        for phase in range(bits.shape[2]):
            bits[place, word, phase] = every[row, word, phase]


@kernel
def spell_out(
    layout: Layout,
    widest: WordArray,
    start: IntArray,
    member: IntArray,
    worth: FloatArray,
    chains: IntArray,
    may_lose: FloatArray,
    with_failures: bool,
    classes: IntArray,
    place: IntArray,
    out: IntArray,
) -> int:
    """Sets of poses, one of each class in its place, that lose little; how many were written.

    `place`, (n_units + 1,), is where the search stands: the members looked at, and the number of
    units that are settled; it comes back with -1 there when all sets were seen.
    """
    n_units = len(classes)
    bits = np.empty((n_units, *widest.shape[1:]), dtype=np.uint64)
    union = np.empty(widest.shape[1:], dtype=np.uint64)
    first = np.empty(len(chains), dtype=np.int64)
    unit, n_found = place[n_units], 0
    for number in range(n_units):
        if number < unit:
            put(layout.bits, member[place[number]], bits, number)
        else:
            put(widest, classes[number], bits, number)
    if unit == 0 and place[0] < start[classes[0]]:
        place[0] = start[classes[0]]
        if not can_keep(layout, bits, worth, chains, may_lose, with_failures, union, first):
            unit = -1
    while unit >= 0:
        if place[unit] == start[classes[unit] + 1]:
            put(widest, classes[unit], bits, unit)
            unit -= 1
            if unit >= 0:
                place[unit] += 1
            continue
        if n_found == len(out):
            break
        put(layout.bits, member[place[unit]], bits, unit)
        if not can_keep(layout, bits, worth, chains, may_lose, with_failures, union, first):
            place[unit] += 1
        elif unit + 1 == n_units:
            for number in range(n_units):
                out[n_found, number] = member[place[number]]
            n_found += 1
            place[unit] += 1
        else:
            is_same = classes[unit + 1] == classes[unit]
            place[unit + 1] = place[unit] + 1 if is_same else start[classes[unit + 1]]
            unit += 1
    place[n_units] = unit
    return n_found
