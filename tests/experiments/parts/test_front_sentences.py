from dataclasses import replace

import pytest
from small_tables import avoiding_problem

from experiments.parts.front import describe_money, describe_units
from placement.layout import Certificate, Stage, relative_gap
from placement.optimiser import PlacementValue
from placement.optimiser.front import Front, FrontPoint, cost_front, pareto_front

NAMES = PlacementValue._fields


def point(units, *values, poses=None, bounds=None):
    """A point with the values given; bounds by the names of stages, else proven."""
    value = PlacementValue(*values)
    bounds = bounds or {}
    stages = tuple(
        Stage(
            name=name,
            objective=number,
            bound=bounds.get(name, number),
            gap=relative_gap(number, bounds.get(name, number)),
            seconds=0.0,
        )
        for name, number in zip(NAMES, value, strict=True)
    )
    return FrontPoint(
        units=units,
        pose_index=tuple(range(poses or units)),
        value=value,
        certificate=Certificate(stages=stages, solver="none"),
    )


def front(*points, settled=None, refused=(), by="units", stages="all"):
    return Front(
        by=by, points=points, stages=stages, settled=settled, refused=refused, presolve=None
    )


ONE = point(1, 1.0, 0.0, 0.33, 3.8, 1500.0)
TWO = point(2, 1.0, 1.0, 1.4, 5.0, 3000.0)
THREE = point(3, 1.0, 1.0, 2.3, 6.6, 4500.0)
FOUR = point(4, 1.0, 1.0, 2.3, 6.72, 6000.0)


def test_each_unit_is_said_to_buy_what_it_buys():
    five = replace(FOUR, units=5)
    found = front(ONE, TWO, THREE, FOUR, five, settled=4)
    assert describe_units(found, pole_failed=lambda point: point.value.apr) == [
        "The first unit reaches an APR of 100.0 %.",
        "The second unit adds no APR; the layout then survives any single failure; buys 1.07 s of "
        "time to spare in the tightest run and 1.20 s of mean time to spare.",
        "The third unit buys 0.90 s of time to spare in the tightest run and 1.60 s of mean time "
        "to spare.",
        "The fourth unit buys 0.12 s of mean time to spare.",
        "From K = 4 on nothing grows: no layout of any size is better.",
    ]


def test_a_front_of_first_stages_says_nothing_of_time():
    assert describe_units(front(ONE, TWO, replace(TWO, units=3), settled=2, stages="first")) == [
        "The first unit reaches an APR of 100.0 %.",
        "The second unit adds no APR; the layout then survives the failure of any one unit.",
        "From K = 2 on nothing grows: no layout of any size avoids more, or keeps more when one "
        "unit fails. Time to spare was not optimised.",
    ]


def test_gains_are_told_in_points_with_what_is_left():
    points = (
        point(1, 0.5, 0.0, 0.1, 1.0, 1.0),
        point(2, 0.75, 0.25, 0.1, 1.0, 2.0),
        point(3, 0.9, 0.2, 0.1, 1.0, 3.0),
        point(4, 0.9, 0.3, 0.1, 1.0, 4.0),
    )
    assert describe_units(front(*points, stages="first")) == [
        "The first unit reaches an APR of 50.0 %.",
        "The second unit adds 25.0 points of APR (75.0 %); 25.0 % are then left when any one unit "
        "fails.",
        "The third unit adds 15.0 points of APR (90.0 %); only 20.0 % are then left when any one "
        "unit fails, not 25.0 %.",
        "The fourth unit adds no APR; 30.0 % are then left when any one unit fails, not 20.0 %.",
    ]


def test_what_is_not_proven_is_said_so():
    open_apr = point(1, 0.5, 0.0, 0.1, 1.0, 1.0, bounds={"apr": 0.612})
    open_left = point(2, 0.75, 0.25, 0.1, 1.0, 2.0, bounds={"apr_one_failed": 0.5})
    open_time = point(3, 0.75, 0.25, 0.1, 1.25, 3.0, bounds={"mean_margin_s": 2.0})
    idle = replace(open_time, units=4)
    sentences = describe_units(front(open_apr, open_left, open_time, idle, replace(idle, units=5)))
    assert sentences == [
        "The first unit reaches an APR of 50.0 % (proven is only: no more than 61.20 %).",
        "The second unit adds 25.0 points of APR (75.0 %); 25.0 % are then left when any one unit "
        "fails (proven is only: what is left when one fails is no more than 50.00 %).",
        "The third unit buys 0.25 s of mean time to spare (proven is only: no more than 2.00 s).",
        "The fourth and fifth unit add nothing, as far as was found: that is not proven.",
    ]


def test_units_that_add_nothing_before_others_do_are_told():
    points = (ONE, *(replace(ONE, units=units) for units in (2, 3, 4)), replace(FOUR, units=5))
    assert describe_units(front(*points))[1] == "The second to fourth unit add nothing."
    assert describe_units(front(ONE, replace(ONE, units=2), replace(TWO, units=3)))[1] == (
        "The second unit adds nothing."
    )


def test_kept_units_and_refused_numbers_are_told():
    points = (replace(TWO, units=12), replace(THREE, units=13), replace(FOUR, units=22))
    sentences = describe_units(front(*points), n_kept=12)
    assert sentences[0] == (
        "The 12 existing units reach an APR of 100.0 %, whichever single one fails."
    )
    assert sentences[1].startswith("The 13th unit buys 0.90 s")
    assert sentences[2].startswith("The 22nd unit buys")
    refused = front(TWO, refused=((1, "--min-case-apr: got 0.9; expected at most 0.5"),))
    assert describe_units(refused) == [
        "The first 2 units reach an APR of 100.0 %, whichever single one fails.",
        "With 1 the wishes cannot be met: --min-case-apr: got 0.9; expected at most 0.5.",
    ]


def test_a_saving_is_told_where_nothing_else_grows():
    cheaper = point(3, 1.0, 1.0, 1.4, 5.0, 2500.0)
    assert describe_units(front(TWO, cheaper))[1] == "The third unit saves 500 EUR."


def test_money_is_told_by_steps():
    problem = avoiding_problem(["1100", "0011", "1111"], price_eur=[1000.0, 2000.0, 7000.0])
    told = describe_money(cost_front(problem), pole_failed=lambda point: point.value.apr)
    assert told == [
        "1,000 EUR buy an APR of 50.0 %.",
        "2,000 EUR more (3,000 EUR in all) add 50.0 points of APR (100.0 %); 50.0 % are then left "
        "when any one unit fails.",
        "7,000 EUR more (10,000 EUR in all) add no APR; the layout then survives any single "
        "failure.",
        "Beyond 10,000 EUR nothing grows: no layout of any size avoids more, or keeps more when "
        "one unit fails. Time to spare was not optimised.",
    ]


def test_money_that_is_not_proven_to_be_the_least_is_told():
    open_cost = point(2, 0.5, 0.25, 0.1, 1.0, 3000.0, bounds={"cost_eur": 2000.0})
    (sentence,) = describe_money(front(open_cost, by="cost"))
    assert sentence == (
        "3,000 EUR buy an APR of 50.0 %, 25.0 % when the most needed one fails (proven is only: "
        "not for less than 2,000 EUR)."
    )


def test_what_hangs_on_one_pole_does_not_survive_any_single_failure():
    for describe in (describe_units, describe_money):
        assert (
            "survives the failure of any one unit, but not that of a pole (0.0 % are then "
            in (describe(front(ONE, TWO), pole_failed=lambda point: 0.0)[1])
        )


@pytest.mark.parametrize("stages", ["first", "all"])
def test_every_point_of_a_real_front_has_its_sentence(stages):
    problem = avoiding_problem(["1100", "0110", "0011", "1001"])
    found = pareto_front(problem, max_units=4, stages=stages)
    sentences = describe_units(found)
    assert sentences[0] == "The first unit reaches an APR of 50.0 %."
    assert sentences[1].startswith("The second unit adds 50.0 points of APR (100.0 %)")
    assert sentences[2].startswith(
        "The third unit adds no APR; 75.0 % are then left when any one unit fails, not 50.0 %"
    )
    assert sentences[3].startswith(
        "The fourth unit adds no APR; the layout then survives the failure of any one unit"
    )
    assert sentences[-1].startswith("From K = 4 on nothing grows")
