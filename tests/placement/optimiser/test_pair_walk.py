"""The walk through pairs beside a unit against all sets, on small tables."""

from dataclasses import replace
from itertools import combinations, islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.arrays import IntArray
from placement.detection_table import pack_table
from placement.optimiser import Limits, PlacementProblem, pair_walk, presolve
from placement.optimiser.bitsets import union_apr, unions_of
from placement.optimiser.limits import are_allowed
from placement.optimiser.pair_walk import PairWalk
from placement.optimiser.presolve import ReducedProblem
from placement.optimiser.set_tree import avoided_runs, build_links, first_seen
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis


def all_sets(reduced: ReducedProblem, n_units: int) -> IntArray:
    numbers = np.array(list(combinations(range(reduced.n_poses), n_units)), dtype=np.int64)
    return numbers[are_allowed(reduced.limits, numbers.reshape(-1, n_units))]


def numbered(sets: IntArray) -> IntArray:
    """A number for each set, whatever the order of its poses."""
    return np.sort(sets, axis=1) @ (1000 ** np.arange(sets.shape[1]))


@given(problem=st.from_type(PlacementProblem), place=st.floats(0.0, 1.0), seed=st.integers(0, 99))
def test_a_walk_meets_every_set_that_reaches_the_need(
    problem: PlacementProblem, place: float, seed: int
) -> None:
    problem = replace(problem, limits=replace(problem.limits, budget_units=2 + seed % 2))
    reduced = presolve(problem)
    n_units = reduced.limits.max_units
    if not (2 <= n_units <= 3) or not len(reduced.weight) or reduced.n_poses < n_units:
        return
    sets = all_sets(reduced, n_units)
    if not len(sets):
        return
    # Weights of its own: as where worlds count by how bad they are.
    weight = reduced.weight * np.random.default_rng(seed).uniform(0.0, 2.0, len(reduced.weight))
    reduced = replace(reduced, measure=replace(reduced.measure, weight=weight))
    share = union_apr(reduced, unions_of(reduced, sets))
    need = float(np.quantile(share, place, method="nearest"))
    links = build_links(reduced)
    walk = PairWalk(reduced, links, weight, n_units=n_units, need=need)
    with pytest.MonkeyPatch.context() as patch:
        if seed % 3 == 0:  # as where a class promises much
            patch.setattr(pair_walk, "_FEW_PAIRS", 0)
        parts = [np.empty((0, n_units), dtype=np.int64)]
        for block in walk.blocks(np.inf):
            parts.append(block)
            is_met = np.isin(*(numbered(some) for some in (sets, np.concatenate(parts))))
            assert walk.left_limit >= share[~is_met].max(initial=0.0) - 1e-9  # cut off here
        met = np.concatenate(parts)
    assert walk.is_finished
    assert walk.root_limit >= share.max() - 1e-9
    rest = walk.again(need + 0.5 * (share.max() - need))
    assert sum(map(len, rest.blocks(np.inf))) == (share >= rest.need - 1e-9).sum()
    expected = sorted(tuple(sorted(units)) for units in sets[share >= need - 1e-9].tolist())
    assert sorted(tuple(sorted(units)) for units in met.tolist()) == expected


def drawn_problem(*, n_poses: int, n_runs: int, n_confirmations: int) -> PlacementProblem:
    """Detections that flicker: each pose sees some runs well, and a frame of them by chance."""
    rng = np.random.default_rng(n_confirmations)
    n_frames, share = 17, rng.uniform(0.2, 1.0, n_runs)
    axis = FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("CPNA-50",) * n_runs,
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=share / share.sum(),
        last_brake_time_s=np.full(n_runs, -0.01),
        run_start=np.arange(n_runs + 1) * n_frames,
        time_s=np.tile(np.arange(1 - n_frames, 1) / 10.0, n_runs),
    )
    chance = rng.uniform(0.1, 0.8, (n_poses, n_runs)).repeat(n_frames, axis=1)
    return PlacementProblem(
        table=pack_table(tuple(map(str, range(n_poses))), axis, rng.random(chance.shape) < chance),
        limits=Limits(
            site_index=np.arange(n_poses) % 3,
            site_capacity=np.array([1, 2, 2]),
            budget_units=3,
            unit_cost_eur=np.full(n_poses, 1500.0),
        ),
        fusion="any",
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=n_confirmations,
            frame_rate_hz=10.0,
            track_memory_s=0.3,
        ),
    )


@pytest.mark.parametrize("n_units", [2, 3])
@pytest.mark.parametrize("n_confirmations", [2, 4])
@pytest.mark.parametrize("constants", [{}, {"_CLASS_POSES": 1, "_FEW_PAIRS": 3}])
def test_many_poses_in_many_runs_are_all_met(
    n_units: int, n_confirmations: int, constants: dict[str, int]
) -> None:
    problem = drawn_problem(n_poses=90, n_runs=300, n_confirmations=n_confirmations)
    problem = replace(problem, limits=replace(problem.limits, budget_units=n_units))
    reduced = presolve(problem)
    sets, links = all_sets(reduced, n_units), build_links(reduced)
    weight = reduced.weight
    share = np.concatenate(
        [
            avoided_runs(links, first_seen(links, part)) @ weight
            for part in np.array_split(sets, 1 + len(sets) // 4096)
        ]
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pair_walk, "_HARD_ROWS", (64, 250))
        patch.setattr(pair_walk, "_MANY_WORDS", 1)  # of poses, few are put side by side
        for name, value in constants.items():
            patch.setattr(pair_walk, name, value)
        walk = PairWalk(reduced, build_links(reduced), weight, n_units=n_units, need=1.0)
        for n_better in (0, 1, 40, 1000):
            need = float(np.sort(share)[-n_better]) - 1e-12 if n_better else share.max() + 1e-6
            met = np.concatenate([sets[:0], *walk.again(need).blocks(np.inf)])
            expected = numbered(sets[share >= need])
            assert np.array_equal(np.sort(numbered(met)), np.sort(expected))
        # Broken off, walked for more, and gone on with: what was met is not met again.
        walk = walk.again(need)
        met = [sets[:0], *islice(walk.blocks(np.inf), 100)]
        walk.go_on(need + 0.5 * (share.max() - need))
        assert len(np.concatenate([sets[:0], *walk.blocks(np.inf)])) < len(expected)
        walk.go_on(need)
        met += walk.blocks(np.inf)
        assert walk.is_finished
        assert set(numbered(np.concatenate(met))) == set(expected)


def test_more_units_than_three_are_refused() -> None:
    with pytest.raises(ValueError, match=r"n_units: got 4; expected 2 \.\. 3"):
        PairWalk(*[None] * 3, n_units=4, need=0.0)  # type: ignore[arg-type]
