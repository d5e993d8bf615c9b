"""Lists of poles as towns have them: their files, their headers, their coordinates."""

import logging

import geopandas
import numpy as np
import pytest
import shapely
from osm_drawing import drawn, drawn_crossing
from osm_text import LAT_DEG, LON_DEG

from geometry.errors import InputError
from geometry.frames import WGS84, transform
from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.place_lists import known_columns, list_files, read_sites
from geometry.maps.sites import check_sites
from geometry.scene_files import load_scene_folder, save_scene

IDS = ["Mast Südstraße 1", "Mast Nord 2", "Mast 3"]
PLACES_M = np.array(
    [
        [8.0, -6.0],
        [-8.0, 6.0],
        [9.0, 7.0],
    ]
)
HERE = (
    f"+proj=tmerc +lat_0={LAT_DEG} +lon_0={LON_DEG} +k=1 +x_0=0 +y_0=0 +datum=WGS84"
    " +units=m +no_defs"
)
LON_LAT = transform(PLACES_M, HERE, WGS84)


@pytest.fixture(scope="module")
def street_map(tmp_path_factory):
    """A file with a crossing of streets."""
    osm = drawn_crossing("highway=residential", length_m=150.0)
    return osm.write(tmp_path_factory.mktemp("map"))


def also_long(*values):
    """Values of a test that quicker ones cover, too."""
    return pytest.param(*values, marks=pytest.mark.long)


@pytest.fixture
def scene_with(street_map):
    """A function that imports the crossing with sites from a list."""

    def build(sites, sites_crs=""):
        options = ImportOptions(sites=str(sites), sites_crs=sites_crs)
        return import_scene([street_map], options).scene

    return build


@pytest.fixture
def assert_at_places(scene_with):
    """A function that asserts that all three poles of a list are where they were put.

    It returns the scene with them.
    """

    def check(sites, sites_crs="", within_m=0.02):
        scene = scene_with(sites, sites_crs)
        ids = [site.id for site in scene.sites]
        assert ids == ["Mast-Südstraße-1", "Mast-Nord-2", "Mast-3"]
        found = np.array([site.position_m[:2] for site in scene.sites])
        assert found == pytest.approx(PLACES_M, abs=within_m)
        assert {site.height_range_m[1] for site in scene.sites} == {6.0}
        return scene

    return check


def csv_of(folder, heads, crs, *, digits=2):
    """A list with decimal commas and points between thousands."""
    points = transform(LON_LAT, WGS84, crs)
    lines = [heads]
    for name, place in zip(IDS, points.tolist(), strict=True):
        cells = [name]
        for number in place:
            text = f"{number:,.{digits}f}"
            cells.append(text.translate(str.maketrans(",.", ".,")))
        lines.append(";".join([*cells, "6,0"]))

    path = folder / "sites.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def degrees_of(folder):
    """A list with latitudes and longitudes."""
    return csv_of(folder, "id;lon;lat;height", WGS84, digits=8)


def frame_of(crs):
    """The list as a table with points."""
    points = shapely.points(transform(LON_LAT, WGS84, crs))
    columns = {"Mastnummer": IDS, "Hoehe": [6] * 3}
    return geopandas.GeoDataFrame(columns, geometry=points, crs=crs)


@pytest.mark.long
@pytest.mark.parametrize("crs", ["EPSG:25833", "EPSG:31468", "EPSG:4258", "EPSG:4326"])
@pytest.mark.parametrize("name", ["sites.shp", "sites.gpkg"])
def test_gis_files_are_lists_of_poles(assert_at_places, tmp_path, name, crs):
    frame_of(crs).to_file(tmp_path / name)
    assert_at_places(tmp_path / name, within_m=0.05)


@pytest.mark.long
def test_a_shapefile_without_its_system_is_told_it_or_finds_it(
    assert_at_places, tmp_path
):
    path = tmp_path / "sites.shp"
    frame_of("EPSG:25833").to_file(path, encoding="utf-8")
    suffixes = [one.suffix for one in list_files(path)]

    assert suffixes == [".cpg", ".dbf", ".prj", ".shp", ".shx"]

    path.with_suffix(".prj").unlink()
    assert_at_places(path)
    assert_at_places(path, "EPSG:25833")


@pytest.mark.long
def test_of_several_layers_the_one_with_points_or_named_sites_is_read(
    assert_at_places, tmp_path, caplog
):
    path = tmp_path / "town.gpkg"
    frame = frame_of("EPSG:25833")
    areas = frame.set_geometry(frame.buffer(5.0))
    areas.to_file(path, layer="districts")
    frame.to_file(path, layer="trees")

    assert_at_places(path)

    others = frame.set_geometry(frame.translate(20.0, 0.0))
    others.to_file(path, layer="benches")

    with pytest.raises(InputError, match=r"3 layers: districts, trees, benches; .*si"):
        read_sites(path, crs=HERE)

    frame.to_file(path, layer="sites")
    assert_at_places(path)
    assert f"{path}: layer sites is read, of 4" in caplog.messages


@pytest.mark.long
def test_excel_says_the_separator_above_the_header(assert_at_places, tmp_path):
    path = degrees_of(tmp_path)
    plain = path.read_text(encoding="utf-8")
    for head in ("sep=;\n", "SEP=;\r\n", '"sep=;"\n', "\ufeffsep=;\n"):
        path.write_text(head + plain, encoding="utf-8")
        assert_at_places(path)

    path.write_text("sep=|\n" + plain.replace(";", "|"), encoding="utf-8")

    assert_at_places(path)

    broken = plain.replace("6,0", "six")
    path.write_text("sep=;\n" + broken, encoding="utf-8")

    with pytest.raises(InputError, match="line 3: height"):
        read_sites(path, crs=HERE)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_files_of_excel_are_read_whatever_their_encoding(
    assert_at_places, tmp_path, caplog, encoding
):
    path = degrees_of(tmp_path)
    path.write_text(path.read_text(encoding="utf-8"), encoding=encoding)
    with caplog.at_level(logging.WARNING):
        assert_at_places(path)

    told = f"{path}: not UTF-8: read as Windows-1252" in caplog.messages

    assert told == (encoding == "cp1252")


@pytest.mark.long
@pytest.mark.parametrize(
    ("heads", "crs", "name"),
    [
        ("id;x;y;height", "EPSG:25833", "EPSG:25833 (ETRS89 / UTM zone 33N)"),
        also_long("id;E;N;height", "EPSG:32633", "EPSG:25833 (ETRS89 / UTM zone 33N)"),
        also_long("Mast-Nr.;Ostwert;Nordwert;Höhe (m)", "EPSG:5650", "EPSG:5650 ("),
        ("Mastnummer;Rechtswert;Hochwert;Lichtpunkthöhe", "EPSG:31468", "EPSG:31468 ("),
        also_long("id;UTM_E;UTM_N;LPH", "EPSG:25833", "EPSG:25833 ("),
        also_long("id;x;y;height", "EPSG:3857", "EPSG:3857 ("),
    ],
)
def test_coordinates_in_metres_find_their_reference_system(
    assert_at_places, tmp_path, heads, crs, name
):
    path = csv_of(tmp_path, heads, crs)
    scene = assert_at_places(path, within_m=0.05)
    (told,) = [note for note in scene.notes if note.what == "coordinates in sites.csv"]

    assert str(told.why).startswith(f"taken as {name}")
    assert not told.site_ids

    # Who says it is told nothing.
    scene = assert_at_places(path, crs, within_m=0.05)
    assert not [note for note in scene.notes if "coordinates in" in note.what]


@pytest.mark.long
def test_a_system_that_is_not_the_only_one_is_asked_for(tmp_path):
    osm = drawn("")
    # A town: 200 m on, poles stand beside another street.
    for at_m in range(-1000, 1001, 50):
        osm.draw(f"""
            road -1000 {at_m}, 1000 {at_m}
            road {at_m} -1000, {at_m} 1000
        """)

    roads = read_openstreetmap(osm.write(tmp_path), keeps_left=False)
    path = csv_of(tmp_path, "id;x;y;height", "EPSG:25833")

    with pytest.raises(InputError) as caught:
        check_sites(str(path), roads, sites_crs="")

    expected = caught.value.expected
    assert "sites_crs" in expected
    assert "EPSG:25833 (ETRS89 / UTM zone 33N)" in expected
    assert "EPSG:23033 (ED50 / UTM zone 33N)" in expected
    assert check_sites(str(path), roads, sites_crs="EPSG:25833") == ("EPSG:25833", ())


@pytest.mark.long
def test_coordinates_that_fit_no_system_are_refused(street_map, scene_with, tmp_path):
    path = tmp_path / "sites.csv"
    path.write_text("id;x;y\na;652381,2;6862047,3\n")

    with pytest.raises(InputError, match=r"x and y: got 652381.20, 6862047.30; .*crs"):
        scene_with(path)
    with pytest.raises(InputError, match=r"sites_crs: got 'EPSG:0'; .*pyproj knows"):
        scene_with(path, "EPSG:0")
    with pytest.raises(InputError, match=r"sites_crs: .*`sites` with a list, not auto"):
        import_scene([street_map], ImportOptions(sites_crs="EPSG:25833"))

    frame_of("EPSG:25833").to_file(tmp_path / "sites.gpkg")
    with pytest.raises(InputError, match=r"none: sites.gpkg says .*EPSG:25833 \(ETRS"):
        scene_with(tmp_path / "sites.gpkg", "EPSG:31468")


HEADERS = """
    Mastnummer           | id
    MAST-NR.             | id
    LichtpunktNr         | id
    Leuchten_Nr          | id
    N° de support        | id
    Numéro               | id
    Identifiant          | id
    Número de poste      | id
    Código               | id
    Lichtpunkthoehe      | height
    Lichtpunkthöhe in m  | height
    Masthöhe [m]         | height
    Hauteur du mât (m)   | height
    Hauteur en m         | height
    Altura del báculo (m) | height
    Breite               | lat
    geogr. Breite [°]    | lat
    Latitud              | lat
    Länge                | lon
    longitud             | lon
    Rechtswert           | x
    UTM_E                | x
    X (Lambert 93)       | x
    Coordenada X         | x
    Hochwert_GK4         | y
    Norte                | y
    Nordwert             | y
    Höhe ü. NHN          | z
    Coût                 | cost
    Precio (euros)       | cost
    Masttyp              | kind
    Type de support      | kind
    Stromanschluss       | power
    Fibre optique        | fibre
    Kapazität            | capacity
    Prohibido            | forbidden
    LEUCHTENHO           | height
"""


@pytest.mark.parametrize(
    ("header", "field"),
    [
        ("Mastnummer", "id"),
        ("MAST-NR.", "id"),
        ("LichtpunktNr", "id"),
        ("Leuchten_Nr", "id"),
        ("N° de support", "id"),
        ("Numéro", "id"),
        ("Identifiant", "id"),
        ("Número de poste", "id"),
        ("Código", "id"),
        ("Lichtpunkthoehe", "height"),
        ("Lichtpunkthöhe in m", "height"),
        ("Masthöhe [m]", "height"),
        ("Hauteur du mât (m)", "height"),
        ("Hauteur en m", "height"),
        ("Altura del báculo (m)", "height"),
        ("Breite", "lat"),
        ("geogr. Breite [°]", "lat"),
        ("Latitud", "lat"),
        ("Länge", "lon"),
        ("longitud", "lon"),
        ("Rechtswert", "x"),
        ("UTM_E", "x"),
        ("X (Lambert 93)", "x"),
        ("Coordenada X", "x"),
        ("Hochwert_GK4", "y"),
        ("Norte", "y"),
        ("Nordwert", "y"),
        ("Höhe ü. NHN", "z"),
        ("Coût", "cost"),
        ("Precio (euros)", "cost"),
        ("Masttyp", "kind"),
        ("Type de support", "kind"),
        ("Stromanschluss", "power"),
        ("Fibre optique", "fibre"),
        ("Kapazität", "capacity"),
        ("Prohibido", "forbidden"),
        ("LEUCHTENHO", "height"),
    ],
)
def test_headers_of_four_languages_are_known(header, field):
    assert known_columns([header], "list") == {header: field}


def test_a_header_that_is_not_known_has_no_field():
    assert known_columns(["Straße"], "list") == {}


def test_the_number_of_a_pole_goes_before_its_name(tmp_path, caplog):
    path = tmp_path / "sites.csv"
    path.write_text(f"Bezeichnung;Mastnummer;lat;lon\nEcke;17;{LAT_DEG};{LON_DEG}\n")
    (site,) = read_sites(path, crs=HERE)

    assert site.id == "17"
    assert caplog.messages == [
        f"{path}: columns that are not known, and not read: Bezeichnung"
    ]


def test_all_faults_of_a_list_are_told_at_once(tmp_path):
    path = tmp_path / "sites.csv"
    path.write_text(
        "Kennwort;lat;lon;height_ft;capacity;power\n"
        "a;52,5;13,4;x;0;ja\n"
        "b;99;13,4;7;2;perhaps\n"
        "c;52,5;13,4;7\n"
        "d;52,5;13,4;7;half;ja\n"
    )

    with pytest.raises(InputError) as caught:
        read_sites(path, crs=HERE)

    message = str(caught.value)
    assert "\n" not in message
    for words in (
        f"{path}: got 7 faults; expected none: ",
        "line 4: got 4 fields; expected 6",
        "column 'height_ft': got 'ft'; expected metres and euros",
        "got no id; expected one of id, site_id, pole_id, mastnummer, ",
        "line 2: capacity: got '0'; expected a finite number, at least 1, and 1 more",
        "line 3: lat: got 99.0; expected -90 to 90 degrees",
        "line 3: power: got 'perhaps'; expected yes or no",
    ):
        assert words in message


def test_surveyed_poles_stay_where_they_were_surveyed(tmp_path):
    osm = drawn_crossing("lanes=4; highway=secondary")
    osm.draw("way 20 20, 40 20, 40 40, 20 40, 20 20: building=yes")
    places_m = np.array(
        [
            [3.0, 30.0],
            [21.0, 30.0],
            [-20.0, 20.0],
        ]
    )
    lines = ["id;lat;lon"]

    for name, (lon, lat) in zip("abc", transform(places_m, HERE, WGS84), strict=True):
        lines.append(f"{name};{lat:.9f};{lon:.9f}")
    path = tmp_path / "sites.csv"
    path.write_text("\n".join(lines))
    options = ImportOptions(sites=str(path))
    scene = import_scene([osm.write(tmp_path)], options).scene
    sites = {site.id: site for site in scene.sites}
    told = {str(note.what): str(note.why) for note in scene.notes}

    # One on a lane of the map, one inside a wall, one in the open.
    assert sites["a"].position_m[:2] == pytest.approx(places_m[0], abs=0.02)
    assert sites["a"].surveyed_m is None
    assert "kept where it was surveyed" in told["site a"]
    assert sites["b"].position_m[0] < 20.0
    assert sites["b"].surveyed_m == pytest.approx(places_m[1], abs=0.02)
    assert "its coordinates stay as surveyed" in told["site b"]
    assert sites["c"].position_m[:2] == pytest.approx(places_m[2], abs=0.02)
    assert "site c" not in told

    folder = tmp_path / "scene"
    folder.mkdir()
    save_scene(folder, scene)
    again = {site.id: site for site in load_scene_folder(folder).sites}

    assert again["b"].surveyed_m == pytest.approx(places_m[1], abs=0.02)
    assert again["a"].surveyed_m is None
