"""Numba kernels on bits: dominance, live windows of sets of poses.

There is one layout of detections: a row of 64-bit words for each pose, bits
along the merged frames, lowest bit first; and its transpose, a row for each
frame, bits along the poses. All functions work on plain arrays;
:mod:`placement.optimiser.presolve` says what they hold.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

from .problem import Chains, WordArray


@kernel
def copy_entries(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy an array, (n,), into another one of that length.

    A loop: numba takes seconds to compile ``target[:] = source``, with the text of the
    error for arrays of other lengths.
    """
    for place in range(len(target)):
        target[place] = source[place]


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
def lowest_bit(word: np.uint64) -> int:
    """Place of the lowest bit of a word that is not 0: the number of zeros below it."""
    return count_bits(~word & (word - np.uint64(1)))


# ---------- rows of bits
@kernel
def join_ranges(
    rows: WordArray, begin: IntArray, end: IntArray, joined: WordArray
) -> None:
    """Find the bits that are set in one of the rows of each range.

    Parameters
    ----------
    rows : (n_rows, n_words) uint64
        Rows of bits.
    begin, end : (n_ranges,) int
        A range has the rows begin .. end - 1.
    joined : (n_ranges, n_words) uint64
        Written.
    """
    for place in range(len(begin)):
        joined[place] = 0
        for row in range(begin[place], end[place]):
            for word in range(rows.shape[1]):
                joined[place, word] |= rows[row, word]


@kernel
def find_dominated(
    words: WordArray,
    site: IntArray,
    price: FloatArray,
    elsewhere: FloatArray,
    may_move: BoolArray,
    capacity: IntArray,
    max_units: int,
    begin: int,
    step: int,
    dominated: BoolArray,
) -> None:
    """Mark poses whose dominators other units cannot use up.

    Parameters
    ----------
    words : (n_poses, n_words) uint64
        What each pose sees; poses come in the order of dominance.
    site : (n_poses,) int
        Site of each pose.
    price : (n_poses,) float
        Price of each: a dominator at the same site costs no more.
    elsewhere : (n_poses,) float
        Price of each with its site: a dominator elsewhere costs no more.
    may_move : (n_poses,) bool
        True if a pose at another site may take the place.
    capacity : (n_sites,) int
        Units that each site can carry.
    max_units : int
        No set has more units.
    begin, step : int
        Every `step`-th pose from `begin` on is looked at.
    dominated : (n_poses,) bool
        Written, for the poses that are looked at.
    """
    n_words = words.shape[1]
    needed = np.empty(n_words, dtype=np.int64)
    at_site = np.zeros(len(capacity), dtype=np.int64)
    # Poses that may be dropped.
    for pose in range(begin, len(words), step):
        own = site[pose]
        n_blockers = 0
        n_needed = 0
        # To the last digit: dominators are dominated in turn.
        affordable = price[pose]
        at_site[:] = 0
        dominated[pose] = capacity[own] <= 0 or max_units <= 0
        # Words in which the pose sees anything.
        for word in range(n_words):
            if words[pose, word]:
                needed[n_needed] = word
                n_needed += 1
        # Poses before it, those that see little more first, until other units could not
        # use up all.
        for other in range(pose - 1, -1, -1):
            there = site[other]
            if dominated[pose]:
                break
            if at_site[there] >= capacity[there] or not (
                (there == own and price[other] <= affordable)
                or (may_move[pose] and elsewhere[other] <= affordable)
            ):
                continue
            is_above = True
            for number in range(n_needed):
                word = needed[number]
                if words[pose, word] & ~words[other, word]:
                    is_above = False
                    # Where others fail, too.
                    before = number // 2
                    needed[number] = needed[before]
                    needed[before] = word
                    break
            if is_above:
                at_site[there] += 1
                n_blockers += 1
                dominated[pose] = (
                    at_site[own] >= capacity[own] or n_blockers > max_units - 1
                )


@kernel
def thin_out(
    sets: IntArray,
    set_start: IntArray,
    tail_frame: IntArray,
    tail_start: IntArray,
    n_links: IntArray,
    is_kept: BoolArray,
) -> None:
    """Mark windows that are not dominated, and count how many need each tail.

    Parameters
    ----------
    sets : (n_windows, n_frames) int
        Frames of windows, run by run, ascending in time.
    set_start : (n_runs + 1,) int
        First window of each run.
    tail_frame : (n_tails,) int
        Frame of each tail.
    tail_start : (n_runs + 1,) int
        First tail of each run.
    n_links : (n_tails,) int
        How many windows of its run need each tail; in the end, of those kept.
    is_kept : (n_windows,) bool
        Written.
    """
    for run in range(len(set_start) - 1):
        begin = set_start[run]
        end = set_start[run + 1]
        for tail in range(tail_start[run], tail_start[run + 1]):
            # A window that needs the very frame that a tail is, too, is never without
            # the tail.
            while n_links[tail] > 0 and has_entry(
                sets[begin + n_links[tail] - 1], tail_frame[tail]
            ):
                n_links[tail] -= 1
        # Windows of the run, each against those before it.
        for window in range(begin, end):
            # Windows before this one need a tail that this one neither needs nor
            # ensures.
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
        # How many of the kept windows need each tail.
        for tail in range(tail_start[run], tail_start[run + 1]):
            n_kept = 0
            for window in range(begin, begin + n_links[tail]):
                n_kept += is_kept[window]
            n_links[tail] = n_kept


@kernel
def has_entry(entries: IntArray, entry: int) -> bool:
    """True if a number is among others."""
    is_there = False
    for other in entries:
        is_there |= other == entry
    return is_there


# ---------- live windows
@kernel
def has_bit(union: WordArray, frame: int) -> bool:
    """True if a frame is among those of a union."""
    return bool((union[frame >> 6] >> np.uint64(frame & 63)) & np.uint64(1))


@kernel
def look_through(
    union: WordArray,
    chains: Chains,
    order: IntArray,
    lost: FloatArray,
    most_lost: float,
    first: IntArray,
) -> int:
    """Find first live windows until too much is lost; return how many chains it took.

    Parameters
    ----------
    union : (n_words,) uint64
        Frames that are seen.
    chains : Chains
        Windows and tails.
    order : (n,) int
        Chains, in the order in which they are looked at.
    lost : (n_chains, longest + 1) float
        ``lost[g, k]`` is what is lost in chain g if the k-th of its windows is the
        first live one, or none if that is their number. No rows: nothing can be.
    most_lost : float
        The search ends when more is lost.
    first : (n_chains,) int
        Written: the first live window of each chain.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    total = 0.0
    for rank in range(len(order)):
        chain = order[rank]
        place = start[chain]
        end = start[chain + 1]
        # The first tail that is not seen ends most windows: it is not live before.
        for tail in range(tail_start[chain], tail_start[chain + 1]):
            if not has_bit(union, tail_frame[tail]):
                place += tail_links[tail]
                break
        # The first window whose frames are all seen.
        while place < end:
            is_seen = True
            for frame in window_frames[window[place]]:
                is_seen &= has_bit(union, frame)
            if is_seen:
                break
            place += 1
        first[chain] = place - start[chain]
        if len(lost):
            total += lost[chain, first[chain]]
            if total > most_lost:
                return rank
    return len(order)


@kernel
def first_live_windows(unions: WordArray, chains: Chains, first: IntArray) -> None:
    """Find the first live window of each chain for each union of merged frames.

    Parameters
    ----------
    unions : (n_unions, n_words) uint64
        Frames that are seen.
    chains : Chains
        Windows and tails.
    first : (n_unions, n_chains) int
        Written; the number of windows of the chain where none is live.
    """
    order = np.arange(len(chains.start) - 1)
    nothing = np.empty((0, 0))
    for row in range(len(unions)):
        look_through(unions[row], chains, order, nothing, 0.0, first[row])


@kernel
def first_live_with_each(
    columns: WordArray,
    is_seen: BoolArray,
    chains: Chains,
    begin: int,
    end: int,
    first: NDArray[np.int32],
) -> None:
    """Find the first live window of some chains for a set with each pose in turn.

    Parameters
    ----------
    columns : (n_frames, n_words) uint64
        Poses that see each frame.
    is_seen : (n_frames,) bool
        What the set sees by itself.
    chains : Chains
        Windows and tails.
    begin, end : int
        Chains begin .. end - 1 are looked at.
    first : (n_chains, n_poses) int32
        Written; the number of windows of the chain where none is live.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    n_words = columns.shape[1]
    n_poses = first.shape[1]
    every = ~np.uint64(0)
    # Row t: poses with which the first t tails of the chain are seen, those that most
    # windows need.
    most = 0
    for chain in range(begin, end):
        most = max(most, tail_start[chain + 1] - tail_start[chain])
    held = np.empty((most + 1, n_words), dtype=np.uint64)
    held[0] = every
    # Poses with which no window has been live so far, and with which one is.
    left = np.empty(n_words, dtype=np.uint64)
    live = np.empty(n_words, dtype=np.uint64)
    for chain in range(begin, end):
        tail = tail_start[chain]
        n_tails = tail_start[chain + 1] - tail_start[chain]
        for number in range(n_tails):
            frame = tail_frame[tail + number]
            copy_entries(held[number], held[number + 1])
            if not is_seen[frame]:
                for word in range(n_words):
                    held[number + 1, word] &= columns[frame, word]
        n_links = start[chain + 1] - start[chain]
        first[chain] = n_links
        left[:] = every
        if n_poses & 63:
            left[n_words - 1] = (np.uint64(1) << np.uint64(n_poses & 63)) - np.uint64(1)
        # Windows of the chain: poses with which this is the first live one.
        for link in range(n_links):
            while n_tails > 0 and tail_links[tail + n_tails - 1] <= link:
                n_tails -= 1
            # Frame by frame the compiler takes several words at a time.
            for word in range(n_words):
                live[word] = left[word] & held[n_tails, word]
            for frame in window_frames[window[start[chain] + link]]:
                if not is_seen[frame]:
                    for word in range(n_words):
                        live[word] &= columns[frame, word]
            for word in range(n_words):
                left[word] &= ~live[word]
                new = live[word]
                while new != 0:
                    first[chain, 64 * word + lowest_bit(new)] = link
                    new &= new - np.uint64(1)


@kernel
def avoid_with_each(
    columns: WordArray,
    is_seen: BoolArray,
    chains: Chains,
    chain: int,
    last: int,
    space: WordArray,
    avoided: WordArray,
    part: WordArray,
) -> None:
    """Find poses with which a set avoids a run, and those that see a missing piece.

    Parameters
    ----------
    columns : (n_frames, n_words) uint64
        Poses that see each frame.
    is_seen : (n_frames,) bool
        What the set sees by itself.
    chains : Chains
        Windows and tails.
    chain, last : int
        A live window among the first `last` of the chain avoids the run.
    space : (2, n_words) uint64
        Working space.
    avoided : (n_words,) uint64
        Written: poses with which the run is avoided.
    part : (n_words,) uint64
        Written: poses that see a frame or tail that is missing; may be empty.
    """
    window_frames, window, start, tail_frame, tail_links, tail_start = chains
    n_words = columns.shape[1]
    has_part = len(part) > 0
    every = ~np.uint64(0)
    held = space[0]
    live = space[1]
    held[:] = every
    avoided[:] = 0
    part[:] = 0
    tail = tail_start[chain]
    last_tail = tail_start[chain + 1]
    # Windows of the run, the last one in time first: the earlier, the more tails are
    # needed.
    for link in range(last - 1, -1, -1):
        while tail < last_tail and tail_links[tail] > link:
            frame = tail_frame[tail]
            tail += 1
            if not is_seen[frame]:
                for word in range(n_words):
                    held[word] &= columns[frame, word]
                if has_part:
                    for word in range(n_words):
                        part[word] |= columns[frame, word]
        copy_entries(held, live)
        for frame in window_frames[window[start[chain] + link]]:
            if not is_seen[frame]:
                for word in range(n_words):
                    live[word] &= columns[frame, word]
                if has_part:
                    for word in range(n_words):
                        part[word] |= columns[frame, word]
        for word in range(n_words):
            avoided[word] |= live[word]


@kernel
def add_weights_with_each(
    columns: WordArray,
    is_seen: BoolArray,
    chains: Chains,
    run_chain: IntArray,
    last: IntArray,
    weight: FloatArray,
    runs: IntArray,
    total: FloatArray,
) -> None:
    """Add the weight of runs to all poses with which a set avoids them.

    Parameters
    ----------
    columns : (n_frames, n_words) uint64
        Poses that see each frame.
    is_seen : (n_frames,) bool
        What the set sees by itself.
    chains : Chains
        Windows and tails.
    run_chain, last : (n_runs,) int
        Of run r, the first ``last[r]`` windows of chain ``run_chain[r]`` are in
        time.
    weight : (n_runs,) float
        Weight of each run.
    runs : (n,) int
        Runs that are looked at.
    total : (n_poses,) float
        Added to.
    """
    n_words = columns.shape[1]
    space = np.empty((2, n_words), dtype=np.uint64)
    avoided = np.empty(n_words, dtype=np.uint64)
    no_part = np.empty(0, dtype=np.uint64)
    for run in runs:
        avoid_with_each(
            columns, is_seen, chains, run_chain[run], last[run], space, avoided, no_part
        )
        # Bits that are set, 64 poses at a time.
        for word in range(n_words):
            left = avoided[word]
            while left != 0:
                pose = 64 * word + lowest_bit(left)
                if pose < len(total):
                    total[pose] += weight[run]
                left &= left - np.uint64(1)


@kernel
def avoid_beside(
    columns: WordArray,
    is_seen: BoolArray,
    chains: Chains,
    row_chain: IntArray,
    row_last: IntArray,
    alone: WordArray,
    part: WordArray,
) -> None:
    """Find units that avoid each row next to a set, and that see a missing piece.

    `alone` and `part`, (n_rows, n_words), are written as by
    :func:`avoid_with_each`, row by row.
    """
    space = np.empty((2, columns.shape[1]), dtype=np.uint64)
    for row in range(len(row_chain)):
        avoid_with_each(
            columns,
            is_seen,
            chains,
            row_chain[row],
            row_last[row],
            space,
            alone[row],
            part[row],
        )
