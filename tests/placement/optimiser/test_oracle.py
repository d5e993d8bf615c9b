"""Random problems of every kind against the enumeration of ``oracle``, by every solver."""

from typing import Any

import numpy as np
import pytest
from oracle import Oracle

from geometry.errors import InputError
from placement.detection_table import pack_table
from placement.optimiser import Effort, Floor, Limits, PlacementProblem, solve_placement
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

SOLVERS = ("auto", "relax", "exact", "greedy")
EVERY_WAY = (*SOLVERS, "models", "walk")
"""Besides the solvers, the exact one where small problems are not gone through set by set."""


def random_problem(rng: np.random.Generator) -> PlacementProblem:
    """Up to 14 poses, 3 units and 6 runs, with any wishes; many cannot be met."""
    axis = random_axis(rng)
    n_poses = int(rng.choice([1, 2, 3, 4, 5, 6, 7, 8, 10, 14]))
    n_sites = int(rng.integers(1, n_poses + 1))
    site_index = rng.integers(n_sites, size=n_poses)
    detected = rng.random((n_poses, axis.n_frames)) < rng.choice([0.25, 0.5, 0.8, 0.95])
    sample_index = rng.integers(0, rng.integers(2, 4), axis.n_runs)
    is_sampled = rng.random() < 0.4 and (np.bincount(sample_index, weights=axis.weight) > 0.0).all()
    n_failures = int(rng.choice([0, 0, 1, 2, 3]))
    floors = random_floors(rng, axis, n_failures)
    return PlacementProblem(
        table=pack_table(tuple(map(str, range(n_poses))), axis, detected),
        limits=random_limits(rng, site_index, n_sites),
        fusion=rng.choice(["any", "single"]).item(),
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=float(rng.choice([0.025, 0.1])),
            n_confirmations=int(rng.choice([1, 2, 3])),
            frame_rate_hz=10.0,
            track_memory_s=float(rng.choice([0.1, 0.2, 0.3, 0.5, np.inf])),
        ),
        floors=floors,
        goal=rng.choice(["best", "fewest", "cheapest"]).item() if floors else "best",
        survive=n_failures if not floors and rng.random() < 0.5 else 0,
        sample_index=sample_index if is_sampled else None,
        tail=float(rng.choice([1.0, 0.5, 0.3, 0.1])) if is_sampled else 1.0,
    )


def random_axis(rng: np.random.Generator) -> FrameAxis:
    """Runs with deadlines and weights of any kind: whole, any, of many magnitudes, zero."""
    n_runs = int(rng.integers(1, 7))
    n_frames = rng.integers(1, 10, n_runs)
    kind = rng.choice(["alike", "whole", "any", "magnitudes"])
    weight = {
        "alike": np.ones(n_runs),
        "whole": rng.integers(1, 4, n_runs).astype(np.float64),
        "any": rng.random(n_runs) + 0.01,
        "magnitudes": 10.0 ** -rng.integers(0, 9, n_runs),
    }[kind.item()]
    weight[rng.random(n_runs) < rng.choice([0.0, 0.2, 0.5])] = 0.0
    weight[rng.integers(n_runs)] += 1.0
    last_brake_s = rng.choice([-0.01, -0.125, -0.325, -0.5, -np.inf], n_runs)
    last_brake_s -= rng.random(n_runs) * rng.choice([0.0, 0.2])
    ends_s = rng.choice([0.0, 0.05], n_runs)
    return FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("CPNA-50",) * n_runs,
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=weight / weight.sum(),
        last_brake_time_s=last_brake_s,
        run_start=np.cumsum([0, *n_frames]),
        time_s=np.concatenate(
            [np.arange(1 - n, 1) / 10.0 - end_s for n, end_s in zip(n_frames, ends_s, strict=True)]
        ),
    )


def random_limits(rng: np.random.Generator, site_index: Any, n_sites: int) -> Limits:
    """Units, money, capacities and wishes."""
    n_poses = len(site_index)
    has_prices, has_wishes = rng.random(2) < 0.4
    unit = float(rng.choice([1.0, 333.33, 1.0e6]))
    rivals = [(a, b) for a in range(n_sites) for b in range(a) if rng.random() < 0.1]
    is_all = n_poses <= 5 and rng.random() < 0.2
    return Limits(
        site_index=site_index,
        site_capacity=rng.integers(1, 4, n_sites),
        budget_units=None if is_all else int(rng.integers(1, 4)),
        unit_cost_eur=unit * (rng.integers(0, 5, n_poses) if has_prices else np.ones(n_poses)),
        site_cost_eur=unit * rng.integers(0, 4, n_sites) if has_prices else None,
        budget_eur=unit * rng.integers(3, 12) if has_prices and rng.random() < 0.5 else None,
        is_forced=rng.random(n_poses) < 0.15 if has_wishes else None,
        is_forbidden=rng.random(n_poses) < 0.15 if has_wishes else None,
        is_forced_site=rng.random(n_sites) < 0.15 if has_wishes else None,
        rivals=np.array(rivals if has_wishes else [], dtype=np.int64).reshape(-1, 2),
        failing=rng.choice(["unit", "site"]).item(),
    )


def random_floors(rng: np.random.Generator, axis: FrameAxis, n_failures: int) -> tuple[Floor, ...]:
    """A target, and a share of some of the runs."""
    if rng.random() < 0.6:
        return ()
    share = float(rng.choice([1.0, 0.75, 0.5, 0.1, 0.0]))
    floors = [Floor(name="--target", share=share, n_failures=n_failures)]
    is_counted = rng.random(axis.n_runs) < 0.5
    if axis.weight[is_counted].sum() > 0.0 and rng.random() < 0.5:
        share = float(rng.choice([1.0, 0.5]))
        floors.append(Floor(name="--min-case-apr", share=share, is_counted=is_counted))
    return tuple(floors)


def check(problem: PlacementProblem, solver: str) -> None:
    """Check one way to solve a problem, by every stage's value, bound and gap."""
    oracle = Oracle(problem)
    is_exact = solver in ("auto", "exact") or (solver in ("models", "walk") and problem.tail == 1.0)
    with pytest.MonkeyPatch.context() as patch:
        if solver not in SOLVERS:
            patch.setattr("placement.optimiser.stages.best_of_few", lambda *_, **__: (None, False))
        if solver == "models":
            patch.setattr("placement.optimiser.search.can_walk", lambda _: False)
            patch.setattr("placement.optimiser.stages.can_enumerate", lambda *_: False)
        effort = Effort(solver=solver if solver in SOLVERS else "exact", time_limit_s=600.0)
        try:
            solution = solve_placement(problem, effort=effort)
        except InputError:
            assert not (oracle.layouts and is_exact), "a layout that meets all wishes was not found"
            return
    oracle.check(solution.pose_index, solution.certificate.stages, proves=is_exact)


def test_all_solvers_hold_what_the_oracle_says() -> None:
    for number in range(10):
        problem = random_problem(np.random.default_rng([7, number]))
        for solver in EVERY_WAY:
            check(problem, solver)
