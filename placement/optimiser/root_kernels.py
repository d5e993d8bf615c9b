"""Machine code of the covering problem: what windows are asked for, and prices on its rows.

Everything here works on plain arrays; :mod:`placement.optimiser.set_tree` says what they hold.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .problem import WordArray

ByteArray = NDArray[np.uint8]

_DEFLECTION = 0.7
_CUT = 0.6
_MEMORY = 0.97  # of the shares
_PATIENCE = 6


@kernel
def first_windows(
    bits: WordArray,
    n_phases: int,
    start: IntArray,
    asked: WordArray,
    part_start: IntArray,
    part_place: IntArray,
    part_links: WordArray,
    none: int,
    first: IntArray,
    begin: int,
    end: int,
) -> None:
    """First window of each chain of which each pose sees what is asked for, (n_poses, n_chains).

    Poses begin .. end - 1 are looked at. `asked`, (n_phases, n_words), has a bit where a window is
    asked for a phase: seen is the window if a pose sees that. Others are asked for tails: parts of
    words, those of word w from ``part_start[w]`` on, whose windows, ``part_links``, all need the
    tail at ``part_place``.
    """
    for pose in range(begin, end):
        for chain in range(len(start) - 1):
            first[pose, chain] = none
            for word in range(start[chain], start[chain + 1]):
                seen = np.uint64(0)
                for part in range(part_start[word], part_start[word + 1]):
                    place = part_place[part]
                    if (bits[pose, place >> 6, n_phases] >> np.uint64(place & 63)) & np.uint64(1):
                        seen |= part_links[part]
                for phase in range(n_phases):
                    seen |= bits[pose, word, phase] & asked[phase, word]
                if seen != 0:
                    link = 64 * (word - start[chain])
                    while seen & np.uint64(1) == 0:
                        seen >>= np.uint64(1)
                        link += 1
                    first[pose, chain] = link
                    break


@kernel
def add_up(bits: WordArray, row: int, poses: IntArray, share: FloatArray, seen: FloatArray) -> None:
    """How often some poses see each bit of a row, at most once, (64 n_words,), by their shares."""
    seen[:] = 0.0
    for number in range(len(poses)):
        for word in range(bits.shape[1]):
            left, place = bits[poses[number], word, row], 64 * word
            while left:
                if left & np.uint64(1):
                    seen[place] += share[number]
                left >>= np.uint64(1)
                place += 1
    for place in range(len(seen)):
        seen[place] = min(seen[place], 1.0)


@kernel
def ask_for_tails(
    start: IntArray,
    tail_links: IntArray,
    tail_start: IntArray,
    seen_of_tail: FloatArray,
    seen: FloatArray,
    asked_place: IntArray,
) -> None:
    """Ask every window for the tail that is seen least of those that it needs.

    `seen_of_tail`, (n_tails,), is how much of each is seen; `seen`, (64 n_words,), becomes that of
    the tail that a window is asked for, and `asked_place`, (64 n_words,), where its bit is.
    """
    for chain in range(len(start) - 1):
        first, last = tail_start[chain], tail_start[chain + 1]
        begin = 64 * start[chain]
        least, tail = first, first
        while tail < last:
            if seen_of_tail[tail] < seen_of_tail[least]:
                least = tail
            n_links = tail_links[tail]
            tail += 1
            fewer = tail_links[tail] if tail < last else 0
            for link in range(fewer, n_links):
                seen[begin + link] = seen_of_tail[least]
                asked_place[begin + link] = begin + least - first


@kernel
def weigh_bytes(weight: FloatArray, rows: WordArray, table: FloatArray, used: IntArray) -> int:
    """What each byte of bits along rows is worth, (n_bytes, 256), if only some rows count.

    Bytes that are worth something are written to `used`; how many they are. Sums over bits become
    sums over bytes (Arlazarov, Dinic, Kronrod, Faradzev 1970).
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
            amount = weight[8 * place + bit] if is_counted else 0.0
            for value in range(1 << bit):
                of_byte[value + (1 << bit)] = of_byte[value] + amount
    return n_used


@kernel
def weight_of(covers: ByteArray, table: FloatArray, used: IntArray, n_used: int) -> float:
    """What a pose's bits along rows are worth, by a table of bytes."""
    total = 0.0
    for number in range(n_used):
        place = used[number]
        total += table[place, covers[place]]
    return total


@kernel
def pick_best(
    gain: FloatArray, site: IntArray, room: IntArray, n_units: int, picked: IntArray
) -> tuple[float, int]:
    """Poses that gain most and have room at their sites: their sum and number."""
    total, n_picked = 0.0, 0
    for _ in range(n_units):
        best, most = -1, 0.0
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
                    best, most = place, gain[place]
        if best < 0:
            break
        picked[n_picked] = best
        n_picked += 1
        total += most
    return total, n_picked


@kernel
def row_limit(reward: FloatArray, weight: float, n_units: int, price: float) -> tuple[float, int]:
    """Most that a row is worth after paying for each unit that covers it; how many do."""
    most, units = weight * reward[0], 0
    for number in range(1, n_units + 1):
        value = weight * reward[number] - number * price
        if value > most:
            most, units = value, number
    return most, units


@kernel
def tighten_prices(
    covers: ByteArray,
    site: IntArray,
    room: IntArray,
    weight: FloatArray,
    reward: FloatArray,
    n_units: int,
    price: FloatArray,
    n_steps: int,
    share: FloatArray,
) -> float:
    """Lower the bound of sets of so many units by subgradient steps on the prices of rows.

    `covers`, (n_poses, n_bytes), has a bit for each row, lowest first. Returns the bound; `price`
    becomes what proves it, and `share` how often each pose was picked of late.
    """
    n_rows = len(price)
    best = np.inf
    best_price = np.empty(n_rows)
    slope, units = np.zeros(n_rows), np.zeros(n_rows, dtype=np.int64)
    gain, picked = np.empty(len(share)), np.empty(max(n_units, 1), dtype=np.int64)
    table, used = np.empty((covers.shape[1], 256)), np.empty(covers.shape[1], dtype=np.int64)
    every = np.empty(-(-covers.shape[1] // 8), dtype=np.uint64)
    every[:] = ~np.uint64(0)
    for row in range(n_rows, 64 * len(every)):
        every[row >> 6] &= ~(np.uint64(1) << np.uint64(row & 63))
    length, idle = 0.7, 0
    for step in range(n_steps + 1):
        total = 0.0
        for row in range(n_rows):
            most = weight[row] * (reward[1] - reward[0])
            price[row] = min(max(price[row], 0.0), most)
            value, units[row] = row_limit(reward, weight[row], n_units, price[row])
            total += value
        n_used = weigh_bytes(price, every, table, used)
        for pose in range(len(gain)):
            gain[pose] = weight_of(covers[pose], table, used, n_used)
        of_poses, n_picked = pick_best(gain, site, room, n_units, picked)
        total += of_poses
        for pose in range(len(share)):
            share[pose] *= _MEMORY
        for number in range(n_picked):
            share[picked[number]] += 1.0 - _MEMORY
        if total < best * (1.0 - 1.0e-12):
            best, idle = total, 0
            for row in range(n_rows):
                best_price[row] = price[row]
        else:
            idle += 1
        if step == n_steps:
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
                rise += (covers[picked[number], row >> 3] >> (row & 7)) & 1
            slope[row] = rise + _DEFLECTION * slope[row]
            steepness += slope[row] * slope[row]
        if steepness < 1.0e-12:
            break
        for row in range(n_rows):
            price[row] -= length * total / steepness * slope[row]
    for row in range(n_rows):
        price[row] = best_price[row]
    return best
