"""What may be mounted together: limits against sets one by one, and what wrong ones
say.
"""

from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import questions, random_limits
from refusals import refused_with
from small_tables import avoiding_problem

from placement.optimiser import Floor, Limits, UnmetError, solve_placement
from placement.optimiser.allowed_sets import (
    are_allowed,
    build_choice,
    cost_eur,
    costs_eur,
    fitting,
    is_allowed,
    may_grow,
    price_step_eur,
    whole_cents,
)
from placement.optimiser.solve import check_limits

SEEDS = st.integers(0, 2**32 - 1)


def some_limits(seed):
    """Any limits on six poses at three sites."""
    rng = np.random.default_rng(seed)
    return random_limits(rng, rng.integers(0, 3, 6), 3)


def all_sets(size):
    """All sets of a size of six poses, (n_sets, size)."""
    return np.array(list(combinations(range(6), size)), dtype=np.int64).reshape(
        comb(6, size), size
    )


def price_of(limits, units):
    """Price of units and of the sites that they open. [EUR]"""
    sites = {int(limits.site_index[unit]) for unit in units}
    of_units = sum(float(limits.unit_cost_eur[unit]) for unit in units)
    return of_units + sum(float(limits.site_cost_eur[site]) for site in sites)


def breaks(limits, units):
    """The first limit that a set breaks; empty if it breaks none."""
    sites = [int(limits.site_index[unit]) for unit in units]
    most = limits.budget_units
    if not units or (most is not None and len(units) > most):
        return "units"
    if any(sites.count(site) > limits.site_capacity[site] for site in sites):
        return "sites"
    if (
        limits.budget_eur is not None
        and price_of(limits, units) > limits.budget_eur + 1e-6
    ):
        return "money"
    if any(limits.is_forbidden[unit] for unit in units):
        return "forbidden"
    if set(np.flatnonzero(limits.is_forced)) - set(units):
        return "forced"
    if set(np.flatnonzero(limits.is_forced_site)) - set(sites):
        return "forced sites"
    if any({one, other} <= set(sites) for one, other in limits.rivals):
        return "rivals"

    return ""


@given(SEEDS, st.integers(0, 4))
def test_sets_are_allowed_that_break_no_limit(seed, size):
    limits = some_limits(seed)
    sets = all_sets(size)
    expected = [not breaks(limits, tuple(units)) for units in sets.tolist()]

    assert are_allowed(limits, sets).tolist() == expected
    assert [is_allowed(limits, units) for units in sets] == expected

    doubled = np.column_stack([sets, sets[:, :1]])

    assert not any(is_allowed(limits, units) for units in doubled)


@given(SEEDS, st.integers(1, 4))
def test_what_allowed_sets_are_parts_of_may_grow(seed, size):
    limits = some_limits(seed)
    sets = all_sets(size)
    of_sites_and_money = [breaks(limits, tuple(units)) for units in sets.tolist()]
    grows = may_grow(replace(limits, budget_units=None), sets)

    for units, reason, may in zip(
        sets.tolist(),
        of_sites_and_money,
        grows,
        strict=True,
    ):
        if may:
            assert reason not in ("sites", "money"), units
        if not reason:
            assert may
            assert may_grow(
                limits, np.array([units])[:, 1:]
            ).all()  # and so may all their parts


@given(SEEDS, st.integers(0, 4))
def test_costs_are_those_of_units_and_of_each_site_once(seed, size):
    limits = some_limits(seed)
    sets = all_sets(size)
    expected = [price_of(limits, tuple(units)) for units in sets.tolist()]

    assert costs_eur(limits, sets) == pytest.approx(expected)
    assert [cost_eur(limits, units) for units in sets] == pytest.approx(expected)


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=5), st.integers(1, 50))
def test_every_cost_is_a_multiple_of_the_step_of_prices(cents, times):
    prices = np.array(cents) * times / 100.0
    site_index = np.zeros(len(cents), dtype=int)
    limits = Limits(
        site_index=site_index,
        site_capacity=[9],
        unit_cost_eur=prices,
    )

    step = price_step_eur(limits)
    expected = np.gcd.reduce(np.array(cents) * times)

    assert round(100.0 * step) == expected
    assert price_step_eur(replace(limits, site_cost_eur=[np.pi])) == 0.0


def test_prices_are_whole_cents_or_none():
    found = whole_cents(np.array([0.0, 0.01, 333.33, 1.0e6]))

    assert found is not None
    assert found.tolist() == [0, 1, 33333, 10**8]
    assert whole_cents(np.array([0.005])) is None
    # Float64 does not know each cent any more.
    assert whole_cents(np.array([1.0e16])) is None
    assert price_step_eur(Limits(site_index=[], site_capacity=[])) == 0.0


@given(SEEDS)
def test_no_allowed_set_has_more_units_than_the_limits_say(seed):
    limits = some_limits(seed)
    sizes = [
        size
        for size in range(1, 7)
        if any(not breaks(limits, tuple(units)) for units in all_sets(size).tolist())
    ]

    assert max(sizes, default=0) <= limits.max_units


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, 3),  # two at the first site, one at the second
        ({"budget_units": 2}, 2),
        ({"is_forbidden": [True, True, False, False]}, 1),
        ({"budget_eur": 2.5}, 2),
        ({"budget_eur": 0.5}, 0),
    ],
)
def test_most_units_are_those_of_sites_budgets_and_prices(change, expected):
    limits = Limits(
        site_index=[0, 0, 1, 1],
        site_capacity=[2, 1],
        unit_cost_eur=[1.0] * 4,
    )
    assert replace(limits, **change).max_units == expected


@given(SEEDS, st.integers(0, 3))
def test_who_fits_leaves_room_and_money_for_what_is_forced(seed, size):
    limits = some_limits(seed)
    allowed = [
        set(units)
        for n in range(1, 7)
        for units in all_sets(n).tolist()
        if not breaks(limits, tuple(units))
    ]
    for units in all_sets(size):
        fits = np.flatnonzero(fitting(limits, units)).tolist()
        parts = [one for one in allowed if one > set(units.tolist())]

        assert not set(fits) & set(units.tolist())

        for pose in range(6):  # whoever leads to an allowed set fits
            if any(pose in one for one in parts) and pose not in units:
                assert pose in fits


@pytest.mark.parametrize(
    ("wish", "units", "expected"),
    [
        ({}, [], [0, 1, 2, 3]),
        ({}, [0], [2, 3]),  # the first site is full
        ({"rivals": [[1, 0]]}, [2], [3]),
        ({"is_forbidden": [0, 0, 1, 0]}, [], [0, 1, 3]),
        ({"budget_units": 1, "is_forced": [0, 0, 0, 1]}, [], [3]),
        ({"budget_units": 2, "is_forced": [0, 0, 0, 1]}, [], [0, 1, 2, 3]),
        ({"budget_units": 1, "is_forced_site": [0, 1, 0]}, [], [2]),
        # A forced unit at a forced site is one unit.
        # 4 of 5 are kept back.
        ({"budget_eur": 5.0, "is_forced": [0, 0, 0, 1]}, [], [2, 3]),
        ({"budget_eur": 5.0, "is_forced": [0, 0, 0, 1]}, [3], [2]),
        (
            {
                "budget_eur": 9.0,
                "is_forced_site": [0, 1, 0],
                "is_forbidden": [0, 0, 1, 0],
            },
            [],
            [],
        ),
    ],
)
def test_these_poses_fit(wish, units, expected):
    limits = Limits(
        site_index=[0, 0, 1, 2],
        site_capacity=[1, 1, 1],
        unit_cost_eur=[1.0, 2.0, 1.0, 4.0],
        site_cost_eur=[1.0, 0.0, 0.0],
        **wish,
    )

    fits = fitting(limits, np.array(units, dtype=int))

    assert np.flatnonzero(fits).tolist() == expected


@given(SEEDS, st.integers(1, 4))
def test_who_may_join_what_is_forced_is_told_to_kernels(seed, n_units):
    limits = some_limits(seed)

    choice = build_choice(limits, n_units)
    forced = np.flatnonzero(limits.is_forced)

    assert choice.n_units == max(n_units - len(forced), 0)

    at_site = np.bincount(limits.site_index[forced], minlength=3)

    expected = np.maximum(limits.site_capacity - at_site, 0).tolist()

    assert choice.room.tolist() == expected

    is_open = ~limits.is_forced & ~limits.is_forbidden

    assert choice.is_open.tolist() == is_open.astype(int).tolist()

    if limits.budget_eur is None:
        assert not len(choice.cost)
        return

    # No allowed set costs more than the money left.
    for size in range(len(forced) + 1, 5):
        for units in all_sets(size).tolist():
            if not breaks(limits, tuple(units)):
                others = [unit for unit in units if not limits.is_forced[unit]]
                assert choice.cost[others].sum() <= 1.0 + 1e-6


@given(SEEDS)
def test_limits_on_some_poses_are_those_of_their_sets(seed):
    is_forced = np.zeros(6, dtype=bool)
    limits = replace(some_limits(seed), is_forced=is_forced)
    poses = np.array([5, 0, 3])
    part = limits.of_poses(poses)

    for size in (1, 2, 3):
        for units in combinations(range(3), size):
            assert is_allowed(part, units) == is_allowed(limits, poses[list(units)])
            assert cost_eur(part, units) == cost_eur(limits, poses[list(units)])


def test_new_units_are_those_beyond_the_forced_ones():
    limits = Limits(
        site_index=[0, 1, 2],
        site_capacity=[1, 1, 1],
        budget_units=3,
        is_forced=[True, True, False],
    )

    assert limits.budget_new_units == 1
    assert replace(limits, budget_units=None).budget_new_units is None
    assert str(limits) == "Limits(3 units, None EUR, 3 poses at 3 sites)"


# ---------- what wrong limits say


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"budget_units": True},
            "budget: got True; expected a whole number of units, at least 1",
        ),
        (
            {"budget_units": -1},
            "budget: got -1; expected a whole number of units, at least 1",
        ),
        ({"budget_eur": -1.0}, "budget_cost: got -1.0; expected euros, at least 0"),
        ({"budget_eur": np.nan}, "budget_cost: got nan; expected euros, at least 0"),
        (
            {"unit_cost_eur": [1.0]},
            "unit_cost_eur: got shape (1,); expected shape (2,)",
        ),
        (
            {"unit_cost_eur": [1, -1]},
            "unit_cost_eur: got [1.0, -1.0]; expected euros, at least 0",
        ),
        (
            {"site_index": [[0, 1]]},
            "site_index: got [[0, 1]]; expected whole numbers in one row",
        ),
        ({"site_index": [-1, 0]}, "site_index: got [-1, 0]; expected sites 0..1"),
        (
            {"rivals": [[1, 1]]},
            "rivals: got [[1, 1]]; expected pairs of two sites, 0..1",
        ),
        ({"failing": "all"}, "failing: got 'all'; expected one of unit, site"),
    ],
)
def test_limits_say_what_is_wrong(change, message):
    limits = Limits(site_index=[0, 1], site_capacity=[1, 1])
    with refused_with(message):
        replace(limits, **change)


PAIR = {
    "site_index": [0, 0, 1],
    "site_capacity": [1, 1],
    "unit_cost_eur": [5.0, 7.0, 9.0],
}


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        (
            {"is_forced": [1, 0, 0], "is_forbidden": [1, 0, 0]},
            "a: got forced and forbidden; expected one of the two at most",
        ),
        (
            {"is_forced": [1, 1, 0]},
            (
                "forced units: got 2 at one site (a, b); expected at most 1, what the"
                " site can carry"
            ),
        ),
        (
            {"is_forbidden": [1, 1, 1]},
            "candidates: got none that may be used; expected at least one",
        ),
        (
            {"is_forbidden": [0, 0, 1], "is_forced_site": [0, 1]},
            (
                "forced sites: got a site without a pose that may be used; expected one"
                " or more"
            ),
        ),
        (
            {
                "is_forced": [1, 0, 0],
                "is_forced_site": [0, 1],
                "rivals": [[0, 1]],
            },
            (
                "separation_m: got two sites nearer than that which must both carry"
                " units; expected one of them at most"
            ),
        ),
        (
            {
                "is_forced": [1, 0, 0],
                "is_forced_site": [0, 1],
                "budget_units": 1,
            },
            (
                "budget: got 1; expected at least 2, the units that are forced or stand"
                " at forced sites"
            ),
        ),
        (
            {"is_forced": [1, 0, 1], "budget_eur": 13.0},
            (
                "budget_cost: got 13.0; expected at least 14.00 EUR, the price of the"
                " forced units"
            ),
        ),
        (
            {"budget_eur": 4.0},
            (
                "budget_cost: got 4.0; expected at least 5.00 EUR, the price of the"
                " cheapest unit with its site"
            ),
        ),
        (
            {"budget_eur": 5.5, "site_cost_eur": [1.0, 0.0]},
            (
                "budget_cost: got 5.5; expected at least 6.00 EUR, the price of the"
                " cheapest unit with its site"
            ),
        ),
    ],
)
def test_two_limits_that_cannot_both_be_met_are_told(wish, message):
    with refused_with(message, UnmetError):
        check_limits(Limits(**PAIR, **wish), ("a", "b", "c"))


@given(questions())
def test_limits_that_pass_the_check_are_not_refused_for_one_reason_alone(problem):
    try:
        check_limits(problem.limits, problem.table.pose_ids)
    except UnmetError:
        n_poses = problem.table.n_poses
        sets = [
            one
            for n in range(1, n_poses + 1)
            for one in combinations(range(n_poses), n)
        ]
        # It is right to refuse.
        assert not any(is_allowed(problem.limits, one) for one in sets)


@pytest.mark.parametrize(
    ("floors", "message"),
    [
        (
            [Floor(name="--target", share=0.9)],
            (
                "--target: got 0.9; expected at most 0.75, which all candidate poses"
                " together reach"
            ),
        ),
        (
            [Floor(name="--target", share=0.75)],
            "--target: got 0.75; expected at most 0.5, what the best set found reaches",
        ),
        (
            [Floor(name="--target", share=0.5, n_failures=1)],
            (
                "--target: got 0.5; expected at most 0 when any 1 fail, what the best"
                " set found reaches"
            ),
        ),
        (
            [
                Floor(
                    name="--case",
                    share=1.0,
                    is_counted=np.array([False, True, False, True]),
                )
            ],
            (
                "--case: got 1; expected at most 0.5, which all candidate poses "
                "together reach"
            ),
        ),
    ],
)
def test_floors_that_are_out_of_reach_tell_how_far_one_gets(floors, message):
    problem = avoiding_problem(["1100", "0010", "1000"], budget_units=1)
    with refused_with(message, UnmetError):
        solve_placement(replace(problem, floors=tuple(floors)))


def test_limits_without_any_set_say_so():
    problem = avoiding_problem(["10", "01"], budget_units=2)
    limits = replace(
        problem.limits,
        site_cost_eur=[0.0, 9.0],
        is_forced_site=[True, True],
        budget_eur=2008.0,
    )

    with pytest.raises(UnmetError) as told:
        solve_placement(replace(problem, limits=limits))

    expected = (
        "limits: got no set of poses meets all of them; expected limits that leave a"
        " choice"
    )

    assert str(told.value) == expected
