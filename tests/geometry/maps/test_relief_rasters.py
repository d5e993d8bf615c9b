"""Heights of the ground from rasters: one line for each that does not do."""

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_allclose
from plane_vectors import lengths
from refusal_words import refused_about
from refusals import refused_with

from geometry.errors import MissingExtraError
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
        heights = np.asarray(self.heights, dtype=np.float64)
        place = rasterio.Affine(
            self.step, 0.0, self.corner[0], 0.0, -self.step, self.corner[1]
        )
        height, width = heights.shape
        size = {
            "width": width,
            "height": height,
            "transform": place,
            "count": self.count,
        }
        about = {"dtype": "float64", "crs": self.crs, "nodata": self.nodata}

        with rasterio.open(
            path,
            "w",
            driver=self.driver,
            **size,
            **about,
            **self.more,
        ) as raster:
            for band in range(1, self.count + 1):
                raster.write(heights, band)


def plane(n=200, step=2.0, **options):
    """A raster around the junction: 300 m in its middle, 5 % up to the east, 2 % to the
    south.
    """
    corner = AT_M + [-0.5 * n * step, 0.5 * n * step]
    steps = (np.arange(n) + 0.5) * step - 0.5 * n * step
    heights = 300.0 + 0.05 * steps[None, :] + 0.02 * steps[:, None]
    return Raster(
        heights=heights,
        corner=corner,
        step=step,
        **options,
    )


@pytest.fixture
def read(tmp_path):
    """Write a raster and read it around the junction."""

    def build(raster, *, crs=UTM, middle_m=AT_M, half_m=100.0):
        raster.write(tmp_path / "dem.tif")
        path = tmp_path / "dem.tif"
        return read_elevation(path, crs=crs, middle_m=middle_m, half_m=half_m).ground_m

    return build


def test_pixels_around_the_place_become_points(read):
    points = read(plane())
    offset = points[:, :2] - AT_M

    assert_allclose(points[:, 2], 300.0 + 0.05 * offset[:, 0] - 0.02 * offset[:, 1])
    assert np.abs(offset).max() <= 100.0 + 2.0 * 2.0
    assert len(points) >= 100**2


def test_rasters_in_another_reference_system_lie_at_the_same_place(read):
    lon, lat = transform(AT_M, UTM, "EPSG:4326")
    step = 2.0e-5
    corner = np.array([lon, lat]) + 150 * step * np.array([-1.0, 1.0])
    heights = np.tile(np.arange(300.0), (300, 1))  # by column
    points = read(
        Raster(
            heights=heights,
            corner=corner,
            step=step,
            crs="EPSG:4326",
        )
    )
    lon_lat = transform(points[:, :2], UTM, "EPSG:4326")

    assert_allclose((lon_lat[:, 0] - corner[0]) / step - 0.5, points[:, 2], atol=1e-3)
    assert lengths(points[:, :2] - AT_M).min() < 2.0


def test_pixels_without_a_height_are_left_out(read):
    raster = plane(nodata=-9999.0)
    raster.heights[:, :90] = -9999.0
    raster.heights[:40] = np.nan
    points = read(raster)

    assert np.isfinite(points).all()
    assert points[:, 2].min() > 280.0
    assert (points[:, 0] - AT_M[0]).min() > -21.0


ELSEWHERE = Raster(heights=np.zeros((50, 50)), corner=AT_M + [5000.0, 0.0], step=2.0)
UNKNOWN = plane()
UNKNOWN.heights[:] = np.nan
DEEP = plane()
DEEP.heights[:] = -32768.0


@pytest.mark.parametrize(
    ("raster", "message"),
    [
        (
            ELSEWHERE,
            "got a raster that lies elsewhere; expected one that covers the junction",
        ),
        (
            plane(n=20, step=90.0),
            "got pixels of 90 m; expected at most 30 m: finer heights",
        ),
        (UNKNOWN, "got no heights at the junction; expected some within 60 m of it"),
        (
            plane(crs=None),
            "got no coordinate reference system; expected a raster with one",
        ),
        (plane(count=3), "got 3 bands; expected one band, of heights in metres"),
        (
            DEEP,
            (
                "got heights from -32768 to -32768; expected metres above the sea, -500"
                " to 9000"
            ),
        ),
        (plane(driver="AAIGrid"), "got something else; expected a GeoTIFF of heights"),
        (
            plane(n=2200, step=0.1),
            (
                "got 4,008,004 pixels around the junction; expected at most 4,000,000: "
                "a coarser raster"
            ),
        ),
    ],
)
def test_rasters_that_do_not_do_are_refused_in_one_line(
    read, tmp_path, raster, message
):
    with refused_with(f"{tmp_path / 'dem.tif'}: {message}"):
        read(raster)


def test_a_map_of_no_known_place_cannot_have_a_raster(read, tmp_path):
    with refused_about("expected a map that says where on earth it lies"):
        read(plane(), crs="")


def test_a_missing_package_is_told(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[terrain\]"):
        read_elevation(tmp_path / "dem.tif", crs=UTM, middle_m=AT_M, half_m=100.0)


def test_a_text_that_names_an_address_is_never_opened(tmp_path):
    path = tmp_path / "dem.tif"
    path.write_text(
        '<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Byte"'
        ' band="1">'
        "<SimpleSource><SourceFilename>/vsicurl/http://127.0.0.1:9/a.tif</SourceFilename>"
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with refused_about("got something else; expected a GeoTIFF of heights"):
        read_elevation(path, crs=UTM, middle_m=AT_M, half_m=100.0)


def test_a_raster_that_is_cut_off_is_refused(read, tmp_path):
    plane().write(tmp_path / "dem.tif")
    (tmp_path / "dem.tif").write_bytes((tmp_path / "dem.tif").read_bytes()[:900])
    with refused_about("expected a GeoTIFF of heights"):
        read_elevation(tmp_path / "dem.tif", crs=UTM, middle_m=AT_M, half_m=100.0)


def test_a_mask_beside_the_raster_is_not_opened(read, tmp_path):
    mask = Raster(heights=np.zeros((200, 200)), corner=AT_M, step=2.0)
    mask.write(tmp_path / "dem.tif.msk")
    assert len(read(plane())) >= 100**2


def test_blocks_that_take_gigabytes_are_refused(read, monkeypatch):
    monkeypatch.setattr(relief, "_MAX_BLOCK_BYTES", 10_000)
    assert len(read(plane()))  # strips of five lines
    with refused_about("got blocks of 346,112 bytes; expected at most 10,000"):
        read(plane(more={"tiled": True, "blockxsize": 208, "blockysize": 208}))
