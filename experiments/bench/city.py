"""Speed of a city's choice: made-up fronts, solved here and by a direct call of HiGHS.

``python -m experiments.bench.city FOLDER --out costs.png`` draws what the junctions of a folder of
``place-rsus city`` cost.
"""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp, nnls

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from placement.city.choose import CityWishes, choose
from placement.city.fronts import Options
from placement.city.knapsack import Knapsack, solve_knapsack

from .speed import Figures

if TYPE_CHECKING:
    import pandas as pd

_POINTS = 10
_JUNCTIONS, _FEW = 100_000, 1_000
_GAP = 1.0e-3
_BUDGET_SHARE = 0.15
_COSTS = ("sites", "runs", "frames", "cpu_s", "peak_memory_mib")


def measure_city() -> Figures:
    """100,000 junctions with ten points each; and a direct call of HiGHS for a thousand."""
    few, few_weight, few_eur = build_made_up_city(_FEW)
    choose(few, few_weight, CityWishes(budget_eur=few_eur), gap=_GAP)  # loads cvxpy
    options, weight, budget_eur = build_made_up_city(_JUNCTIONS)
    began_s = time.process_time()
    choice = choose(options, weight, CityWishes(budget_eur=budget_eur), gap=_GAP)
    all_s = time.process_time() - began_s
    problem = Knapsack(
        group=few.junction,
        profit=(few_weight / few_weight.sum())[few.junction] * few.apr,
        rows=few.cost_eur[None],
        limits=np.array([few_eur]),
    )
    began_s = time.process_time()
    found = solve_knapsack(problem, gap=_GAP)
    ours_s = time.process_time() - began_s
    began_s = time.process_time()
    theirs = solve_directly(few, few_weight, few_eur, gap=_GAP)
    theirs_s = time.process_time() - began_s
    if not theirs <= found.bound + 1.0e-9:
        raise RuntimeError(f"HiGHS finds {theirs}, above the bound {found.bound}")
    name = f"city: {_JUNCTIONS:,} junctions x {_POINTS} points"
    return {
        f"{name}: processor seconds, all objectives (under 10)": all_s,
        f"{name}: proven gap, % (at most 0.1)": 100.0 * choice.certificate.stages[0].gap,
        f"city: {_FEW:,} junctions: HiGHS / ours, first objective": theirs_s / ours_s,
    }


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
    """The first objective by SciPy's HiGHS alone."""
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


# ---------- cost of junctions


def read_costs(folder: Path) -> "pd.DataFrame":
    """Sizes and costs in ``junctions.csv``, of junctions whose fronts were found.

    Raises InputError: there is no such file, it lacks the columns, or no junction was answered.
    """
    import pandas as pd

    path = folder / "junctions.csv"
    try:
        table = pd.read_csv(path)[list(_COSTS)].apply(pd.to_numeric).astype(float)
    except (OSError, KeyError, ValueError) as error:
        raise InputError(str(path), Unquoted(str(error)), "of place-rsus city") from None
    found: pd.DataFrame = table[np.isfinite(table).all(axis=1) & (table > 0.0).all(axis=1)]
    if found.empty:
        raise InputError(str(path), Unquoted("no junctions"), "some whose fronts were found")
    return found.assign(sites_frames_1e6=found["sites"] * found["frames"] / 1.0e6)


def share_costs(costs: "pd.DataFrame") -> tuple[float, float, float]:
    """Processor seconds of each junction, each run, and each million sites x frames.

    Least squares, none below 0.
    """
    parts = np.column_stack([np.ones(len(costs)), costs["runs"], costs["sites_frames_1e6"]])
    each, _ = nnls(parts, costs["cpu_s"].to_numpy(dtype=np.float64))
    return float(each[0]), float(each[1]), float(each[2])


def plot_costs(costs: "pd.DataFrame", path: Path) -> None:
    """Processor seconds of junctions over their runs, sites, and sites x frames."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    over = {
        "runs": costs["runs"],
        "sites": costs["sites"],
        "million sites x frames": costs["sites_frames_1e6"],
    }
    for axes, (label, x) in zip(figure.subplots(1, 3, sharey=True), over.items(), strict=True):
        axes.plot(x, costs["cpu_s"], "o", color="0.25", markersize=4.0, alpha=0.7)
        axes.set_xlabel(label)
        axes.set_ylim(bottom=0.0)
    figure.axes[0].set_ylabel("processor seconds of a junction")
    figure.savefig(path, dpi=150)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Figure, .png.")
def main(folder: Path, out: Path) -> None:
    """Draw what the junctions of FOLDER, which place-rsus city wrote, cost."""
    costs = read_costs(folder)
    plot_costs(costs, out)
    spent, peak_mib = costs["cpu_s"], costs["peak_memory_mib"].max()
    click.echo(
        f"{len(costs)} junctions: {spent.sum() / 60.0:.0f} processor minutes, median "
        f"{spent.median():.0f} s, most {spent.max():.0f} s, {peak_mib:.0f} MiB"
    )
    junction, run, size = share_costs(costs)
    click.echo(f"{junction:.1f} s each, {run:.3f} s a run, {size:.1f} s a million sites x frames")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"error: {error}") from None
