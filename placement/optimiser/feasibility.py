"""Wishes that cannot be met: which, and the best that can."""

from collections.abc import Sequence

import numpy as np

from geometry.errors import InputError, Unquoted

from .bitsets import left_after_failures, union_margins_s
from .limits import Limits, cost_eur
from .objectives import COST_TOLERANCE_EUR, TOLERANCE
from .presolve import ReducedProblem
from .problem import Measure, PlacementProblem
from .search import Search


class UnmetError(InputError):
    """A wish that no layout meets, or none that was found."""


def check_limits(limits: Limits, pose_ids: Sequence[str]) -> None:
    """Check limits against each other, before anything is solved.

    `pose_ids` are the names of the poses in messages.

    Raises UnmetError: two of them cannot both be met: forced and forbidden, a site that is too
    small, money that does not suffice, rivals that are both forced, or no unit at all.
    """
    forced = np.flatnonzero(limits.is_forced)
    both = np.flatnonzero(limits.is_forced & limits.is_forbidden)
    if len(both):
        raise UnmetError(
            pose_ids[int(both[0])], Unquoted("forced and forbidden"), "one of the two at most"
        )
    at_site = np.bincount(limits.site_index[forced], minlength=limits.n_sites)
    for site in np.flatnonzero(at_site > limits.site_capacity):
        names = ", ".join(pose_ids[int(pose)] for pose in forced if limits.site_index[pose] == site)
        raise UnmetError(
            "forced units",
            Unquoted(f"{at_site[site]} at one site ({names})"),
            f"at most {limits.site_capacity[site]}, what the site can carry",
        )
    usable = (limits.site_capacity[limits.site_index] > 0) & ~limits.is_forbidden
    if not usable.any():
        raise UnmetError("candidates", Unquoted("none that may be used"), "at least one")
    for site in np.flatnonzero(limits.is_forced_site):
        if not usable[limits.site_index == site].any():
            raise UnmetError(
                "forced sites", Unquoted("a site without a pose that may be used"), "one or more"
            )
    must_carry = limits.is_forced_site | (at_site > 0)
    for one, other in limits.rivals:
        if must_carry[one] and must_carry[other]:
            raise UnmetError(
                "--separation",
                Unquoted("two sites nearer than that which must both carry units"),
                "one of them at most",
            )
    n_needed = len(forced) + int((limits.is_forced_site & (at_site == 0)).sum())
    if limits.budget_units is not None and n_needed > limits.budget_units:
        raise UnmetError(
            "--budget",
            limits.budget_units,
            f"at least {n_needed}, the units that are forced or stand at forced sites",
        )
    if limits.budget_eur is None:
        return
    price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
    needed = cost_eur(limits, forced)
    what = "the price of the forced units"
    if not len(forced):
        needed, what = float(price[usable].min()), "the price of the cheapest unit with its site"
    if needed > limits.budget_eur + COST_TOLERANCE_EUR:
        raise UnmetError("--budget-cost", limits.budget_eur, f"at least {needed:.2f} EUR, {what}")


def check_reach(problem: PlacementProblem, reduced: ReducedProblem) -> None:
    """Check that all poses together reach every floor.

    Raises UnmetError: they do not.
    """
    everything = np.bitwise_or.reduce(reduced.words, axis=0, keepdims=True)
    is_avoided = union_margins_s(reduced, everything) > -np.inf
    for floor, requirement in zip(problem.floors, reduced.floors, strict=True):
        reached = float(requirement.measure.of(is_avoided)[0])
        if reached < floor.share - TOLERANCE:
            raise UnmetError(
                floor.name,
                Unquoted(f"{floor.share:g}"),
                f"at most {_rounded_down(reached)}, what all candidate poses together reach",
            )


def check_floors(problem: PlacementProblem, search: Search) -> None:
    """Check that the set that was found reaches all floors.

    Raises UnmetError: it does not: out of reach, and the best that can be reached, or not found in
    time.
    """
    if search.units is not None and search.shortfall == 0.0:
        return
    reduced = search.reduced
    if search.units is None:
        why = "no set of poses meets all of them" if search.nothing_meets_all else "none was found"
        raise UnmetError("limits", Unquoted(why), "limits that leave a choice")
    worst = max(
        zip(problem.floors, reduced.floors, strict=True),
        key=lambda pair: pair[1].least - _reached(search, pair[1].measure, pair[1].n_failures),
    )
    floor, requirement = worst
    reached = _reached(search, requirement.measure, requirement.n_failures)
    failing = f" when any {floor.n_failures} fail" if floor.n_failures else ""
    if search.nothing_meets_all:
        expected = f"at most {_rounded_down(reached)}{failing}, what the best set found reaches"
    else:
        expected = (
            f"more time than the limit, or at most {_rounded_down(reached)}{failing}, what the "
            "best set found in it reaches"
        )
    raise UnmetError(floor.name, Unquoted(f"{floor.share:g}"), expected)


def _reached(search: Search, measure: Measure, n_failures: int) -> float:
    assert search.units is not None
    left = left_after_failures(search.reduced, measure, n_failures, search.units[None, :])
    return float(left[0])


def _rounded_down(share: float) -> str:
    return f"{np.floor(share * 1.0e4) / 1.0e4:g}"
