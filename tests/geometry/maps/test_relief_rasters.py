"""Heights of the ground from rasters: one line for each that does not do."""

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_allclose
from refusals import refused_with

from geometry.errors import InputError, MissingExtraError
from geometry.frames import transform
from geometry.maps import relief
from geometry.maps.relief import read_elevation

UTM = "EPSG:32633"
AT_M = np.array([400_000.0, 5_800_000.0])


@dataclass(kw_only=True)
class Raster:
    """Heights to be written as GeoTIFF."""

    heights: Any
    corner: Any
    step: float
    crs: str | None = UTM
    nodata: float | None = None
    count: int = 1
    driver: str = "GTiff"
    more: dict[str, Any] = field(default_factory=dict)

    def write(self, path):
        """Write the heights to each band of a file."""
        heights = np.asarray(self.heights, dtype=np.float64)
        east_m, north_m = self.corner
        place = rasterio.Affine(self.step, 0.0, east_m, 0.0, -self.step, north_m)
        height, width = heights.shape

        with rasterio.open(
            path,
            "w",
            driver=self.driver,
            width=width,
            height=height,
            transform=place,
            count=self.count,
            dtype="float64",
            crs=self.crs,
            nodata=self.nodata,
            **self.more,
        ) as raster:
            for band in range(1, self.count + 1):
                raster.write(heights, band)


def plane(n=200, step=2.0, **options):
    """A raster around the junction: 300 m in its middle, 5 % up to the east, 2 % to the
    south.
    """
    half_m = 0.5 * n * step
    corner = AT_M + [-half_m, half_m]
    east_m = (np.arange(n) + 0.5) * step - half_m
    south_m = east_m[:, None]
    heights = 300.0 + 0.05 * east_m + 0.02 * south_m
    return Raster(
        heights=heights,
        corner=corner,
        step=step,
        **options,
    )


@pytest.fixture
def read_path(tmp_path):
    """Read what lies there as a raster around the junction."""

    def read_it(crs=UTM):
        path = tmp_path / "dem.tif"
        return read_elevation(path, crs=crs, middle_m=AT_M, half_m=100.0)

    return read_it


@pytest.fixture
def read(tmp_path, read_path):
    """Write a raster and read it around the junction."""

    def write_and_read(raster, **options):
        raster.write(tmp_path / "dem.tif")
        return read_path(**options).ground_m

    return write_and_read


def test_pixels_around_the_place_become_points(read):
    points = read(plane())
    offset = points[:, :2] - AT_M
    slope = [0.05, -0.02]

    assert_allclose(points[:, 2], 300.0 + offset @ slope)
    assert np.abs(offset).max() <= 100.0 + 2.0 * 2.0
    assert len(points) >= 100**2


def test_rasters_in_another_reference_system_lie_at_the_same_place(read):
    lon, lat = transform(AT_M, UTM, "EPSG:4326")
    step = 2.0e-5
    corner = np.array([lon, lat]) + 150 * step * np.array([-1.0, 1.0])
    by_column = np.tile(np.arange(300.0), (300, 1))
    raster = Raster(
        heights=by_column,
        corner=corner,
        step=step,
        crs="EPSG:4326",
    )
    points = read(raster)
    lon_lat = transform(points[:, :2], UTM, "EPSG:4326")

    column = (lon_lat[:, 0] - corner[0]) / step - 0.5

    assert_allclose(column, points[:, 2], atol=1e-3)
    assert np.linalg.norm(points[:, :2] - AT_M, axis=-1).min() < 2.0


def test_pixels_without_a_height_are_left_out(read):
    raster = plane(nodata=-9999.0)
    raster.heights[:, :90] = -9999.0
    raster.heights[:40] = np.nan
    points = read(raster)

    assert np.isfinite(points).all()
    assert points[:, 2].min() > 280.0
    assert (points[:, 0] - AT_M[0]).min() > -21.0


def level(height_m):
    """A raster around the junction with one height everywhere."""
    raster = plane()
    raster.heights[:] = height_m
    return raster


ELSEWHERE = Raster(heights=np.zeros((50, 50)), corner=AT_M + [5000.0, 0.0], step=2.0)
RASTERS = {
    "elsewhere": ELSEWHERE,
    "coarse": plane(n=20, step=90.0),
    "unknown": level(np.nan),
    "nowhere": plane(crs=None),
    "bands": plane(count=3),
    "deep": level(-32768.0),
    "ascii": plane(driver="AAIGrid"),
    "large": plane(n=2200, step=0.1),
}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "elsewhere",
            ("got a raster that lies elsewhere; expected one that covers the junction"),
        ),
        ("coarse", "got pixels of 90 m; expected at most 30 m: finer heights"),
        ("unknown", "got no heights at the junction; expected some within 60 m of it"),
        ("nowhere", "got no coordinate reference system; expected a raster with one"),
        ("bands", "got 3 bands; expected one band, of heights in metres"),
        (
            "deep",
            (
                "got heights from -32768 to -32768; expected metres above the "
                "sea, -500 to 9000"
            ),
        ),
        ("ascii", "got something else; expected a GeoTIFF of heights"),
        (
            "large",
            (
                "got 4,008,004 pixels around the junction; expected at most "
                "4,000,000: a coarser raster"
            ),
        ),
    ],
)
def test_rasters_that_do_not_do_are_refused_in_one_line(read, tmp_path, name, message):
    with refused_with(f"{tmp_path / 'dem.tif'}: {message}"):
        read(RASTERS[name])


def test_a_map_of_no_known_place_cannot_have_a_raster(read, tmp_path):
    with pytest.raises(
        InputError, match="expected a map that says where on earth it lies"
    ):
        read(plane(), crs="")


def test_a_missing_package_is_told(monkeypatch, read_path):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[terrain\]"):
        read_path()


def test_a_text_that_names_an_address_is_never_opened(tmp_path, read_path):
    path = tmp_path / "dem.tif"
    path.write_text(
        '<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Byte"'
        ' band="1">'
        "<SimpleSource><SourceFilename>/vsicurl/http://127.0.0.1:9/a.tif</SourceFilename>"
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(
        InputError, match="got something else; expected a GeoTIFF of heights"
    ):
        read_path()


def test_a_raster_that_is_cut_off_is_refused(read_path, tmp_path):
    path = tmp_path / "dem.tif"
    plane().write(path)
    path.write_bytes(path.read_bytes()[:900])

    with pytest.raises(InputError, match="expected a GeoTIFF of heights"):
        read_path()


def test_a_mask_beside_the_raster_is_not_opened(read, tmp_path):
    mask = Raster(heights=np.zeros((200, 200)), corner=AT_M, step=2.0)
    mask.write(tmp_path / "dem.tif.msk")
    assert len(read(plane())) >= 100**2


def test_blocks_that_take_gigabytes_are_refused(read, monkeypatch):
    monkeypatch.setattr(relief, "_MAX_BLOCK_BYTES", 10_000)
    assert len(read(plane()))  # strips of five lines

    tiles = {"tiled": True, "blockxsize": 208, "blockysize": 208}
    with pytest.raises(
        InputError, match="got blocks of 346,112 bytes; expected at most 10,000"
    ):
        read(plane(more=tiles))
