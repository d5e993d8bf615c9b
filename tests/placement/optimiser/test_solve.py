from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from placement.detection_table import pack_table
from placement.optimiser import (
    PlacementProblem,
    PlacementValue,
    is_better,
    is_feasible,
    placement_value,
    presolve,
    solve_greedy,
    solve_placement,
)
from placement.optimiser.greedy import solve_heuristically, to_full
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis


@st.composite
def problems(draw: st.DrawFn, max_poses: int = 8) -> PlacementProblem:
    """Small tables, frames at 10 Hz that end at the impact, any deadlines and weights."""
    n_runs = draw(st.integers(1, 4))
    n_frames = draw(st.lists(st.integers(1, 8), min_size=n_runs, max_size=n_runs))
    share = np.array(draw(st.lists(st.integers(0, 5), min_size=n_runs, max_size=n_runs)), float)
    share[0] += 1.0
    deadlines = st.floats(-0.8, 0.0) | st.just(-np.inf)
    axis = FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("CPNA-50",) * n_runs,
        approaches=("north",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=share / share.sum(),
        last_brake_time_s=np.array(draw(st.lists(deadlines, min_size=n_runs, max_size=n_runs))),
        run_start=np.cumsum([0, *n_frames]),
        time_s=np.concatenate([np.arange(1 - n, 1) / 10.0 for n in n_frames]),
    )
    n_poses = draw(st.integers(1, max_poses))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    detected = rng.random((n_poses, sum(n_frames))) < draw(st.floats(0.2, 0.9))
    n_sites = draw(st.integers(1, n_poses))
    site_index = draw(arrays(np.int64, n_poses, elements=st.integers(0, n_sites - 1)))
    site_capacity = draw(arrays(np.int64, n_sites, elements=st.integers(1, 2)))
    max_units = np.minimum(site_capacity, np.bincount(site_index, minlength=n_sites)).sum()
    return PlacementProblem(
        table=pack_table(tuple(map(str, range(n_poses))), axis, detected),
        site_index=site_index,
        site_capacity=site_capacity,
        budget_units=draw(st.integers(1, min(3, int(max_units)))),
        fusion=draw(st.sampled_from(["any", "single"])),
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=draw(st.integers(1, 3)),
            frame_rate_hz=10.0,
        ),
    )


def feasible_sets(problem: PlacementProblem) -> Iterator[tuple[int, ...]]:
    for units in combinations(range(problem.table.n_poses), problem.budget_units):
        if is_feasible(problem, units):
            yield units


def best_value(problem: PlacementProblem) -> PlacementValue:
    """Brute force over all feasible layouts of the full size."""
    best = PlacementValue(0.0, 0.0, 0.0, 0.0)
    for units in feasible_sets(problem):
        value = placement_value(problem, units)
        if is_better(value, best):
            best = value
    return best


@given(problem=problems())
@settings(deadline=None, max_examples=150)
def test_solve_matches_brute_force_on_small_tables(problem: PlacementProblem) -> None:
    solution = solve_placement(problem)
    value = placement_value(problem, solution.pose_index)
    assert is_feasible(problem, solution.pose_index)
    assert len(solution.pose_index) == problem.budget_units
    assert value == pytest.approx(best_value(problem), abs=1e-9)
    assert [stage.objective for stage in solution.certificate.stages] == pytest.approx(list(value))
    assert solution.certificate.is_proven
