"""Sums that layouts can cost: where prices are few, most amounts buy nothing."""

from collections.abc import Iterable

import numpy as np

from geometry.arrays import FloatArray

from .limits import COST_TOLERANCE_EUR, Limits

_MAX_LEVELS = 20_000
_CENTS = 100.0


def price_levels_eur(limits: Limits) -> FloatArray | None:
    """Amounts of which every layout within limits costs one, ascending.

    Parameters
    ----------
    limits : Limits
        Units, sites and their prices.

    Returns
    -------
    levels_eur : (n,) float or None
        Not every amount need be the cost of a layout. None: prices are too many, or no whole
        cents. [EUR]
    """
    usable = ~limits.is_forbidden | limits.is_forced
    units = _cents(limits.unit_cost_eur[usable])
    sites = _cents(limits.site_cost_eur[np.unique(limits.site_index[usable])])
    if units is None or sites is None:
        return None
    most = limits.max_units
    by_units = _sums(units, most)
    by_sites = _sums(sites, min(most, limits.n_sites))
    if by_units is None or by_sites is None:
        return None
    # So many units need at least so many sites.
    largest = max(int(limits.site_capacity.max(initial=1)), 1)
    levels: set[int] = set()
    for n_units in range(1, most + 1):
        for n_sites in range(-(-n_units // largest), min(n_units, len(by_sites) - 1) + 1):
            levels.update(a + b for a in by_units[n_units] for b in by_sites[n_sites])
            if len(levels) > _MAX_LEVELS:
                return None
    return np.array(sorted(levels)) / _CENTS


def level_at_least_eur(levels_eur: FloatArray | None, amount_eur: float) -> float:
    """The first level that is no less than an amount; the amount where levels are not known."""
    if levels_eur is None or not np.isfinite(amount_eur):
        return amount_eur
    above = levels_eur[levels_eur >= amount_eur - COST_TOLERANCE_EUR]
    return float(above[0]) if len(above) else np.inf


def level_beyond_eur(levels_eur: FloatArray | None, amount_eur: float) -> float:
    """The first level above an amount; the amount where levels are not known."""
    if levels_eur is None or not np.isfinite(amount_eur):
        return amount_eur
    above = levels_eur[levels_eur > amount_eur + COST_TOLERANCE_EUR]
    return float(above[0]) if len(above) else np.inf


def _cents(amounts_eur: FloatArray) -> list[int] | None:
    cents = np.unique(amounts_eur) * _CENTS
    whole = np.rint(cents)
    is_whole = len(cents) <= _MAX_LEVELS and bool((np.abs(cents - whole) <= 1.0e-6 * _CENTS).all())
    return [int(number) for number in whole] if is_whole else None


def _sums(prices: Iterable[int], most: int) -> list[set[int]] | None:
    """Sums of 0, 1, .. prices, each of which may be taken again and again."""
    sums: list[set[int]] = [{0}]
    for _ in range(most):
        sums.append({before + price for before in sums[-1] for price in prices})
        if len(sums[-1]) > _MAX_LEVELS:
            return None
    return sums
