"""Weighted best-of coverage: what is proven about many poses when each run counts its best one.

Rows r are demands (runs, their weight multiplied in), v[c, r] >= 0 is what pose c alone is worth
in row r, and a set S is worth

    f(S) = sum over r of max(reached[r], max of v[c, r] over c in S),

the p-median problem turned round (Cornuejols, Fisher, Nemhauser 1977); with v of 0 and 1 the MCLP.
f is monotone and submodular. Where runs are confirmed by several units together, v from the
first frame of each window (first_seen.py) makes f a limit of the true value.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray

from .supply import Pick, Supply

ValueArray = NDArray[np.float32] | NDArray[np.float64]

_BLOCK_VALUES = 1 << 18  # differences of so many values at a time stay in the cache
_WORTH_THREADS = 1 << 21  # values: with fewer, threads take longer to start than to work


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """Poses to choose from, and what each is worth in every row.

    Attributes
    ----------
    values : (n_poses, n_rows) float32 or float64
        v[c, r], at least 0; never copied.
    supply : Supply
        Which sets are feasible.
    reached : (n_rows,) float, optional
        What units that stand already are worth; by default 0.
    """

    values: ValueArray
    supply: Supply
    reached: FloatArray | None = None

    def __post_init__(self) -> None:
        reached = np.zeros(self.n_rows) if self.reached is None else self.reached
        if self.supply.n_poses != self.n_poses:
            raise ValueError(f"supply: {self.supply.n_poses} poses; expected {self.n_poses}")
        object.__setattr__(self, "reached", reached.astype(self.values.dtype))

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.values)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.values.shape[1])

    @property
    def floor(self) -> ValueArray:
        """`reached`, of the same kind as the values, (n_rows,)."""
        assert self.reached is not None
        return self.reached

    def of_poses(self, poses: IntArray) -> "Coverage":
        """The same for some of the poses: copies their values."""
        return Coverage(
            values=self.values[poses], supply=self.supply.of_poses(poses), reached=self.reached
        )

    def with_units(self, max_units: int) -> "Coverage":
        """The same for another number of units, on the same values."""
        return Coverage(
            values=self.values, supply=self.supply.with_units(max_units), reached=self.reached
        )

    def level(self, poses: IntArray) -> ValueArray:
        """What a set reaches in every row, (n_rows,)."""
        level: ValueArray = self.values[poses].max(axis=0, initial=0.0)
        return np.maximum(level, self.floor)

    def value(self, poses: IntArray) -> float:
        """What a set is worth, f(S)."""
        return float(self.level(poses).sum(dtype=np.float64))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bound:
    """A limit that multipliers prove.

    Attributes
    ----------
    limit : float
        No feasible set is worth more.
    multipliers : (n_rows,) float
        lambda, as it was used: at least what is reached already.
    worth : (n_poses,) float
        rho: what each pose has beyond lambda, summed over the rows.
    pick : Pick
        The poses whose worth makes the limit.
    """

    limit: float
    multipliers: ValueArray
    worth: FloatArray
    pick: Pick


def gains(
    values: ValueArray, level: ValueArray, poses: IntArray | None = None, *, workers: int = 1
) -> FloatArray:
    """What poses have beyond a level: sum over r of max(0, v[c, r] - level[r]).

    Parameters
    ----------
    values : (n_poses, n_rows) float32 or float64
        v[c, r].
    level : (n_rows,) float
        Of the same kind.
    poses : (n,) int, optional
        Of which poses; by default all.
    workers : int
        Threads.

    Returns
    -------
    gains : (n,) float
        Summed in float64: exact but for the rounding of differences. Never grows with the level,
        not even by rounding.
    """
    n_poses = len(values) if poses is None else len(poses)
    result = np.empty(n_poses)
    step = max(1, _BLOCK_VALUES // max(1, values.shape[1]))

    def work(start: int) -> None:
        part = slice(start, start + step)
        over = (values[part] if poses is None else values[poses[part]]) - level
        np.maximum(over, 0.0, out=over)
        over.sum(axis=1, dtype=np.float64, out=result[part])

    starts = range(0, n_poses, step)
    if workers == 1 or n_poses * values.shape[1] < _WORTH_THREADS:
        for start in starts:
            work(start)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, starts))
    return result


def prove(coverage: Coverage, multipliers: ValueArray, *, workers: int = 1) -> Bound:
    """Limit of the value of all feasible sets, from any multipliers.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    multipliers : (n_rows,) float
        lambda. Whatever it is, the limit holds: an approximate dual solution becomes a proof.
    workers : int
        Threads.

    Returns
    -------
    bound : Bound
        ``sum of lambda + max over feasible S of the sum of rho in S``.

    Notes
    -----
    ``max over S of v[c, r] <= lambda[r] + sum over S of max(0, v[c, r] - lambda[r])``
    for every row; summed, the second part separates by poses. This is the Lagrangian dual of the
    p-median problem (Cornuejols, Fisher, Nemhauser 1977); its lowest value is that of the LP
    relaxation. Rounding errs towards a higher limit.
    """
    level = np.maximum(multipliers.astype(coverage.values.dtype), coverage.floor)
    worth = gains(coverage.values, level, workers=workers)
    worth *= 1.0 + 2.0 * np.finfo(coverage.values.dtype).eps  # more than differences err by
    pick = coverage.supply.pick(worth)
    return Bound(
        limit=float(level.sum(dtype=np.float64)) + pick.limit,
        multipliers=level,
        worth=worth,
        pick=pick,
    )


def can_matter(coverage: Coverage, bound: Bound, need: float) -> BoolArray:
    """Poses that a set worth more than `need` may contain: reduced-cost fixing.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    bound : Bound
        From any multipliers.
    need : float
        Such as what the best known set is worth.

    Returns
    -------
    can_matter : (n_poses,) bool
        False: no feasible set with this pose is worth more than `need`.

    Notes
    -----
    A set with pose c is worth at most ``sum of lambda + rho[c]`` and the best K - 1 others, in
    which the room that c takes and the money that it costs are neglected.
    """
    supply = coverage.supply
    fixed = float(bound.multipliers.sum(dtype=np.float64))
    fewer = supply.with_units(supply.max_units - 1)
    limit = np.full(coverage.n_poses, fewer.pick(bound.worth).limit)
    for number, group in enumerate(supply.groups):
        others = supply.groups[:number] + supply.groups[number + 1 :]
        limit[group] = fewer.with_groups(others).pick(bound.worth).limit
    mask: BoolArray = fixed + limit + bound.worth > need
    return mask
