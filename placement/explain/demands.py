"""What a placement problem demands, piece by piece, and the problem without some of the pieces."""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..optimiser import Floor, Limits, PlacementProblem, floor_value, is_allowed
from ..optimiser.problem import TOLERANCE

Kind = Literal[
    "budget_units",
    "budget_eur",
    "floor",
    "survive",
    "capacity",
    "separation",
    "forced_sites",
    "forbidden",
    "forced",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """One of the pieces: it can be dropped, or relaxed, without the others.

    Attributes
    ----------
    kind : str
        "budget_units", "budget_eur"; "floor": one of them, without failures; "survive": that all
        floors hold when units fail; "capacity": of all sites; "separation": rivals among the
        sites; "forced_sites", "forbidden", "forced": all of them together.
    floor : int, optional
        Index of the floor.
    """

    kind: Kind
    floor: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Separation:
    """What a least distance between units has made of the limits.

    Attributes
    ----------
    distance_m : float
        Pairs of sites that are nearer are rivals. [m]
    pair_distance_m : (n_pairs,) float
        Distances of the limits' rivals. [m]
    site_capacity : (n_sites,) int
        Units that each site could carry without it.
    """

    distance_m: float
    pair_distance_m: FloatArray
    site_capacity: IntArray


class Wish:
    """A placement problem that can be taken apart.

    Parameters
    ----------
    problem : PlacementProblem
        The whole.
    separation : Separation, optional
        Where the rivals of its limits come from, if from a least distance.
    keeps_forced : bool
        Forced poses are no demand but a fact, such as units that hang there already.
    """

    def __init__(
        self,
        problem: PlacementProblem,
        separation: Separation | None = None,
        *,
        keeps_forced: bool = False,
    ) -> None:
        self.problem, self.separation = problem, separation
        self.keeps_forced = keeps_forced
        self.demands = tuple(
            demand
            for demand in _list_demands(problem, separation)
            if not (keeps_forced and demand.kind == "forced")
        )
        self.everything = frozenset(range(len(self.demands)))
        self._limits: dict[frozenset[int], Limits] = {}

    def part(self, active: Set[int]) -> PlacementProblem:
        """The problem with some of the demands only; equal limits are one object."""
        demands = self.demands
        survives = any(demands[number].kind == "survive" for number in active)
        floors = tuple(
            floor if survives else replace(floor, n_failures=0) for floor in self._floors(active)
        )
        return replace(
            self.problem,
            limits=self._limits_of(active),
            floors=floors,
            goal="best",
            survive=0,
            stage_weights=None,
        )

    def met_by(self, poses: Sequence[int], active: Set[int]) -> frozenset[int]:
        """Demands that a set of poses meets all at once, `active` ones among them if it meets them.

        That floors hold when units fail counts as met where that is so for all floors that are
        met without failures, or where it is asked for: then floors must hold so.
        """
        met = set()
        asks_to_survive = any(self.demands[number].kind == "survive" for number in active)
        holds_all, survive = True, None
        for number, demand in enumerate(self.demands):
            if demand.kind == "survive":
                survive = number
            elif demand.floor is None:
                if is_allowed(self._limits_of({number}), poses):
                    met.add(number)
            else:
                floor = self.problem.floors[demand.floor]
                holds = self._holds(floor, poses)
                holds_unfailed = self._holds(replace(floor, n_failures=0), poses)
                holds_all &= holds or not holds_unfailed
                if holds or (holds_unfailed and not asks_to_survive):
                    met.add(number)
        if survive is not None and (asks_to_survive or holds_all):
            met.add(survive)
        return frozenset(met)

    def _holds(self, floor: Floor, poses: Sequence[int]) -> bool:
        return floor_value(self.problem, floor, poses) >= floor.share - TOLERANCE

    def _floors(self, active: Set[int]) -> list[Floor]:
        indices = [self.demands[number].floor for number in sorted(active)]
        return [self.problem.floors[index] for index in indices if index is not None]

    def _limits_of(self, active: Set[int]) -> Limits:
        key = frozenset(
            number for number in active if self.demands[number].kind not in ("floor", "survive")
        )
        if key not in self._limits:
            kinds = {self.demands[number].kind for number in key}
            if self.keeps_forced:
                kinds.add("forced")
            self._limits[key] = _loosen(self.problem.limits, kinds, self.separation)
        return self._limits[key]


def _list_demands(problem: PlacementProblem, separation: Separation | None) -> tuple[Demand, ...]:
    """What is demanded; what binds nothing is left out."""
    limits = problem.limits
    capacity = limits.site_capacity if separation is None else separation.site_capacity
    per_site = np.bincount(limits.site_index, minlength=limits.n_sites)
    is_there: dict[Kind, bool] = {
        "budget_units": limits.budget_units is not None,
        "budget_eur": limits.budget_eur is not None,
        "capacity": bool((per_site > capacity).any()),
        "separation": separation is not None or len(limits.rivals) > 0,
        "forced_sites": bool(limits.is_forced_site.any()),
        "forbidden": bool(limits.is_forbidden.any()),
        "forced": bool(limits.is_forced.any()),
    }
    demands = [Demand(kind="floor", floor=index) for index in range(len(problem.floors))]
    if any(floor.n_failures for floor in problem.floors):
        demands.append(Demand(kind="survive"))
    return (*demands, *(Demand(kind=kind) for kind, is_asked in is_there.items() if is_asked))


def _loosen(limits: Limits, kinds: Set[Kind], separation: Separation | None) -> Limits:
    """Limits of some kinds only."""
    capacity = limits.site_capacity
    if separation is not None and "separation" not in kinds:
        capacity = separation.site_capacity
    # One unit per site is what a separation asks for, whatever the sites could carry.
    is_kept_apart = separation is not None and "separation" in kinds
    if "capacity" not in kinds and not is_kept_apart:
        capacity = np.full(limits.n_sites, limits.n_poses)
    return replace(
        limits,
        site_capacity=capacity,
        budget_units=limits.budget_units if "budget_units" in kinds else None,
        budget_eur=limits.budget_eur if "budget_eur" in kinds else None,
        is_forced=limits.is_forced & ("forced" in kinds),
        is_forbidden=limits.is_forbidden & ("forbidden" in kinds),
        is_forced_site=limits.is_forced_site & ("forced_sites" in kinds),
        rivals=limits.rivals if "separation" in kinds else limits.rivals[:0],
    )
