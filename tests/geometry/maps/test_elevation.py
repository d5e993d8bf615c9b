"""Heights of the ground from rasters: one line for each that does not do."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from geometry.errors import InputError, MissingExtraError
from geometry.maps.elevation import read_elevation
from geometry.maps.georeferences import transform

UTM = "EPSG:32633"
AT_M = np.array([400_000.0, 5_800_000.0])


class Affine(SimpleNamespace):
    """An affine transformation, as rasterio has them."""

    def __invert__(self):
        inverse = np.linalg.inv([[self.a, self.b, self.c], [self.d, self.e, self.f], [0, 0, 1]])
        return Affine(**dict(zip("abcdef", inverse[:2].ravel(), strict=True)))


class Raster:
    """The part of an open rasterio data set that is used, over an array."""

    def __init__(self, heights, *, corner, step, crs=UTM, nodata=None, count=1):
        self.heights, self.count = np.asarray(heights), count
        self.height, self.width = self.heights.shape
        self.crs = None if crs is None else SimpleNamespace(to_wkt=lambda: crs)
        self.transform = Affine(a=step, b=0.0, c=corner[0], d=0.0, e=-step, f=corner[1])
        self.nodata = nodata

    def read(self, band, *, window, masked):
        assert (band, masked) == (1, True)
        (top, bottom), (left, right) = window
        part = self.heights[top:bottom, left:right]
        return np.ma.array(part, mask=False if self.nodata is None else part == self.nodata)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


def plane(n=200, step=2.0, **options):
    """A raster around the junction: 300 m in its middle, 5 % up to the east, 2 % to the south."""
    corner = AT_M + [-0.5 * n * step, 0.5 * n * step]
    steps = (np.arange(n) + 0.5) * step - 0.5 * n * step
    heights = 300.0 + 0.05 * steps[None, :] + 0.02 * steps[:, None]
    return Raster(heights, corner=corner, step=step, **options)


class RasterioError(Exception):
    """As rasterio's."""


@pytest.fixture
def read(monkeypatch, tmp_path):
    """Read a raster, or what opening it raises, as a file around the junction."""
    path = tmp_path / "dem.tif"
    path.write_bytes(b"II*\0")

    def build(raster, *, crs=UTM, middle_m=AT_M, half_m=100.0):
        def open_raster(_):
            if isinstance(raster, Exception):
                raise raster
            return raster

        errors = SimpleNamespace(RasterioError=RasterioError)
        module = SimpleNamespace(open=open_raster, errors=errors)
        monkeypatch.setitem(sys.modules, "rasterio", module)
        return read_elevation(path, crs=crs, middle_m=middle_m, half_m=half_m).points_m

    return build


def test_pixels_around_the_place_become_points(read):
    points = read(plane())
    offset = points[:, :2] - AT_M
    np.testing.assert_allclose(points[:, 2], 300.0 + 0.05 * offset[:, 0] - 0.02 * offset[:, 1])
    assert np.abs(offset).max() <= 100.0 + 2.0 * 2.0
    assert len(points) >= 100**2


def test_rasters_in_another_reference_system_lie_at_the_same_place(read):
    lon, lat = transform(AT_M, UTM, "EPSG:4326")
    step = 2.0e-5
    corner = np.array([lon, lat]) + 150 * step * np.array([-1.0, 1.0])
    heights = np.tile(np.arange(300.0), (300, 1))  # by column
    points = read(Raster(heights, corner=corner, step=step, crs="EPSG:4326"))
    lon_lat = transform(points[:, :2], UTM, "EPSG:4326")
    np.testing.assert_allclose((lon_lat[:, 0] - corner[0]) / step - 0.5, points[:, 2], atol=1e-3)
    assert np.hypot(*(points[:, :2] - AT_M).T).min() < 2.0


def test_pixels_without_a_height_are_left_out(read):
    raster = plane(nodata=-9999.0)
    raster.heights[:, :90] = -9999.0
    raster.heights[:40] = np.nan
    points = read(raster)
    assert np.isfinite(points).all()
    assert points[:, 2].min() > 280.0
    assert (points[:, 0] - AT_M[0]).min() > -21.0


ELSEWHERE = Raster(np.zeros((50, 50)), corner=AT_M + [5000.0, 0.0], step=2.0)
UNKNOWN = plane()
UNKNOWN.heights[:] = np.nan
DEEP = plane()
DEEP.heights[:] = -32768.0


@pytest.mark.parametrize(
    ("raster", "message"),
    [
        (ELSEWHERE, "got a raster that lies elsewhere; expected one that covers the junction"),
        (plane(n=20, step=90.0), "got pixels of 90 m; expected at most 30 m: finer heights"),
        (UNKNOWN, "got no heights at the junction; expected some within 60 m of it"),
        (plane(crs=None), "got no coordinate reference system; expected a raster with one"),
        (plane(count=3), "got 3 bands; expected one band, of heights in metres"),
        (DEEP, "got heights from -32768 to -32768; expected metres above the sea, -500 to 9000"),
        (
            RasterioError("not recognized\n as a format"),
            "got not recognized as a format; expected a raster of heights, such as GeoTIFF",
        ),
    ],
)
def test_rasters_that_do_not_do_are_refused_in_one_line(read, tmp_path, raster, message):
    with pytest.raises(InputError) as error:
        read(raster)
    assert str(error.value) == f"{tmp_path / 'dem.tif'}: {message}"


def test_a_map_of_no_known_place_cannot_have_a_raster(read, tmp_path):
    with pytest.raises(InputError, match="expected a map that says where on earth it lies"):
        read(plane(), crs="")


def test_a_missing_package_is_told(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[terrain\]"):
        read_elevation(tmp_path / "dem.tif", crs=UTM, middle_m=AT_M, half_m=100.0)


def test_a_real_raster_is_read_as_it_was_written(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    wanted = plane()
    path = tmp_path / "dem.tif"
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": UTM}
    at = wanted.transform
    place = rasterio.Affine(at.a, at.b, at.c, at.d, at.e, at.f)
    size = {"width": wanted.width, "height": wanted.height, "transform": place}
    with rasterio.open(path, "w", **profile, **size) as raster:
        raster.write(wanted.heights.astype(np.float32), 1)
    points = read_elevation(path, crs=UTM, middle_m=AT_M, half_m=50.0).points_m
    offset = points[:, :2] - AT_M
    expected = 300.0 + 0.05 * offset[:, 0] - 0.02 * offset[:, 1]
    np.testing.assert_allclose(points[:, 2], expected, atol=1e-3)
