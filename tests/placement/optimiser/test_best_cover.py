import time

import numpy as np
import pytest
from coverages import best_value, coverages
from hypothesis import given, settings

from placement.optimiser.best_cover import choose_greedily, find_best_cover, sweep_covers
from placement.optimiser.bounds import Coverage, Supply, prove


def medium_coverage() -> Coverage:
    """300 poses in 60 near copies of 5, whose relaxation is not whole."""
    random = np.random.default_rng(7)
    values = np.repeat(random.random((60, 40)), 5, axis=0)
    values[random.random(values.shape) < 0.8] = 0.0
    return Coverage(
        values=values.astype(np.float32),
        supply=Supply(
            max_units=4, site_index=np.repeat(np.arange(20), 15), site_capacity=np.full(20, 2)
        ),
    )


@given(coverages())
@settings(max_examples=30)
def test_cover_is_the_best_and_proven(coverage: Coverage) -> None:
    cover = find_best_cover(coverage)
    assert coverage.supply.allows(cover.poses)
    assert cover.value == pytest.approx(coverage.value(cover.poses))
    assert cover.value == pytest.approx(best_value(coverage), rel=1e-6)
    assert cover.gap <= 1e-6


def test_gap_is_what_was_asked_for_and_the_root_limit_can_be_checked() -> None:
    coverage = medium_coverage()
    steps: list[str] = []
    rough = find_best_cover(coverage, gap=0.1, on_step=steps.append)
    exact = find_best_cover(coverage, workers=2)
    assert steps[:2] == ["greedy", "bound"]
    assert rough.gap <= 0.1
    assert exact.gap <= 1e-6
    assert exact.n_nodes > 0
    assert rough.value <= exact.value * (1.0 + 1e-9) <= rough.limit * (1.0 + 1e-9)
    proven = prove(coverage, exact.multipliers).limit
    assert exact.root_limit == pytest.approx(proven, rel=1e-6)
    assert exact.limit < exact.root_limit


def test_sweep_is_monotone_and_each_of_its_points_proven() -> None:
    coverage = medium_coverage()
    covers = list(sweep_covers(coverage, range(1, 5)))
    values = [cover.value for cover in covers]
    assert values == sorted(values)
    for n_units, cover in enumerate(covers, start=1):
        assert len(cover.poses) == n_units
        assert cover.gap <= 1e-6


def test_time_that_is_up_leaves_an_honest_gap() -> None:
    coverage = medium_coverage()
    began_s = time.monotonic()
    cover = find_best_cover(coverage, time_limit_s=0.0)
    exact = find_best_cover(coverage)
    assert cover.seconds <= time.monotonic() - began_s
    assert cover.n_nodes == 0
    assert cover.limit >= exact.value
    assert cover.gap > 0.0


@given(coverages(has_money=True))
@settings(max_examples=30)
def test_with_money_the_better_greedy_choice_is_taken(coverage: Coverage) -> None:
    chosen = choose_greedily(coverage)
    assert coverage.supply.allows(chosen)
    assert coverage.value(chosen) <= best_value(coverage) * (1.0 + 1e-6)
