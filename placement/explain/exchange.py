"""Good sets of poses by exchanging units one for one, from the best set and from every site."""

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..optimiser import ReducedProblem
from ..optimiser.bitsets import set_values, values_with_each
from ..optimiser.greedy import extend_greedily, forced_units
from ..optimiser.limits import are_allowed, is_allowed
from .every_set import Listed
from .rows import LACKING, QuickRows, descending, first_column, is_within, site_counts, threshold_of

_FEW_SETS = 100  # up to so many are quicker one by one than by a look at all poses


def list_by_exchange(
    reduced: ReducedProblem,
    start: IntArray,
    *,
    tolerance: float,
    n_sets: int,
    max_looks: int,
) -> Listed:
    """The best sets that exchanges lead to.

    Parameters
    ----------
    reduced : ReducedProblem
        What to choose from.
    start : (n_units,) int
        A set that meets limits and floors.
    tolerance : float
        By how much a set may be worse than the best in the first stage; relative where few units
        or little money come first.
    n_sets : int
        How many to list.
    max_looks : int
        When to stop: looks at a set with one unit taken away, together with every pose.

    Returns
    -------
    listed : Listed
        Every set listed has been exchanged itself, unless the looks were used up. Beside `start`,
        the best pose of each site, with what greedy choice adds to it, is a beginning.
    """
    search = _Exchange(reduced, tolerance=tolerance, n_sets=n_sets, max_looks=max_looks)
    search.offer(start[None, :])
    search.exchange_all()
    for pose in _best_of_each_site(reduced):
        if search.n_looks >= max_looks:
            break
        seed = np.unique(np.append(forced_units(reduced), pose))
        units = extend_greedily(reduced, seed)
        search.n_looks += len(units) - len(seed)
        if is_allowed(reduced.limits, units):
            search.offer(np.sort(units)[None, :])
            search.exchange_all()
    return search.listed()


def _best_of_each_site(reduced: ReducedProblem) -> IntArray:
    """The best single pose of every site, the best site first."""
    usable = np.flatnonzero(~reduced.limits.is_forbidden)
    rows = QuickRows(reduced).with_each(np.empty(0, dtype=np.int64))[usable]
    ordered = usable[descending(rows)]
    _, first = np.unique(reduced.limits.site_index[ordered], return_index=True)
    return ordered[np.sort(first)]


class _Exchange:
    """The best sets so far."""

    def __init__(
        self, reduced: ReducedProblem, *, tolerance: float, n_sets: int, max_looks: int
    ) -> None:
        self.reduced, self.tolerance = reduced, tolerance
        self.n_sets, self.max_looks = n_sets, max_looks
        self.column = first_column(reduced)
        self.quick = QuickRows(reduced)
        self.rows: dict[tuple[int, ...], FloatArray] = {}
        self.exchanged: set[tuple[int, ...]] = set()
        self.best = -np.inf
        self.n_looks = 0

    @property
    def threshold(self) -> float:
        """What a set must reach in the first stage."""
        return threshold_of(self.reduced, self.best, self.tolerance)

    def offer(self, sets: IntArray) -> None:
        """Take sets, (n, n_units), if they are among the best."""
        if len(sets):
            self._take(sets, set_values(self.reduced, sets))

    def exchange_all(self) -> None:
        """Exchange units of the sets listed until nothing new is listed, or looks are used up."""
        while self.n_looks < self.max_looks:
            key = next((key for key in self.rows if key not in self.exchanged), None)
            if key is None:
                return
            self.exchanged.add(key)
            units = np.array(key, dtype=np.int64)
            if len(units) < self.reduced.limits.max_units:
                self._look_at(units)
            for position in range(len(units)):
                left = np.delete(units, position)
                if len(left) and are_allowed(self.reduced.limits, left[None, :])[0]:
                    self.offer(left[None, :])
                self._look_at(left)

    def _look_at(self, left: IntArray) -> None:
        """All sets of these units and one more."""
        reduced = self.reduced
        self.n_looks += 1
        rows = self.quick.with_each(left)
        comes_close = (rows[:, LACKING] == 0.0) & is_within(rows[:, self.column], self.threshold)
        comes_close[left] = False
        joined = np.flatnonzero(comes_close)
        sets = np.sort(np.column_stack([np.tile(left, (len(joined), 1)), joined]), axis=1)
        allowed = are_allowed(reduced.limits, sets)
        joined, sets = joined[allowed], sets[allowed]
        if len(sets) > _FEW_SETS:
            self._take(sets, values_with_each(reduced, left)[joined])
        else:
            self.offer(sets)

    def _take(self, sets: IntArray, rows: FloatArray) -> None:
        meets = rows[:, LACKING] == 0.0
        sets, rows = sets[meets], rows[meets]
        if not len(sets):
            return
        self.best = max(self.best, float(rows[:, self.column].max()))
        for index in descending(rows)[: self.n_sets]:
            self.rows[tuple(sets[index].tolist())] = rows[index]
        within = {
            key: row
            for key, row in self.rows.items()
            if bool(is_within(float(row[self.column]), self.threshold))
        }
        keys = list(within)
        order = descending(np.array(list(within.values())))[: self.n_sets]
        self.rows = {keys[index]: within[keys[index]] for index in order}

    def listed(self) -> Listed:
        """The best sets."""
        sets = tuple(np.array(key, dtype=np.int64) for key in self.rows)
        pose_count = np.zeros(self.reduced.n_poses, dtype=np.int64)
        site_count = np.zeros(self.reduced.limits.n_sites, dtype=np.int64)
        for units in sets:
            pose_count[units] += 1
            site_count += site_counts(self.reduced, units[None, :])
        return Listed(
            sets=sets,
            rows=np.array(list(self.rows.values())),
            n_within=len(sets),
            pose_count=pose_count,
            site_count=site_count,
            best=self.best,
        )
