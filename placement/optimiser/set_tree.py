"""Detections laid out by chains, and prices on runs that bound all sets of so many units.

A set avoids a run only if one of its poses sees a certain frame of one of the run's windows, or a
certain tail of it; any frame or tail of each window may be asked for, so that every choice makes
the problem a maximal covering problem that promises no less (see
:mod:`placement.optimiser.window_cover`). There a pose *covers* a run, and prices on runs bound all
sets:

    sum over runs of max over n of (weight G(n) - n price) + the best poses' sums of prices,

where G(n) is what n covering poses are worth. With G(n) = 1 from n = 1 on that is the share of runs
avoided (the Lagrangian dual of Cornuejols, Fisher, Nemhauser 1977). What is left when N of K units
fail is no more than what is left on average, and of the ways to fail the share C(K - n, N - n) /
C(K, N) takes all n poses that cover a run: G is concave again, so that the same prices bound it.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .limits import Limits
from .presolve import Detections, ReducedProblem, distinct_rows, pack_words, unpack_words
from .problem import Chains, WordArray
from .threads import WORKERS, share_out
from .tolerances import TINY

if TYPE_CHECKING:
    from .chain_kernels import Layout

_FEW_SETS = 1000  # more are worth that detections are laid out by chains
_ROUNDS = 8
_ROOT_STEPS = 250
_LATER_STEPS = 120  # in rounds that begin with good prices
_SMALL_SHARE = 1.0e-3
_SHARE_DIGITS = 3
_PRICES_OF_APR = (0.0, 0.3, 1.0, 3.0)


# ---------- detections by chains


@dataclass(frozen=True, kw_only=True, eq=False)
class Links:
    """Detections of a reduced problem by chains, laid out when that is asked for."""

    detections: Detections
    last: IntArray  # (n_runs,): windows of its chain that end in time for each run
    run_chain: IntArray  # (n_runs,): chain of each run
    n_links: IntArray  # (n_chains,): windows of each chain

    @cached_property
    def layout(self) -> "Layout":
        """Detections for kernels; it takes seconds where they take a gigabyte."""
        return _lay_out(self.detections)

    @property
    def longest(self) -> int:
        """Windows of the longest chain: what stands for none seen."""
        return int(self.n_links.max(initial=0))

    def union(self, units: IntArray) -> WordArray:
        """What a set of poses sees, (n_words, n_phases or one more)."""
        union: WordArray = np.bitwise_or.reduce(self.layout.bits[units], axis=0)
        return union

    def chain_worth(self, weight: FloatArray) -> FloatArray:
        """Weight of avoided runs by chain and first live window, (n_chains, longest + 1)."""
        worth = np.zeros((len(self.n_links), self.longest + 1))
        for chain, last, amount in zip(self.run_chain, self.last, weight, strict=True):
            worth[chain, :last] += amount
        return worth


def build_links(reduced: ReducedProblem) -> Links:
    """Lay out the detections of a reduced problem by chains."""
    return Links(
        detections=reduced.detections,
        last=(reduced.margin_s > -np.inf).sum(axis=1),
        run_chain=reduced.run_chain,
        n_links=np.diff(reduced.chains.start),
    )


_WORDS_TOGETHER = 64


@lru_cache(maxsize=1)  # for all searches of a question; it may take a gigabyte
def _lay_out(detections: Detections) -> "Layout":
    from .chain_kernels import Layout
    from .presolve_kernels import turn_round

    chains, columns = detections.chains, detections.columns
    start = _word_starts(chains)
    frames = chains.window_frames[chains.window]
    n_phases, n_words, n_poses = frames.shape[1], int(start[-1]), len(detections.words)
    place = _places(start, chains.start)
    rows = [(of_phase, place) for of_phase in frames.T]
    if len(chains.tail_frame):
        rows.append((chains.tail_frame, _places(start, chains.tail_start)))
    bits = np.empty((n_poses, n_words, len(rows)), dtype=np.uint64)

    def fill(begin: int, end: int) -> None:
        turned = np.empty((64 * columns.shape[1], _WORDS_TOGETHER), dtype=np.uint64)
        for first in range(begin, end, _WORDS_TOGETHER):
            last = min(first + _WORDS_TOGETHER, end)
            part = turned[:, : last - first]
            for row, (of_row, places) in enumerate(rows):
                mine = slice(*np.searchsorted(places, [64 * first, 64 * last]))
                shape = 64 * (last - first), columns.shape[1]
                seen = np.full(shape, -int(row == n_phases)).view(np.uint64)
                seen[places[mine] - 64 * first] = columns[of_row[mine]]
                turn_round(seen.view(np.uint8), part)
                bits[:, first:last, row] = part[:n_poses]

    share_out(fill, n_words)
    return Layout(
        bits=bits,
        n_phases=n_phases,
        start=start,
        tail_links=chains.tail_links,
        tail_start=chains.tail_start,
    )


def _word_starts(chains: Chains) -> IntArray:
    """First word of each chain, and their number: there is room for windows and for tails."""
    n_bits = np.maximum(np.diff(chains.start), np.diff(chains.tail_start))
    return np.cumsum([0, *(-(-n_bits // 64))])


def _places(word_start: IntArray, start: IntArray) -> IntArray:
    """Bits of what chains have, one after the other, when each chain begins a word."""
    count = np.diff(start)
    return np.arange(start[-1]) + np.repeat(64 * word_start[:-1] - start[:-1], count)


def link_bytes(reduced: ReducedProblem) -> int:
    """Memory that the detections by chains take."""
    n_rows = int(reduced.window_frames.shape[1]) + (len(reduced.chains.tail_frame) > 0)
    return 8 * n_rows * reduced.n_poses * int(_word_starts(reduced.chains)[-1])


def first_seen(links: Links, sets: IntArray, *, left_out: int = -1) -> IntArray:
    """First live window of each chain for sets, (n_sets, n_chains); without one of their units.

    `left_out` is the place of that unit in each set; negative: none.
    """
    from .chain_kernels import set_links
    from .frame_kernels import first_live_windows

    first = np.empty((len(sets), len(links.n_links)), dtype=np.int64)
    if "layout" not in links.__dict__ and len(sets) <= _FEW_SETS:
        units = sets if left_out < 0 else np.delete(sets, left_out, axis=1)
        unions = np.bitwise_or.reduce(links.detections.words[units], axis=1)
        first_live_windows(unions, links.detections.chains, first)
        return np.where(first < links.n_links, first, links.longest)
    nothing = np.zeros((len(links.n_links), links.longest + 1))
    set_links(links.layout, nothing, np.ascontiguousarray(sets), left_out, first)
    return first


def avoided_runs(links: Links, first: IntArray) -> BoolArray:
    """Runs that are avoided, (.., n_runs), given the first window seen of each chain."""
    avoided: BoolArray = first[..., links.run_chain] < links.last
    return avoided


# ---------- runs as bits


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Runs as bits, in some order, and who avoids them."""

    detections: Detections
    run: IntArray  # (64 n_words,): run of each bit; -1: none
    chain: IntArray  # (64 n_words,): chain of that run
    last: IntArray  # (64 n_words,): windows of the chain that end in time for it

    @property
    def n_words(self) -> int:
        """Words of all rows."""
        return len(self.run) // 64

    @cached_property
    def every(self) -> WordArray:
        """Bits of all rows, (n_words,)."""
        return pack_words(self.run >= 0)

    @cached_property
    def seen_by(self) -> IntArray:
        """How many poses see each frame, (n_frames,)."""
        count: IntArray = np.bitwise_count(self.detections.columns).sum(axis=1, dtype=np.int64)
        return count

    def bits(self, is_run: BoolArray) -> WordArray:
        """Some runs, (n_runs,), as bits, (n_words,)."""
        return pack_words((self.run >= 0) & is_run[self.run])

    def table(self, weight: FloatArray) -> FloatArray:
        """What each byte of bits is worth by weights of runs, (8 n_words, 256)."""
        from .root_kernels import weigh_bytes

        table, used = np.zeros((8 * self.n_words, 256)), np.empty(8 * self.n_words, dtype=np.int64)
        of_rows = np.where(self.run >= 0, weight[self.run], 0.0)
        weigh_bytes(of_rows, np.full(self.n_words, ~np.uint64(0)), table, used)
        return table

    def cover(
        self,
        columns: WordArray,
        union: WordArray,
        open_rows: WordArray,
        part: slice,
        bits: tuple[WordArray, WordArray, WordArray],
        *,
        frame_0: int = 0,
    ) -> None:
        """Open rows of some words as ``pair_kernels.cover_beside`` finds them: alone, may, part.

        `columns`, (n_frames, n_words), have bits along poses, or sets of them, for frames from
        `frame_0` on. `bits` have rows for 64 in each of those words, or, the last two, none.
        """
        from .pair_kernels import cover_beside

        rows = slice(64 * part.start, 64 * part.stop)
        cover_beside(
            columns,
            union,
            self.seen_by,
            self.detections.chains,
            self.chain[rows],
            self.last[rows],
            open_rows[part],
            frame_0,
            *bits,
        )

    def avoided_with(self, columns: WordArray, union: WordArray, rows: WordArray) -> WordArray:
        """Which of some rows a union avoids with each of all poses, (64 n_pose_words, n_words)."""
        avoided = np.empty((64 * columns.shape[1], self.n_words), dtype=np.uint64)
        none = np.empty((0, 0), dtype=np.uint64)

        def look(begin: int, end: int) -> None:
            of_part = np.empty((len(avoided), end - begin), dtype=np.uint64)
            self.cover(columns, union, rows, slice(begin, end), (of_part, none, none))
            avoided[:, begin:end] = of_part

        share_out(look, self.n_words, few=WORKERS)
        return avoided


def build_rows(links: Links, runs: IntArray) -> Rows:
    """Runs as bits in this order; -1 leaves a bit out."""
    padded = np.full(64 * max(1, -(-len(runs) // 64)), -1)
    padded[: len(runs)] = runs
    is_run = padded >= 0
    return Rows(
        detections=links.detections,
        run=padded,
        chain=np.where(is_run, links.run_chain[padded], 0),
        last=np.where(is_run, links.last[padded], 0),
    )


def weigh(bits: WordArray, table: FloatArray) -> FloatArray:
    """What the bits of each row weigh by a table of bytes, (n,)."""
    from .pair_kernels import weights_of

    total = np.empty(len(bits))
    weights_of(np.ascontiguousarray(bits), table, total)
    return total


# ---------- prices at the root


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Root:
    """A covering problem that promises no less than the windows do, and prices on its rows."""

    covers: WordArray  # (n_poses, n_row_words): rows that each pose covers
    weight: FloatArray  # (n_rows,): runs that the same poses cover are one row
    price: FloatArray  # (n_rows,)
    limit: float  # no set of so many units reaches more
    share: FloatArray  # (n_poses,): how often each pose was picked of late


def find_root(
    links: Links, limits: Limits, weight: FloatArray, *, n_units: int, end_s: float = np.inf
) -> Root:
    """Ask for the frames, window by window, that bound sets of so many units best.

    `weight`, (n_runs,), is what runs are worth. Windows are asked for the frame, or the tail, that
    the poses picked so far see least, again and again, and the best round is kept.
    """
    from .root_kernels import add_up, first_windows

    layout = links.layout
    n_poses, n_words, _ = layout.bits.shape
    n_phases = layout.n_phases
    bits = np.zeros(64 * n_words, dtype=bool)
    bits[_places(layout.start, np.cumsum([0, *links.n_links]))] = True
    asked = np.zeros((n_phases, n_words), dtype=np.uint64)
    asked[0] = pack_words(bits)
    first = np.empty((n_poses, len(links.n_links)), dtype=np.int64)
    seen_sum = np.zeros((n_phases, 64 * n_words))
    tails = _Tails(links)
    parts = tails.parts(np.zeros_like(bits))
    price = 0.3 * weight
    best: Root | None = None
    for number in range(_ROUNDS):
        look_for = partial(
            first_windows, layout.bits, n_phases, layout.start, asked, *parts, links.longest, first
        )
        share_out(look_for, n_poses)
        avoided = avoided_runs(links, first)
        index, row = distinct_rows(pack_words(avoided.T))
        covers = pack_words(avoided[:, index])
        row_weight, row_price = np.zeros(len(index)), np.zeros(len(index))
        np.add.at(row_weight, row, weight)
        np.add.at(row_price, row, price)
        root = _tighten(
            covers,
            row_weight,
            row_price,
            limits,
            _reward(n_units, 0),
            n_units,
            n_steps=_LATER_STEPS if number else _ROOT_STEPS,
        )
        settled = best is not None and root.limit > best.limit * (1.0 - 1.0e-5)
        if best is None or root.limit < best.limit:
            best = root
        if (settled and number > 2) or now_s() > end_s:
            break
        part = np.divide(weight, row_weight[row], out=np.zeros(len(weight)), where=weight > 0.0)
        price = root.price[row] * part
        used = np.flatnonzero(root.share > _SMALL_SHARE)
        share, seen = root.share[used], np.empty(64 * n_words)
        for phase in range(n_phases):
            add_up(layout.bits, phase, used, share, seen)
            seen_sum[phase] += seen
        tails.look(share, used)
        sums = np.concatenate([seen_sum, tails.seen_sum[None, :]])
        rounded = np.round(sums / max(float(seen_sum.max()), TINY), _SHARE_DIGITS)
        least = rounded.argmin(axis=0)
        for phase in range(n_phases):
            asked[phase] = pack_words((least == phase) & bits)
        parts = tails.parts((least == n_phases) & bits)
    assert best is not None
    return best


class _Tails:
    """Which tail each window is asked for: the one that is seen least."""

    def __init__(self, links: Links) -> None:
        self.layout = links.layout
        n_words = self.layout.bits.shape[1]
        self.has_any = len(self.layout.tail_links) > 0
        self.place = _places(self.layout.start, self.layout.tail_start)
        # (64 n_words,): of the tail that each window is asked for; infinite: it needs none.
        self.seen_sum = np.full(64 * n_words, np.inf)
        self._of_tail = np.zeros(len(self.place))
        self._asked_place = np.zeros(64 * n_words, dtype=np.int64)  # bits of these tails

    def look(self, share: FloatArray, used: IntArray) -> None:
        """Add up how much poses see of the tails, and ask for the others then."""
        from .root_kernels import add_up, ask_for_tails

        if not self.has_any:
            return
        layout = self.layout
        seen = np.empty(64 * layout.bits.shape[1])
        add_up(layout.bits, layout.n_phases, used, share, seen)
        self._of_tail += seen[self.place]
        ask_for_tails(
            layout.start,
            layout.tail_links,
            layout.tail_start,
            self._of_tail,
            self.seen_sum,
            self._asked_place,
        )

    def parts(self, is_asked: BoolArray) -> tuple[IntArray, IntArray, WordArray]:
        """Windows of words that are asked for the same tail: first ones of words, tails, windows.

        (n_words + 1,), (n_parts,), (n_parts,), for windows that are asked for tails at all.
        """
        link = np.flatnonzero(is_asked)
        word, tail = link >> 6, self._asked_place[link]
        begin = np.flatnonzero(np.diff(word, prepend=-1) | np.diff(tail, prepend=-1))
        links = np.uint64(1) << (link & 63).astype(np.uint64)
        if len(begin):
            links = np.bitwise_or.reduceat(links, begin)
        start = np.searchsorted(word[begin], np.arange(self.layout.bits.shape[1] + 1))
        return start, tail[begin], links


def _tighten(
    covers: WordArray,
    weight: FloatArray,
    price: FloatArray,
    limits: Limits,
    reward: FloatArray,
    n_units: int,
    *,
    n_steps: int = _ROOT_STEPS,
) -> Root:
    """Better prices for all sets of so many units, by the reward of being covered so often."""
    from .root_kernels import tighten_prices

    price, share = price.copy(), np.zeros(len(covers))
    limit = tighten_prices(
        covers.view(np.uint8),
        limits.site_index,
        limits.site_capacity,
        weight,
        reward,
        n_units,
        price,
        n_steps,
        share,
    )
    share *= n_units / max(float(share.sum()), TINY)
    return Root(covers=covers, weight=weight, price=price, limit=limit, share=share)


def _reward(n_units: int, n_failures: int) -> FloatArray:
    """What a row is worth on average by the number of units that cover it, (n_units + 2,)."""
    return np.array([_share_left(n, n_units, n_failures) for n in range(n_units + 2)])


def _share_left(n_covering: int, n_units: int, n_failures: int) -> float:
    """Of the ways in which units fail, the share that leaves one of the covering units."""
    if n_covering == 0:
        return 0.0
    if n_covering > n_failures or n_units < n_failures:
        return 1.0
    n_lost = comb(max(n_units - n_covering, 0), n_failures - n_covering)
    return 1.0 - n_lost / comb(n_units, n_failures)


def failure_limit(
    root: Root,
    limits: Limits,
    n_units: int,
    n_failures: int,
    least: float,
    *,
    end_s: float = np.inf,
) -> float:
    """No set of so many units that is worth `least` keeps more when units fail.

    At `end_s` of `geometry.clock` it ends with the best limit so far.
    """
    limit = root.limit
    for amount in _PRICES_OF_APR if n_failures else ():
        if now_s() > end_s:
            break
        reward = _reward(n_units, n_failures) + amount * _reward(n_units, 0)
        trial = _tighten(root.covers, root.weight, root.price, limits, reward, n_units)
        limit = min(limit, trial.limit - amount * least)
    return limit


def chains_hardest_first(links: Links, worth: FloatArray, root: Root) -> IntArray:
    """Chains in the order of what the worthiest poses lose in them."""
    n_look = min(len(root.covers), 256)
    gain = unpack_words(root.covers, len(root.weight)) @ root.price
    best = np.argsort(-gain, kind="stable")[:n_look]
    first = first_seen(links, best[:, None])
    lost = worth[:, 0] - worth[np.arange(len(worth)), first].mean(axis=0)
    order: IntArray = np.argsort(-lost, kind="stable")
    return order
