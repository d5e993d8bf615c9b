"""Placement problems for tests: small ones, and every question asked of them."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from hypothesis import strategies as st
from tiny_worlds import axis_of_runs

from geometry.arrays import BoolArray, FloatArray
from placement.detection_table import pack_table
from placement.optimiser import Floor, Limits, PlacementProblem
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis


@st.composite
def problems(draw: st.DrawFn) -> PlacementProblem:
    """Small tables, frames at 10 Hz that end at the impact, any deadlines and
    weights.
    """
    # Sizes are Hypothesis's, what stands in the tables is random: small values of
    # everything at once, as Hypothesis likes them, leave nothing to choose.
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_runs = draw(st.integers(1, 4))
    n_frames = rng.integers(draw(st.sampled_from([6, 1])), 9, size=n_runs)
    share = rng.integers(draw(st.integers(0, 1)), 4, size=n_runs).astype(np.float64)
    share[0] += 1.0
    last_brake = rng.choice(
        [-0.01, -0.125, -0.325, -np.inf], n_runs, p=[0.4, 0.3, 0.2, 0.1]
    )
    last_brake -= rng.random(n_runs) * draw(st.sampled_from([0.0, 0.3]))
    time_s = [np.arange(1 - n, 1) / 10.0 for n in n_frames]
    axis = axis_of_runs(
        np.cumsum([0, *n_frames]),
        np.concatenate(time_s),
        last_brake,
        weight=share / share.sum(),
    )

    n_poses = draw(st.sampled_from([6, 5, 4, 3, 2, 1]))
    share = draw(st.sampled_from([0.6, 0.8, 0.4]))
    detected = rng.random((n_poses, n_frames.sum())) < share

    n_sites = draw(st.sampled_from(sorted({n_poses, 1 + n_poses // 2, 1})))
    site_index = rng.integers(n_sites, size=n_poses)
    site_capacity = rng.integers(1, 3, size=n_sites)
    n_poses_of = np.bincount(site_index, minlength=n_sites)
    max_units = int(np.minimum(site_capacity, n_poses_of).sum())
    budget_units = min(draw(st.sampled_from([3, 2, 1])), max_units)

    return PlacementProblem(
        table=pack_table(tuple(map(str, range(n_poses))), axis, detected),
        limits=Limits(
            site_index=site_index,
            site_capacity=site_capacity,
            budget_units=budget_units,
            unit_cost_eur=np.full(n_poses, 1500.0),
        ),
        fusion=draw(st.sampled_from(["any", "single"])),
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=draw(st.sampled_from([2, 3, 1])),
            frame_rate_hz=10.0,
            track_memory_s=draw(st.sampled_from([0.1, np.inf, 0.2, 0.3, 0.5])),
        ),
        seen_by_vut=draw(st.sampled_from([None, random_sight(rng, axis)])),
    )


@st.composite
def questions(draw: st.DrawFn) -> PlacementProblem:
    """Any problem with any wishes; many cannot be met."""
    problem = draw(problems())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    limits = problem.limits
    n_poses = problem.table.n_poses
    n_runs = problem.table.axis.n_runs
    n_sites = limits.n_sites
    kinds = draw(
        st.sets(st.sampled_from(["money", "wishes", "floors", "failures", "samples"]))
    )

    if "money" in kinds:
        limits = replace(
            limits,
            unit_cost_eur=rng.integers(1, 4, n_poses).astype(np.float64),
            site_cost_eur=rng.integers(0, 3, n_sites).astype(np.float64),
            budget_eur=draw(st.sampled_from([None, 8.0, 5.0, 3.0])),
        )

    if "wishes" in kinds:
        rivals = [
            (a, b) for a, b in combinations(range(n_sites), 2) if rng.random() < 0.2
        ]
        limits = replace(
            limits,
            is_forced=rng.random(n_poses) < 0.15,
            is_forbidden=rng.random(n_poses) < 0.15,
            is_forced_site=rng.random(n_sites) < 0.15,
            rivals=np.array(rivals, dtype=np.int64).reshape(-1, 2),
        )

    floors: list[Floor] = []
    if "failures" in kinds:
        n_failures = draw(st.integers(0, 3))
    else:
        n_failures = 0
    if n_failures:
        limits = replace(limits, failing=draw(st.sampled_from(["unit", "site"])))

    if "floors" in kinds:
        share = rng.choice([1.0, 0.75, 0.5])
        floors.append(Floor(name="--target", share=share, n_failures=n_failures))
        counted = rng.random(n_runs) < 0.5
        if problem.table.axis.weight[counted].sum() > 0.0:
            share = rng.choice([1.0, 0.5])
            floors.append(Floor(name="--min-case-apr", share=share, is_counted=counted))

    sample_index = None
    weight = problem.table.axis.weight
    if "samples" in kinds:
        sample_index = rng.integers(0, 2, n_runs)
        if not (np.bincount(sample_index, weights=weight, minlength=2) > 0.0).all():
            sample_index = None
    if floors:
        goal = draw(st.sampled_from(["best", "fewest", "cheapest"]))
        survive = 0
    else:
        goal = "best"
        survive = n_failures
    tail = 1.0
    if sample_index is not None:
        tail = draw(st.sampled_from([1.0, 0.5, 0.1]))

    return replace(
        problem,
        limits=limits,
        floors=tuple(floors),
        goal=goal,
        survive=survive,
        sample_index=sample_index,
        tail=tail,
    )


def random_sight(rng: np.random.Generator, axis: FrameAxis) -> BoolArray:
    """Frames in which the VUT detects."""
    return rng.random(axis.n_frames) < rng.choice(
        [0.0, 0.5, 0.8, 1.0], p=[0.1, 0.4, 0.4, 0.1]
    )


# ---------- without Hypothesis: many, quickly


def random_problem(rng: np.random.Generator) -> PlacementProblem:
    """Up to 14 poses, 3 units and 7 runs, with any wishes; many cannot be met."""
    axis = random_axis(rng)
    n_poses = int(rng.choice([1, 2, 3, 4, 5, 6, 7, 8, 10, 14]))
    n_sites = int(rng.integers(1, n_poses + 1))
    site_index = rng.integers(n_sites, size=n_poses)

    if rng.random() < 0.4:
        seen_by_vut = random_sight(rng, axis)
    else:
        seen_by_vut = None
    detected = random_detections(rng, axis, n_poses, seen_by_vut)

    sample_index = rng.integers(0, rng.integers(2, 4), axis.n_runs)
    weight_of_worlds = np.bincount(sample_index, weights=axis.weight)
    is_sampled = rng.random() < 0.5 and bool((weight_of_worlds > 0.0).all())
    if is_sampled:
        tail = float(rng.choice([1.0, 0.5, 0.3, 0.1]))
    else:
        tail = 1.0
        sample_index = None

    n_failures = int(rng.choice([0, 0, 1, 2, 3]))
    floors = random_floors(rng, axis, n_failures)
    if floors:
        goal = rng.choice(["best", "fewest", "cheapest"]).item()
    else:
        goal = "best"

    if not floors and rng.random() < 0.5:
        survive = n_failures
    else:
        survive = 0
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
        goal=goal,
        survive=survive,
        sample_index=sample_index,
        tail=tail,
        seen_by_vut=seen_by_vut,
    )


def random_detections(
    rng: np.random.Generator,
    axis: FrameAxis,
    n_poses: int,
    seen_by_vut: BoolArray | None,
) -> BoolArray:
    """What poses detect, (n_poses, n_frames): some add nothing, others less than
    another.
    """
    share = rng.choice([0.25, 0.5, 0.8, 0.95])
    detected = rng.random((n_poses, axis.n_frames)) < share
    if seen_by_vut is None:
        seen = np.zeros(axis.n_frames, dtype=bool)
    else:
        seen = seen_by_vut

    if rng.random() < 0.5:
        adds_nothing = rng.random(n_poses) < 0.4
        detected[adds_nothing] &= seen

    if n_poses > 1 and rng.random() < 0.5:
        for pose in np.flatnonzero(rng.random(n_poses) < 0.4):
            detected[pose] &= detected[rng.integers(n_poses)]
    return detected


def kinds_of(problem: PlacementProblem) -> frozenset[str]:
    """Names of what makes a problem hard, by which the draw is counted."""
    limits = problem.limits
    axis = problem.table.axis
    seen = problem.seen_by_vut
    detected = problem.table.detected(list(range(problem.table.n_poses)))
    if seen is not None:
        detected = detected & ~seen
    adds_nothing = bool((~detected.any(axis=1)).any())
    has_levels = len(set(axis.run_ids)) < axis.n_runs

    weight = axis.weight[axis.weight > 0.0]
    is_tail = problem.tail < 1.0
    is_forced_site = bool(limits.is_forced_site.any())
    has_case_floor = any(floor.is_counted is not None for floor in problem.floors)

    kinds = {
        "tail": is_tail,
        "pose adds nothing": adds_nothing,
        "tail, pose adds nothing": is_tail and adds_nothing,
        "tail, pose adds nothing to a car that sees": is_tail
        and adds_nothing
        and seen is not None,
        "tiny weight": bool((weight < 1.0e-8).any()),
        "levels": has_levels,
        "car sees": seen is not None,
        "single": problem.fusion == "single",
        "money": limits.budget_eur is not None,
        "forced pose": bool(limits.is_forced.any()),
        "forced site": is_forced_site,
        "rivals": len(limits.rivals) > 0,
        "floor": bool(problem.floors),
        "floor of a case": has_case_floor,
        "survive": problem.survive > 0,
        "sites fail": limits.failing == "site",
        "fewest": problem.goal == "fewest",
        "cheapest": problem.goal == "cheapest",
    }
    return frozenset(name for name, is_of_kind in kinds.items() if is_of_kind)


def random_axis(rng: np.random.Generator) -> FrameAxis:
    """Runs with deadlines and weights of any kind: whole, any, tiny, zero; some in
    levels.
    """
    n_runs = int(rng.integers(1, 7))
    n_frames = rng.integers(1, 10, n_runs)
    last_brake_s = rng.choice([-0.01, -0.125, -0.325, -0.5, -np.inf], n_runs)
    last_brake_s -= rng.random(n_runs) * rng.choice([0.0, 0.2])
    ends_s = rng.choice([0.0, 0.05], n_runs)
    weight = random_weights(rng, n_runs)

    time_s = [
        np.arange(1 - count, 1) / 10.0 - end_s
        for count, end_s in zip(n_frames, ends_s, strict=True)
    ]

    run_ids = list(map(str, range(n_runs)))
    if rng.random() < 0.15:  # levels: a run again, with a later deadline
        level = int(rng.integers(n_runs))
        run_ids.append(run_ids[level])
        time_s.append(time_s[level])
        weight = np.append(weight, rng.choice([1.0, 0.25]) * weight[level])
        later_s = min(last_brake_s[level] + 0.1, 0.0)
        last_brake_s = np.append(last_brake_s, later_s)
        n_runs += 1

    run_start = np.cumsum([0, *(len(times) for times in time_s)])
    return axis_of_runs(
        run_start,
        np.concatenate(time_s),
        last_brake_s,
        weight=weight / weight.sum(),
        ids=run_ids,
    )


def random_weights(rng: np.random.Generator, n_runs: int) -> FloatArray:
    """Weights: alike, whole, any, of many magnitudes, near a tie, hardly any; some are
    0.
    """
    kind = rng.choice(["alike", "whole", "any", "magnitudes", "ties", "nothing"])
    is_small = rng.random(n_runs) < 0.5
    small = {"ties": rng.choice([1, 2, 3, 6], n_runs) * 0.4e-9, "nothing": 1.0e-300}
    whole = rng.integers(1, 4, n_runs).astype(np.float64)

    weight = {
        "alike": np.ones(n_runs),
        "any": rng.random(n_runs) + 0.01,
        "magnitudes": 10.0 ** -rng.integers(0, 13, n_runs),
    }.get(kind.item(), whole)
    if kind.item() in small:
        weight = np.where(is_small, small[kind.item()], weight)
    weight[rng.random(n_runs) < rng.choice([0.0, 0.2, 0.5])] = 0.0
    weight[rng.integers(n_runs)] += 1.0
    return weight


def random_limits(rng: np.random.Generator, site_index: Any, n_sites: int) -> Limits:
    """Units, money, capacities and wishes."""
    n_poses = len(site_index)
    has_prices, has_wishes = rng.random(2) < 0.4
    unit_eur = float(rng.choice([1.0, 333.33, 1.0e6]))
    rivals = [(a, b) for a in range(n_sites) for b in range(a) if rng.random() < 0.1]
    is_all = n_poses <= 5 and rng.random() < 0.2
    site_capacity = rng.integers(1, 4, n_sites)
    budget_units = None
    if not is_all:
        budget_units = int(rng.integers(1, 4))

    limits = Limits(
        site_index=site_index,
        site_capacity=site_capacity,
        budget_units=budget_units,
        unit_cost_eur=np.full(n_poses, unit_eur),
    )

    if has_prices:
        limits = replace(
            limits,
            unit_cost_eur=unit_eur * rng.integers(0, 5, n_poses),
            site_cost_eur=unit_eur * rng.integers(0, 4, n_sites),
        )
        if rng.random() < 0.5:
            limits = replace(limits, budget_eur=unit_eur * rng.integers(3, 12))

    if has_wishes:
        limits = replace(
            limits,
            is_forced=rng.random(n_poses) < 0.15,
            is_forbidden=rng.random(n_poses) < 0.15,
            is_forced_site=rng.random(n_sites) < 0.25,
            rivals=np.array(rivals, dtype=np.int64).reshape(-1, 2),
        )
    return replace(limits, failing=rng.choice(["unit", "site"]).item())


def random_floors(
    rng: np.random.Generator, axis: FrameAxis, n_failures: int
) -> tuple[Floor, ...]:
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
