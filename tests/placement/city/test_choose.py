"""What junctions get, against going through all choices objective by objective."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.errors import InputError
from placement.city.choose import (
    CityWishes,
    District,
    choose,
    city_front,
    city_values,
    plan_phases,
)
from placement.city.fronts import (
    NOTHING,
    Point,
    build_junction_front,
    lowest,
    stack_bounds,
    stack_fronts,
)
from placement.optimiser.problem import Objective

STAGES = (
    Objective.APR,
    Objective.APR_ONE_FAILED,
    Objective.SMALLEST_MARGIN,
    Objective.MEAN_MARGIN,
    Objective.COST,
)


@st.composite
def fronts(draw, n_junctions=3):
    """A few points each, on a coarse scale: there are ties in every objective."""
    found = []
    eighths = st.integers(1, 8)

    for _ in range(n_junctions):
        points = [NOTHING]
        counts = st.integers(0, 4)
        for _ in range(draw(counts)):
            apr = draw(eighths) / 8.0
            points.append(
                Point(
                    units=draw(st.integers(1, 3)),
                    cost_eur=500.0 * draw(st.integers(1, 8)),
                    apr=apr,
                    apr_one_failed=draw(st.integers(0, 3)) / 8.0,
                    smallest_margin_s=draw(st.integers(0, 4)) / 4.0,
                    mean_margin_s=1.0 + draw(st.integers(0, 4)) / 4.0,
                )
            )

        most = max(point.apr for point in points)
        steps = st.sampled_from([0.0, 0.0, 0.05])
        step = draw(steps)
        above = min(most + step, 1.0)
        found.append(
            build_junction_front(
                points,
                by_units=[(0, 0.0), (1, above)],
                by_cost=[(0.0, 0.0), (500.0, above)],
            )
        )

    return found


def brute_force(options, weight, wishes):
    """Values of the best choice of all, in the objectives' order; None: nothing is
    allowed.
    """
    share = weight / weight.sum()
    jumps = np.diff(options.junction, prepend=-1)
    starts = [*np.flatnonzero(jumps), len(options)]
    groups = [range(a, b) for a, b in pairwise(starts)]
    best = None
    for choice in product(*groups):
        rows = np.array(choice)
        if (
            wishes.budget_units is not None
            and options.units[rows].sum() > wishes.budget_units
        ):
            continue
        if (
            wishes.budget_eur is not None
            and options.cost_eur[rows].sum() > wishes.budget_eur
        ):
            continue
        if (
            wishes.least_apr is not None
            and (options.apr[rows] < wishes.least_apr).any()
        ):
            continue
        if any(
            share[d.junctions] @ options.apr[rows][d.junctions]
            < d.least_apr * share[d.junctions].sum() - 1e-12
            for d in wishes.districts
        ):
            continue
        values = city_values(options, rows, weight)
        key = tuple(
            round(values[s] * (-1 if s is Objective.COST else 1), 9) for s in STAGES
        )
        if best is None:
            best = key
        else:
            best = max(best, key)

    return best


@given(
    fronts(),
    st.lists(st.integers(1, 5), min_size=3, max_size=3),
    st.integers(0, 6) | st.none(),
    st.integers(0, 12) | st.none(),
    st.sampled_from([None, 0.25, 0.5]),
    st.sampled_from([None, 0.25]),
)
def test_the_choice_is_the_best_of_all_in_every_objective(
    found,
    weights,
    units,
    halves,
    least_in_district,
    least,
):
    if units is None and halves is None:
        units = 3

    options = stack_fronts(found)
    weight = np.array(weights, dtype=float)
    wishes = CityWishes(
        budget_units=units,
        budget_eur=None if halves is None else 500.0 * halves,
        districts=(
            ()
            if least_in_district is None
            else [
                District(
                    name="north",
                    junctions=np.array([0, 2]),
                    least_apr=least_in_district,
                )
            ]
        ),
        least_apr=None if least is None else np.array([0.0, least, 0.0]),
    )
    expected = brute_force(options, weight, wishes)
    if expected is None:
        with pytest.raises(InputError, match=r"at (least|most)"):
            choose(options, weight, wishes)
        return

    choice = choose(options, weight, wishes, bounds=None)
    values = city_values(options, choice.rows, weight)
    got = tuple(
        round(values[s] * (-1 if s is Objective.COST else 1), 9) for s in STAGES
    )

    assert got == pytest.approx(expected, abs=2e-8)
    assert [stage.name for stage in choice.certificate.stages] == [
        str(s) for s in STAGES
    ]

    for stage in choice.certificate.stages:
        objective = Objective(stage.name)
        value = values[objective]
        assert stage.objective == pytest.approx(value, abs=1e-6)

    assert choice.certificate.stages[0].gap == 0.0


@pytest.mark.long
@given(fronts(), st.integers(0, 6), st.integers(0, 12))
def test_what_the_fronts_leave_open_is_in_the_bound(found, units, halves):
    """A layout within the junctions' bounds, which the fronts lack, does not exceed the
    bound.
    """
    options = stack_fronts(found)
    weight = np.ones(3)
    wishes = CityWishes(budget_units=units, budget_eur=500.0 * halves)
    bounds = stack_bounds(found, counts_units=True, counts_cost=True)

    choice = choose(options, weight, wishes, bounds=bounds)
    stage = choice.certificate.stages[0]
    highest = stage.bound

    reached = stage.objective

    best_of_bounds = brute_force(bounds, weight, wishes)
    within_bounds = best_of_bounds[0]
    best_of_points = brute_force(options, weight, wishes)
    within_points = best_of_points[0]
    expected = max(highest, within_points)

    assert reached <= choice.bound_of_points <= highest + 1e-12
    assert within_bounds == pytest.approx(expected, abs=1e-8)


@given(fronts(), st.booleans())
def test_each_step_of_the_citys_front_is_the_best_for_its_money(found, by_cost):
    options = stack_fronts(found)
    weight = np.array([1.0, 2.0, 3.0])
    before = 0.0
    for step in city_front(options, weight, by_cost=by_cost):
        if by_cost:
            wishes = CityWishes(budget_eur=step.taken)
        else:
            n_units = round(step.taken)
            wishes = CityWishes(budget_units=n_units)

        assert step.apr == pytest.approx(
            brute_force(options, weight, wishes)[0], abs=1e-8
        )
        assert step.apr > before

        before = step.apr


def test_points_that_another_one_beats_are_left_out():
    good = Point(
        units=1,
        cost_eur=1000.0,
        apr=0.5,
        apr_one_failed=0.0,
        smallest_margin_s=0.1,
        mean_margin_s=1.0,
    )
    dear = Point(
        units=2,
        cost_eur=1000.0,
        apr=0.5,
        apr_one_failed=0.0,
        smallest_margin_s=0.0,
        mean_margin_s=1.0,
    )

    front = build_junction_front(
        [good, NOTHING, dear, good],
        by_units=[
            (0, 0.0),
            (1, 0.5),
            (2, 0.8),
        ],
        by_cost=lowest(
            [
                ((0.0, 0.0), (1000.0, 0.9)),
                ((0.0, 0.0), (1000.0, 0.5), (2000.0, 0.8), (3000.0, 0.8)),
            ]
        ),
    )

    assert front.points == (NOTHING, good)
    assert front.by_cost == (
        (0.0, 0.0),
        (1000.0, 0.5),
        (2000.0, 0.8),
    )


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 9)), min_size=1, max_size=4),
    st.integers(1, 4),
)
def test_years_are_the_best_of_all_orders(junctions, per_year):
    numbers = [one[0] for one in junctions]
    units = np.array(numbers)
    gains = [float(one[1]) for one in junctions]
    gain = np.array(gains)
    n_units = units.sum()
    n_full = -(-int(n_units) // per_year)
    n_years = max(n_full, 1)
    best = 0.0
    for years in product(range(1, n_years + 1), repeat=len(units)):
        year = np.where(units > 0, years, n_years + 1)
        if all(units[year <= t].sum() <= per_year * t for t in range(1, n_years + 1)):
            gained = gain * (n_years + 1 - year)
            gain_years = float(gained.sum())
            best = max(best, gain_years)

    phases = plan_phases(units, gain, units_per_year=per_year)
    expected = (units > 0).tolist()
    is_built = (phases.year > 0).tolist()

    assert phases.gain_years == pytest.approx(best)
    assert phases.bound == pytest.approx(best)
    assert is_built == expected


def test_too_few_years_are_told():
    with pytest.raises(
        InputError, match="years: got 1; expected at least 2, for 5 units"
    ):
        plan_phases(
            np.array([2, 3]),
            np.ones(2),
            units_per_year=3,
            years=1,
        )
