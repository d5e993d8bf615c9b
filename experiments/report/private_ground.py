"""Private ground: read from a file, and what units see of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import UnsetType

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted
from geometry.maps.georeferences import transform
from geometry.maps.gis_files import read_features
from geometry.scene import Scene
from placement.private_ground import PrivateGround, build_private_ground

from ..results.explanations import PrivateGroundRecord
from ..results.numbers import percent
from ..results.result import Result
from .section import Section, Table


def load_private_ground(path: Path, scene: Scene) -> PrivateGround:
    """Private ground from a file of polygons.

    GeoJSON, GeoPackage or Shapefile; a column "name" or "id" names an area. Raises InputError if
    the file cannot be read or has no polygon, or says where on earth it lies and the scene does
    not.
    """
    import shapely

    found = read_features(path)
    if found.crs and not scene.crs:
        raise InputError(
            str(path),
            Unquoted(f"coordinates in {found.crs}"),
            "a scene that says where on earth it lies, or coordinates of its map without a crs",
        )

    def to_world(points: Any) -> Any:
        if not found.crs:
            return points - scene.source_origin_m if not scene.crs else points
        return transform(points, found.crs, scene.crs)

    areas = []
    for number, feature in enumerate(found.features, start=1):
        shape = feature.geometry
        if shape is None or shape.geom_type not in ("Polygon", "MultiPolygon"):
            continue
        name = str(feature.values.get("name") or feature.values.get("id") or f"area {number}")
        world = shapely.make_valid(shapely.transform(shapely.force_2d(shape), to_world))
        if not np.isfinite(world.bounds).all():
            raise InputError(feature.where, Unquoted("coordinates that cannot be"), "a polygon")
        areas.append((name, world))
    if not areas:
        raise InputError(str(path), Unquoted("no polygon"), "areas that cameras must not look into")
    return build_private_ground(areas)


def is_decent(shares: FloatArray, *, most: float) -> BoolArray:
    """Which candidates see no more than a share of any private area.

    `shares` is (n_candidates, n_areas), see :func:`placement.private_ground.private_shares`. Raises
    InputError if all of them see more.
    """
    share = shares.max(axis=1)
    kept: BoolArray = share <= most
    if not kept.any():
        raise InputError(
            "--no-look-share",
            Unquoted(percent(most)),
            f"at least {np.ceil(1000.0 * share.min()) / 1000.0:g}, what the most decent pose sees",
        )
    return kept


def private_sentences(found: PrivateGroundRecord) -> list[str]:
    """What each unit sees of private ground, in a sentence or two."""
    seen = [
        f"{unit} sees {percent(share)} of {name}"
        for unit, shares in found.units.items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(found.areas)
    what = "the private area" if n_areas == 1 else f"any of the {n_areas} private areas"
    if not seen:
        return [f"No camera has {what} in its picture."]
    return [f"Of private ground, {'; '.join(seen)}.", *_price_sentences(found)]


def result_private_sentences(result: Result) -> list[str]:
    """The same of a result; of each layout where several are compared."""
    if not result.private_ground:
        return []
    sentences = private_sentences(result.private_ground)
    for other in result.compared or ():
        if other.private_ground:
            sentences += [f"{other.name}: {one}" for one in private_sentences(other.private_ground)]
    return sentences


def _price_sentences(found: PrivateGroundRecord) -> list[str]:
    if not found.price_eur:
        return []
    return [
        f"That is in the cost with {found.price_eur:,.0f} EUR, "
        f"{found.eur_per_m2:g} EUR a square metre: no money is paid for it."
    ]


# ---------- the section of the report


MAX_UNITS, MAX_AREAS = 12, 60
"""Columns and rows of the table: beyond, only what is seen the most."""
_MAX_NAMED = 6  # pairs of unit and area in a sentence


def private_ground_section(
    found: PrivateGroundRecord | UnsetType, labels: Mapping[str, str]
) -> Section | None:
    """What units see of private ground: areas that are seen the most first; None without any.

    `labels` are short names of the units, by id.
    """
    if not found:
        return None
    units, areas = found.units, found.areas
    most_seen = {
        area.name: max((shares[area.name] for shares in units.values()), default=0.0)
        for area in areas
    }
    seeing = sorted(units, key=lambda unit_id: -max(units[unit_id].values(), default=0.0))
    shown = [unit_id for unit_id in units if unit_id in set(seeing[:MAX_UNITS])]
    rows = sorted(areas, key=lambda area: -most_seen[area.name])[:MAX_AREAS]
    caption = "Share of each private area that a unit sees"
    for n_shown, n_all, what in (
        (len(shown), len(units), "units"),
        (len(rows), len(areas), "areas"),
    ):
        if n_shown < n_all:
            caption += f"; of {n_all} {what} the {n_shown} that matter most"
    table = Table(
        caption=caption,
        columns=[
            "area",
            "size (m\N{SUPERSCRIPT TWO})",
            "most, by one unit",
            *(labels.get(unit_id, unit_id) for unit_id in shown),
        ],
        rows=[
            [
                area.name,
                f"{area.area_m2:.0f}",
                percent(most_seen[area.name]),
                *(percent(units[unit_id][area.name]) for unit_id in shown),
            ]
            for area in rows
        ],
        numeric=range(1, 3 + len(shown)),
    )
    note = (
        "Seen is what lies in a camera's picture with nothing in between, at the height of "
        "people's eyes. LiDARs take no pictures."
    )
    blocks = [" ".join(_short_sentences(found, most_seen)), table, note]
    return Section("private-ground", "Private ground", blocks)


def _short_sentences(found: PrivateGroundRecord, most_seen: Mapping[str, float]) -> list[str]:
    """Who sees what, where few do; where many do, only how many."""
    n_seen = sum(share > 0.0 for share in most_seen.values())
    n_seeing = sum(max(shares.values()) > 0.0 for shares in found.units.values())
    if n_seen * n_seeing <= _MAX_NAMED:
        return private_sentences(found)
    worst = max(most_seen, key=lambda name: most_seen[name])
    return [
        f"{n_seeing} of {len(found.units)} units see something of {n_seen} of "
        f"{len(most_seen)} private areas; the most is {percent(most_seen[worst])} of {worst}.",
        *_price_sentences(found),
    ]
