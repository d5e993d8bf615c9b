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

from .chain_kernels import Layout, lowest_bit
from .presolve import WordArray


@kernel
def ask_for_pieces(
    layout: Layout,
    union: WordArray,
    n_links: IntArray,
    seen_by: FloatArray,
    asked: WordArray,
    missing: WordArray,
    asked_tail: IntArray,
    dead_links: IntArray,
) -> None:
    """Ask each window for the piece that fewest see of those that a union lacks.

    `seen_by`, (n_phases + 1, 64 n_words), says how many see each frame of each window, and in the
    last row each tail. `asked` and `missing`, (n_words, n_phases + 1), take the windows that are
    asked for, and that lack, each phase, or in the last column of `asked` a tail: that of their
    chain whose bit is at ``asked_tail[chain]``, which the first ``dead_links[chain]`` windows
    lack; -1 and 0: the union has all tails of the chain.
    """
    n_phases = layout.n_phases
    asked[:] = 0
    missing[:] = 0
    for chain in range(len(layout.start) - 1):
        begin, end = layout.start[chain], layout.start[chain + 1]
        tail, last_tail = layout.tail_start[chain], layout.tail_start[chain + 1]
        asked_tail[chain], dead_links[chain] = -1, 0
        if tail < last_tail:
            for word in range(begin, end):
                unseen = ~union[word, n_phases]
                if unseen != 0:
                    place = 64 * (word - begin) + lowest_bit(unseen)
                    asked_tail[chain] = 64 * begin + place
                    dead_links[chain] = layout.tail_links[tail + place]
                    break
        for link in range(n_links[chain]):
            word, bit = begin + (link >> 6), np.uint64(1) << np.uint64(link & 63)
            least, choice = np.inf, -1
            for phase in range(n_phases):
                if union[word, phase] & bit == 0:
                    missing[word, phase] |= bit
                    if seen_by[phase, 64 * begin + link] < least:
                        least, choice = seen_by[phase, 64 * begin + link], phase
            if link < dead_links[chain] and seen_by[n_phases, asked_tail[chain]] < least:
                choice = n_phases
            if choice >= 0:
                asked[word, choice] |= bit


@kernel
def cover_beside(
    bits: WordArray,
    phases: tuple[int, ...],
    start: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    union: WordArray,
    asked: WordArray,
    missing: WordArray,
    asked_tail: IntArray,
    dead_links: IntArray,
    chains: IntArray,
    row_start: IntArray,
    row_last: IntArray,
    row_place: IntArray,
    none: int,
    poses: IntArray,
    alone: WordArray,
    may: WordArray,
    part: WordArray,
) -> None:
    """Runs that a union avoids with each of some poses, and for which each may be of use.

    Only `chains` are looked at. Rows of chain g are
    ``row_start[g]`` .. ``row_start[g + 1] - 1``: they end after ``row_last`` windows, falling, and
    their bits are at ``row_place``. Sets bits, (n_poses, n_row_words): in `alone` where the pose
    and the union avoid the run, in `may` where it sees a piece that is asked for, in `part` where
    it sees one that is missing. `phases` are 0, 1, ..: a tuple, so that loops are unrolled.
    """
    n_phases = len(phases)
    alone[:] = 0
    may[:] = 0
    part[:] = 0
    for number in range(len(poses)):
        of_pose = bits[poses[number]]
        for chain in chains:
            begin, end, first_row = start[chain], start[chain + 1], row_start[chain]
            sees_asked_tail, some = False, none
            place = asked_tail[chain]
            if place >= 0:
                seen = of_pose[place >> 6, n_phases] >> np.uint64(place & 63)
                sees_asked_tail = seen & np.uint64(1) != 0
                if dead_links[chain] > 0:
                    for word in range(begin, end):
                        if of_pose[word, n_phases] & ~union[word, n_phases] != 0:
                            some = 0
                            break
            hopeful = none
            for word in range(begin, end):
                seen = asked[word, n_phases] if sees_asked_tail else np.uint64(0)
                any_seen = np.uint64(0)
                for phase in phases:
                    seen |= of_pose[word, phase] & asked[word, phase]
                    any_seen |= of_pose[word, phase] & missing[word, phase]
                if some == none and any_seen != 0:
                    some = 64 * (word - begin) + lowest_bit(any_seen)
                if seen != 0:
                    hopeful = 64 * (word - begin) + lowest_bit(seen)
                    break
            exact = none
            if hopeful < row_last[first_row]:
                lowest, tail = 0, tail_start[chain]
                if tail < tail_start[chain + 1]:
                    for word in range(begin, end):
                        unseen = ~(of_pose[word, n_phases] | union[word, n_phases])
                        if unseen != 0:
                            lowest = tail_links[tail + 64 * (word - begin) + lowest_bit(unseen)]
                            break
                mask = ~np.uint64(0) << np.uint64(lowest & 63)
                for word in range(begin + (lowest >> 6), end):
                    live = mask
                    for phase in phases:
                        live &= of_pose[word, phase] | union[word, phase]
                    if live != 0:
                        exact = 64 * (word - begin) + lowest_bit(live)
                        break
                    mask = ~np.uint64(0)
            for row in range(first_row, row_start[chain + 1]):
                last, place = row_last[row], row_place[row]
                if some >= last and hopeful >= last:
                    break
                word, bit = place >> 6, np.uint64(1) << np.uint64(place & 63)
                if exact < last:
                    alone[number, word] |= bit
                if hopeful < last:
                    may[number, word] |= bit
                if some < last:
                    part[number, word] |= bit


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
    words: IntArray,
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

    Bits are as in :func:`cover_beside`; `open_rows` counts, in `words` alone, and a row is worth
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
        for word in words:
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
    words: IntArray,
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
            for number in range(len(words)):
                lost += lost_in_word(alone, may, part, open_rows, table, words[number], one, other)
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
    words: IntArray,
    table: FloatArray,
    may_lose: float,
    pairs: IntArray,
    lost: FloatArray,
) -> None:
    """Add what pairs, (n, 2), lose of some rows, see :func:`find_pairs`, until it is too much."""
    for number in range(len(pairs)):
        for word in words:
            if lost[number] > may_lose:
                break
            lost[number] += lost_in_word(
                alone, may, part, open_rows, table, word, pairs[number, 0], pairs[number, 1]
            )


@kernel
def keep_sets(
    bits: WordArray,
    n_phases: int,
    start: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    worth: FloatArray,
    chains: IntArray,
    before: WordArray,
    sets: IntArray,
    most: float,
    kept: BoolArray,
) -> None:
    """Which sets, beside what is seen `before`, lose no more than so much, (n_sets,)."""
    none, n_units = worth.shape[1] - 1, sets.shape[1]
    for number in range(len(sets)):
        lost = 0.0
        for chain in chains:
            begin, end = start[chain], start[chain + 1]
            lowest, tail = 0, tail_start[chain]
            if tail < tail_start[chain + 1]:
                for word in range(begin, end):
                    seen = before[word, n_phases]
                    for unit in range(n_units):
                        seen |= bits[sets[number, unit], word, n_phases]
                    if ~seen != 0:
                        lowest = tail_links[tail + 64 * (word - begin) + lowest_bit(~seen)]
                        break
            mask, link = ~np.uint64(0) << np.uint64(lowest & 63), none
            for word in range(begin + (lowest >> 6), end):
                live = mask
                for phase in range(n_phases):
                    seen = before[word, phase]
                    for unit in range(n_units):
                        seen |= bits[sets[number, unit], word, phase]
                    live &= seen
                if live != 0:
                    link = 64 * (word - begin) + lowest_bit(live)
                    break
                mask = ~np.uint64(0)
            lost += worth[chain, 0] - worth[chain, link]
            if lost > most:
                break
        kept[number] = lost <= most
