"""``--no-look FILE``: private ground from a planner's polygons, and what units see of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted
from geometry.maps.feature_files import read_features
from geometry.maps.local_frame import transform
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.privacy import PrivateGround, build_private_ground, private_shares

from .tables import percent


def load_private_ground(path: Path, scene: Scene) -> PrivateGround:
    """Private ground from a file of polygons.

    Parameters
    ----------
    path : Path
        GeoJSON, GeoPackage or Shapefile; a column "name" or "id" names an area.
    scene : Scene
        Into whose world frame.

    Raises
    ------
    InputError
        The file cannot be read or has no polygon, or the scene does not say where on earth it lies
        while the file does.
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

    Parameters
    ----------
    shares : (n_candidates, n_areas) float
        See :func:`placement.privacy.private_shares`.
    most : float
        How much they may see, 0 .. 1.

    Raises
    ------
    InputError
        None is.
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


def summarise_private_ground(
    units: Sequence[CandidatePose],
    scene: Scene,
    ground: PrivateGround,
    *,
    eur_per_m2: float = 0.0,
) -> dict[str, Any]:
    """What units see of private ground, as one plain object.

    Returns
    -------
    summary : dict
        ``{"areas": [{"name", "area_m2"}], "units": {id: {area name: share}}, "eur_per_m2",
        "price_eur"}``; the last two are 0 where it has no price.
    """
    shares = private_shares(scene, units, ground)
    return {
        "eur_per_m2": eur_per_m2,
        "price_eur": float(eur_per_m2 * (shares @ ground.area_m2).sum()),
        "areas": [
            {"name": name, "area_m2": float(area)}
            for name, area in zip(ground.names, ground.area_m2, strict=True)
        ],
        "units": {
            unit.id: dict(zip(ground.names, row.tolist(), strict=True))
            for unit, row in zip(units, shares, strict=True)
        },
    }


def private_sentences(summary: dict[str, Any]) -> list[str]:
    """The same in a sentence or two."""
    seen = [
        f"{unit} sees {percent(share)} of {name}"
        for unit, shares in summary["units"].items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(summary["areas"])
    what = "the private area" if n_areas == 1 else f"any of the {n_areas} private areas"
    if not seen:
        return [f"No camera has {what} in its picture."]
    sentences = [f"Of private ground, {'; '.join(seen)}."]
    if summary["price_eur"]:
        sentences.append(
            f"That is in the cost with {summary['price_eur']:,.0f} EUR, "
            f"{summary['eur_per_m2']:g} EUR a square metre: no money is paid for it."
        )
    return sentences
