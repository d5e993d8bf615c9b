"""Prices of sites that have none of their own: a table of assumptions, each with its source."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Annotated

from msgspec import Meta

from geometry.errors import InputError
from geometry.files import load_toml, read_table
from geometry.scene import Site

_FILE = "prices.toml"
_OTHERWISE = "pole"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Something that a site takes."""

    eur: Annotated[float, Meta(ge=0.0, description="euros, at least 0")]  # its price. [EUR]
    source: str  # where the price comes from; it begins with "assumption" where that is nowhere


@dataclass(frozen=True, slots=True, kw_only=True)
class SitePrices:
    """The content of ``data/prices.toml``."""

    parts: dict[str, Part]  # what sites may take, by name
    # names of the parts that a site takes, by its kind; "pole" stands for all other kinds
    kinds: dict[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        unknown = {name for kind in self.kinds.values() for name in kind} - set(self.parts)
        if unknown or _OTHERWISE not in self.kinds:
            got = sorted(unknown) or list(self.kinds)
            raise InputError(f"{_FILE}: kinds", got, f"parts of the table, and {_OTHERWISE!r}")

    def of_kind(self, kind: str) -> dict[str, float]:
        """Parts that a site of a kind takes: prices in euros by name."""
        names = self.kinds.get(kind, self.kinds[_OTHERWISE])
        return {name: self.parts[name].eur for name in names}

    def cost_eur(self, site: Site) -> float:
        """Cost of a site: what it says itself, else what its kind takes, in euros."""
        return site.cost_eur if site.cost_eur > 0.0 else sum(self.of_kind(site.kind).values())


@cache
def load_prices() -> SitePrices:
    """Read ``data/prices.toml``.

    Examples
    --------
    >>> load_prices().of_kind("lamp post")
    {'mounting': 900.0, 'power-at-hand': 400.0, 'data-link': 2260.0}
    """
    return read_table(load_toml(files(__package__) / "data" / _FILE), SitePrices, _FILE)


def assumed_prices(prices: SitePrices, sites: Sequence[Site]) -> tuple[str, ...]:
    """Assumed prices of sites that have none of their own, a sentence for each kind."""
    count = Counter(site.kind for site in sites if not site.cost_eur > 0.0)
    sentences = []
    for kind, number in count.most_common():
        parts = prices.of_kind(kind)
        sum_of = ", ".join(f"{name.replace('-', ' ')} {eur:,.0f}" for name, eur in parts.items())
        sentences.append(
            f"No price is known for {number} site{'s' if number > 1 else ''} of the kind {kind}: "
            f"{sum(parts.values()):,.0f} EUR each are assumed ({sum_of})."
        )
    if sentences:
        sentences.append(
            f"Sources are in {_FILE}; a site cost in the question, or cost_eur in the scene, takes "
            "their place."
        )
    return tuple(sentences)
