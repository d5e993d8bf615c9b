"""What a junction may get, and what bounds it: points of its front, and steps that none exceeds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted

from ..optimiser.steering import COST_TOLERANCE_EUR, TOLERANCE

# ---------- one junction

Steps = tuple[tuple[float, float], ...]
"""From which units or euros on, up to the next step, which APR is not exceeded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A layout that a junction may get, by what it takes and what it is worth.

    Attributes
    ----------
    units : int
        New ones: those that hang there already are not counted.
    cost_eur : float
        Of the new units and their sites. [EUR]
    apr, apr_one_failed, smallest_margin_s, mean_margin_s : float
        As :class:`placement.optimiser.PlacementValue` has them, with what hangs there already.
    """

    units: int
    cost_eur: float
    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float

    def is_beaten_by(self, other: "Point") -> bool:
        """Whether another point takes no more and is no worse, objective by objective."""
        return (
            other.units <= self.units
            and other.cost_eur <= self.cost_eur + COST_TOLERANCE_EUR
            and _compare(other, self) >= 0
        )


NOTHING = Point(
    units=0,
    cost_eur=0.0,
    apr=0.0,
    apr_one_failed=0.0,
    smallest_margin_s=0.0,
    mean_margin_s=0.0,
)
"""What a junction has where nothing hangs."""


def _compare(one: Point, other: Point) -> int:
    """1 if a point is better than another, objective by objective, -1 if worse, 0 if alike."""
    for name in ("apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s"):
        difference = getattr(one, name) - getattr(other, name)
        if abs(difference) > TOLERANCE:
            return 1 if difference > 0.0 else -1
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class JunctionFront:
    """What a junction may get, and what no layout there exceeds.

    Attributes
    ----------
    points : tuple of Point
        The first takes nothing.
    by_units : tuple of (float, float)
        From so many new units on, up to the next step, no layout has a higher APR.
    by_cost : tuple of (float, float)
        From so many euros on, up to the next step, no layout has a higher APR.
    """

    points: tuple[Point, ...]
    by_units: Steps
    by_cost: Steps

    def __post_init__(self) -> None:
        if not self.points or self.points[0].units or self.points[0].cost_eur:
            raise InputError("front", Unquoted("no point without units"), "it as the first")
        for name in ("by_units", "by_cost"):
            steps = getattr(self, name)
            if not steps or steps[0][0] != 0:
                raise InputError(f"front.{name}", steps[:1], "steps from 0 on")
            if any(a[0] >= b[0] or a[1] > b[1] + TOLERANCE for a, b in pairwise(steps)):
                raise InputError(f"front.{name}", steps, "steps that rise")

    @property
    def is_proven(self) -> bool:
        """Whether no layout has a higher APR than the points, for any number of units or euros."""
        return all(
            bound <= max(p.apr for p in self.points if p.units <= units) + TOLERANCE
            for units, bound in self.by_units
        ) and all(
            bound
            <= max(p.apr for p in self.points if p.cost_eur <= cost + COST_TOLERANCE_EUR)
            + TOLERANCE
            for cost, bound in self.by_cost
        )


def build_junction_front(
    points: Iterable[Point],
    *,
    by_units: Sequence[tuple[float, float]],
    by_cost: Sequence[tuple[float, float]],
) -> JunctionFront:
    """A front of the points that no other one beats.

    Parameters
    ----------
    points : iterable of Point
        Any; one without new units is among them.
    by_units, by_cost : sequence of (from, APR)
        Steps from 0 on, ascending, in any order of APR: a bound also holds for less.

    Returns
    -------
    front : JunctionFront
        With steps that rise.
    """
    found = sorted(points, key=lambda point: (point.units, point.cost_eur, -point.apr))
    kept = [
        point
        for index, point in enumerate(found)
        if not any(
            point.is_beaten_by(other) and (not other.is_beaten_by(point) or before < index)
            for before, other in enumerate(found)
            if before != index
        )
    ]
    return JunctionFront(points=tuple(kept), by_units=lowered(by_units), by_cost=lowered(by_cost))


def value_at(steps: Sequence[tuple[float, float]], place: float) -> float:
    """The bound of the step in which a number of units, or an amount, lies."""
    return next(bound for start, bound in reversed(steps) if start <= place)


def lowest(steps: Sequence[Steps]) -> Steps:
    """Bounds of which each is the least of several that hold."""
    starts = sorted({start for each in steps for start, _ in each})
    return tuple((start, min(value_at(each, start) for each in steps)) for start in starts)


def lowered(steps: Sequence[tuple[float, float]]) -> Steps:
    """Steps that rise: what holds for more holds for less; steps that say the same are one."""
    least = np.minimum.accumulate([bound for _, bound in reversed(steps)])[::-1]
    rising: list[tuple[float, float]] = []
    for (start, _), bound in zip(steps, least.tolist(), strict=True):
        if not rising or bound > rising[-1][1] + TOLERANCE:
            rising.append((start, bound))
    return tuple(rising)


# ---------- many junctions, as arrays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options:
    """What each of many junctions may get, one option per row.

    Attributes
    ----------
    junction : (n,) int
        Ascending, 0, 1, 2 ..; each junction has an option at least.
    units : (n,) int
        New units.
    cost_eur : (n,) float
        Of these. [EUR]
    apr, apr_one_failed, smallest_margin_s, mean_margin_s : (n,) float
        What the option is worth, see :class:`Point`.
    """

    junction: IntArray
    units: IntArray
    cost_eur: FloatArray
    apr: FloatArray
    apr_one_failed: FloatArray
    smallest_margin_s: FloatArray
    mean_margin_s: FloatArray

    def __post_init__(self) -> None:
        for name in ("junction", "units"):
            object.__setattr__(self, name, freeze(np.array(getattr(self, name), dtype=np.int64)))
        for name in _VALUES:
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != self.junction.shape or not np.isfinite(values).all():
                raise InputError(f"options.{name}", values.shape, "a finite number for each option")
            object.__setattr__(self, name, freeze(values))
        steps = np.diff(self.junction, prepend=-1)
        if not ((steps == 0) | (steps == 1)).all():
            raise InputError("options.junction", Unquoted("gaps"), "junctions 0, 1, 2 .. in order")

    def __len__(self) -> int:
        return len(self.junction)

    @property
    def n_junctions(self) -> int:
        """Number of junctions."""
        return int(self.junction[-1]) + 1 if len(self.junction) else 0

    def taken(self, rows: IntArray) -> "Options":
        """Some of the options, by rows in ascending order; each junction keeps one at least."""
        return Options(
            junction=self.junction[rows],
            units=self.units[rows],
            **{name: getattr(self, name)[rows] for name in _VALUES},
        )


_VALUES = ("cost_eur", "apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s")


def stack_fronts(fronts: Sequence[JunctionFront]) -> Options:
    """The points of many fronts as options."""
    points = [point for front in fronts for point in front.points]
    return Options(
        junction=np.repeat(np.arange(len(fronts)), [len(front.points) for front in fronts]),
        units=np.array([point.units for point in points]),
        **{name: np.array([getattr(point, name) for point in points]) for name in _VALUES},
    )


def stack_bounds(
    fronts: Sequence[JunctionFront], *, counts_units: bool, counts_cost: bool
) -> Options:
    """What layouts beside the points might reach at best, as options.

    Each layout of a junction takes at least as much as one of these options and has no higher APR:
    what cannot be reached with them cannot be reached at all. With units and cost counted, an
    option stands for a step of both. The other values are 0.
    """
    junction: list[int] = []
    units: list[float] = []
    cost: list[float] = []
    apr: list[float] = []
    for index, front in enumerate(fronts):
        by_units = front.by_units if counts_units else ((0, front.by_units[-1][1]),)
        by_cost = front.by_cost if counts_cost else ((0.0, front.by_cost[-1][1]),)
        for row, (n_units, most) in enumerate(by_units):
            for column, (eur, bound) in enumerate(by_cost):
                value = min(most, bound)
                if row and min(by_units[row - 1][1], bound) == value:
                    continue  # fewer units bound it as well
                if column and min(most, by_cost[column - 1][1]) == value:
                    continue
                junction.append(index)
                units.append(n_units)
                cost.append(eur)
                apr.append(value)
    unknown = np.zeros(len(junction))
    return Options(
        junction=np.array(junction),
        units=np.array(units),
        cost_eur=np.array(cost),
        apr=np.array(apr),
        apr_one_failed=unknown,
        smallest_margin_s=unknown,
        mean_margin_s=unknown,
    )
