"""Kernels of bounds and walks against a few lines of plain Python each."""

from itertools import combinations_with_replacement, product

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from kernel_cases import (
    N_FRAMES,
    bits_of,
    columns_of,
    first_live,
    n_chains_of,
    n_links_of,
    needed,
    random_chains,
    random_rows,
    random_sights,
    whole_weights,
)
from numpy.random import default_rng

from placement.optimiser import walk_kernels as kernels
from placement.optimiser.bounds import byte_table, reward_of
from placement.optimiser.presolve import pack_words


def build_losses(rng, chains, alone, may_lose):
    """Random losses of chains."""
    n_chains = n_chains_of(chains)
    drawn = rng.integers(0, 6, (n_chains, 6))
    ordered = np.sort(drawn, axis=1)
    lost = ordered.astype(np.float64)
    return kernels.Losses(
        chains=chains,
        lost=lost,
        order=rng.permutation(n_chains),
        may_lose=np.array(may_lose),
        base=pack_words(alone),
    )


def loss(losses, seen):
    """Weight lost where some frames are seen."""
    seen_frames = np.flatnonzero(seen)
    frames = seen_frames.tolist()
    chains = range(n_chains_of(losses.chains))
    return float(
        sum(losses.lost[g, first_live(losses.chains, g, frames)] for g in chains)
    )


def keeps(losses, sees, alone, *, with_failures):
    """Is no more lost than may be, also when a unit fails?"""
    all_lose, most_lose = losses.may_lose
    if loss(losses, sees.any(axis=0) | alone) > all_lose:
        return False
    if not with_failures:
        return True

    for unit in range(len(sees)):
        others = np.delete(sees, unit, axis=0)
        seen_by_others = others.any(axis=0)
        rest = seen_by_others | alone
        if loss(losses, rest) > most_lose:
            return False

    return True


SEEDS = st.integers(0, 2**32 - 1)

# ---------- what is asked for


def asked_of(chains, chain, link, alone, seen):
    """Pieces of a window that a union lacks, and how much the least seen of them is
    seen.
    """
    frames, tails = needed(chains, chain, link)
    missing = (frames | tails) - alone
    least = min((seen[frame] for frame in missing), default=np.inf)
    return missing, least


@given(SEEDS)
def test_windows_are_asked_for_the_missing_piece_that_is_seen_least(seed):
    rng = np.random.default_rng(seed)
    chains = random_chains(rng)
    is_alone = rng.random(N_FRAMES) < 0.4
    alone_frames = np.flatnonzero(is_alone)
    alone = set(alone_frames.tolist())
    quarters = rng.integers(0, 4, N_FRAMES)
    seen = quarters / 4.0
    is_asked = rng.random(n_chains_of(chains)) < 0.7
    some = np.flatnonzero(is_asked)
    n_windows = len(chains.window)
    asked = np.full(n_windows, -7)

    kernels.ask_for_least_seen(
        chains,
        some,
        pack_words(is_alone),
        seen,
        asked,
    )

    for chain in range(n_chains_of(chains)):
        for link in range(n_links_of(chains, chain)):
            place = chains.start[chain] + link
            found = asked[place]
            missing, least = asked_of(chains, chain, link, alone, seen)
            if chain not in some:
                assert found == -7
            elif missing:
                assert found in missing
                assert seen[found] == least
            else:
                assert found == -1


@given(SEEDS, st.sampled_from([4, 65]))
def test_rows_are_covered_by_who_sees_what_one_of_their_windows_is_asked_for(
    seed, n_poses
):
    rng = default_rng(seed)
    chains = random_chains(rng)
    sees = random_sights(rng, n_poses, share=0.3)
    n_windows = len(chains.window)
    asked = rng.integers(-1, N_FRAMES, n_windows)
    row_chain, row_last = random_rows(rng, chains)
    n_rows = len(row_chain)
    begin = int(rng.integers(0, n_rows + 1))
    n_words = -(-n_poses // 64)
    coverers = np.full((n_rows, n_words), 3, dtype=np.uint64)

    kernels.cover_rows(
        columns_of(sees),
        chains.start,
        asked,
        row_chain,
        row_last,
        begin,
        n_rows,
        coverers,
    )

    assert (coverers[:begin] == 3).all()

    for row in range(begin, n_rows):
        first = chains.start[row_chain[row]]
        frames = asked[first : first + row_last[row]]
        expected = {
            p for p in range(n_poses) if any(f < 0 or sees[p, f] for f in frames)
        }

        assert bits_of(coverers[row], n_poses) == expected


# ---------- prices


@given(
    st.integers(1, 5),
    st.integers(0, 3),
    st.floats(0.0, 4.0),
    st.floats(0.1, 4.0),
)
def test_a_row_is_worth_its_reward_less_what_it_pays(
    n_units, n_failures, price, weight
):
    reward = reward_of(n_units, n_failures)
    most, units = kernels.row_limit(reward, weight, n_units, price)
    values = [weight * reward[n] - n * price for n in range(n_units + 1)]

    assert most == max(values)
    assert values[units] == most


# ---------- the walk


def build_covers(rng, *, n_poses=6, n_rows=9):
    """Random sets of rows that poses cover."""
    drawn = rng.random((n_poses, n_rows))
    bits = drawn < 0.4
    covers = pack_words(bits)
    weight = whole_weights(rng, n_rows)
    copies = np.ones(n_poses, dtype=np.int64)
    return kernels.Covers(
        covers=covers,
        coverers=pack_words(bits.T),
        rows=covers.view(np.uint8),
        weight=weight,
        price=np.minimum(whole_weights(rng, n_rows), weight),
        site=rng.integers(0, 3, n_poses),
        copies=copies,
    )


def build_walk(covers, n_units, room, may_lose):
    """A walk that stands at its root."""
    n_poses, n_words = covers.covers.shape
    bits = [np.zeros((n_units + 1, n_words), dtype=np.uint64) for _ in range(3)]
    return kernels.Walk(
        at=kernels.build_position(),
        may_lose=np.array(may_lose),
        chosen=np.zeros(n_units, dtype=np.int64),
        covered=bits[0],
        covered_twice=bits[1],
        given_up=bits[2],
        weight_given_up=np.zeros(n_units + 1),
        is_open=np.tile((room > 0)[covers.site], (n_units + 1, 1)),
        room=np.tile(room, (n_units + 1, 1)),
        queue=np.zeros((n_units, n_poses), dtype=np.int64),
        n_queued=np.zeros(n_units, dtype=np.int64),
        position=np.zeros(n_units, dtype=np.int64),
        gain=np.zeros(n_poses),
        gain_beside=np.zeros(n_poses),
        table=np.zeros((8 * n_words, 256)),
        used=np.zeros(8 * n_words, dtype=np.int64),
        best=np.zeros(n_units, dtype=np.int64),
    )


def bits_by_pose(covers):
    """Rows that each pose covers."""
    return [bits_of(words, len(covers.weight)) for words in covers.covers]


def lost_of(covers, units):
    """Weight of the rows that units leave uncovered."""
    covered = set().union(*(bits_by_pose(covers)[unit] for unit in units))
    lost = sum(w for row, w in enumerate(covers.weight) if row not in covered)
    return float(lost)


def walked(covers, walk, n_failures, *, work, n_out):
    """All sets of a walk that is paused again and again."""
    found = []
    n_chosen = len(walk.chosen)
    out = np.empty((n_out, n_chosen), dtype=np.int64)

    for _ in range(10_000):
        walk.at[0].n_found = 0
        state = kernels.grow(covers, walk, n_failures, -1, work, out)
        rows_out = out[: walk.at[0].n_found]
        found += [tuple(sorted(row)) for row in rows_out.tolist()]
        if state == kernels.DONE:
            return found

        assert state in (kernels.PAUSED, kernels.FULL)

    raise AssertionError("the walk does not end")


@given(
    SEEDS,
    st.integers(2, 3),
    st.sampled_from([0, 10**9]),
    st.sampled_from([1, 100]),
)
def test_a_walk_finds_each_set_that_loses_little_once_however_often_it_is_paused(
    seed, n_units, work, n_out
):
    rng = np.random.default_rng(seed)
    covers = build_covers(rng)
    copies = rng.integers(1, 3, 6)
    covers = covers._replace(copies=copies)
    room = rng.integers(0, 3, 3)
    may_lose = float(rng.integers(0, 16))
    walk = build_walk(covers, n_units, room, [may_lose, may_lose])

    found = walked(covers, walk, 0, work=work, n_out=n_out)

    expected = []
    for units in combinations_with_replacement(range(6), n_units):
        n_copies = np.bincount(units, minlength=6)
        sites = covers.site[list(units)]
        n_at_site = np.bincount(sites, minlength=3)
        is_copy_left = (n_copies <= copies).all()
        has_room = is_copy_left and (n_at_site <= room).all()
        if has_room and lost_of(covers, units) <= may_lose:
            expected.append(units)

    assert sorted(found) == expected


def test_a_walk_stops_at_each_node_of_a_depth():
    rng = default_rng(5)
    covers = build_covers(rng)
    most = np.full(3, 3)
    walk = build_walk(covers, 3, most, [100.0, 100.0])
    out = np.empty((100, 3), dtype=np.int64)
    stops = set()

    while kernels.grow(covers, walk, 0, 1, 10**9, out) == kernels.AT_STOP:
        assert walk.at[0].depth == 1

        first = int(walk.chosen[0])
        stops.add(first)
        walk.at[0].depth -= 1
        walk.at[0].is_new = 0

    assert stops == set(range(6))
    assert walk.at[0].n_found == 0


# ---------- sets of poses


@given(SEEDS, st.integers(0, 40))
def test_pairs_lose_the_rows_that_neither_can_avoid(seed, may_lose):
    rng = np.random.default_rng(seed)
    drawn_rows = rng.integers(1, 140)
    n_rows = int(drawn_rows)
    drawn = rng.random((3, 5, n_rows))
    alone, may, part = drawn < 0.6
    weight = whole_weights(rng, n_rows)
    pairs = rng.integers(0, 5, (6, 2))
    table = byte_table(weight, pack_words(alone))
    found = np.empty(6)

    kernels.lost_by_pairs(
        pack_words(alone),
        pack_words(may),
        pack_words(part),
        table,
        float(may_lose),
        pairs,
        found,
    )

    for (one, other), lost in zip(pairs, found, strict=True):
        by_one = alone[one] | alone[other]
        by_both = part[one] & part[other]
        can = by_one | by_both
        can &= may[one] | may[other]
        total = weight[~can].sum()

        assert (lost <= may_lose) == (total <= may_lose)
        assert lost <= total

        if lost <= may_lose:
            assert lost == total


@given(
    SEEDS,
    st.booleans(),
    st.integers(0, 12),
    st.sampled_from([1, 50]),
)
def test_sets_of_classes_are_spelled_out_as_the_poses_that_lose_little(
    seed, with_failures, most, n_out
):
    rng = np.random.default_rng(seed)
    chains = random_chains(rng)
    alone = rng.random(N_FRAMES) < 0.2
    losses = build_losses(
        rng,
        chains,
        alone,
        [float(most), float(most + 3)],
    )
    sees = random_sights(rng, 7)
    words = pack_words(sees)
    member = rng.permutation(7)
    parts = [member[:3], member[3:4], member[4:]]
    sees_of_class = [sees[part].any(axis=0) for part in parts]
    of_class = np.array(sees_of_class)
    start = np.array([0, 3, 4, 7])
    of_classes = kernels.Classes(member=member, start=start, words=pack_words(of_class))
    classes_given = [0, 0, 1, 2, 2]
    drawn = rng.choice(classes_given, 3, replace=False)
    classes = np.sort(drawn)
    place = np.array([-1, -1, -1, 0])
    found = []

    while place[-1] >= 0:
        out = np.empty((n_out, 3), dtype=np.int64)
        n_found = kernels.spell_out(
            words,
            of_classes,
            losses,
            with_failures,
            classes,
            place,
            out,
        )
        found += [tuple(sorted(row)) for row in out[:n_found].tolist()]

    expected = set()
    for chosen in product(*(parts[k] for k in classes)):
        units = sorted(set(chosen))
        if len(units) == 3 and keeps(
            losses,
            sees[units],
            alone,
            with_failures=with_failures,
        ):
            expected.add(tuple(units))

    assert sorted(found) == sorted(expected)
