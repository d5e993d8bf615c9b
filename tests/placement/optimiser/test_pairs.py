"""Sets of two or three units that are gone through pair by pair, against all sets."""

from dataclasses import replace

import numpy as np
import pytest
from all_layouts import allowed_sets
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import problems

from geometry.clock import now_s
from placement.optimiser import presolve
from placement.optimiser.bitsets import union_apr, unions_of
from placement.optimiser.constants import NEVER, Deadline
from placement.optimiser.pairs import PairWalk, goes_by_pairs, walk_by_pairs


def in_two_worlds(problem):
    """Every other run in the second world, where that leaves both with weight."""
    index = np.arange(problem.table.axis.n_runs) % 2
    weight = np.bincount(index, weights=problem.table.axis.weight, minlength=2)
    if (weight > 0.0).all():
        return replace(problem, sample_index=index)

    return problem


@given(
    problem=problems(),
    place=st.floats(0.0, 1.0),
    class_poses=st.sampled_from([1, 2, 12]),
    few=st.sampled_from([0, 200]),
)
def test_a_walk_by_pairs_meets_every_set_that_reaches_the_need(
    problem, place, class_poses, few
):
    reduced = presolve(problem)
    n_units = reduced.limits.max_units
    if not 2 <= n_units <= 3 or not len(reduced.weight) or reduced.n_poses < n_units:
        return

    sets = allowed_sets(reduced, n_units)
    if not len(sets):
        return

    share = union_apr(reduced, unions_of(reduced, sets))
    need = float(np.quantile(share, place, method="nearest"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.optimiser.constants.CLASS_POSES", class_poses)
        patch.setattr("placement.optimiser.constants.FEW_PAIRS", few)
        walk = PairWalk(reduced, need=need)
        met = np.concatenate(
            [np.empty((0, n_units), dtype=np.int64), *walk.blocks(NEVER)]
        )

    assert walk.is_finished

    found = sorted(tuple(sorted(units)) for units in met.tolist())
    expected = sorted(map(tuple, sets[share >= need - 1e-9].tolist()))

    assert found == expected


@settings(max_examples=30)
@given(problem=problems(), tail=st.sampled_from([1.0, 0.5]))
def test_worlds_are_proven_by_their_mean_and_bounded_by_it(problem, tail):
    reduced = presolve(replace(in_two_worlds(problem), tail=tail))
    if not goes_by_pairs(reduced) or not len(reduced.weight):
        return

    n_units = reduced.limits.max_units
    if reduced.n_poses < n_units:
        return

    sets = allowed_sets(reduced, n_units)
    if not len(sets):
        return

    share = union_apr(reduced, unions_of(reduced, sets))

    tied = walk_by_pairs(
        reduced,
        sets[0],
        deadline=NEVER,
        on_better=lambda units: units,
    )

    assert tied.limit >= share.max() - 1e-9

    if tail == 1.0:
        assert tied.is_finished
        assert tied.value == pytest.approx(share.max())
        assert tied.sets is not None
        assert len(tied.sets) == (share >= share.max() - 1e-9).sum()

    late = walk_by_pairs(
        reduced,
        sets[0],
        deadline=Deadline(-np.inf),
        on_better=lambda units: units,
    )

    assert not late.is_finished
    assert late.limit >= share.max() - 1e-9


@given(problem=problems(), n_ended=st.integers(0, 4))
def test_a_walk_that_does_not_end_leaves_the_nearest_bound_that_was_proven(
    problem, n_ended
):
    reduced = presolve(in_two_worlds(problem))
    n_units = reduced.limits.max_units
    if (
        not goes_by_pairs(reduced)
        or reduced.n_poses < n_units
        or not len(reduced.weight)
    ):
        return

    sets = allowed_sets(reduced, n_units)
    if not len(sets):
        return

    share = union_apr(reduced, unions_of(reduced, sets))
    units = sets[share.argmax()]
    most = float(share.max())
    needs = []
    real = PairWalk.blocks

    def blocks(walk, deadline):
        needs.append(walk.need)
        if len(needs) <= n_ended:  # later ones find no time
            yield from real(walk, NEVER)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PairWalk, "blocks", blocks)
        # So little time is left that no walk is likely to end, but it is never over.
        patch.setattr("placement.optimiser.constants.ALL_TIMES_NEAR", np.inf)
        tied = walk_by_pairs(
            reduced,
            units,
            deadline=Deadline(now_s() + 1.0e6),
            on_better=lambda units: units,
        )

    assert tied.limit >= most - 1e-9

    if most > 0.0 and most * 1.02 < reduced.measure.limit:
        ahead = [need / most - 1.0 for need in needs]

        assert ahead[: n_ended + 1] == pytest.approx(
            [0.02 / 2**n for n in range(n_ended + 1)]
        )

        if n_ended:
            expected = most * (1.0 + 0.02 / 2 ** (n_ended - 1))
        else:
            expected = reduced.measure.limit

        assert tied.limit == pytest.approx(expected)
        assert not tied.is_finished
