"""Which sites a scene gets: the map's own poles, a planner's list, or points along the kerbs."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene import Site
from .cut import Surroundings
from .kerb_sites import kerb_sites, tidy_sites
from .model import MapLane, Skipped, SourceMap
from .pole_bodies import load_pole_kinds, mount_range_m
from .site_files import SUFFIXES, SiteWish, read_sites

AUTO, MAP, KERB = "auto", "map", "kerb:"
_AUTO_SPACING_M = 15.0
_SPACINGS_M = (2.0, 100.0)
_OCTANTS = ("e", "ne", "n", "nw", "w", "sw", "s", "se")


def choose_sites(
    where: str, surroundings: Surroundings, roads: SourceMap, *, radius_m: float
) -> tuple[tuple[Site, ...], tuple[Skipped, ...]]:
    """Sites of a scene.

    Parameters
    ----------
    where : str
        "map", "kerb:SPACING", a CSV or GeoJSON file, or "auto": "map", and where the map has no
        pole "kerb:15".
    surroundings : Surroundings
        What lies around the junction.
    roads : SourceMap
        The map that has the junction: a file's x and y are in its coordinates.
    radius_m : float
        Sites farther from the junction's middle are left out. [m]

    Returns
    -------
    sites : tuple of Site
        At least one.
    skipped : tuple of Skipped
        What was left out, and whether kerbs took the place of poles.

    Raises
    ------
    InputError
        The word or the file cannot be read, or no site is left.
    """
    told: list[Skipped] = []
    if where in (AUTO, MAP):
        wishes = _poles(surroundings)
        if not wishes and where == AUTO:
            wishes = _kerbs(surroundings, _AUTO_SPACING_M, radius_m)
            told.append(
                Skipped(
                    what="poles of the map",
                    why=f"none within {radius_m:g} m: masts every {_AUTO_SPACING_M:g} m along the "
                    "kerbs were taken (--sites)",
                )
            )
    elif where.startswith(KERB):
        wishes = _kerbs(surroundings, _spacing_m(where), radius_m)
    elif Path(where).suffix.lower() in SUFFIXES:
        wishes, far = _listed(Path(where), surroundings, roads, radius_m)
        told += far
    else:
        raise InputError("--sites", where, "auto, map, kerb:SPACING, or a .csv or .geojson file")
    kept, dropped = tidy_sites(wishes, things=surroundings.things)
    told += dropped
    if not kept:
        raise InputError(
            "--sites",
            where,
            f"a site within {radius_m:g} m that stands free ({len(dropped)} do not): kerb:15, or "
            "a list of your own",
        )
    return tuple(_site(wish) for wish in _with_plain_ids(kept)), tuple(told)


def _poles(surroundings: Surroundings) -> tuple[SiteWish, ...]:
    wishes = []
    for pole in surroundings.poles:
        low_m, high_m = mount_range_m(pole)
        wishes.append(
            SiteWish(
                id=pole.id,
                kind=pole.kind,
                position_m=pole.position_m[:2],
                min_height_m=float(low_m),
                max_height_m=float(high_m),
            )
        )
    return tuple(wishes)


def _kerbs(surroundings: Surroundings, spacing_m: float, radius_m: float) -> tuple[SiteWish, ...]:
    lanes = [
        MapLane(
            id=lane.id,
            kind=lane.kind,
            width_m=lane.width_m,
            centreline_m=np.column_stack([lane.centreline_m, np.zeros(len(lane.centreline_m))]),
        )
        for lane in surroundings.lanes
    ]
    wishes = kerb_sites(lanes, surroundings.outline_m, spacing_m)
    near = [wish for wish in wishes if np.hypot(*wish.position_m) <= radius_m]
    near.sort(key=lambda wish: float(np.hypot(*wish.position_m)))
    count: Counter[str] = Counter()
    named = []
    for wish in near:  # by where they lie, seen from the junction: kerb-ne-1 is the nearest there
        east, north = wish.position_m
        octant = round(np.degrees(np.arctan2(north, east)) / 45.0) % 8
        count[_OCTANTS[octant]] += 1
        name = f"kerb-{_OCTANTS[octant]}-{count[_OCTANTS[octant]]}"
        named.append(replace(wish, id=name))
    return tuple(named)


def _listed(
    path: Path, surroundings: Surroundings, roads: SourceMap, radius_m: float
) -> tuple[tuple[SiteWish, ...], list[Skipped]]:
    wishes, told, n_far = [], [], 0
    for wish in read_sites(path, crs=roads.crs):
        position = surroundings.frame.take(wish.position_m, roads)
        if np.hypot(*position) > radius_m:
            n_far += 1
            continue
        wishes.append(replace(wish, position_m=position))
    if n_far:
        why = f"farther than {radius_m:g} m from the junction"
        told.append(Skipped(what=f"{n_far} sites in {path.name}", why=why))
    dark = sum(wish.has_power is False or wish.has_fibre is False for wish in wishes)
    if dark:
        why = "it counts only as far as cost_eur says it"
        told.append(Skipped(what=f"power or fibre that {dark} sites lack", why=why))
    return tuple(wishes), told


def _spacing_m(where: str) -> float:
    low, high = _SPACINGS_M
    try:
        spacing_m = float(where.removeprefix(KERB))
    except ValueError:
        spacing_m = np.nan
    if not low <= spacing_m <= high:
        raise InputError("--sites", where, f"kerb:SPACING in metres, {low:g} to {high:g}")
    return spacing_m


def _with_plain_ids(wishes: Sequence[SiteWish]) -> list[SiteWish]:
    """The same with ids that options with commas between them can name, each once."""
    taken: set[str] = set()
    plain = []
    for wish in wishes:
        words = "-".join(wish.id.replace(",", " ").replace("/", " ").split()) or "site"
        name, number = words, 1
        while name in taken:
            number += 1
            name = f"{words}-{number}"
        taken.add(name)
        plain.append(replace(wish, id=name))
    return plain


def _site(wish: SiteWish) -> Site:
    kinds = load_pole_kinds()
    kind = kinds.get(wish.kind, kinds["pole"])
    low_m, high_m = kind.height_range_m.tolist()
    low_m = low_m if wish.min_height_m is None else wish.min_height_m
    high_m = max(high_m, low_m) if wish.max_height_m is None else wish.max_height_m
    low_m = min(low_m, high_m)
    if low_m <= 0.0:
        raise InputError(f"site {wish.id}: mount height", low_m, "metres above the road, > 0")
    return Site(
        id=wish.id,
        position_m=np.append(wish.position_m, 0.0),
        kind=wish.kind or "pole",
        height_range_m=np.array([low_m, high_m]),
        capacity_units=wish.capacity_units or kind.capacity_units,
        cost_eur=wish.cost_eur or 0.0,
        use="forbidden" if wish.is_forbidden else "free",
    )
