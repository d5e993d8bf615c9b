"""Conflicts and relaxations of small problems against all sets of poses."""

from dataclasses import replace
from itertools import chain, combinations

import numpy as np
import pytest
from changes import changed
from hypothesis import given
from hypothesis import strategies as st
from problems import questions

from placement.explain.conflicts import Separation, Wish, find_conflicts, relax
from placement.optimiser import cost_eur, floor_value, is_feasible


def relaxed(problem, relaxation, separation):
    """The problem with one demand relaxed, all others as they were."""
    demand = relaxation.demand
    value = relaxation.value
    if demand.floor is not None:
        floors = list(problem.floors)
        not_below_0 = max(value, 0.0)
        share = min(not_below_0, 1.0)
        floors[demand.floor] = replace(floors[demand.floor], share=share)
        return replace(problem, floors=tuple(floors))

    if demand.kind == "budget_units":
        return changed(problem, "limits.budget_units", int(value))
    if demand.kind == "budget_eur":
        return changed(problem, "limits.budget_eur", value)

    return relax(problem, relaxation, separation)


@st.composite
def wishes(draw):
    """Questions, many of which cannot be met; rivals may come from a distance."""
    problem = draw(questions())
    limits = problem.limits
    if not draw(st.booleans()):
        alone = replace(limits, rivals=limits.rivals[:0])
        single = replace(problem, limits=alone)
        return single, None

    seeds = st.integers(0, 2**32 - 1)
    seed = draw(seeds)
    rng = np.random.default_rng(seed)
    drawn = rng.integers(1, 20, len(limits.rivals))
    pair_distance_m = drawn.astype(np.float64)
    separation = Separation(
        distance_m=20.0,
        pair_distance_m=pair_distance_m,
        site_capacity=limits.site_capacity,
    )
    site_capacity = np.minimum(limits.site_capacity, 1)
    one_each = replace(limits, site_capacity=site_capacity)
    return replace(problem, limits=one_each), separation


def sets_of(n):
    """All sets but the empty one of n poses."""
    return list(
        chain.from_iterable(combinations(range(n), size) for size in range(1, n + 1))
    )


def meets(problem, separation, demand, poses, *, survives):
    """Whether a set of poses meets one demand."""
    limits = problem.limits
    kind = demand.kind
    sites = limits.site_index[list(poses)]
    at_site = np.bincount(sites, minlength=limits.n_sites)
    if kind == "floor":
        floor = problem.floors[demand.floor]
        if not survives:
            floor = replace(floor, n_failures=0)
        value = floor_value(problem, floor, poses)
        return value >= floor.share - 1e-9

    if kind == "budget_units":
        return len(poses) <= limits.budget_units
    if kind == "budget_eur":
        price_eur = cost_eur(limits, poses)
        return price_eur <= limits.budget_eur + 1e-6

    if kind == "capacity":
        if separation is None:
            capacity = limits.site_capacity
        else:
            capacity = separation.site_capacity
        has_room = (at_site <= capacity).all()
        return bool(has_room)

    if kind == "separation":
        if separation is not None and (at_site > limits.site_capacity).any():
            return False
        is_rivalling = any(
            at_site[one] and at_site[other] for one, other in limits.rivals
        )
        return not is_rivalling

    if kind == "forbidden":
        is_forbidden = limits.is_forbidden[list(poses)]
        return not is_forbidden.any()

    if kind == "forced_sites":
        is_carrying = at_site[limits.is_forced_site] > 0
        return bool(is_carrying.all())

    return True  # "survive" shows in the floors


def met_together(problem, separation, demands):
    """All sets of poses that meet some demands, and have what is there already."""
    demands = list(demands)
    survives = any(demand.kind == "survive" for demand in demands)
    forced_poses = np.flatnonzero(problem.limits.is_forced)
    forced = set(forced_poses.tolist())
    return [
        poses
        for poses in sets_of(problem.table.n_poses)
        if forced <= set(poses)
        and all(
            meets(problem, separation, d, poses, survives=survives) for d in demands
        )
    ]


def check_conflicts(problem, separation):
    """Conflicts are the smallest sets of demands that no set of poses meets."""
    demands = Wish(problem, separation).demands
    found = find_conflicts(problem, separation=separation)
    feasible = [
        poses for poses in sets_of(problem.table.n_poses) if is_feasible(problem, poses)
    ]

    assert met_together(problem, separation, demands) == feasible
    assert (len(found) == 0) == (len(feasible) > 0)

    left = list(demands)

    for conflict in found:
        for size in range(1, len(conflict.demands)):
            for fewer in combinations(left, size):
                assert met_together(problem, separation, fewer)

        assert not met_together(problem, separation, conflict.demands)

        for relaxation in conflict.relaxations:
            check_relaxation(problem, separation, conflict, relaxation)

        relaxed_demands = [r.demand for r in conflict.relaxations]

        assert relaxed_demands == list(conflict.demands)

        left = [demand for demand in left if demand not in conflict.demands]

    assert not found or met_together(problem, separation, left)


def check_relaxation(problem, separation, conflict, relaxation):
    """A relaxed demand can be met, and a little more of it cannot."""
    demands = Wish(problem, separation).demands
    demand = relaxation.demand
    others = [other for other in demands if other != demand]

    assert relaxation.suffices == bool(met_together(problem, separation, others))

    if relaxation.suffices:
        assert is_feasible(
            relaxed(problem, relaxation, separation), relaxation.pose_index
        )
    else:
        others = [other for other in conflict.demands if other != demand]

    allowed = met_together(problem, separation, others)

    assert relaxation.pose_index in allowed
    assert relaxation.is_least

    expected = least(problem, separation, demand, others, allowed)
    if not relaxation.given_up:
        assert relaxation.value == pytest.approx(expected)
    elif demand.kind == "forbidden":
        given_up = list(relaxation.given_up)
        sites = problem.limits.site_index[given_up]
        assert len(set(sites)) == expected
    else:
        assert len(relaxation.given_up) == expected


def least(problem, separation, demand, others, allowed):
    """The best value of a relaxation, or how few items have to go."""
    limits = problem.limits
    kind = demand.kind
    survives = any(other.kind == "survive" for other in others)
    sites = [set(limits.site_index[list(poses)].tolist()) for poses in allowed]
    if kind == "budget_units":
        return min(map(len, allowed))
    if kind == "budget_eur":
        return min(cost_eur(limits, poses) for poses in allowed)
    if kind == "floor":
        floor = problem.floors[demand.floor]
        if not survives:
            floor = replace(floor, n_failures=0)
        return max(floor_value(problem, floor, poses) for poses in allowed)

    if kind == "survive":
        counted = [
            problem.floors[other.floor] for other in others if other.floor is not None
        ]
        return max(
            n
            for n in range(3)
            for poses in allowed
            if all(
                floor_value(problem, replace(f, n_failures=min(n, f.n_failures)), poses)
                >= f.share - 1e-9
                for f in counted
            )
            and n < max(f.n_failures for f in counted)
        )

    if kind == "capacity":
        if separation is None:
            capacity = limits.site_capacity
        else:
            capacity = separation.site_capacity
        return min(
            max(
                (
                    n
                    for n, most in zip(counts(limits, poses), capacity, strict=True)
                    if n > most
                ),
                default=0,
            )
            for poses in allowed
        )

    if kind == "separation":
        return max(
            nearest(limits, separation, poses, used)
            for poses, used in zip(allowed, sites, strict=True)
        )
    if kind == "forbidden":
        return min(
            len(
                {limits.site_index[pose] for pose in poses if limits.is_forbidden[pose]}
            )
            for poses in allowed
        )

    forced_rows = np.flatnonzero(limits.is_forced_site)
    forced_sites = set(forced_rows.tolist())
    return min(len(forced_sites - used) for used in sites)


def counts(limits, poses):
    """Units at each site, (n_sites,)."""
    sites = limits.site_index[list(poses)]
    return np.bincount(sites, minlength=limits.n_sites)


def nearest(limits, separation, poses, used):
    """The largest distance at which a set of poses is allowed."""
    if (counts(limits, poses) > limits.site_capacity).any():
        return 0.0
    distances = [
        distance
        for (one, other), distance in zip(
            limits.rivals.tolist(), separation.pair_distance_m, strict=True
        )
        if {one, other} <= used
    ]
    return min(distances, default=np.inf)


@given(wish=wishes())
def test_conflicts_are_smallest_and_relaxations_are_least(wish):
    check_conflicts(*wish)


@given(wish=wishes())
def test_the_whole_is_the_sum_of_its_demands(wish):
    problem, separation = wish
    whole = Wish(problem, separation)
    part = whole.part(whole.everything)

    met_sets = met_together(problem, separation, [])
    for poses in met_sets[:60]:
        feasible = is_feasible(part, poses)
        expected_feasible = is_feasible(problem, poses)

        assert feasible == expected_feasible

        met = whole.met_by(poses, frozenset())
        expected_met = is_feasible(problem, poses)

        assert is_feasible(whole.part(met), poses)
        assert (met == whole.everything) == expected_met


@given(wish=wishes())
def test_nothing_is_claimed_when_time_is_up(wish):
    problem, separation = wish
    demands = Wish(problem, separation).demands
    for conflict in find_conflicts(problem, separation=separation, time_limit_s=0.0):
        assert not met_together(problem, separation, conflict.demands)
        for relaxation in conflict.relaxations:
            if not relaxation.suffices:
                others = conflict.demands
            else:
                others = demands
            others = [other for other in others if other != relaxation.demand]
            met_sets = met_together(problem, separation, others)

            assert relaxation.pose_index in met_sets
