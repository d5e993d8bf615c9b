"""Numba kernels of the covering problem and of the walk through its sets.

In this order: what windows are asked for and which poses cover a row, prices
that bound all sets, the walk, and what the sets that it meets lose on the
windows. Bits along rows, poses or frames are 64-bit words, lowest bit first.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .allowed_sets import Choice
from .bit_kernels import (
    copy_entries,
    count_bits,
    has_bit,
    has_entry,
    look_through,
    lowest_bit,
)
from .problem import Chains, WordArray

ByteArray = NDArray[np.uint8]


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
            # Neighbours are often asked for the same.
            if frame == before:
                continue
            before = frame
            if frame >= 0:
                for word in range(columns.shape[1]):
                    coverers[row, word] |= columns[frame, word]
            else:
                coverers[row] = ~np.uint64(0)


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
    # Bytes of rows, lowest first.
    for place in range(len(table)):
        counted = (rows[place >> 3] >> np.uint64(8 * (place & 7))) & np.uint64(0xFF)
        if counted == 0:
            continue
        used[n_used] = place
        n_used += 1
        of_byte = table[place]
        of_byte[0] = 0.0
        # Values that have this bit as their highest are those before them, and the bit.
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
        # The pose that gains most of those not picked whose sites have room left.
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


# Loops instead of array expressions: numba takes seconds to compile each of those.
@kernel
def _sum_of(values: FloatArray, places: IntArray, n: int) -> float:
    """Sum of the values at the first `n` places."""
    total = 0.0
    for number in range(n):
        total += values[places[number]]
    return total


@kernel
def _count(values: IntArray, n: int, wanted: int) -> int:
    """How many of the first `n` values are the wanted one."""
    n_equal = 0
    for number in range(n):
        n_equal += values[number] == wanted
    return n_equal


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
    if len(cost) == 0 or _sum_of(cost, picked, n_picked) <= 1.0:
        return total, n_picked
    low = 0.0
    high = total
    # Prices of money.
    for _ in range(16):
        middle = 0.5 * (low + high)
        of_poses, n_picked = pick_best(gain - middle * cost, choice, picked)
        total = min(total, of_poses + middle)
        if _sum_of(cost, picked, n_picked) > 1.0:
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
    by_byte: ByteArray,
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
    by_byte : (n_bytes, n_poses) uint8
        What each pose covers: a bit for each row, lowest first.
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
    table = np.empty((len(by_byte), 256))
    used = np.empty(len(by_byte), dtype=np.int64)
    every = np.full(-(-len(by_byte) // 8), ~np.uint64(0))
    # Padding behind the rows.
    for row in range(n_rows, 64 * len(every)):
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
        # Poses side by side, so that no addition waits for the one before it.
        gain[:] = 0.0
        for number in range(n_used):
            place = used[number]
            for pose in range(n_poses):
                gain[pose] += table[place, by_byte[place, pose]]
        for pose in range(n_poses):
            if not is_open[pose]:
                gain[pose] = 0.0
        of_poses, n_picked = pick_affordable(gain, choice, picked)
        total += of_poses
        for pose in range(n_poses):
            share[pose] *= memory
        for pose in picked[:n_picked]:
            share[pose] += 1.0 - memory
        if total < best * (1.0 - 1.0e-12):
            best = total
            idle = 0
            copy_entries(price, best_price)
        else:
            idle += 1
        if step == n_steps:
            break
        if idle > patience:
            copy_entries(best_price, price)
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
                rise += (by_byte[row >> 3, pose] >> (row & 7)) & 1
            slope[row] = rise + deflection * slope[row]
            steepness += slope[row] * slope[row]
        if steepness < 1.0e-12:
            break
        for row in range(n_rows):
            price[row] -= length * total / steepness * slope[row]
    copy_entries(best_price, price)
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

    covers: WordArray
    coverers: WordArray
    rows: ByteArray
    weight: FloatArray
    price: FloatArray
    site: IntArray
    copies: IntArray


POSITION = np.dtype(
    (
        np.record,
        [
            ("depth", np.int64),
            ("is_new", np.int64),
            ("n_found", np.int64),
            ("work", np.int64),
            ("base", np.int64),
        ],
    )
)
"""Where a walk stands: one record that its kernels change.

depth
    Units that are chosen so far: the depth of the node at hand.
is_new
    1 if the node at hand has not been looked at yet, else 0.
n_found
    Sets that were written since the walk was last told to go on.
work
    Bytes that the walk has looked at.
base
    Depth of the node behind which the walk began; it ends when it leaves it.
"""

# What sets may lose, by what is left of them.
# All units work.
WHOLE = 0
# As many have failed as may.
ON_FAILURE = 1


def build_position(depth: int = 0) -> np.recarray[Any, Any]:
    """Position of a walk that begins at a node of some depth: one record, (1,)."""
    position = np.recarray(1, dtype=POSITION)
    position[0] = (depth, 1, 0, 0, depth)
    return position


class Walk(NamedTuple):
    """A walk through sets of classes, and its nodes from the root to the one at hand.

    A node of depth d has d chosen units, which the nodes above it queued::

        depth 0   no unit             queue[0] = 4 9 7        position[0] = 2
                                                 |
                                      chosen[0] = 9
                                                 |
        depth 1   unit 9              queue[1] = 2 8          position[1] = 1
                                                 |
                                      chosen[1] = 2
                                                 |
        depth 2   units 9, 2          not looked at yet: is_new = 1

    A node asks for the row that fewest of its candidates cover, its *hardest* row,
    and queues the candidates that cover it, the best first. Each one that is tried
    is the unit of a node below, and is no candidate any more when the walk comes
    back: no set is met twice. When the queue is through, nothing that is left
    covers the hardest row: the row is given up, and the node asks for the next one.
    A node ends when what is given up weighs too much, or no candidate is left.

    Row d of the arrays below is the node of depth d on the way to the one at hand.

    Attributes
    ----------
    at : (1,) record
        Where the walk stands, see :data:`POSITION`.
    may_lose : (2,) float
        Weight of rows that all units, ``WHOLE``, and all but the failed,
        ``ON_FAILURE``, may lose.
    chosen : (n_units,) int
        Unit that leads from the node of each depth to the one below.
    covered : (n_units + 1, n_row_words) uint64
        Rows that a chosen unit covers.
    covered_twice : (n_units + 1, n_row_words) uint64
        Rows that two of them do: these stay covered when one fails.
    given_up : (n_units + 1, n_row_words) uint64
        Rows that nothing covers any more.
    weight_given_up : (n_units + 1,) float
        What those weigh.
    is_open : (n_units + 1, n_poses) bool
        Candidates.
    room : (n_units + 1, n_sites) int
        Units that each site can still carry.
    queue : (n_units, n_poses) int
        Candidates that are tried, one after the other.
    n_queued : (n_units,) int
        How many those are.
    position : (n_units,) int
        Place in the queue of the next one.
    gain, gain_beside : (n_poses,) float
        Working space: what each candidate gains, and next to a unit that fails.
    table : (n_bytes, 256) float
        Working space of :func:`weigh_bytes`.
    used : (n_bytes,) int
        Working space of :func:`weigh_bytes`.
    best : (n_units,) int
        Working space of :func:`drop_hopeless`.
    """

    at: np.recarray[Any, Any]
    may_lose: FloatArray
    chosen: IntArray
    covered: WordArray
    covered_twice: WordArray
    given_up: WordArray
    weight_given_up: FloatArray
    is_open: BoolArray
    room: IntArray
    queue: IntArray
    n_queued: IntArray
    position: IntArray
    gain: FloatArray
    gain_beside: FloatArray
    table: FloatArray
    used: IntArray
    best: IntArray


@kernel
def add_gains(
    covers: Covers, weight: FloatArray, rows: WordArray, walk: Walk, gain: FloatArray
) -> float:
    """Add to each candidate's gain what it covers of some rows; return their weight."""
    at = walk.at[0]
    is_open = walk.is_open[at.depth]
    n_used = weigh_bytes(weight, rows, walk.table, walk.used)
    work = 64 * n_used
    for pose in range(len(gain)):
        if is_open[pose]:
            gain[pose] += weight_of(covers.rows[pose], walk.table, walk.used, n_used)
            work += n_used
    at.work += work
    # Rows that are set, 64 at a time.
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
    # The best candidates: what they gain together, and the last of them.
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
    depth = walk.at[0].depth
    covered = walk.covered[depth]
    given_up = walk.given_up[depth]
    # Candidates as bits, to be counted by words.
    candidates = np.zeros(covers.coverers.shape[1], dtype=np.uint64)
    for pose in range(walk.is_open.shape[1]):
        if walk.is_open[depth, pose]:
            candidates[pose >> 6] |= np.uint64(1) << np.uint64(pose & 63)
    hardest = -1
    fewest = len(walk.gain) + 1
    rows[:] = 0
    # Rows that are neither covered nor given up: how many candidates cover each?
    for row in range(len(covers.weight)):
        word = row >> 6
        mask = np.uint64(1) << np.uint64(row & 63)
        if (covered[word] | given_up[word]) & mask:
            continue
        n_covering = 0
        for place in range(len(candidates)):
            n_covering += count_bits(candidates[place] & covers.coverers[row, place])
        if n_covering == 0:
            given_up[word] |= mask
            walk.weight_given_up[depth] += covers.weight[row]
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
    depth = walk.at[0].depth
    n_more = len(walk.chosen) - depth
    may_lose = walk.may_lose
    is_open = walk.is_open[depth]
    gain = walk.gain
    beside = walk.gain_beside
    # What is given up already, and which row the node asks for.
    rows = np.empty(walk.covered.shape[1], dtype=np.uint64)
    hardest = give_up_rows(covers, walk, rows)
    walk.n_queued[depth] = 0
    walk.position[depth] = 0
    lost = walk.weight_given_up[depth]
    if lost > may_lose[WHOLE]:
        return False
    # All units work: those to come must gain what may not be lost, by the prices of
    # rows, which say more, and by their weights.
    total = 0.0
    for weight in (covers.price, covers.weight):
        gain[:] = 0.0
        total = lost + add_gains(covers, weight, rows, walk, gain)
        need = total - may_lose[WHOLE]
        if not drop_hopeless(gain, is_open, n_more, need, walk.best):
            return False
    if n_failures > 0:
        # The units that fail are all still to come ..
        need = total - may_lose[ON_FAILURE]
        if not drop_hopeless(gain, is_open, n_more - n_failures, need, walk.best):
            return False
        # .. or one of them is chosen: the rows that it alone covers are open again.
        n_working = n_more - n_failures + 1
        for number in range(depth):
            of_unit = covers.covers[walk.chosen[number]]
            for word in range(len(rows)):
                rows[word] = of_unit[word] & ~walk.covered_twice[depth, word]
            copy_entries(gain, beside)
            of_rows = add_gains(covers, covers.weight, rows, walk, beside)
            need = total + of_rows - may_lose[ON_FAILURE]
            if not drop_hopeless(beside, is_open, n_working, need, walk.best):
                return False
    # Candidates that cover the hardest row, in the order of what they gain.
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
    at = walk.at[0]
    begun = at.work
    base = at.base
    while at.depth >= base:
        depth = at.depth
        if at.work - begun > max_work:
            return PAUSED
        if at.is_new == 1:
            if depth == stop:
                return AT_STOP
            at.is_new = 0
            if not look_at_node(covers, walk, n_failures):
                at.depth -= 1
                continue
        place = walk.position[depth]
        if place == walk.n_queued[depth]:
            # None of these candidates any more.
            at.is_new = 1
            continue
        pose = walk.queue[depth, place]
        walk.chosen[depth] = pose
        if depth + 1 == n_units:
            # The set is complete.
            if at.n_found == len(out):
                return FULL
            copy_entries(walk.chosen, out[at.n_found])
            at.n_found += 1
            walk.position[depth] += 1
            walk.is_open[depth, pose] = False
            continue
        # A node below, at which the pose is chosen.
        walk.position[depth] += 1
        after = depth + 1
        copy_entries(walk.is_open[depth], walk.is_open[after])
        walk.is_open[depth, pose] = False
        if _count(walk.chosen, after, pose) >= covers.copies[pose]:
            walk.is_open[after, pose] = False
        here = covers.site[pose]
        copy_entries(walk.room[depth], walk.room[after])
        walk.room[after, here] -= 1
        if walk.room[after, here] <= 0:
            for other in range(n_poses):
                if covers.site[other] == here:
                    walk.is_open[after, other] = False
        for word in range(walk.covered.shape[1]):
            of_pose = covers.covers[pose, word]
            before = walk.covered[depth, word]
            walk.covered_twice[after, word] = walk.covered_twice[depth, word] | (
                before & of_pose
            )
            walk.covered[after, word] = before | of_pose
        copy_entries(walk.given_up[depth], walk.given_up[after])
        walk.weight_given_up[after] = walk.weight_given_up[depth]
        at.depth = after
        at.is_new = 1
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
    lost: FloatArray
    order: IntArray
    may_lose: FloatArray
    base: WordArray


@kernel
def can_keep(bits: WordArray, losses: Losses, with_failures: bool) -> bool:
    """True if units, (n_units, n_words), lose little, and without each on failure."""
    chains, lost, order, may_lose, base = losses
    n_units = len(bits)
    union = np.empty(len(base), dtype=np.uint64)
    first = np.empty(len(lost), dtype=np.int64)
    # All units together, then all but each one of them.
    last = n_units
    if with_failures:
        last = 0
    for failed in range(n_units, last - 1, -1):
        copy_entries(base, union)
        for unit in range(n_units):
            if unit != failed:
                for word in range(len(union)):
                    union[word] |= bits[unit, word]
        if failed == n_units:
            may = may_lose[WHOLE]
        else:
            may = may_lose[ON_FAILURE]
        rank = look_through(union, chains, order, lost, may, first)
        if rank < len(order):
            # Nearer to the front, not all the way: some fail by chance.
            before = rank // 2
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

    member: IntArray
    start: IntArray
    words: WordArray


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
    # What units see: a pose where they are settled, else all poses of the class.
    for number in range(n_units):
        is_settled = number < unit
        if is_settled:
            copy_entries(words[member[place[number]]], bits[number])
        else:
            copy_entries(class_words[classes[number]], bits[number])
    if unit == 0 and place[0] < start[classes[0]]:
        place[0] = start[classes[0]]
        if not can_keep(bits, losses, with_failures):
            unit = -1
    # A member of the class of one unit after the other; units behind see what their
    # class sees.
    while unit >= 0:
        if place[unit] == start[classes[unit] + 1]:
            copy_entries(class_words[classes[unit]], bits[unit])
            unit -= 1
            if unit >= 0:
                place[unit] += 1
            continue
        if n_found == len(out):
            break
        copy_entries(words[member[place[unit]]], bits[unit])
        if not can_keep(bits, losses, with_failures):
            place[unit] += 1
        elif unit + 1 == n_units:
            for number in range(n_units):
                out[n_found, number] = member[place[number]]
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
