"""What sites cost where nobody tells a price."""

import numpy as np
import pytest

from geometry.errors import InputError
from geometry.scene import Site
from placement.wishes import PricedPart, SitePrices, assumed_prices, load_prices


def site(kind, cost_eur=0.0):
    """A site of a kind."""
    return Site(
        id=f"{kind} {cost_eur:g}",
        position_m=np.zeros(3),
        kind=kind,
        height_range_m=[4.0, 8.0],
        capacity_units=1,
        cost_eur=cost_eur,
    )


def test_every_price_has_a_source_or_is_called_an_assumption():
    prices = load_prices()

    for name, part in prices.parts.items():
        is_assumed = part.source.startswith("assumption: ")
        assert is_assumed or any(c.isdigit() for c in part.source), name
        assert part.eur > 0.0

    used = {name for names in prices.kinds.values() for name in names}

    assert used == set(prices.parts)


def test_a_site_costs_what_it_says_else_what_its_kind_takes():
    prices = load_prices()
    expected = prices.cost_eur(site("pole"))

    assert prices.cost_eur(site("lamp post", 123.0)) == 123.0
    assert prices.cost_eur(site("lamp post")) == 900.0 + 400.0 + 2260.0
    assert prices.cost_eur(site("kerb")) == 2400.0 + 900.0 + 1500.0 + 2260.0
    assert prices.cost_eur(site("totem")) == expected


def test_what_is_assumed_is_told_for_each_kind():
    sites = [site("lamp post"), site("lamp post"), site("kerb"), site("pole", 10.0)]
    assert assumed_prices(load_prices(), sites) == (
        (
            "No price is known for 2 sites of the kind lamp post: 3,560 EUR each are"
            " assumed (mounting 900, existing power 400, data link 2,260)."
        ),
        (
            "No price is known for 1 site of the kind kerb: 7,060 EUR each are assumed"
            " (new pole 2,400, mounting 900, new power 1,500, data link 2,260)."
        ),
        (
            "Sources are in prices.toml; a site cost in the question, or cost_eur in"
            " the scene, overrides them."
        ),
    )
    assert assumed_prices(load_prices(), [site("pole", 10.0)]) == ()


def test_parts_that_are_not_in_the_table_are_refused():
    with pytest.raises(
        InputError, match=r"prices\.toml: kinds: got \['lift'\]; expected parts of"
    ):
        SitePrices(
            parts={"mounting": PricedPart(eur=1.0, source="")},
            kinds={"pole": ("mounting", "lift")},
            left_out={},
        )
