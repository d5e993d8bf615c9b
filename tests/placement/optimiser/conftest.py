from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np
import pytest
from hypothesis import strategies as st

from placement.detection_table import pack_table
from placement.optimiser import (
    Limits,
    PlacementProblem,
    PlacementValue,
    is_better,
    is_feasible,
    placement_value,
)
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis


@st.composite
def problems(draw: st.DrawFn) -> PlacementProblem:
    """Small tables, frames at 10 Hz that end at the impact, any deadlines and weights."""
    # Sizes are Hypothesis's, what stands in the tables is random: small values of everything at
    # once, as Hypothesis likes them, leave nothing to choose.
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_runs = draw(st.integers(1, 4))
    n_frames = rng.integers(draw(st.sampled_from([6, 1])), 9, size=n_runs)
    share = rng.integers(draw(st.integers(0, 1)), 4, size=n_runs).astype(np.float64)
    share[0] += 1.0
    last_brake = rng.choice([-0.01, -0.125, -0.325, -np.inf], n_runs, p=[0.4, 0.3, 0.2, 0.1])
    last_brake -= rng.random(n_runs) * draw(st.sampled_from([0.0, 0.3]))
    axis = FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("CPNA-50",) * n_runs,
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=share / share.sum(),
        last_brake_time_s=last_brake,
        run_start=np.cumsum([0, *n_frames]),
        time_s=np.concatenate([np.arange(1 - n, 1) / 10.0 for n in n_frames]),
    )
    n_poses = draw(st.sampled_from([8, 7, 6, 5, 4, 3, 2, 1]))
    detected = rng.random((n_poses, n_frames.sum())) < draw(st.sampled_from([0.6, 0.8, 0.4]))
    n_sites = draw(st.sampled_from(sorted({n_poses, 1 + n_poses // 2, 1})))
    site_index = rng.integers(n_sites, size=n_poses)
    site_capacity = rng.integers(1, 3, size=n_sites)
    max_units = np.minimum(site_capacity, np.bincount(site_index, minlength=n_sites)).sum()
    return PlacementProblem(
        table=pack_table(tuple(map(str, range(n_poses))), axis, detected),
        limits=Limits(
            site_index=site_index,
            site_capacity=site_capacity,
            budget_units=min(draw(st.sampled_from([3, 2, 1])), int(max_units)),
            unit_cost_eur=np.full(n_poses, 1500.0),
        ),
        fusion=draw(st.sampled_from(["any", "single"])),
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=draw(st.sampled_from([2, 3, 1])),
            frame_rate_hz=10.0,
        ),
    )


st.register_type_strategy(PlacementProblem, problems())


def _best_value(problem: PlacementProblem, poses: Iterable[int]) -> PlacementValue:
    best = PlacementValue(0.0, 0.0, 0.0, 0.0, np.inf)
    choice = list(poses)
    for n_units in range(1, problem.limits.max_units + 1):
        for units in combinations(choice, n_units):
            if is_feasible(problem, units):
                value = placement_value(problem, units)
                best = value if is_better(value, best) else best
    return best


@pytest.fixture(scope="session")
def best_value() -> Callable[[PlacementProblem, Iterable[int]], PlacementValue]:
    """Brute force: best value of all feasible layouts, of any size, among some poses."""
    return _best_value
