"""The made-up city of the benchmark, solved in two ways."""

import numpy as np
import pytest

from experiments.bench.city import build_made_up_city, solve_directly
from placement.city.choose import CityWishes, choose


@pytest.mark.parametrize("seed", [0, 1])
def test_a_made_up_city_is_solved_as_by_highs_itself(seed):
    options, weight, budget_eur = build_made_up_city(40, seed=seed)
    choice = choose(options, weight, CityWishes(budget_eur=budget_eur))
    assert choice.certificate.stages[0].gap == 0.0
    theirs = solve_directly(options, weight, budget_eur)
    assert choice.certificate.stages[0].objective == pytest.approx(theirs, abs=1e-6)
    assert options.cost_eur[choice.rows].sum() <= budget_eur
    assert (np.diff(options.apr.reshape(40, 11), axis=1) > 0.0).all()
