"""Machine code of presolve: tables turned round, equal rows, dominated poses and windows.

Everything here works on plain arrays; :mod:`placement.optimiser.presolve` says what they hold.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .frame_kernels import turn_blocks
from .problem import Chains, WordArray

ByteArray = NDArray[np.uint8]

_N_TOGETHER = 16  # words turned side by side, which fill lines of memory
_N_LOOK = 24  # words of a pose by which others are told that see less


@kernel
def turn_round(rows: ByteArray, columns: WordArray) -> None:
    """Bits along the rows of a table as bits along its columns.

    (n_rows, n_bytes) -> (8 n_bytes, n_words), n_words * 64 >= n_rows; lowest bits come first.
    """
    turn_chosen(rows, np.arange(len(rows)), np.arange(8 * rows.shape[1]), columns)


@kernel
def turn_chosen(rows: ByteArray, chosen: IntArray, place: IntArray, columns: WordArray) -> None:
    """The same of some rows of a table, and of some of its columns.

    `chosen`, (n,), are rows; `place`, (8 n_bytes,), says which row of `columns`, (n_left, n_words),
    becomes of each bit, or is negative.
    """
    block = np.empty((64, _N_TOGETHER), dtype=np.uint64)
    n_rows, n_bytes, n_words = len(chosen), rows.shape[1], columns.shape[1]
    for begin in range(0, n_words, _N_TOGETHER):
        n_together = min(_N_TOGETHER, n_words - begin)
        for first in range(0, n_bytes, 8):
            n_there = min(8, n_bytes - first)
            for lane in range(n_together):
                word = begin + lane
                n_in_block = max(0, min(64, n_rows - 64 * word))
                for bit in range(n_in_block, 64):
                    block[bit, lane] = 0
                for bit in range(n_in_block):
                    row = rows[chosen[64 * word + bit]]
                    if n_there == 8:  # the compiler makes one load of these
                        value = (
                            np.uint64(row[first])
                            | np.uint64(row[first + 1]) << np.uint64(8)
                            | np.uint64(row[first + 2]) << np.uint64(16)
                            | np.uint64(row[first + 3]) << np.uint64(24)
                            | np.uint64(row[first + 4]) << np.uint64(32)
                            | np.uint64(row[first + 5]) << np.uint64(40)
                            | np.uint64(row[first + 6]) << np.uint64(48)
                            | np.uint64(row[first + 7]) << np.uint64(56)
                        )
                    else:
                        value = np.uint64(0)
                        for byte in range(n_there):
                            value |= np.uint64(row[first + byte]) << np.uint64(8 * byte)
                    block[bit, lane] = value
            turn_blocks(block)
            for bit in range(8 * n_there):
                column = place[8 * first + bit]
                if column >= 0:
                    for lane in range(n_together):
                        columns[column, begin + lane] = block[bit, lane]


@kernel
def join_ranges(rows: WordArray, begin: IntArray, end: IntArray, joined: WordArray) -> None:
    """Bits that are set in one of the rows begin .. end - 1: (n_rows, n) -> (n_ranges, n)."""
    for place in range(len(begin)):
        joined[place] = 0
        for row in range(begin[place], end[place]):
            for word in range(rows.shape[1]):
                joined[place, word] |= rows[row, word]


@kernel
def have_bits(rows: WordArray, kept: WordArray, has_bits: BoolArray) -> None:
    """Whether rows have any of the bits in `kept`, (n_words,)."""
    for row in range(len(rows)):
        has_bits[row] = False
        for word in range(rows.shape[1]):
            if rows[row, word] & kept[word]:
                has_bits[row] = True
                break


@kernel
def lack_nothing(rows: WordArray, kept: WordArray, lacks_nothing: BoolArray) -> None:
    """Whether rows but the last have all the bits in `kept`, (n_words,), that the next one has."""
    for row in range(len(rows) - 1):
        lacks_nothing[row] = True
        for word in range(rows.shape[1]):
            if rows[row + 1, word] & ~rows[row, word] & kept[word]:
                lacks_nothing[row] = False
                break


@kernel
def mix_rows(rows: WordArray, kept: WordArray, mixed: WordArray) -> None:
    """A number for each row, equal for rows that are equal within `kept`, (n_words,)."""
    for row in range(len(rows)):
        value = np.uint64(0x9E3779B97F4A7C15)
        for word in range(rows.shape[1]):
            value = (value ^ (rows[row, word] & kept[word])) * np.uint64(0xFF51AFD7ED558CCD)
            value ^= value >> np.uint64(32)
        mixed[row] = value


@kernel
def number_rows(
    rows: WordArray, kept: WordArray, mixed: WordArray, slots: IntArray, number: IntArray
) -> int:
    """Number distinct rows by their first appearance; how many there are.

    Only the bits in `kept`, (n_words,), count; `mixed` are what :func:`mix_rows` makes of them.
    `slots`, a power of two of -1, more than rows, is working space: what becomes of it are the
    first rows with each number, behind one another.
    """
    first = np.empty(len(rows), dtype=np.int64)
    n_distinct, n_slots = 0, len(slots)
    for row in range(len(rows)):
        slot = np.int64(mixed[row] & np.uint64(n_slots - 1))
        while slots[slot] >= 0:
            other = first[slots[slot]]
            is_equal = mixed[row] == mixed[other]
            for word in range(rows.shape[1]):
                if not is_equal:
                    break
                is_equal = (rows[row, word] ^ rows[other, word]) & kept[word] == 0
            if is_equal:
                break
            slot = (slot + 1) & (n_slots - 1)
        if slots[slot] < 0:
            slots[slot] = n_distinct
            first[n_distinct] = row
            n_distinct += 1
        number[row] = slots[slot]
    for place in range(n_distinct):
        slots[place] = first[place]
    return n_distinct


@kernel
def find_dominated(
    words: WordArray,
    order: IntArray,
    looked: IntArray,
    columns: WordArray,
    poses: IntArray,
    most: WordArray,
    site: IntArray,
    price: FloatArray,
    elsewhere: FloatArray,
    affordable: FloatArray,
    may_move: BoolArray,
    capacity: IntArray,
    max_units: int,
    begin: int,
    step: int,
    dominated: BoolArray,
) -> None:
    """Poses whose dominators other units cannot use up.

    Poses come in the order of dominance, but for the rows of `words`, which `order` gives. Every
    `step`-th of `poses` from `begin` on is looked at. `columns`, (n_looked, n_poses), are some of
    the words, `looked`, by which most poses are told that see less. `most`, what dominators may
    see, has a row for each of `poses`, or none where they may see anything. A dominator costs no
    more than `affordable`, by its `price` at the same site, `elsewhere` at another one, if the pose
    `may_move` there.
    """
    n_words = words.shape[1]
    needed, has_bits = np.empty(n_words, dtype=np.int64), np.empty(len(looked), dtype=np.int64)
    above = np.empty(len(words), dtype=np.int64)
    at_site = np.zeros(len(capacity), dtype=np.int64)
    for place in range(begin, len(poses), step):
        pose = poses[place]
        row, own, n_blockers, n_needed, n_above, n_look = order[pose], site[pose], 0, 0, 0, 0
        at_site[:] = 0
        dominated[pose] = capacity[own] <= 0 or max_units <= 0
        if dominated[pose]:
            continue
        for other in range(pose - 1, -1, -1):  # those that see little more come first
            if (site[other] == own and price[other] <= affordable[pose]) or (
                may_move[pose] and elsewhere[other] <= affordable[pose]
            ):
                above[n_above] = other
                n_above += 1
        for number in range(len(looked)):
            if columns[number, pose]:
                has_bits[n_look] = number
                n_look += 1
        # Word by word they lie side by side.
        for number in range(min(_N_LOOK, n_look)):
            column, n_left = columns[has_bits[number * n_look // min(_N_LOOK, n_look)]], 0
            for rank in range(n_above):
                above[n_left] = above[rank]
                n_left += column[pose] & ~column[above[rank]] == 0
            n_above = n_left
        if n_above == 0:
            continue
        for word in range(n_words):
            if words[row, word]:
                needed[n_needed] = word
                n_needed += 1
        for rank in range(n_above):
            other = above[rank]
            there = site[other]
            if at_site[there] >= capacity[there]:
                continue
            is_above = True
            for number in range(n_needed):
                word = needed[number]
                if words[row, word] & ~words[order[other], word]:
                    is_above = False
                    before = number // 2  # where others fail, too
                    needed[number], needed[before] = needed[before], word
                    break
            if is_above and len(most):
                for word in range(n_words):
                    if words[order[other], word] & ~most[place, word]:
                        is_above = False
                        break
            if is_above:
                at_site[there] += 1
                n_blockers += 1
                dominated[pose] = at_site[own] >= capacity[own] or n_blockers > max_units - 1
                if dominated[pose]:
                    break


@kernel
def let_settled(first: IntArray, n_common: IntArray, chains: Chains, settled: WordArray) -> None:
    """Take the merged frames of all chains that are not settled from `settled`, (n_words,).

    `first`, (n_chains,), is the first live window of each chain, `n_common`, (n_chains,), how many
    of its windows come in time for all its runs: a chain is settled if it is among these.
    """
    window_frames, window, start, tail_frame, _, tail_start = chains
    for chain in range(len(first)):
        if first[chain] < n_common[chain]:
            continue
        for link in range(start[chain], start[chain + 1]):
            for frame in window_frames[window[link]]:
                settled[frame >> 6] &= ~(np.uint64(1) << np.uint64(frame & 63))
        for tail in range(tail_start[chain], tail_start[chain + 1]):
            frame = tail_frame[tail]
            settled[frame >> 6] &= ~(np.uint64(1) << np.uint64(frame & 63))


@kernel
def thin_out(
    sets: IntArray,
    set_start: IntArray,
    tail_frame: IntArray,
    tail_start: IntArray,
    n_links: IntArray,
    is_kept: BoolArray,
) -> None:
    """Windows of runs that are not dominated, and how many of them need each tail.

    `sets`, (n_windows, n_frames), are the frames of windows, run by run, ascending in time;
    `n_links` says how many windows of its run need each tail, and becomes the number of those kept
    that do.
    """
    for run in range(len(set_start) - 1):
        begin, end = set_start[run], set_start[run + 1]
        for tail in range(tail_start[run], tail_start[run + 1]):
            # A window that needs the very frame that a tail is, too, is never without the tail.
            while n_links[tail] > 0 and has_entry(
                sets[begin + n_links[tail] - 1], tail_frame[tail]
            ):
                n_links[tail] -= 1
        for window in range(begin, end):
            # Windows before this one need a tail that this one neither needs nor ensures.
            first = 0
            for tail in range(tail_start[run], tail_start[run + 1]):
                n_before = n_links[tail]
                if first < n_before <= window - begin and not has_entry(
                    sets[window], tail_frame[tail]
                ):
                    first = n_before
            is_kept[window] = True
            for earlier in range(begin + first, window):
                is_part = True
                for frame in sets[earlier]:
                    is_part &= has_entry(sets[window], frame)
                if is_part:
                    is_kept[window] = False
                    break
        for tail in range(tail_start[run], tail_start[run + 1]):
            n_kept = 0
            for window in range(begin, begin + n_links[tail]):
                n_kept += is_kept[window]
            n_links[tail] = n_kept


@kernel
def has_entry(entries: IntArray, entry: int) -> bool:
    """Whether a number is among others."""
    is_there = False
    for other in entries:
        is_there |= other == entry
    return is_there
