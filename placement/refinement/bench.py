"""Promising poses, old and new, and the placement problem on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import IntArray

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..optimiser import Limits, PlacementProblem, ReducedProblem
from ..optimiser.bitsets import values_with_each
from ..optimiser.limits import fitting
from .proposals import Places


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """Poses that are tried together.

    Attributes
    ----------
    candidates : tuple of CandidatePose
        The poses.
    origin : (n,) int
        Row of the grid's pose that each one is, or stands in for: it hangs at the same place, and
        has the same sensor.
    is_new : (n,) bool
        Whether it is not in the grid.
    packed : (n, ceil(n_frames / 8)) uint8
        Detection rows.
    """

    candidates: tuple[CandidatePose, ...]
    origin: IntArray
    is_new: NDArray[np.bool_]
    packed: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.candidates)

    def plus(self, other: "Bench") -> "Bench":
        """With other poses behind."""
        return Bench(
            candidates=(*self.candidates, *other.candidates),
            origin=np.concatenate([self.origin, other.origin]),
            is_new=np.concatenate([self.is_new, other.is_new]),
            packed=np.concatenate([self.packed, other.packed]),
        )

    def only(self, rows: IntArray) -> "Bench":
        """Some of the poses, in the order given."""
        return Bench(
            candidates=tuple(self.candidates[row] for row in rows),
            origin=self.origin[rows],
            is_new=self.is_new[rows],
            packed=self.packed[rows],
        )

    def problem(self, grid: PlacementProblem) -> PlacementProblem:
        """The grid's problem on these poses; those that are forced must be among them."""
        return replace(
            grid,
            table=DetectionTable(
                pose_ids=tuple(candidate.id for candidate in self.candidates),
                axis=grid.table.axis,
                packed=self.packed,
            ),
            limits=_limits_of(grid.limits, self.origin, self.is_new),
        )


def grid_bench(
    problem: PlacementProblem, candidates: Sequence[CandidatePose], rows: IntArray
) -> Bench:
    """Some poses of a grid."""
    return Bench(
        candidates=tuple(candidates[row] for row in rows),
        origin=np.asarray(rows, dtype=np.int64),
        is_new=np.zeros(len(rows), dtype=bool),
        packed=problem.table.packed[rows],
    )


def add_poses(
    bench: Bench,
    problem: PlacementProblem,
    proposals: Sequence[tuple[int, CandidatePose]],
    *,
    places: Places,
    build_rows: Callable[[Sequence[CandidatePose]], NDArray[np.uint8]],
) -> Bench:
    """A bench with more poses behind, those that it does not have yet.

    Parameters
    ----------
    bench : Bench
        What is there.
    problem : PlacementProblem
        The grid's: what is in its table is not computed again.
    proposals : sequence of (int, CandidatePose)
        Poses, and the rows of the grid that they stand for; equal ids mean equal poses.
    places : Places
        The grid.
    build_rows : callable
        Makes detection rows.
    """
    known = {candidate.id for candidate in bench.candidates}
    asked = {pose.id: (origin, pose) for origin, pose in proposals if pose.id not in known}
    old = [places.row_of[name] for name in asked if name in places.row_of]
    new = [item for name, item in asked.items() if name not in places.row_of]
    poses = tuple(pose for _, pose in new)
    if old:
        bench = bench.plus(grid_bench(problem, places.candidates, np.array(old)))
    if poses:
        added = Bench(
            candidates=poses,
            origin=np.array([origin for origin, _ in new], dtype=np.int64),
            is_new=np.ones(len(poses), dtype=bool),
            packed=build_rows(poses),
        )
        bench = bench.plus(added)
    return bench


def promising_rows(
    reduced: ReducedProblem, pose_index: Sequence[int], *, n_best: int, n_per_site: int
) -> IntArray:
    """Poses that could take a chosen one's place best.

    Parameters
    ----------
    reduced : ReducedProblem
        Presolved problem.
    pose_index : sequence of int
        What is chosen, rows of the full problem's table.
    n_best : int
        Poses per unit, the best ones beside all others.
    n_per_site : int
        The same, of each site: so that every site stays in the race.

    Returns
    -------
    rows : (n,) int
        Of the full problem's table, ascending; the chosen ones and all that are forced are among
        them.
    """
    chosen = np.flatnonzero(np.isin(reduced.pose_index, pose_index))
    found = [np.asarray(pose_index, dtype=np.int64)]
    found.append(reduced.pose_index[reduced.limits.is_forced])
    for position in np.flatnonzero(~reduced.limits.is_forced[chosen]):
        others = np.delete(chosen, position)
        fits = np.flatnonzero(fitting(reduced.limits, others))
        values = values_with_each(reduced, others)[fits]
        best_first = fits[np.lexsort(-values.T[::-1])]
        site = reduced.limits.site_index[best_first]
        first_of_sites = [best_first[site == one][:n_per_site] for one in np.unique(site)]
        found += [reduced.pose_index[rows] for rows in (best_first[:n_best], *first_of_sites)]
    rows: IntArray = np.unique(np.concatenate(found))
    return rows


def _limits_of(limits: Limits, origin: IntArray, is_new: NDArray[np.bool_]) -> Limits:
    part = limits.of_poses(origin)
    return replace(part, is_forced=part.is_forced & ~is_new)
