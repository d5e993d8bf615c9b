"""Years: when each junction gets its units, so that the gain comes as early as can be."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError

from ..optimiser.model import run_solver

_MAX_BINARIES = 3_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Phases:
    """When the junctions are ready.

    Attributes
    ----------
    year : (n,) int
        From 1; 0 where nothing is mounted.
    gain_years : float
        Sum over junctions of gain times the years, up to the last one, in which it is there.
    bound : float
        What no other order exceeds.
    """

    year: IntArray
    gain_years: float
    bound: float


def plan_phases(
    units: IntArray,
    gain: FloatArray,
    *,
    units_per_year: int,
    years: int | None = None,
    time_limit_s: float = 10.0,
) -> Phases:
    """Spread units over years.

    At most so many units are mounted in a year. A junction counts from the year in which its last
    unit is mounted: its units may hang in two years. The order is the one with the largest sum of
    gains over the years in which they are there: a mixed-integer model, or for thousands of
    junctions those with the largest gain per unit first (Smith, 1956), with the bound of the order
    in which units may be divided.

    Parameters
    ----------
    units, gain : (n,)
        Of each junction; the gain is at least 0.
    units_per_year : int
        At least 1.
    years : int, optional
        By default as many as it takes.

    Raises
    ------
    InputError
        The years do not suffice.
    """
    total = int(units.sum())
    needed = -(-total // units_per_year)
    n_years = max(needed if years is None else years, 1)
    if needed > n_years:
        raise InputError(
            "years",
            years,
            f"at least {needed}, for {total} units, at most {units_per_year} of them a year",
        )
    rows = np.flatnonzero(units > 0)
    year = np.zeros(len(units), dtype=np.int64)
    year[rows] = _in_order(units[rows], gain[rows], units_per_year)
    bound = _divided(units[rows], gain[rows], units_per_year, n_years)
    if 0 < len(rows) * n_years <= _MAX_BINARIES and n_years > 1:
        found, proven = _solve(
            units[rows], gain[rows], units_per_year, n_years, time_limit_s=time_limit_s
        )
        before = _gain_years(year[rows], gain[rows], n_years)
        if found is not None and _gain_years(found, gain[rows], n_years) > before:
            year[rows] = found
        bound = min(bound, proven)
    value = _gain_years(year[rows], gain[rows], n_years)
    if bound <= value + 1.0e-7 * max(1.0, value):
        bound = value
    return Phases(year=year, gain_years=value, bound=bound)


def _gain_years(year: IntArray, gain: FloatArray, n_years: int) -> float:
    return float(gain @ (n_years + 1 - year)) if len(gain) else 0.0


def _in_order(units: IntArray, gain: FloatArray, units_per_year: int) -> IntArray:
    """Years where the junctions with the largest gain per unit come first."""
    order = np.argsort(-gain / units, kind="stable")
    year = np.empty(len(units), dtype=np.int64)
    year[order] = -(-np.cumsum(units[order]) // units_per_year)
    return year


def _divided(units: IntArray, gain: FloatArray, units_per_year: int, n_years: int) -> float:
    """The largest sum where parts of a junction would gain parts of it."""
    order = np.argsort(-gain / units, kind="stable") if len(units) else units
    end = np.cumsum(units[order])
    worth = 0.0
    for year in range(1, n_years + 1):
        within = np.clip(
            (year * units_per_year - (end - units[order])) / np.maximum(units[order], 1), 0.0, 1.0
        )
        worth += float(gain[order] @ within)
    return worth


def _solve(
    units: IntArray, gain: FloatArray, units_per_year: int, n_years: int, *, time_limit_s: float
) -> tuple[IntArray | None, float]:
    import cvxpy as cp

    n = len(units)
    x = cp.Variable(n * n_years, boolean=True)  # junction by junction, its year
    one_each = sp.kron(sp.eye_array(n), np.ones((1, n_years)), format="csr")
    until = np.tril(np.ones((n_years, n_years)))
    ready = sp.csr_array(np.kron(units.astype(np.float64)[None], until))
    most = units_per_year * np.arange(1.0, n_years + 1.0)
    unit = max(float(gain.sum()), 1.0e-300) / 1.0e4
    worth = np.kron(gain / unit, np.arange(n_years, 0, -1.0))
    answer = run_solver(
        cp.Problem(cp.Maximize(worth @ x), [one_each @ x == 1.0, ready @ x <= most]),
        time_limit_s=time_limit_s,
    )
    if not answer.is_found:
        return None, np.inf
    return 1 + x.value.reshape(n, n_years).argmax(axis=1), answer.bound * unit
