"""Numba kernels of the covering problem and of the walk through its sets.

In this order: what windows are asked for and which poses cover a row, prices
that bound all sets, the walk, and what the sets that it meets lose on the
windows. Bits along rows, poses or frames are 64-bit words, lowest bit first.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .allowed_sets import Choice
from .bit_kernels import (
    ByteArray,
    count_bits,
    has_bit,
    has_entry,
    look_through,
    lowest_bit,
)
from .problem import Chains, WordArray


# ---------- what is asked for, and who covers it
@kernel
def ask_for_least_seen(
    chains: Chains, some: IntArray, union: WordArray, seen: FloatArray, asked: IntArray
) -> None:
    """Ask each window for the frame, or tail, that a union lacks and is seen least.

    Parameters
    ----------
    chains : Chains
        Windows and tails.
    some : (n,) int
        Chains that are looked at.
    union : (n_words,) uint64
        Frames that are seen already.
    seen : (n_frames,) float
        How much of each frame is seen.
    asked : (n_links,) int
        Written: the frame of each window, -1 where the union lacks nothing.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    for chain in some:
        tail = tail_start[chain]
        last_tail = tail_start[chain + 1]
        least_tail = -1
        # Windows of the chain, the last one first: the earlier, the more tails are
        # needed.
        for link in range(start[chain + 1] - start[chain] - 1, -1, -1):
            while tail < last_tail and tail_links[tail] > link:
                least_tail = less_seen(union, seen, tail_frame[tail], least_tail)
                tail += 1
            least = -1
            for frame in window_frames[window[start[chain] + link]]:
                least = less_seen(union, seen, frame, least)
            if least_tail >= 0 and (least < 0 or seen[least_tail] < seen[least]):
                least = least_tail
            asked[start[chain] + link] = least


@kernel
def less_seen(union: WordArray, seen: FloatArray, frame: int, least: int) -> int:
    """A frame that a union lacks and that is seen less than the least, or the least."""
    is_less = not has_bit(union, frame) and (least < 0 or seen[frame] < seen[least])
    if is_less:
        return frame
    return least


@kernel
def cover_rows(
    columns: WordArray,
    start: IntArray,
    asked: IntArray,
    row_chain: IntArray,
    row_last: IntArray,
    begin: int,
    end: int,
    coverers: WordArray,
) -> None:
    """Find the poses that see what one of a row's windows is asked for.

    Parameters
    ----------
    columns : (n_frames, n_words) uint64
        Poses that see each frame.
    start : (n_chains + 1,) int
        First link of each chain.
    asked : (n_links,) int
        Frame that each window is asked for; -1: every pose will do.
    row_chain, row_last : (n_rows,) int
        Row r has the first ``row_last[r]`` windows of chain ``row_chain[r]``.
    begin, end : int
        Rows begin .. end - 1 are looked at.
    coverers : (n_rows, n_words) uint64
        Written: poses that cover each row.
    """
    for row in range(begin, end):
        first = start[row_chain[row]]
        before = -2
        coverers[row] = 0
        for link in range(first, first + row_last[row]):
            frame = asked[link]
            if frame == before:  # neighbours are often asked for the same
                continue
            before = frame
            for word in range(columns.shape[1]):
                coverers[row, word] |= (
                    columns[frame, word] if frame >= 0 else ~np.uint64(0)
                )


# ---------- prices
@kernel
def weigh_bytes(
    weight: FloatArray, rows: WordArray, table: FloatArray, used: IntArray
) -> int:
    """Weigh each value of each byte of bits along rows; return how many count.

    Sums over bits become sums over bytes [1]_.

    Parameters
    ----------
    weight : (64 n_words,) float
        Weight of each row.
    rows : (n_words,) uint64
        Rows that count.
    table : (n_bytes, 256) float
        Written: what each value of each byte is worth.
    used : (n_bytes,) int
        Written: bytes that are worth something, first in it.

    References
    ----------
    .. [1] V. Arlazarov, E. Dinic, M. Kronrod, I. Faradzev, "On economical
       construction of the transitive closure of a directed graph", 1970.
    """
    n_used = 0
    for place in range(len(table)):
        counted = (rows[place >> 3] >> np.uint64(8 * (place & 7))) & np.uint64(0xFF)
        if counted == 0:
            continue
        used[n_used] = place
        n_used += 1
        of_byte = table[place]
        of_byte[0] = 0.0
        for bit in range(8):
            is_counted = (counted >> np.uint64(bit)) & np.uint64(1)
            if is_counted:
                amount = weight[8 * place + bit]
            else:
                amount = 0.0
            for value in range(1 << bit):
                of_byte[value + (1 << bit)] = of_byte[value] + amount
    return n_used


@kernel
def weight_of(
    covers: ByteArray, table: FloatArray, used: IntArray, n_used: int
) -> float:
    """Worth of a pose's bits along rows, by a table of bytes."""
    total = 0.0
    for number in range(n_used):
        place = used[number]
        total += table[place, covers[place]]
    return total


@kernel
def weights_of(
    covers: ByteArray, table: FloatArray, used: IntArray, n_used: int, total: FloatArray
) -> None:
    """Find the worth of the bits of each pose, (n_poses,), by a table of bytes."""
    for pose in range(len(covers)):
        total[pose] = weight_of(covers[pose], table, used, n_used)


@kernel
def pick_best(gain: FloatArray, choice: Choice, picked: IntArray) -> tuple[float, int]:
    """Pick poses that gain most and have room; return their sum and number.

    Parameters
    ----------
    gain : (n_poses,) float
        What each pose gains; only positive gains are picked.
    choice : Choice
        Number of units, and room at the sites.
    picked : (n_units,) int
        Written: the poses, best first.
    """
    total = 0.0
    n_picked = 0
    site = choice.site
    room = choice.room
    for _ in range(choice.n_units):
        best = -1
        most = 0.0
        for place in range(len(gain)):
            if gain[place] > most:
                here = site[place]
                left = room[here]
                for earlier in range(n_picked):
                    if picked[earlier] == place:
                        left = 0
                    elif site[picked[earlier]] == here:
                        left -= 1
                if left > 0:
                    best = place
                    most = gain[place]
        if best < 0:
            break
        picked[n_picked] = best
        n_picked += 1
        total += most
    return total, n_picked


@kernel
def pick_affordable(
    gain: FloatArray, choice: Choice, picked: IntArray
) -> tuple[float, int]:
    """Upper bound of what affordable poses gain; return it and how many are picked.

    Poses must have room and cost no more than 1 together. Any price of money bounds
    their gain: what the best poses gain beyond their price, and the price itself.
    The lowest bound is convex in the price; it is looked for by halving.
    """
    total, n_picked = pick_best(gain, choice, picked)
    cost = choice.cost
    if len(cost) == 0 or cost[picked[:n_picked]].sum() <= 1.0:
        return total, n_picked
    low = 0.0
    high = total
    for _ in range(16):  # prices of money
        middle = 0.5 * (low + high)
        of_poses, n_picked = pick_best(gain - middle * cost, choice, picked)
        total = min(total, of_poses + middle)
        if cost[picked[:n_picked]].sum() > 1.0:
            low = middle
        else:
            high = middle
    return total, n_picked


@kernel
def row_limit(
    reward: FloatArray, weight: float, n_units: int, price: float
) -> tuple[float, int]:
    """Most that a row is worth after paying each covering unit; how many cover it."""
    most = weight * reward[0]
    units = 0
    for number in range(1, n_units + 1):
        value = weight * reward[number] - number * price
        if value > most:
            most = value
            units = number
    return most, units


@kernel
def tighten_prices(
    covers: ByteArray,
    choice: Choice,
    weight: FloatArray,
    reward: FloatArray,
    price: FloatArray,
    n_steps: int,
    timing: FloatArray,
    share: FloatArray,
) -> float:
    """Lower the bound of sets by subgradient steps on the prices of rows.

    Parameters
    ----------
    covers : (n_poses, n_bytes) uint8
        A bit for each row, lowest first.
    choice : Choice
        Poses that may be chosen, and how many.
    weight : (n_rows,) float
        Weight of each row.
    reward : (n_units + 2,) float
        Worth of a row by the number of units that cover it.
    price : (n_rows,) float
        Where to begin; overwritten by the prices that prove the bound.
    n_steps : int
        Steps; with 0 the bound that the prices prove as they are.
    timing : (5,) float
        Step length, cut, deflection, memory and patience, see
        :mod:`placement.optimiser.constants`.
    share : (n_poses,) float
        Overwritten by how often each pose was picked of late.

    Returns
    -------
    bound : float
        No set of so many units is worth more.
    """
    length, cut, deflection, memory, patience = timing
    n_units = choice.n_units
    is_open = choice.is_open
    n_rows = len(price)
    n_poses = len(share)
    best = np.inf
    idle = 0
    best_price = np.empty(n_rows)
    slope = np.zeros(n_rows)
    units = np.zeros(n_rows, dtype=np.int64)
    gain = np.empty(n_poses)
    picked = np.empty(max(n_units, 1), dtype=np.int64)
    table = np.empty((covers.shape[1], 256))
    used = np.empty(covers.shape[1], dtype=np.int64)
    every = np.full(-(-covers.shape[1] // 8), ~np.uint64(0))
    for row in range(n_rows, 64 * len(every)):  # padding behind the rows
        every[row >> 6] &= ~(np.uint64(1) << np.uint64(row & 63))
    for step in range(n_steps + 1):
        # The bound at these prices: what rows are worth beyond them, and the best
        # poses.
        total = 0.0
        for row in range(n_rows):
            most = weight[row] * (reward[1] - reward[0])
            price[row] = min(max(price[row], 0.0), most)
            value, units[row] = row_limit(reward, weight[row], n_units, price[row])
            total += value
        n_used = weigh_bytes(price, every, table, used)
        for pose in range(n_poses):
            if is_open[pose]:
                gain[pose] = weight_of(covers[pose], table, used, n_used)
            else:
                gain[pose] = 0.0
        of_poses, n_picked = pick_affordable(gain, choice, picked)
        total += of_poses
        share *= memory
        for pose in picked[:n_picked]:
            share[pose] += 1.0 - memory
        if total < best * (1.0 - 1.0e-12):
            best = total
            idle = 0
            best_price[:] = price
        else:
            idle += 1
        if step == n_steps:
            break
        if idle > patience:
            price[:] = best_price
            slope[:] = 0.0
            length = length * cut
            idle = 0
            continue
        # A step against the slope: poses that cover the row less the units it would pay
        # for.
        steepness = 0.0
        for row in range(n_rows):
            rise = -float(units[row])
            for pose in picked[:n_picked]:
                rise += (covers[pose, row >> 3] >> (row & 7)) & 1
            slope[row] = rise + deflection * slope[row]
            steepness += slope[row] * slope[row]
        if steepness < 1.0e-12:
            break
        for row in range(n_rows):
            price[row] -= length * total / steepness * slope[row]
    price[:] = best_price
    return best


# ---------- the walk
DONE = 0
PAUSED = 1
FULL = 2
AT_STOP = 3


class Covers(NamedTuple):
    """Covering problem of a walk: it stays as it is.

    Attributes
    ----------
    covers : (n_poses, n_row_words) uint64
        Rows that each pose covers.
    coverers : (n_rows, n_pose_words) uint64
        Poses that cover each row.
    rows : (n_poses, n_bytes) uint8
        `covers` by bytes, lowest bits first.
    weight : (n_rows,) float
        Weight of each row.
    price : (n_rows,) float
        Lagrangian price of each row, at most the weight.
    site : (n_poses,) int
        Site of each pose.
    copies : (n_poses,) int
        How often a pose may be chosen: it stands for its class.
    """

    covers: WordArray  # (n_poses, n_row_words): rows that each pose covers
    coverers: WordArray  # (n_rows, n_pose_words): poses that cover each row
    rows: ByteArray  # (n_poses, n_bytes): `covers` by bytes, lowest bits first
    weight: FloatArray  # (n_rows,)
    price: FloatArray  # (n_rows,): at most the weight
    site: IntArray  # (n_poses,)
    copies: IntArray  # (n_poses,): how often a pose may be chosen


class Walk(NamedTuple):
    """Where a walk stands; arrays have a place for each depth."""

    # (5,): depth; whether its node is new; sets found; bytes looked at; depth behind
    # which the walk began.
    where: IntArray
    # (2,): weight of rows that all units, and all but the failed, may lose
    may_lose: FloatArray
    chosen: IntArray  # (n_units,)
    once: WordArray  # (n_units + 1, n_row_words): rows that a unit covers
    twice: WordArray  # the same, that two do
    gone: WordArray  # the same, that nothing covers any more
    lost: FloatArray  # (n_units + 1,): what those weigh
    is_open: BoolArray  # (n_units + 1, n_poses): candidates
    room: IntArray  # (n_units + 1, n_sites)
    queue: (
        IntArray  # (n_units, n_poses): candidates that are tried, one after the other
    )
    n_queued: IntArray  # (n_units,)
    position: IntArray  # (n_units,)
    gain: FloatArray  # (n_poses,): working space
    beside: FloatArray  # (n_poses,): working space
    table: FloatArray  # (n_bytes, 256): working space
    used: IntArray  # (n_bytes,): working space
    best: IntArray  # (n_units,): working space


@kernel
def add_gains(
    covers: Covers, weight: FloatArray, rows: WordArray, walk: Walk, gain: FloatArray
) -> float:
    """Add to each candidate's gain what it covers of some rows; return their weight."""
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
    """Drop candidates that cannot gain enough with others; True if some may do.

    Parameters
    ----------
    gain : (n_poses,) float
        What each candidate gains.
    is_open : (n_poses,) bool
        Candidates; those that cannot help are dropped.
    n_more : int
        So many candidates together have to gain `need`. With none to choose,
        nothing is dropped.
    need : float
        What they have to gain.
    best : (n_units,) int
        Working space.
    """
    if n_more <= 0:
        return need <= 0.0
    most = 0.0
    least = 0.0
    for number in range(n_more):
        highest = -1.0
        pose = -1
        for other in range(len(gain)):
            if (
                is_open[other]
                and gain[other] > highest
                and not has_entry(best[:number], other)
            ):
                highest = gain[other]
                pose = other
        if pose < 0:
            break
        best[number] = pose
        least = highest
        most += highest
    if most < need:
        return False
    # Whatever is not among the best takes the place of the last of them.
    for pose in range(len(gain)):
        if is_open[pose] and gain[pose] < least and most - least + gain[pose] < need:
            is_open[pose] = False
    return True


@kernel
def give_up_rows(covers: Covers, walk: Walk, rows: WordArray) -> int:
    """Give up rows that nothing can cover any more; return the hardest one left.

    The hardest row is the one which fewest candidates cover; -1 if all rows are
    covered. `rows`, (n_row_words,), becomes the rows that are open.
    """
    depth = walk.where[0]
    once = walk.once[depth]
    gone = walk.gone[depth]
    candidates = np.zeros(covers.coverers.shape[1], dtype=np.uint64)
    for pose in range(walk.is_open.shape[1]):
        if walk.is_open[depth, pose]:
            candidates[pose >> 6] |= np.uint64(1) << np.uint64(pose & 63)
    hardest = -1
    fewest = len(walk.gain) + 1
    rows[:] = 0
    for row in range(len(covers.weight)):
        word = row >> 6
        mask = np.uint64(1) << np.uint64(row & 63)
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
            hardest = row
            fewest = n_covering
    return hardest


@kernel
def look_at_node(covers: Covers, walk: Walk, n_failures: int) -> bool:
    """Bound the node at hand and queue candidates; True if any candidate is left.

    Candidates that cannot help are dropped. Those queued cover the row that fewest
    cover, best first; when all of them have been tried, that row is lost.
    """
    depth = walk.where[0]
    left = len(walk.chosen) - depth
    is_open = walk.is_open[depth]
    gain = walk.gain
    beside = walk.beside
    rows = np.empty(walk.once.shape[1], dtype=np.uint64)
    hardest = give_up_rows(covers, walk, rows)
    walk.n_queued[depth] = walk.position[depth] = 0
    lost = walk.lost[depth]
    if lost > walk.may_lose[0]:
        return False
    total = 0.0
    for weight in (covers.price, covers.weight):
        gain[:] = 0.0
        total = lost + add_gains(covers, weight, rows, walk, gain)
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
            beside[:] = gain
            need = (
                total
                + add_gains(covers, covers.weight, rows, walk, beside)
                - walk.may_lose[1]
            )
            if not drop_hopeless(
                beside, is_open, left - n_failures + 1, need, walk.best
            ):
                return False
    queue = walk.queue[depth]
    n_queued = 0
    is_any = False
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
    """Go on with a walk through all sets that lose little; return why it stopped.

    Parameters
    ----------
    covers : Covers
        The covering problem.
    walk : Walk
        Where the walk stands; changed.
    n_failures : int
        Units that fail.
    stop : int
        Nodes of this depth are not looked into: the walk pauses at each. -1: none.
    max_work : int
        The walk pauses after so many bytes.
    out : (n, n_units) int
        Written: the sets that were found.

    Returns
    -------
    state : int
        DONE, PAUSED, FULL (`out` is) or AT_STOP.
    """
    n_poses = walk.is_open.shape[1]
    n_units = len(walk.chosen)
    begun = walk.where[3]
    base = walk.where[4]
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
            out[walk.where[2]] = walk.chosen
            walk.where[2] += 1
            walk.position[depth] += 1
            walk.is_open[depth, pose] = False
            continue
        walk.position[depth] += 1
        after = depth + 1
        walk.is_open[after] = walk.is_open[depth]
        walk.is_open[depth, pose] = False
        if (walk.chosen[:after] == pose).sum() >= covers.copies[pose]:
            walk.is_open[after, pose] = False
        here = covers.site[pose]
        walk.room[after] = walk.room[depth]
        walk.room[after, here] -= 1
        if walk.room[after, here] <= 0:
            for other in range(n_poses):
                if covers.site[other] == here:
                    walk.is_open[after, other] = False
        for word in range(walk.once.shape[1]):
            of_pose = covers.covers[pose, word]
            walk.twice[after, word] = walk.twice[depth, word] | (
                walk.once[depth, word] & of_pose
            )
            walk.once[after, word] = walk.once[depth, word] | of_pose
        walk.gone[after] = walk.gone[depth]
        walk.lost[after] = walk.lost[depth]
        walk.where[0] = after
        walk.where[1] = 1
    return DONE


class Losses(NamedTuple):
    """What sets lose on the windows, and how much they may.

    Attributes
    ----------
    chains : Chains
        Windows and tails.
    lost : (n_chains, longest + 1) float
        Weight that is lost in each chain by its first live window.
    order : (n_chains,) int
        Chains in the order in which they are looked at; those at which sets fail
        come earlier the next time.
    may_lose : (2,) float
        Weight that all units may lose; and all without any one of them.
    base : (n_words,) uint64
        Frames that are in every set.
    """

    chains: Chains
    lost: FloatArray  # (n_chains, longest + 1): by the first live window of each chain
    order: IntArray  # (n_chains,): chains at which sets fail come earlier the next time
    may_lose: FloatArray  # (2,): in all; and without any one of the units
    base: WordArray  # (n_words,): frames that are in every set


@kernel
def can_keep(bits: WordArray, losses: Losses, with_failures: bool) -> bool:
    """True if units, (n_units, n_words), lose little, and without each on failure."""
    chains, lost, order, may_lose, base = losses
    n_units = len(bits)
    union = np.empty(len(base), dtype=np.uint64)
    first = np.empty(len(lost), dtype=np.int64)
    # All units together, then all but each one of them.
    for failed in range(n_units, -1 if with_failures else n_units - 1, -1):
        union[:] = base
        for unit in range(n_units):
            if unit != failed:
                for word in range(len(union)):
                    union[word] |= bits[unit, word]
        if failed == n_units:
            may = may_lose[0]
        else:
            may = may_lose[1]
        rank = look_through(union, chains, order, lost, may, first)
        if rank < len(order):
            before = (
                rank // 2
            )  # nearer to the front, not all the way: some fail by chance
            order[rank], order[before] = order[before], order[rank]
            return False
    return True


class Classes(NamedTuple):
    """Poses of each class.

    Attributes
    ----------
    member : (n,) int
        Poses, class after class.
    start : (n_classes + 1,) int
        Members of class k are ``start[k] .. start[k + 1] - 1``.
    words : (n_classes, n_words) uint64
        Frames that the poses of each class see together.
    """

    member: IntArray  # poses, class after class
    # (n_classes + 1,): members of class k are start[k] .. start[k + 1] - 1
    start: IntArray
    words: WordArray  # (n_classes, n_words): what all poses of each class see


@kernel
def spell_out(
    words: WordArray,
    of_classes: Classes,
    losses: Losses,
    with_failures: bool,
    classes: IntArray,
    place: IntArray,
    out: IntArray,
) -> int:
    """Find sets of poses, one of each class, that lose little; return how many.

    Parameters
    ----------
    words : (n_poses, n_words) uint64
        Frames that each pose sees.
    of_classes : Classes
        Poses of each class.
    losses : Losses
        What sets may lose.
    with_failures : bool
        True if it counts what is left without each unit, too.
    classes : (n_units,) int
        One class for each unit, ascending.
    place : (n_units + 1,) int
        Where the search stands: the member looked at for each unit, and last the
        number of units that are settled, or -1 when all sets were seen. Changed.
    out : (n, n_units) int
        Written: the sets.
    """
    member, start, class_words = of_classes
    n_units = len(classes)
    bits = np.empty((n_units, words.shape[1]), dtype=np.uint64)
    unit = place[n_units]
    n_found = 0
    for number in range(n_units):
        is_settled = number < unit
        if is_settled:
            bits[number] = words[member[place[number]]]
        else:
            bits[number] = class_words[classes[number]]
    if unit == 0 and place[0] < start[classes[0]]:
        place[0] = start[classes[0]]
        if not can_keep(bits, losses, with_failures):
            unit = -1
    # A member of the class of one unit after the other; units behind see what their
    # class sees.
    while unit >= 0:
        if place[unit] == start[classes[unit] + 1]:
            bits[unit] = class_words[classes[unit]]
            unit -= 1
            if unit >= 0:
                place[unit] += 1
            continue
        if n_found == len(out):
            break
        bits[unit] = words[member[place[unit]]]
        if not can_keep(bits, losses, with_failures):
            place[unit] += 1
        elif unit + 1 == n_units:
            out[n_found] = member[place[:n_units]]
            n_found += 1
            place[unit] += 1
        else:
            is_same = classes[unit + 1] == classes[unit]
            if is_same:
                place[unit + 1] = place[unit] + 1
            else:
                place[unit + 1] = start[classes[unit + 1]]
            unit += 1
    place[n_units] = unit
    return n_found


@kernel
def lost_by_pairs(
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    table: FloatArray,
    may_lose: float,
    pairs: IntArray,
    lost: FloatArray,
) -> None:
    """Count what pairs of units lose at least, until it is too much.

    Bits are along the rows, the hardest first. A pair may avoid a row only if one
    of the two sees what is asked for, and one avoids it or both see a part.

    Parameters
    ----------
    alone : (n_units, n_row_words) uint64
        Rows that each unit avoids next to the others.
    may : (n_units, n_row_words) uint64
        Rows of which it sees what is asked for.
    part : (n_units, n_row_words) uint64
        Rows of which it sees a piece that is missing.
    table : (n_bytes, 256) float
        What each value of each byte of rows weighs.
    may_lose : float
        Counting ends when a pair loses more.
    pairs : (n, 2) int
        Units of each pair.
    lost : (n,) float
        Written: what each pair loses at least.
    """
    for number in range(len(pairs)):
        one = pairs[number, 0]
        other = pairs[number, 1]
        total = 0.0
        # 64 rows at a time, the hardest first.
        for word in range(alone.shape[1]):
            covered = (
                alone[one, word]
                | alone[other, word]
                | (part[one, word] & part[other, word])
            )
            left = ~(covered & (may[one, word] | may[other, word]))
            place = 8 * word
            while left:
                total += table[place, left & np.uint64(0xFF)]
                left >>= np.uint64(8)
                place += 1
            if total > may_lose:
                break
        lost[number] = total


@kernel
def keep_sets(
    words: WordArray, sets: IntArray, losses: Losses, kept: BoolArray
) -> None:
    """Mark the sets of poses, (n_sets, n_units), that lose no more than they may."""
    for number in range(len(sets)):
        kept[number] = can_keep(words[sets[number]], losses, False)
