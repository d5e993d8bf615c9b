"""The model that HiGHS is handed, and its cuts, against all sets of small tables."""

from dataclasses import replace

import numpy as np
import pytest
from all_layouts import sets_of_size
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from placement.optimiser import presolve
from placement.optimiser.allowed_sets import are_allowed
from placement.optimiser.bitsets import left_after_failures, union_margins_s, unions_of
from placement.optimiser.bounds import margin_rows, run_rows
from placement.optimiser.model import (
    entering_poses,
    first_cuts,
    last_links,
    link_weights,
    solve_window_model,
    violated_cuts,
)
from placement.optimiser.problem import Requirement


def sets_by_size(reduced):
    """Sets of each size that has any, whether they are allowed or not."""
    most = min(4, reduced.n_poses)
    for size in range(1, most + 1):
        yield sets_of_size(reduced.n_poses, size)


def margins(reduced, units):
    """Margins that units leave in each run. [s]"""
    unions = unions_of(reduced, units[None, :])
    margins_s = union_margins_s(reduced, unions)
    found = margins_s[0]
    return found


def live_links(reduced, units):
    """a of the model: whether a window of the chain up to each link is live."""
    detected = reduced.detected()
    chains = reduced.chains
    seen = detected[units].any(axis=0)
    n_windows = len(chains.window)
    a = np.zeros(n_windows)

    for chain in range(reduced.n_chains):
        frames, n_links = reduced.tails(chain)
        is_live = False
        for link, window in enumerate(reduced.chain(chain)):
            tails = seen[frames[n_links > link]]
            has_tails = tails.all()
            is_seen = has_tails and seen[reduced.window_frames[window]].all()
            is_live |= bool(is_seen)
            a[chains.start[chain] + link] = is_live

    return a


@given(problem=problems(), place=st.sampled_from([0.5, 0.9, 1.0]))
def test_the_model_finds_a_set_that_meets_a_requirement_where_there_is_one(
    problem, place
):
    reduced = presolve(problem)
    limit = reduced.measure.limit
    plain = Requirement(measure=reduced.measure, least=0.0)
    reached = [
        float(plain.reached(margins(reduced, units)[None, :])[0])
        for sets in sets_by_size(reduced)
        for units in sets[are_allowed(reduced.limits, sets)]
    ]

    def find(least):
        asked = replace(plain, least=least)
        return solve_window_model(
            reduced,
            None,
            requirements=[asked],
            time_limit_s=60.0,
        ).units

    needed = np.quantile(reached, place, method="nearest")
    least = float(needed)
    units = find(least)

    assert units is not None

    if len(reduced.weight):
        mean_weight = reduced.weight.mean()
        slack = 1e-3 * float(mean_weight)
        margin_s = margins(reduced, units)
        reached_by_units = plain.reached(margin_s[None, :])
        mine = reached_by_units[0]
        assert mine >= least - slack - 1e-6

    if max(reached) < limit - 1e-3:
        assert find(limit) is None


@given(problem=problems())
def test_links_weigh_what_their_rows_are_worth(problem):
    reduced = presolve(problem)
    of_runs = link_weights(reduced, run_rows(reduced))

    of_margins = link_weights(reduced, margin_rows(reduced))

    for sets in sets_by_size(reduced):
        for units in sets[:6]:
            a = live_links(reduced, units)
            margin = margins(reduced, units)
            is_avoided = margin > -np.inf
            expected = pytest.approx(reduced.weight @ is_avoided)

            assert of_runs @ a == expected

            avoided_s = np.where(is_avoided, margin, 0.0)
            total_s = avoided_s @ reduced.weight

            assert of_margins @ a == pytest.approx(total_s, abs=1e-12)


@given(problem=problems(), least_s=st.sampled_from([-np.inf, 0.05, 0.2, 9.0]))
def test_the_last_link_leaves_the_margin_and_the_next_one_does_not(problem, least_s):
    reduced = presolve(problem)
    last = last_links(reduced, min_margin_s=least_s)
    for run, chain in enumerate(reduced.run_chain):
        enough = [m > -np.inf and m >= least_s - 1e-9 for m in reduced.margin_s[run]]
        if False in enough:
            n_links = enough.index(False)
        else:
            n_links = len(enough)

        assert last[run] == (
            reduced.chains.start[chain] + n_links - 1 if n_links else -1
        )


@given(problem=problems())
def test_who_makes_a_window_live_has_seen_a_frame_that_stabs(problem):
    reduced = presolve(problem)
    for phase in range(reduced.window_frames.shape[1]):
        entering = entering_poses(reduced, phase)
        enters = entering.toarray()

        assert enters.max(initial=0.0) <= 1.0

        for sets in sets_by_size(reduced):
            for units in sets[:6]:
                a = live_links(reduced, units)
                for chain in range(reduced.n_chains):
                    mine = slice(*reduced.chains.start[chain : chain + 2])
                    entered_by_units = enters[mine][:, units]
                    entered = np.cumsum(entered_by_units.sum(axis=1))
                    n_entered = enters[mine].sum(axis=0)

                    assert (a[mine] <= entered).all()
                    assert (n_entered <= 1.0).all()  # once in a chain


def holds(reduced, cut, units):
    """True if a set has so many of the units that count, or sites with such units."""
    counted = units[cut.is_counted[units]]
    sites = reduced.limits.site_index[counted]
    if reduced.limits.failing == "unit":
        n_counted = len(counted)
    else:
        n_counted = len(np.unique(sites))

    return n_counted >= cut.n_units


def drawn_requirement(reduced, n_failures, place):
    """A requirement at a share of its limit."""
    least = place * reduced.measure.limit
    return Requirement(measure=reduced.measure, least=least, n_failures=n_failures)


def meets(reduced, units, requirement):
    """Do units meet a requirement, also when some fail?"""
    left = left_after_failures(
        reduced,
        requirement.measure,
        requirement.n_failures,
        units[None, :],
    )
    is_met = left[0] >= requirement.least - 1e-9
    return bool(is_met)


FAILING = st.sampled_from(["unit", "site"])
PLACES = st.sampled_from([1.0, 1.0, 0.5, 0.9])


@given(
    problem=problems(),
    n_failures=st.integers(0, 2),
    place=PLACES,
    failing=FAILING,
)
def test_cuts_are_met_by_all_sets_that_keep_enough(problem, n_failures, place, failing):
    limits = replace(problem.limits, failing=failing)
    limited = replace(problem, limits=limits)
    reduced = presolve(limited)
    if not len(reduced.weight):
        return

    requirement = drawn_requirement(reduced, n_failures, place)

    first = first_cuts(reduced, requirement)

    assert not first or (requirement.needs_all and n_failures)

    sets = [units for size in sets_by_size(reduced) for units in size]
    good = [units for units in sets if meets(reduced, units, requirement)]

    for units in sets:
        cuts = violated_cuts(reduced, units, requirement)
        is_cut_off = any(units is one for one in good)

        assert bool(cuts) != is_cut_off
        for cut in cuts:
            assert not holds(reduced, cut, units)
            assert all(holds(reduced, cut, one) for one in good)

    for cut in first:
        assert all(holds(reduced, cut, one) for one in good)


@given(problem=problems(), failing=FAILING)
def test_a_model_with_cuts_finds_a_set_that_survives_where_there_is_one(
    problem, failing
):
    limits = replace(problem.limits, failing=failing)
    limited = replace(problem, limits=limits)
    reduced = presolve(limited)
    if not len(reduced.weight):
        return

    requirement = drawn_requirement(reduced, 1, 0.6)
    sets = [s[are_allowed(reduced.limits, s)] for s in sets_by_size(reduced)]
    good = [
        units for size in sets for units in size if meets(reduced, units, requirement)
    ]
    cuts = first_cuts(reduced, requirement)

    for _ in range(200):
        found = solve_window_model(
            reduced,
            None,
            requirements=[requirement],
            cuts=cuts,
            time_limit_s=60.0,
        )
        if found.units is None:
            break
        new = violated_cuts(reduced, found.units, requirement)
        if not new:
            break
        cuts += new

    assert (found.units is not None) == bool(good)

    if found.units is not None:
        assert meets(reduced, found.units, requirement)
