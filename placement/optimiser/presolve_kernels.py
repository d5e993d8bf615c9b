"""Machine code of presolve: tables turned round, equal rows, dominated poses and windows.

Everything here works on plain arrays; :mod:`placement.optimiser.presolve` says what they hold.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

ByteArray = NDArray[np.uint8]
WordArray = NDArray[np.uint64]

_N_LOOK = 24  # words by which poses are told that see less


@kernel
def turn_round(rows: ByteArray, columns: WordArray) -> None:
    """Bits along the rows of a table as bits along its columns.

    (n_rows, n_bytes) -> (8 n_bytes, n_words), n_words * 64 >= n_rows; lowest bits come first.
    Blocks of 64 x 64 bits are turned by exchanging their quarters, down to single bits (Warren,
    Hacker's Delight, 7-3).
    """
    block = np.empty(64, dtype=np.uint64)
    n_rows, n_bytes = rows.shape
    for word in range(columns.shape[1]):
        for first in range(0, n_bytes, 8):
            n_there = min(8, n_bytes - first)
            for bit in range(64):
                row, value = 64 * word + bit, np.uint64(0)
                if row < n_rows:
                    for byte in range(n_there):
                        value |= np.uint64(rows[row, first + byte]) << np.uint64(8 * byte)
                block[bit] = value
            width, mask = 32, np.uint64(0x00000000FFFFFFFF)
            while width:
                for one in range(64):
                    if one & width == 0:
                        other = one | width
                        swapped = ((block[one] >> np.uint64(width)) ^ block[other]) & mask
                        block[one] ^= swapped << np.uint64(width)
                        block[other] ^= swapped
                width >>= 1
                mask ^= mask << np.uint64(width)
            for bit in range(8 * n_there):
                columns[8 * first + bit, word] = block[bit]


@kernel
def join_ranges(rows: WordArray, begin: IntArray, end: IntArray, joined: WordArray) -> None:
    """Bits that are set in one of the rows begin .. end - 1: (n_rows, n) -> (n_ranges, n)."""
    for place in range(len(begin)):
        for word in range(rows.shape[1]):
            value = np.uint64(0)
            for row in range(begin[place], end[place]):
                value |= rows[row, word]
            joined[place, word] = value


@kernel
def number_rows(rows: WordArray, kept: WordArray, slots: IntArray, number: IntArray) -> int:
    """Number distinct rows by their first appearance; how many there are.

    Only the bits in `kept`, (n_words,), count. `slots`, a power of two of -1, more than rows, is
    working space: what becomes of it are the first rows with each number, behind one another.
    """
    first = np.empty(len(rows), dtype=np.int64)
    n_distinct, n_slots = 0, len(slots)
    for row in range(len(rows)):
        mixed = np.uint64(0x9E3779B97F4A7C15)
        for word in range(rows.shape[1]):
            mixed = (mixed ^ (rows[row, word] & kept[word])) * np.uint64(0xFF51AFD7ED558CCD)
            mixed ^= mixed >> np.uint64(32)
        slot = np.int64(mixed & np.uint64(n_slots - 1))
        while slots[slot] >= 0:
            other = first[slots[slot]]
            is_equal = True
            for word in range(rows.shape[1]):
                if (rows[row, word] ^ rows[other, word]) & kept[word]:
                    is_equal = False
                    break
            if is_equal:
                break
            slot = (slot + 1) & (n_slots - 1)
        if slots[slot] < 0:
            slots[slot] = n_distinct
            first[n_distinct] = row
            n_distinct += 1
        number[row] = slots[slot]
    slots[:n_distinct] = first[:n_distinct]
    return n_distinct


@kernel
def find_dominated(
    words: WordArray,
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
    """Poses whose dominators other units cannot use up; poses come in the order of dominance.

    Every `step`-th of `poses` from `begin` on is looked at. `columns` are the words turned round,
    (n_words, n_poses). `most`, what dominators may see, has a row for each of `poses`, or none
    where they may see anything. A dominator costs no more than `affordable`, by its `price` at the
    same site, `elsewhere` at another one, if the pose `may_move` there.
    """
    n_words = words.shape[1]
    needed = np.empty(n_words, dtype=np.int64)
    above = np.empty(len(words), dtype=np.int64)
    at_site = np.zeros(len(capacity), dtype=np.int64)
    for place in range(begin, len(poses), step):
        pose = poses[place]
        own, n_blockers, n_needed, n_above = site[pose], 0, 0, 0
        at_site[:] = 0
        dominated[pose] = capacity[own] <= 0 or max_units <= 0
        if dominated[pose]:
            continue
        for word in range(n_words):
            if words[pose, word]:
                needed[n_needed] = word
                n_needed += 1
        for other in range(pose - 1, -1, -1):  # those that see little more come first
            if (site[other] == own and price[other] <= affordable[pose]) or (
                may_move[pose] and elsewhere[other] <= affordable[pose]
            ):
                above[n_above] = other
                n_above += 1
        # A few words tell of most poses that they see less: word by word they lie side by side.
        for number in range(min(_N_LOOK, n_needed)):
            word = needed[number * n_needed // min(_N_LOOK, n_needed)]
            of_pose, column, n_left = words[pose, word], columns[word], 0
            for rank in range(n_above):
                above[n_left] = above[rank]
                n_left += of_pose & ~column[above[rank]] == 0
            n_above = n_left
        for rank in range(n_above):
            other = above[rank]
            there = site[other]
            if at_site[there] >= capacity[there]:
                continue
            is_above = True
            for number in range(n_needed):
                word = needed[number]
                if words[pose, word] & ~words[other, word]:
                    is_above = False
                    before = number // 2  # where others fail, too
                    needed[number], needed[before] = needed[before], word
                    break
            if is_above and len(most):
                for word in range(n_words):
                    if words[other, word] & ~most[place, word]:
                        is_above = False
                        break
            if is_above:
                at_site[there] += 1
                n_blockers += 1
                dominated[pose] = at_site[own] >= capacity[own] or n_blockers > max_units - 1
                if dominated[pose]:
                    break


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
