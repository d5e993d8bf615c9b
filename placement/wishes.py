"""Demands on a layout, and the problem that they make.

Demands are on units, money, targets and sites; prices belong to them.
"""

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
from geometry.phrases import Phrase, join_phrases
from geometry.scene import Scene, Site
from geometry.tables import read_data

from .candidates import CandidatePose
from .detection_table import DetectionTable
from .optimiser import Failing, Floor, Goal, Limits, PlacementProblem, apr
from .optimiser.problem import Fusion
from .question import BLIND, Question, read_number, split_names
from .setting import Setting

# ---------- prices of sites without one: assumptions, each with its source
_FILE = "prices.toml"
_OTHERWISE = "pole"


@dataclass(frozen=True, slots=True, kw_only=True)
class PricedPart:
    """Something that a site takes.

    Attributes
    ----------
    eur : float
        Its price. [EUR]
    source : str
        Where the price comes from; it begins with "assumption" where that is nowhere.
    """

    eur: Annotated[float, Meta(ge=0.0, description="euros, at least 0")]
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SitePrices:
    """The content of ``data/prices.toml``.

    Attributes
    ----------
    parts : dict of str to PricedPart
        What sites may take, by name.
    kinds : dict of str to tuple of str
        Names of the parts that a site takes, by its kind; "pole" stands for all other
        kinds.
    left_out : dict of str to PricedPart
        What a junction takes that no bill has.
    """

    parts: dict[str, PricedPart]
    kinds: dict[str, tuple[str, ...]]
    left_out: dict[str, PricedPart]

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


def site_price_eur(site: Site, site_cost_eur: float | None) -> float:
    """Cost of a site: what was asked for all, else by :func:`load_prices`, in euros."""
    if site_cost_eur is not None:
        return site_cost_eur
    return load_prices().cost_eur(site)


def assumed_prices(prices: SitePrices, sites: Sequence[Site]) -> tuple[str, ...]:
    """Assumed prices of sites without one, a sentence for each kind."""
    # Frequent kinds come first.
    count = Counter(site.kind for site in sites if not site.cost_eur > 0.0)
    sentences = []
    for kind, number in count.most_common():
        parts = prices.of_kind(kind)
        sum_of = join_phrases(
            [Phrase(_PARTS[name], price=eur) for name, eur in parts.items()], ", "
        )
        values = {
            "n": number,
            "kind": Phrase(kind),
            "price": sum(parts.values()),
            "parts": sum_of,
        }
        one = Phrase(
            "No price is known for {n} site of the kind {kind}: {price:,.0f} EUR "
            "each are assumed ({parts}).",
            **values,
        )
        several = Phrase(
            "No price is known for {n} sites of the kind {kind}: {price:,.0f} EUR "
            "each are assumed ({parts}).",
            **values,
        )
        sentences.append(one if number == 1 else several)
    if sentences:
        sentences.append(
            Phrase(
                "Sources are in {file}; a site cost in the question, or cost_eur in "
                "the scene, overrides them.",
                file=_FILE,
            )
        )
    return tuple(sentences)


_PARTS = {
    "new-pole": Phrase("new pole {price:,.0f}"),
    "mounting": Phrase("mounting {price:,.0f}"),
    "new-power": Phrase("new power {price:,.0f}"),
    "power-at-hand": Phrase("existing power {price:,.0f}"),
    "fibre-at-hand": Phrase("existing fibre {price:,.0f}"),
    "data-link": Phrase("data link {price:,.0f}"),
}
"""What a part of a site's price is, by its name in ``data/prices.toml``."""


# ---------- demands
@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Demands on a layout.

    Attributes
    ----------
    budget_units : int, optional
        At most so many units in all, the existing ones among them.
    budget_eur : float, optional
        At most so much money for new units and their sites. [EUR]
    target : float, optional
        APR that must be reached, 0..1: with the fewest units or the least cost.
        With ``max`` as infinity: as much as all candidates together reach.
    saves : str
        What a target is reached with the least of.
    min_case_apr : float
        APR that must be reached in every case.
    survive : int
        Units or sites that may fail, any of them: target and floors hold then,
        too; without these, the APR that is left is the first objective.
    give_up : float
        APR that may be given up so that more is left when a unit fails.
    located_m : float, optional
        So well the road user's place is to be known in most runs, in place of the
        APR that is left when a unit fails. [m]
    failing : Failing
        What fails at once: a unit, or a site with all that it carries.
    existing : tuple of str
        Ids of candidates that are mounted already: they stay, and cost nothing.
    paid : tuple of str
        Ids of candidates that are mounted already and may go; kept, they cost
        nothing.
    forced_sites, forbidden_sites : tuple of str
        Ids of sites that must, and must not, carry units, in addition to the
        scene's.
    site_capacity : int, optional
        Units per site, in place of the scene's.
    site_cost_eur : float, optional
        For a site that is used, in place of the scene's. [EUR]
    prices : SitePrices, optional
        For sites without a price; by default they cost nothing.
    separation_m : float
        Least distance on the ground between two units; on one site there is one
        at most then. [m]
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
    give_up: float = 0.0
    located_m: float | None = None
    failing: Failing = "unit"
    existing: tuple[str, ...] = ()
    paid: tuple[str, ...] = ()
    forced_sites: tuple[str, ...] = ()
    forbidden_sites: tuple[str, ...] = ()
    site_capacity: int | None = None
    site_cost_eur: float | None = None
    prices: SitePrices | None = None
    separation_m: float = 0.0
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
    # Sites and forced units must exist.
    sites = {site.id: site for site in scene.sites}
    for name in (*wishes.forced_sites, *wishes.forbidden_sites):
        if name not in sites:
            if name in wishes.forced_sites:
                where = "force_site"
            else:
                where = "forbid_site"
            raise InputError(where, name, "one of " + ", ".join(sorted(sites)))
    # Sites in the order of the candidates; a pose of no site is one by itself.
    keys = [c.site_id if c.site_id in sites else ("own", c.id) for c in candidates]
    order = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    site_index = np.array([order[key] for key in keys], dtype=np.int64)
    capacity = np.ones(len(order), dtype=np.int64)
    cost = np.zeros(len(order))
    is_forced_site = np.zeros(len(order), dtype=bool)
    is_forbidden_site = np.zeros(len(order), dtype=bool)
    # Room, price and use of each site.
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
    # Existing units may be nearer to one another than new ones.
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
        # Existing units may stay.
        rivals = pairs[~(existing_at[pairs] > 0).all(axis=1)]
    # Existing units have found room.
    capacity = np.maximum(capacity, existing_at)
    is_paid = is_existing | np.array(
        [candidate.id in wishes.paid for candidate in candidates], dtype=bool
    )
    cost[site_index[is_paid]] = 0.0
    # As many units as sites and candidates allow.
    usable = site_index[~is_forbidden_site[site_index] | is_existing]
    most = int(np.minimum(np.bincount(usable, minlength=len(order)), capacity).sum())
    price = np.array([c.sensor.price_eur for c in candidates])
    limits = Limits(
        site_index=site_index,
        site_capacity=capacity,
        budget_units=wishes.budget_units,
        budget_eur=wishes.budget_eur,
        unit_cost_eur=np.where(is_paid, 0.0, price),
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
    """Raise InputError if the budget has more units than there is room for.

    Sites, and the candidates at them, limit the number.
    """
    if wishes.budget_units is None or wishes.budget_units <= most:
        return
    n_existing = len(wishes.existing)
    asked = wishes.budget_units - n_existing
    n_free = most - n_existing
    # Say what limits the number: sites, or candidates at them.
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
    limits: Limits | None = None,
    fusion: Fusion = "any",
    sample_index: IntArray | None = None,
    seen_by_vut: BoolArray | None = None,
) -> PlacementProblem:
    """The optimiser's problem: the rows of the table are `candidates`.

    `limits` are those of :func:`build_limits`, where they are known already;
    `sample_index` is the sampled world of each run, (n_runs,), `seen_by_vut` the frames
    of the table that a VUT that sees detects in, (n_frames,). Raises InputError as
    :func:`build_limits`, and where a target or floor is no share.
    """
    survive = wishes.survive
    if wishes.target is not None or wishes.min_case_apr:
        survive = 0
    problem = PlacementProblem(
        table=table,
        limits=limits or build_limits(wishes, setting.scene, candidates),
        fusion=fusion,
        rule=setting.rule,
        goal=wishes.goal,
        survive=survive,
        sample_index=sample_index,
        tail=wishes.tail,
        seen_by_vut=seen_by_vut,
    )
    # Targets and least APRs of cases become floors.
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
    """Wishes of a question.

    Its budget is of units in addition to the existing ones. With `counts_money`,
    sites without a price cost what is assumed, whatever is asked for. Raises
    InputError for words that mean nothing.
    """
    survive, failing = _failures(question.survive)
    counts_money |= question.budget_cost is not None
    counts_money |= bool(question.target) and question.least == "cost"
    budget_units = None
    if question.budget is not None:
        budget_units = question.budget + len(existing)
    prices = None
    if counts_money and question.site_cost_eur is None:
        prices = load_prices()
    return Wishes(
        budget_units=budget_units,
        budget_eur=question.budget_cost,
        target=_target(question.target),
        saves=question.least,
        min_case_apr=question.min_case_apr,
        survive=survive,
        give_up=_give_up(question, survive),
        located_m=_located_m(question, survive),
        failing=failing,
        existing=tuple(unit.id for unit in existing),
        forced_sites=split_names(question.force_site, "force_site"),
        forbidden_sites=split_names(question.forbid_site, "forbid_site"),
        site_capacity=question.site_capacity,
        site_cost_eur=question.site_cost_eur,
        prices=prices,
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
    """APR that may be given up to lose less when a unit fails.

    Nothing where failures count already, or something else is asked for.
    """
    # Demands that leave nothing to give up.
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


def _located_m(question: Question, survive: int) -> float | None:
    """How well road users are to be located; None: not asked.

    Located APR is a choice among layouts of nearly the best APR: nothing else can be
    asked for beside it.
    """
    if question.located_m is None:
        return None
    others = {
        "target": bool(question.target),
        "min_case_apr": question.min_case_apr > 0.0,
        "survive": survive > 0,
        "samples": question.n_samples > 0,
        "refine": question.refine,
        "fusion": question.fusion != "any",
        "cars": question.cars != BLIND,
    }
    for name, is_asked in others.items():
        if is_asked:
            refuse("located_m", f"it beside `{name}`", "one of them")
    return question.located_m


def _failures(text: str) -> tuple[int, Failing]:
    """How many of what may fail: "2", "unit", "site", "2 sites"."""
    words = re.fullmatch(r"([0-9]{1,4})? ?(?:(unit|site)s?)?", text.strip())
    if not text.strip() or words is None:
        expected = (
            "how many units may fail, at least 0, or unit, site, such as '2 sites'"
        )
        raise InputError("survive", text, expected)
    count, what = words.groups()
    number = int(count or "1")
    if what == "site":
        return number, "site"
    return number, "unit"


def _tail(risk: str, n_samples: int) -> float:
    """Share of the sampled worlds that counts, from the word on risk."""
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
