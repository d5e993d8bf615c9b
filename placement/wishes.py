"""Demands on a layout - units, money, targets, sites - with prices, and the problem they make."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated

import numpy as np
from msgspec import Meta

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, refuse
from geometry.scene import Scene, Site
from geometry.tables import read_data

from .candidates import CandidatePose
from .detection_table import DetectionTable
from .optimiser import Failing, Floor, Goal, Limits, PlacementProblem, apr
from .optimiser.problem import Fusion
from .question import Question, read_number, split_names
from .setting import Setting

# ---------- prices of sites that have none of their own: assumptions, each with its source
_FILE = "prices.toml"
_OTHERWISE = "pole"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Something that a site takes.

    Attributes
    ----------
    eur : float
        Its price. [EUR]
    source : str
        Where the price comes from; it begins with "assumption" where that is nowhere.
    """

    eur: Annotated[
        float, Meta(ge=0.0, description="euros, at least 0")
    ]  # its price. [EUR]
    # where the price comes from; it begins with "assumption" where that is nowhere
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SitePrices:
    """The content of ``data/prices.toml``.

    Attributes
    ----------
    parts : dict of str to Part
        What sites may take, by name.
    kinds : dict of str to tuple of str
        Names of the parts that a site takes, by its kind; "pole" stands for all other
        kinds.
    """

    parts: dict[str, Part]  # what sites may take, by name
    # names of the parts that a site takes, by its kind; "pole" stands for all other
    # kinds
    kinds: dict[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        unknown = {name for kind in self.kinds.values() for name in kind} - set(
            self.parts
        )
        if unknown or _OTHERWISE not in self.kinds:
            got = sorted(unknown) or list(self.kinds)
            raise InputError(
                f"{_FILE}: kinds", got, f"parts of the table, and {_OTHERWISE!r}"
            )

    def of_kind(self, kind: str) -> dict[str, float]:
        """Parts that a site of a kind takes: prices in euros by name."""
        names = self.kinds.get(kind, self.kinds[_OTHERWISE])
        return {name: self.parts[name].eur for name in names}

    def cost_eur(self, site: Site) -> float:
        """Cost of a site: what it says itself, else what its kind takes, in euros."""
        if site.cost_eur > 0.0:
            return site.cost_eur
        return sum(self.of_kind(site.kind).values())


@cache
def load_prices() -> SitePrices:
    """Read ``data/prices.toml``.

    >>> load_prices().of_kind("lamp post")
    {'mounting': 900.0, 'power-at-hand': 400.0, 'data-link': 2260.0}
    """
    return read_data(__package__, _FILE, SitePrices)


def assumed_prices(prices: SitePrices, sites: Sequence[Site]) -> tuple[str, ...]:
    """Assumed prices of sites that have none of their own, a sentence for each kind."""
    count = Counter(site.kind for site in sites if not site.cost_eur > 0.0)
    sentences = []
    for kind, number in count.most_common():
        parts = prices.of_kind(kind)
        sum_of = ", ".join(
            f"{name.replace('-', ' ')} {eur:,.0f}" for name, eur in parts.items()
        )
        sentences.append(
            f"No price is known for {number} site{'s' if number > 1 else ''} of the"
            f" kind {kind}: {sum(parts.values()):,.0f} EUR each are assumed ({sum_of})."
        )
    if sentences:
        sentences.append(
            f"Sources are in {_FILE}; a site cost in the question, or cost_eur in the"
            " scene, takes their place."
        )
    return tuple(sentences)


# ---------- demands
@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Demands on a layout."""

    budget_units: int | None = (
        None  #: At most so many units in all, the existing ones among them.
    )
    budget_eur: float | None = (
        None  #: At most so much money for new units and their sites. [EUR]
    )
    # : APR that must be reached, 0..1: with the fewest units or the least cost. With
    # ``max`` as : infinity: as much as all candidates together reach.
    target: float | None = None
    saves: str = "units"  #: What a target is reached with the least of.
    min_case_apr: float = 0.0  #: APR that must be reached in every case.
    # : Units or sites that may fail, any of them: target and floors hold then, too;
    # without these, : the APR that is left is the first objective.
    survive: int = 0
    give_up: float = (
        0.0  #: APR that may be given up so that more is left when a unit fails.
    )
    failing: Failing = (
        "unit"  #: What fails at once: a unit, or a site with all that it carries.
    )
    #: Ids of candidates that are mounted already: they stay, and cost nothing.
    existing: tuple[str, ...] = ()
    # : forced_sites and forbidden_sites: ids of sites that must, and must not, carry
    # units, in : addition to the scene's.
    forced_sites: tuple[str, ...] = ()
    forbidden_sites: tuple[str, ...] = ()
    site_capacity: int | None = None  #: Units per site, in place of the scene's.
    site_cost_eur: float | None = (
        None  #: For a site that is used, in place of the scene's. [EUR]
    )
    prices: SitePrices | None = (
        None  #: For sites without a price; by default they cost nothing.
    )
    # : Least distance on the ground between two units; on one site there is one at most
    # then. [m]
    separation_m: float = 0.0
    #: Share of the sampled worlds that counts, the worst ones, see
    #: :class:`placement.optimiser.problem.Measure`.
    tail: float = 1.0

    def __post_init__(self) -> None:
        both = set(self.forced_sites) & set(self.forbidden_sites)
        if both:
            raise InputError(
                "forbid_site",
                sorted(both)[0],
                "another site than those of `force_site`",
            )

    def capacity_of(self, site: Site) -> int:
        """Units that a site can carry."""
        if self.site_capacity is None:
            return site.capacity_units
        return self.site_capacity

    @property
    def goal(self) -> Goal:
        """The first objective."""
        if self.target is None:
            return "best"
        if self.saves == "cost":
            return "cheapest"
        return "fewest"


def build_limits(
    wishes: Wishes, scene: Scene, candidates: Sequence[CandidatePose]
) -> Limits:
    """Limits on what may be mounted together; nothing needs to be detected yet.

    A pose of no site of the scene stands alone on a site of its own. Raises InputError
    for a site that does not exist, an existing unit that is no candidate, or more units
    than sites can carry.
    """
    sites = {site.id: site for site in scene.sites}
    for name in (*wishes.forced_sites, *wishes.forbidden_sites):
        if name not in sites:
            if name in wishes.forced_sites:
                where = "force_site"
            else:
                where = "forbid_site"
            raise InputError(where, name, "one of " + ", ".join(sorted(sites)))
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
            capacity[index] = wishes.capacity_of(site)
            if wishes.prices is None:
                cost[index] = site.cost_eur
            else:
                cost[index] = wishes.prices.cost_eur(site)
            is_forced_site[index] = site.use == "forced" or key in wishes.forced_sites
            is_forbidden_site[index] = (
                site.use == "forbidden" or key in wishes.forbidden_sites
            )
        if wishes.site_cost_eur is not None:
            cost[index] = wishes.site_cost_eur
    missing = [key for key in wishes.forced_sites if key not in order]
    if missing:
        raise InputError("force_site", missing[0], "a site with candidate poses")
    is_existing = np.array(
        [candidate.id in wishes.existing for candidate in candidates], dtype=bool
    )
    lost = set(wishes.existing) - {candidate.id for candidate in candidates}
    if lost:
        raise InputError("keep", sorted(lost)[0], "units that are candidates")
    existing_at = np.bincount(site_index[is_existing], minlength=len(order))
    rivals = np.zeros((0, 2), dtype=np.int64)
    if wishes.separation_m > 0.0:
        capacity = np.minimum(capacity, 1)
        position_m: FloatArray = np.array([c.pose.position_m[:2] for c in candidates])
        where_m = np.array(
            [position_m[site_index == i].mean(axis=0) for i in range(len(order))]
        )
        distance_m = np.linalg.norm(where_m[:, None, :] - where_m[None, :, :], axis=2)
        pairs = np.argwhere(np.triu(distance_m < wishes.separation_m, k=1))
        rivals = pairs[~(existing_at[pairs] > 0).all(axis=1)]  # existing units may stay
    capacity = np.maximum(capacity, existing_at)  # existing units have found room
    cost[existing_at > 0] = 0.0
    usable = site_index[~is_forbidden_site[site_index] | is_existing]
    most = int(np.minimum(np.bincount(usable, minlength=len(order)), capacity).sum())
    price = np.array([c.sensor.price_eur for c in candidates])
    limits = Limits(
        site_index=site_index,
        site_capacity=capacity,
        budget_units=wishes.budget_units,
        budget_eur=wishes.budget_eur,
        unit_cost_eur=np.where(is_existing, 0.0, price),
        site_cost_eur=cost,
        is_forced=is_existing,
        is_forbidden=is_forbidden_site[site_index] & ~is_existing,
        is_forced_site=is_forced_site,
        rivals=rivals,
        failing=wishes.failing,
    )
    _check_room(wishes, scene, most)
    return limits


def _check_room(wishes: Wishes, scene: Scene, most: int) -> None:
    """Raise InputError if the sites, or the candidates at them, cannot carry the budget."""
    if wishes.budget_units is None or wishes.budget_units <= most:
        return
    n_existing = len(wishes.existing)
    asked = wishes.budget_units - n_existing
    n_free = most - n_existing
    at_sites = sum(
        wishes.capacity_of(site)
        for site in scene.sites
        if site.id not in wishes.forbidden_sites
    )
    expected = f"at most {n_free}: candidates and their sites allow no more"
    if asked > at_sites:
        expected = (
            f"a whole number of units, 1 to {at_sites} (what {scene.name}'s sites can"
            " carry)"
        )
    elif n_free <= 0:
        expected = "candidates next to the existing units, at sites with room for them"
    raise InputError("budget", asked, expected)


def build_problem(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    table: DetectionTable,
    *,
    wishes: Wishes,
    fusion: Fusion = "any",
    sample_index: IntArray | None = None,
    seen_by_vut: BoolArray | None = None,
) -> PlacementProblem:
    """The optimiser's problem: the rows of the table are `candidates`.

    `sample_index` is the sampled world of each run, (n_runs,), `seen_by_vut` the frames
    of the table that a VUT that sees detects in, (n_frames,). Raises InputError as
    :func:`build_limits`, and where a target or floor is no share.
    """
    problem = PlacementProblem(
        table=table,
        limits=build_limits(wishes, setting.scene, candidates),
        fusion=fusion,
        rule=setting.rule,
        goal=wishes.goal,
        survive=(
            0 if wishes.target is not None or wishes.min_case_apr else wishes.survive
        ),
        sample_index=sample_index,
        tail=wishes.tail,
        seen_by_vut=seen_by_vut,
    )
    floors = []
    if wishes.target is not None:
        share = wishes.target
        if share == np.inf:
            usable = np.flatnonzero(~problem.limits.is_forbidden)
            share = min(apr(problem, usable.tolist()), 1.0)
        floors.append(Floor(name="target", share=share, n_failures=wishes.survive))
    if wishes.min_case_apr:
        axis = table.axis
        floors += [
            Floor(
                name=f"min_case_apr in {case}",
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


# ---------- from the words of a question
def read_wishes(
    question: Question,
    *,
    existing: Sequence[CandidatePose] = (),
    counts_money: bool = False,
) -> Wishes:
    """Wishes of a question, whose budget is of units in addition to the existing ones.

    With `counts_money`, sites without a price cost what is assumed, whatever is asked
    for. Raises InputError for words that mean nothing.
    """
    survive, failing = _failures(question.survive)
    counts_money |= question.budget_cost is not None
    counts_money |= bool(question.target) and question.least == "cost"
    return Wishes(
        budget_units=(
            None if question.budget is None else question.budget + len(existing)
        ),
        budget_eur=question.budget_cost,
        target=_target(question.target),
        saves=question.least,
        min_case_apr=question.min_case_apr,
        survive=survive,
        give_up=_give_up(question, survive),
        failing=failing,
        existing=tuple(unit.id for unit in existing),
        forced_sites=split_names(question.force_site, "force_site"),
        forbidden_sites=split_names(question.forbid_site, "forbid_site"),
        site_capacity=question.site_capacity,
        site_cost_eur=question.site_cost_eur,
        prices=(
            load_prices() if counts_money and question.site_cost_eur is None else None
        ),
        separation_m=question.separation_m,
        tail=_tail(question.risk, question.n_samples),
    )


def _target(text: str) -> float | None:
    """A share of the weight; None for all that can be covered."""
    if not text:
        return None
    if text == "max":
        return np.inf
    return read_number(
        "target", text, "a share of the runs from 0 to 1, or max", 0.0, 1.0
    )


GIVE_UP = 0.01
"""APR that may be given up by default, so that more is left when a unit fails.

docs/decisions/default_question.md has why.
"""


def _give_up(question: Question, survive: int) -> float:
    """What may be given up; nothing where failures count already, or something else is asked."""
    others = {
        "target": bool(question.target),
        "min_case_apr": question.min_case_apr > 0.0,
        "survive": survive > 0,
        "samples": question.n_samples > 0,
    }
    asked = [name for name, is_asked in others.items() if is_asked]
    if question.give_up and asked:
        refuse("give_up", f"it beside `{asked[0]}`", "one of them")
    if question.give_up is not None:
        return question.give_up
    if asked:
        return 0.0
    return GIVE_UP


def _failures(text: str) -> tuple[int, Failing]:
    """How many of what may fail: "2", "unit", "site", "2 sites"."""
    words = re.fullmatch(r"([0-9]{1,4})? ?(?:(unit|site)s?)?", text.strip())
    if not text.strip() or words is None:
        expected = (
            "how many units may fail, at least 0, or unit, site, such as '2 sites'"
        )
        raise InputError("survive", text, expected)
    count, what = words.groups()
    return 1 if count is None else int(count), "site" if what == "site" else "unit"


def _tail(risk: str, n_samples: int) -> float:
    if risk == "mean":
        return 1.0
    if n_samples == 0:
        raise InputError("risk", risk, "mean, unless worlds are sampled (`samples`)")
    if risk == "worst":
        return 1.0 / n_samples
    expected = "mean, worst, or a share of the worst worlds"
    tail = read_number("risk", risk, expected, 0.0, 1.0)
    if tail == 0.0:
        raise InputError("risk", risk, f"{expected}, more than 0")
    return tail
