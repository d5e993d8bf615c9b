"""Machine code for the last two units of a set: what each of them, and both, add to the others.

Of the units that are chosen, the *union* is known. A run that they do not avoid needs, in a live
window that ends in time, all *pieces* that the union lacks: frames of the window, and tails behind
it. Of the two units to come

* one at least sees the piece that each such window is *asked* for, whichever that is;
* one sees all missing pieces of a window, or both see some.

Both hold for bits by runs, so that most pairs are found out by some words.
"""

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .chain_kernels import lowest_bit
from .frame_kernels import look_through, turn_blocks
from .problem import Chains, WordArray


@kernel
def cover_beside(
    columns: WordArray,
    union: WordArray,
    seen_by: IntArray,
    chains: Chains,
    row_chain: IntArray,
    row_last: IntArray,
    open_rows: WordArray,
    frame_0: int,
    alone: WordArray,
    may: WordArray,
    part: WordArray,
) -> None:
    """Runs that a union avoids with each of some poses, and for which each may be of use.

    `columns` has bits along the poses for frames from `frame_0` on, (n_frames, n_words); `union`
    has bits along all frames, and `seen_by`, (n_frames,), says how many see each. Row r is avoided
    by a live window among the first ``row_last[r]`` of chain ``row_chain[r]``; `open_rows` are
    looked at. Bits are written along the rows for 64 poses in each word of columns, (64 n_words,
    n_row_words): in `alone` where the pose and the union avoid the run, in `may` where it sees a
    piece that is asked for, in `part` where it sees one that is missing. Of each window, the
    missing piece is asked for that fewest see. Where `may` and `part` have no rows, `alone` is all
    that is found.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    n_words, n_phases, has_parts = columns.shape[1], window_frames.shape[1], len(may) > 0
    live, hopeful, some = (
        np.empty((64, n_words), dtype=np.uint64),
        np.empty((64, n_words), dtype=np.uint64),
        np.empty((64, n_words), dtype=np.uint64),
    )
    held = np.empty(n_words, dtype=np.uint64)  # poses that see all tails which a window needs
    # Indices without a sign: loops over words become instructions on many only with these.
    missing, n_all = np.empty(n_phases, dtype=np.uint64), np.uint64(n_words)
    for row_word in range(len(open_rows)):
        live[:], hopeful[:], some[:] = 0, 0, 0
        left = open_rows[row_word]
        while left != 0:
            bit = np.uint64(lowest_bit(left))
            left &= left - np.uint64(1)
            row = 64 * row_word + int(bit)
            chain = row_chain[row]
            held[:] = ~np.uint64(0)
            tail, last_tail = tail_start[chain], tail_start[chain + 1]
            asked_before, tail_asked = -1, -1
            for link in range(row_last[row] - 1, -1, -1):
                while tail < last_tail and tail_links[tail] > link:
                    frame = tail_frame[tail]
                    tail += 1
                    if (union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1):
                        continue
                    if tail_asked < 0 or seen_by[frame] < seen_by[tail_asked]:
                        tail_asked = frame
                    one = np.uint64(frame - frame_0)
                    for word in range(n_all):
                        held[word] &= columns[one, word]
                        some[bit, word] |= columns[one, word]
                asked, n_missing = tail_asked, 0
                of_window = window[start[chain] + link]
                for phase in range(n_phases):
                    frame = window_frames[of_window, phase]
                    if (union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1) == 0:
                        missing[n_missing] = frame - frame_0
                        n_missing += 1
                        if asked < 0 or seen_by[frame] < seen_by[asked]:
                            asked = frame
                if has_parts and asked != asked_before:
                    asked_before, one = asked, np.uint64(asked - frame_0)
                    for word in range(n_all):
                        hopeful[bit, word] |= columns[one, word]
                if n_missing == 0:
                    for word in range(n_all):
                        live[bit, word] |= held[word]
                    continue
                # Up to three at a time, one more than once if they are fewer.
                one, two = missing[0], missing[min(1, n_missing - 1)]
                three = missing[min(2, n_missing - 1)]
                if n_missing <= 3:
                    for word in range(n_all):
                        a, b = columns[one, word], columns[two, word]
                        c = columns[three, word]
                        live[bit, word] |= held[word] & a & b & c
                        some[bit, word] |= a | b | c
                    continue
                for word in range(n_all):
                    every, any_seen = held[word], np.uint64(0)
                    for number in range(n_missing):
                        every &= columns[missing[number], word]
                        any_seen |= columns[missing[number], word]
                    live[bit, word] |= every
                    some[bit, word] |= any_seen
        turn_out(live, alone, row_word)
        if has_parts:
            turn_out(hopeful, may, row_word)
            turn_out(some, part, row_word)


@kernel
def turn_some(words: WordArray, some: IntArray, begin: int, columns: WordArray) -> None:
    """Bits along some poses of bits along the frames, from word `begin` on, (n_frames, n_words)."""
    n_together = 32
    block = np.empty((64, n_together), dtype=np.uint64)
    for place in range(columns.shape[1]):
        n_poses = min(64, len(some) - 64 * place)
        for first in range(0, len(columns) >> 6, n_together):
            n_words = min(n_together, (len(columns) >> 6) - first)
            block[:] = 0
            for bit in range(n_poses):
                of_pose = words[some[64 * place + bit]]
                for word in range(n_words):
                    block[bit, word] = of_pose[begin + first + word]
            turn_blocks(block)
            for word in range(n_words):
                for bit in range(64):
                    columns[64 * (first + word) + bit, place] = block[bit, word]


@kernel
def turn_out(block: WordArray, turned: WordArray, column: int) -> None:
    """Write rows of bits along the poses, (64, n_words), as a column of words along the rows."""
    turn_blocks(block)
    for bit in range(64):
        for word in range(block.shape[1]):
            turned[64 * word + bit, column] = block[bit, word]


@kernel
def weight_of_word(left: np.uint64, word: int, table: FloatArray) -> float:
    """What the bits of a word weigh, by a table of bytes, (n_bytes, 256)."""
    place, weight = 8 * word, 0.0
    while left:
        weight += table[place, left & np.uint64(0xFF)]
        left >>= np.uint64(8)
        place += 1
    return weight


@kernel
def may_pair(one: int, other: int, site: IntArray, room: IntArray, copies: IntArray) -> bool:
    """Whether two poses can hang together: there is room at their site, and one of each kind."""
    if site[one] == site[other] and room[site[one]] < 2:
        return False
    return one != other or copies[one] >= 2


@kernel
def lost_in_word(
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    open_rows: WordArray,
    table: FloatArray,
    word: int,
    one: int,
    other: int,
) -> float:
    """What a pair of poses loses at least of the open rows of a word."""
    covered = alone[one, word] | alone[other, word] | (part[one, word] & part[other, word])
    left = open_rows[word] & ~(covered & (may[one, word] | may[other, word]))
    return weight_of_word(left, word, table)


@kernel
def find_pairs(
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    open_rows: WordArray,
    table: FloatArray,
    gain: FloatArray,
    need: float,
    may_lose: float,
    site: IntArray,
    room: IntArray,
    copies: IntArray,
    next_pair: IntArray,
    out: IntArray,
    of_out: FloatArray,
) -> int:
    """Pairs of poses that may lose so little together, (n, 2), and how much; how many they are.

    Bits are as in :func:`cover_beside`; `open_rows` count, and a row is worth
    what `table`, (n_bytes, 256), says of its byte. `gain`, falling, is what each pose may gain at
    most, of which a pair has to gain `need`. `room` is left at each site; two of a kind that has
    `copies` are a pair. `next_pair`, (2,), is where to go on: at (n, ..) all were looked at.
    """
    n_poses, n_found = len(gain), 0
    one, other = next_pair[0], next_pair[1]
    while one < n_poses and n_found < len(out):
        if other >= n_poses or gain[one] + gain[other] < need:
            if other == one:  # gains fall: nothing behind is any better
                one = n_poses
                break
            one += 1
            other = one
            continue
        if not may_pair(one, other, site, room, copies):
            other += 1
            continue
        lost = 0.0
        for word in range(len(open_rows)):
            lost += lost_in_word(alone, may, part, open_rows, table, word, one, other)
            if lost > may_lose:
                break
        if lost <= may_lose:
            out[n_found, 0], out[n_found, 1] = one, other
            of_out[n_found] = lost
            n_found += 1
        other += 1
    next_pair[0], next_pair[1] = one, other
    return n_found


@kernel
def find_pairs_within(
    class_alone: WordArray,
    class_may: WordArray,
    class_part: WordArray,
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    open_rows: WordArray,
    table: FloatArray,
    may_lose: float,
    pairs: IntArray,
    start: IntArray,
    size: IntArray,
    member: IntArray,
    begin: int,
    out: IntArray,
    of_out: FloatArray,
) -> tuple[int, int]:
    """Pairs of poses, one of each class of some pairs, that may lose so little together.

    Poses of class g are ``size[g]`` from ``member[start[g]]`` on; bits of classes and of poses are
    as in :func:`find_pairs`. Pairs, (n, 2), and what they lose, (n,), are written until there is no
    room for those of one pair more. Returns the pair of classes to go on at, from `begin` on, and
    how many pairs of poses were written.
    """
    n_found = 0
    for number in range(begin, len(pairs)):
        first, second = pairs[number, 0], pairs[number, 1]
        if n_found + size[first] * size[second] > len(out):
            return number, n_found
        for place in range(size[first]):
            one, lost = member[start[first] + place], 0.0
            for word in range(len(open_rows)):
                covered = alone[one, word] | class_alone[second, word]
                covered |= part[one, word] & class_part[second, word]
                covered &= may[one, word] | class_may[second, word]
                lost += weight_of_word(open_rows[word] & ~covered, word, table)
                if lost > may_lose:
                    break
            if lost > may_lose:
                continue
            for other_place in range(place + 1 if first == second else 0, size[second]):
                other, lost = member[start[second] + other_place], 0.0
                for word in range(len(open_rows)):
                    lost += lost_in_word(alone, may, part, open_rows, table, word, one, other)
                    if lost > may_lose:
                        break
                if lost <= may_lose:
                    out[n_found, 0], out[n_found, 1] = one, other
                    of_out[n_found] = lost
                    n_found += 1
    return len(pairs), n_found


@kernel
def weights_of(bits: WordArray, table: FloatArray, total: FloatArray) -> None:
    """What the bits of each row weigh, by a table of bytes, (n,)."""
    for number in range(len(bits)):
        total[number] = 0.0
        for word in range(bits.shape[1]):
            total[number] += weight_of_word(bits[number, word], word, table)


@kernel
def find_least_lost(
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    open_rows: WordArray,
    table: FloatArray,
    gain: FloatArray,
    weight: float,
    site: IntArray,
    room: IntArray,
    copies: IntArray,
) -> float:
    """What the best pair of poses loses of rows that weigh so much: see :func:`find_pairs`."""
    n_poses, least = len(gain), np.inf
    for one in range(n_poses):
        if weight - 2.0 * gain[one] >= least:  # gains fall
            break
        for other in range(one, n_poses):
            if weight - gain[one] - gain[other] >= least:
                break
            if not may_pair(one, other, site, room, copies):
                continue
            lost = 0.0
            for word in range(len(open_rows)):
                lost += lost_in_word(alone, may, part, open_rows, table, word, one, other)
                if lost >= least:
                    break
            least = min(least, lost)
    return least


@kernel
def add_lost(
    alone: WordArray,
    may: WordArray,
    part: WordArray,
    open_rows: WordArray,
    table: FloatArray,
    may_lose: float,
    pairs: IntArray,
    lost: FloatArray,
) -> None:
    """Add what pairs, (n, 2), lose of some rows, see :func:`find_pairs`, until it is too much."""
    for number in range(len(pairs)):
        for word in range(len(open_rows)):
            if lost[number] > may_lose:
                break
            lost[number] += lost_in_word(
                alone, may, part, open_rows, table, word, pairs[number, 0], pairs[number, 1]
            )


@kernel
def keep_sets(
    words: WordArray,
    chains: Chains,
    order: IntArray,
    lost: FloatArray,
    sets: IntArray,
    most_lost: float,
    kept: BoolArray,
) -> None:
    """Which sets lose no more than so much in some chains, looked at in this order, (n_sets,).

    `words`, (n_poses, n_words), has bits along the frames; ``lost[g, k]`` is what is lost in chain
    g if the k-th of its windows is the first live one.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    first = np.empty(len(start) - 1, dtype=np.int64)
    union = np.empty(words.shape[1], dtype=np.uint64)
    for number in range(len(sets)):
        union[:] = 0
        for unit in range(sets.shape[1]):
            of_unit = words[sets[number, unit]]
            for word in range(len(union)):
                union[word] |= of_unit[word]
        n_looked = look_through(
            union,
            window_frames,
            window,
            start,
            tail_frame,
            tail_links,
            tail_start,
            order,
            lost,
            most_lost,
            first,
        )
        kept[number] = n_looked == len(order)
