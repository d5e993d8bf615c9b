"""A city's choice: made-up fronts, solved here and by a direct call of HiGHS."""

import time
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp

from geometry.arrays import FloatArray
from placement.city.choose import CityWishes, choose
from placement.city.fronts import Options
from placement.city.knapsack import Knapsack, solve_knapsack

from .rays import Figures

_POINTS = 10
_JUNCTIONS, _FEW = 100_000, 1_000
_GAP = 1.0e-3
_BUDGET_SHARE = 0.15


def measure_city() -> Figures:
    """100,000 junctions with ten points each; and how a direct call of HiGHS takes a thousand."""
    options, weight, budget_eur = build_made_up_city(_JUNCTIONS)
    wishes = CityWishes(budget_eur=budget_eur)
    choose(*_small(), gap=_GAP)  # loads cvxpy
    began_s = time.process_time()
    choice = choose(options, weight, wishes, gap=_GAP)
    stage = choice.certificate.stages[0]
    name = f"city: {_JUNCTIONS:,} junctions x {_POINTS} points"
    figures: Figures = {
        f"{name}: processor seconds, all objectives (under 10)": time.process_time() - began_s,
        f"{name}: proven gap, % (at most 0.1)": 100.0 * stage.gap,
    }
    few, weight, budget_eur = build_made_up_city(_FEW)
    problem = Knapsack(
        group=few.junction,
        profit=(weight / weight.sum())[few.junction] * few.apr,
        rows=few.cost_eur[None],
        limits=np.array([budget_eur]),
    )
    began_s = time.process_time()
    found = solve_knapsack(problem, gap=_GAP)
    ours_s = time.process_time() - began_s
    began_s = time.process_time()
    theirs = solve_directly(few, weight, budget_eur, gap=_GAP)
    theirs_s = time.process_time() - began_s
    if not theirs <= found.bound + 1.0e-9:
        raise RuntimeError(f"HiGHS finds {theirs}, above the bound {found.bound}")
    return figures | {
        f"city: {_FEW:,} junctions: processor seconds of HiGHS, first objective": theirs_s,
        f"city: {_FEW:,} junctions: HiGHS / ours, first objective": theirs_s / ours_s,
    }


def _small() -> tuple[Options, FloatArray, CityWishes]:
    options, weight, budget_eur = build_made_up_city(20)
    return options, weight, CityWishes(budget_eur=budget_eur)


def build_made_up_city(n_junctions: int, *, seed: int = 0) -> tuple[Options, FloatArray, float]:
    """Fronts that rise ever more slowly, weights of a log-normal distribution, and a budget."""
    rng = np.random.default_rng(seed)
    shape = (n_junctions, _POINTS)
    cost = np.cumsum(rng.integers(1_500, 9_000, shape), axis=1).astype(np.float64)
    rising = 1.0 - np.cumprod(rng.uniform(0.3, 0.95, shape), axis=1)
    nothing = np.zeros((n_junctions, 1))
    cost = np.hstack([nothing, cost])
    apr: FloatArray = np.hstack([nothing, rising]).ravel()
    rows = np.arange(apr.size)
    options = Options(
        junction=rows // (_POINTS + 1),
        units=rows % (_POINTS + 1),
        cost_eur=cost.ravel(),
        apr=apr,
        apr_one_failed=np.array(0.5 * apr),
        smallest_margin_s=np.where(apr > 0.0, 0.1, 0.0),
        mean_margin_s=np.where(apr > 0.0, 1.0, 0.0),
    )
    return options, rng.lognormal(size=n_junctions), _BUDGET_SHARE * float(cost[:, -1].sum())


def solve_directly(
    options: Options, weight: FloatArray, budget_eur: float, *, gap: float = 0.0
) -> float:
    """The first objective by SciPy's HiGHS, with no help of ours."""
    n = len(options)
    one_each = sp.csr_array((np.ones(n), (options.junction, np.arange(n))))
    profit = (weight / weight.sum())[options.junction] * options.apr
    solved: Any = milp(
        -profit,
        integrality=np.ones(n, dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        constraints=[
            LinearConstraint(one_each, lb=1.0, ub=1.0),
            LinearConstraint(options.cost_eur[None], ub=budget_eur),
        ],
        options={"mip_rel_gap": gap},
    )
    return float(-solved.fun)
