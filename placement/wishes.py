"""Wishes of a planner (units, money, targets, sites), and the optimiser's problem they make."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene

from .candidates import CandidatePose
from .detection_table import DetectionTable
from .optimiser import Failing, Floor, Goal, Limits, PlacementProblem, apr
from .optimiser.problem import Fusion
from .prices import SitePrices
from .setting import Setting


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What is asked of a layout.

    Attributes
    ----------
    budget_units : int, optional
        At most so many units, those that are kept aside.
    budget_eur : float, optional
        At most so much money for units and sites; what is kept is paid. [EUR]
    target : float, optional
        APR that must be reached, 0..1: with the fewest units or the least cost. With ``max``
        as infinity: as much as all candidates together reach.
    saves : {"units", "cost"}
        What a target is reached with the least of.
    min_case_apr : float
        APR that must be reached in every case.
    survive : int
        Units or sites that may fail, any of them: target and floors hold then, too; without
        these, the APR that is left is the first objective.
    failing : {"unit", "site"}
        What fails at once: a unit, or a site with everything that it carries.
    kept : tuple of str
        Ids of candidates that hang there already.
    forced_sites, forbidden_sites : tuple of str
        Ids of sites that must, and must not, carry units, beside what the scene says.
    site_capacity : int, optional
        Units per site, in place of the scene's.
    site_cost_eur : float, optional
        For a site that is used, in place of the scene's. [EUR]
    prices : SitePrices, optional
        For sites of which nobody tells a price; by default they cost nothing.
    separation_m : float
        Least distance on the ground between two units; on one site there is one at most then. [m]
    tail : float
        Share of the sampled worlds that counts, the worst ones, see
        :class:`placement.optimiser.problem.Measure`.
    """

    budget_units: int | None = None
    budget_eur: float | None = None
    target: float | None = None
    saves: str = "units"
    min_case_apr: float = 0.0
    survive: int = 0
    failing: Failing = "unit"
    kept: tuple[str, ...] = ()
    forced_sites: tuple[str, ...] = ()
    forbidden_sites: tuple[str, ...] = ()
    site_capacity: int | None = None
    site_cost_eur: float | None = None
    prices: SitePrices | None = None
    separation_m: float = 0.0
    tail: float = 1.0

    def __post_init__(self) -> None:
        if self.budget_units is None and self.budget_eur is None and self.target is None:
            raise InputError("--budget", Unquoted("nothing"), "--budget, --budget-cost or --target")
        both = set(self.forced_sites) & set(self.forbidden_sites)
        if both:
            raise InputError(
                "--forbid-site", sorted(both)[0], "another site than those of --force-site"
            )

    @property
    def goal(self) -> Goal:
        """The first objective."""
        if self.target is None:
            return "best"
        return "cheapest" if self.saves == "cost" else "fewest"


def check_wishes(wishes: Wishes, scene: Scene) -> None:
    """Check wishes against the scene alone, before anything is computed.

    Raises InputError for more units than the sites can carry, or a site that does not exist.
    """
    known = {site.id: site for site in scene.sites}
    for option, names in (
        ("--force-site", wishes.forced_sites),
        ("--forbid-site", wishes.forbidden_sites),
    ):
        for name in names:
            if name not in known:
                raise InputError(option, name, "one of " + ", ".join(sorted(known)))
    capacity = sum(
        site.capacity_units if wishes.site_capacity is None else wishes.site_capacity
        for site in scene.sites
        if site.id not in wishes.forbidden_sites
    )
    budget = wishes.budget_units
    if budget is None:
        return
    is_whole = isinstance(budget, int) and not isinstance(budget, bool)
    if not is_whole or not 1 <= budget <= capacity:
        raise InputError(
            "--budget",
            budget,
            f"a whole number of units, 1 to {capacity} (what {scene.name}'s sites can carry)",
        )


def build_limits(wishes: Wishes, scene: Scene, candidates: Sequence[CandidatePose]) -> Limits:
    """What may be mounted together: a pose of no site of the scene stands alone on one of its own.

    Raises InputError where a kept unit is no candidate, or a number cannot be.
    """
    sites = {site.id: site for site in scene.sites}
    keys = [c.site_id if c.site_id in sites else ("own", c.id) for c in candidates]
    order = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    site_index = np.array([order[key] for key in keys], dtype=np.int64)
    capacity = np.ones(len(order), dtype=np.int64)
    cost = np.zeros(len(order))
    is_forced_site = np.zeros(len(order), dtype=bool)
    is_forbidden_site = np.zeros(len(order), dtype=bool)
    for key, index in order.items():
        if isinstance(key, str):
            site = sites[key]
            capacity[index] = (
                site.capacity_units if wishes.site_capacity is None else wishes.site_capacity
            )
            cost[index] = site.cost_eur if wishes.prices is None else wishes.prices.cost_eur(site)
            is_forced_site[index] = site.use == "forced" or key in wishes.forced_sites
            is_forbidden_site[index] = site.use == "forbidden" or key in wishes.forbidden_sites
        if wishes.site_cost_eur is not None:
            cost[index] = wishes.site_cost_eur
    missing = [key for key in wishes.forced_sites if key not in order]
    if missing:
        raise InputError("--force-site", missing[0], "a site with candidate poses")
    is_kept = np.array([candidate.id in wishes.kept for candidate in candidates], dtype=bool)
    lost = set(wishes.kept) - {candidate.id for candidate in candidates}
    if lost:
        raise InputError("--keep", sorted(lost)[0], "units that are candidates")
    kept_at = np.bincount(site_index[is_kept], minlength=len(order))
    if wishes.separation_m > 0.0:
        capacity = np.minimum(capacity, 1)
    capacity = np.maximum(capacity, kept_at)  # what hangs there has found room
    cost[kept_at > 0] = 0.0
    usable = site_index[~is_forbidden_site[site_index] | is_kept]
    most = int(np.minimum(np.bincount(usable, minlength=len(order)), capacity).sum())
    if wishes.budget_units is not None and wishes.budget_units + is_kept.sum() > most:
        n_free = most - int(is_kept.sum())
        expected = f"at most {n_free}, the units that the sites can carry"
        if n_free <= 0:
            expected = "candidates beside the units kept, at sites with room for them"
        raise InputError("--budget", wishes.budget_units, expected)
    price = np.array([c.sensor.price_eur for c in candidates])
    return Limits(
        site_index=site_index,
        site_capacity=capacity,
        budget_units=None
        if wishes.budget_units is None
        else wishes.budget_units + int(is_kept.sum()),
        budget_eur=wishes.budget_eur,
        unit_cost_eur=np.where(is_kept, 0.0, price),
        site_cost_eur=cost,
        is_forced=is_kept,
        is_forbidden=is_forbidden_site[site_index] & ~is_kept,
        is_forced_site=is_forced_site,
        rivals=_too_near(candidates, site_index, wishes.separation_m, kept_at > 0),
        failing=wishes.failing,
    )


def build_problem(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    table: DetectionTable,
    *,
    wishes: Wishes,
    fusion: Fusion = "any",
    sample_index: IntArray | None = None,
) -> PlacementProblem:
    """The optimiser's problem: the rows of the table are `candidates`.

    `sample_index` is the sampled world of each run, (n_runs,). Raises InputError as
    :func:`build_limits`, and where a target or floor is no share.
    """
    problem = PlacementProblem(
        table=table,
        limits=build_limits(wishes, setting.scene, candidates),
        fusion=fusion,
        rule=setting.rule,
        goal=wishes.goal,
        survive=0 if wishes.target is not None or wishes.min_case_apr else wishes.survive,
        sample_index=sample_index,
        tail=wishes.tail,
    )
    floors = []
    if wishes.target is not None:
        share = wishes.target
        if share == np.inf:
            usable = np.flatnonzero(~problem.limits.is_forbidden)
            share = min(apr(problem, usable.tolist()), 1.0)
        floors.append(Floor(name="--target", share=share, n_failures=wishes.survive))
    if wishes.min_case_apr:
        axis = table.axis
        floors += [
            Floor(
                name=f"--min-case-apr in {case}",
                share=wishes.min_case_apr,
                is_counted=_is_case(axis.cases, case),
                n_failures=wishes.survive,
            )
            for case in dict.fromkeys(axis.cases)
            if axis.weight[_is_case(axis.cases, case)].sum() > 0.0
        ]
    return replace(problem, floors=tuple(floors))


def _is_case(cases: Sequence[str], case: str) -> BoolArray:
    return np.array([name == case for name in cases])


def _too_near(
    candidates: Sequence[CandidatePose],
    site_index: IntArray,
    separation_m: float,
    is_kept_site: BoolArray,
) -> IntArray:
    """Pairs of sites nearer than a distance on the ground; those that carry kept units may stay."""
    if separation_m <= 0.0:
        return np.zeros((0, 2), dtype=np.int64)
    n_sites = len(is_kept_site)
    positions: FloatArray = np.array([c.pose.position_m[:2] for c in candidates])
    where = np.array([positions[site_index == site].mean(axis=0) for site in range(n_sites)])
    distance = np.linalg.norm(where[:, None, :] - where[None, :, :], axis=2)
    first, second = np.nonzero(np.triu(distance < separation_m, k=1))
    free = ~(is_kept_site[first] & is_kept_site[second])
    return np.column_stack([first[free], second[free]])
