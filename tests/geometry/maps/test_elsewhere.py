"""Files whose content all lies somewhere else than the roads are refused."""

import json

import geopandas as gpd
import pytest
from osm_drawing import drawn_crossing
from osm_text import LAT_DEG, LON_DEG
from shapely import transform as moved
from shapely.geometry import box

from experiments.city.inputs import CityWish, load_city
from geometry.errors import InputError
from geometry.maps.importing import ReadingOptions, read_maps

HOUSE = box(LON_DEG, LAT_DEG, LON_DEG + 1e-4, LAT_DEG + 1e-4)


def swapped(shape):
    """A shape with its coordinates in the other order."""
    return moved(shape, lambda points: points[:, ::-1])


def house_in(crs):
    """The house in another reference system."""
    return gpd.GeoSeries([HOUSE], crs="EPSG:4326").to_crs(crs)[0]


def roads(folder):
    """A file of a crossing."""
    return drawn_crossing().write(folder)


def houses(folder, *shapes, crs="EPSG:4326"):
    """A file of houses in a reference system."""
    path = folder / "houses.gpkg"
    gpd.GeoDataFrame(geometry=list(shapes), crs=crs).to_file(path, driver="GPKG")
    return path


def geojson(folder, shape):
    """A file of one house, in degrees."""
    path = folder / "houses.geojson"
    feature = {
        "type": "Feature",
        "properties": {},
        "geometry": shape.__geo_interface__,
    }
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


def refusal(folder, path):
    """What is told of houses that do not lie where the crossing does."""
    with pytest.raises(InputError) as caught:
        read_maps([roads(folder), path], ReadingOptions())
    return str(caught.value)


def test_latitude_and_longitude_swapped(tmp_path):
    path = geojson(tmp_path, swapped(HOUSE))
    assert refusal(tmp_path, path) == (
        "houses.geojson: got all 1 things of houses.geojson lie 5,600 km away: latitude"
        " and longitude swapped?; expected a file of the place that the roads are in"
    )


@pytest.mark.long
def test_easting_and_northing_swapped(tmp_path):
    here = house_in("EPSG:25833")
    path = houses(tmp_path, swapped(here), swapped(here), crs="EPSG:25833")
    message = refusal(tmp_path, path)

    assert "got coordinates around 5817861, 391394" in message
    assert "easting and northing swapped?" in message


def test_easting_and_northing_swapped_on_the_whole_earth(tmp_path):
    """Web Mercator has no area outside of which coordinates make no sense."""
    path = houses(tmp_path, swapped(house_in("EPSG:3857")), crs="EPSG:3857")
    message = refusal(tmp_path, path)

    assert "all 1 things of houses.gpkg lie" in message
    assert "easting and northing swapped?" in message


def test_the_neighbouring_zone(tmp_path):
    path = houses(tmp_path, house_in("EPSG:25833"), crs="EPSG:25832")
    message = refusal(tmp_path, path)

    assert "lie 410 km away: coordinates of another place, or of another" in message


def test_one_house_that_lies_here_is_enough(tmp_path):
    path = houses(tmp_path, swapped(HOUSE), HOUSE)
    maps, _ = read_maps([roads(tmp_path), path], ReadingOptions())
    assert len(maps[1].things) == 2


def test_a_tile_of_the_next_town_is_no_mistake(tmp_path):
    """Nothing of it is near the junction, which a note says."""
    tile = moved(HOUSE, lambda points: points + [0.1, 0.1])
    maps, _ = read_maps([roads(tmp_path), houses(tmp_path, tile)], ReadingOptions())
    assert len(maps[1].things) == 1


def test_a_city_refuses_it_too(tmp_path):
    path = geojson(tmp_path, swapped(HOUSE))
    with pytest.raises(InputError, match="latitude and longitude swapped"):
        load_city([roads(tmp_path), path], ReadingOptions(), CityWish())
