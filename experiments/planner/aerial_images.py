"""Aerial images that say where on earth they lie, cut out and turned north for the plan."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from pyproj.exceptions import CRSError

from geometry.errors import InputError, refuse
from geometry.frames import parse_crs, transform
from geometry.opening import reading
from geometry.phrases import Phrase
from geometry.scene import Scene
from placement.evaluator.picture_sources import to_jpeg

from ..language import mark
from .background import Background, Lie, LiePoint

# How far the image reaches, to each side of the junction's middle
_AROUND_M = 150.0
# Least size of a pixel of the image on the ground
_FINEST_M = 0.1
_EXPECTED = mark("a georeferenced image of the junction with 8 bits per colour")
_DRIVERS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}


def lay_raster(path: str, crs: str, scene: Scene) -> Background:
    """The part of an aerial image that lies around the junction, north up.

    Parameters
    ----------
    path : str
        GeoTIFF, PNG or JPEG; the latter two with a world file next to it.
    crs : str
        Reference system of that world file; what the image itself says comes first.
    scene : Scene
        Where the junction lies.

    Raises
    ------
    InputError
        It cannot be read, does not say where it lies, or lies elsewhere.
    """
    try:
        import rasterio
    except ImportError:
        expected = mark("rasterio to read it: pip install place-rsus[terrain]")
        raise InputError(path, Phrase("an image with coordinates"), expected) from None
    file = Path(path)
    driver = _DRIVERS.get(file.suffix.lower(), "GTiff")
    unplaced = rasterio.errors.NotGeoreferencedWarning
    with (
        reading(file, _EXPECTED, rasterio.errors.RasterioError, CRSError),
        rasterio.Env(GDAL_PAM_ENABLED="NO"),
        warnings.catch_warnings(action="ignore", category=unplaced),
        rasterio.open(path, driver=driver) as raster,
    ):
        return _cut(raster, path, crs, scene)


def _cut(raster: Any, path: str, crs: str, scene: Scene) -> Background:
    """Part of an open raster around the junction, in the scene's frame."""
    import rasterio
    from rasterio.vrt import WarpedVRT

    own_crs = crs
    if raster.crs:
        own_crs = raster.crs.to_wkt()
    is_coloured = (
        raster.dtypes[0] == "uint8" and raster.colorinterp[0].name != "palette"
    )
    if raster.transform.is_identity or not (own_crs and scene.crs and is_coloured):
        refuse(path, mark("another image, or a scene without coordinates"), _EXPECTED)
    low_m, high_m = _extent_m(raster, own_crs, scene.crs)
    step_m = max(float(high_m[0] - low_m[0]) / raster.width, _FINEST_M)
    centre_m = scene.outline_m.mean(axis=0)
    west, south = np.maximum(low_m, centre_m - _AROUND_M).tolist()
    east, north = np.minimum(high_m, centre_m + _AROUND_M).tolist()
    if not (west < east and south < north):
        refuse(path, mark("an image of another place"), _EXPECTED)
    width_px = int(np.ceil((east - west) / step_m))
    height_px = int(np.ceil((north - south) / step_m))
    has_alpha = any(band.name == "alpha" for band in raster.colorinterp)
    # A grey image has one band, which becomes all three colours.
    bands = [1, 1, 1]
    if raster.count >= 3:
        bands = [1, 2, 3]
    with WarpedVRT(
        raster,
        src_crs=parse_crs(own_crs).to_wkt(),
        crs=parse_crs(scene.crs).to_wkt(),
        transform=rasterio.Affine(step_m, 0.0, west, 0.0, -step_m, north),
        width=width_px,
        height=height_px,
        add_alpha=not has_alpha,
    ) as part:
        rgb = part.read(bands)
        # White where the image has nothing
        rgb[:, part.dataset_mask() == 0] = 255
    upper_left = LiePoint(0.0, 0.0, west, north)
    lower_right = LiePoint(
        width_px, height_px, west + width_px * step_m, north - height_px * step_m
    )
    lie = Lie(width_px=width_px, height_px=height_px, points=(upper_left, lower_right))
    return Background(lie=lie, image=to_jpeg(np.moveaxis(rgb, 0, -1)))


def _extent_m(raster: Any, own_crs: str, scene_crs: str) -> Any:
    """Lowest and highest coordinates of a raster's corners, in the scene's frame."""
    corners = []
    for x_px in (0, raster.width):
        for y_px in (0, raster.height):
            corners.append(raster.transform @ (x_px, y_px))
    corners_m = transform(corners, own_crs, scene_crs)
    return corners_m.min(axis=0), corners_m.max(axis=0)
