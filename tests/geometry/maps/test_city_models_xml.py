"""Houses out of CityGML, in all the ways in which it writes them."""

from itertools import product

import numpy as np
import pytest
from box_faces import BOX_FACES
from numpy.testing import assert_allclose

from geometry.errors import InputError
from geometry.maps.city_models import read_citygml, read_cityjson
from geometry.maps.source_map import is_closed, volume_m3

ORIGIN = np.array([390_000.0, 5_819_000.0, 30.0])
BOX = np.array(list(product((0.0, 6.0), (0.0, 8.0), (0.0, 5.0))))
FACES = np.array(BOX_FACES)
KINDS = ["Wall", "Wall", "Wall", "Wall", "Ground", "Roof"]
VERSIONS = ["1.0", "2.0", "3.0"]


def numbers(points, between=" "):
    """Coordinates as text, to a millimetre."""
    return between.join(f"{value:.3f}" for value in np.ravel(points))


def pos_list(points):
    """Points as GML has them today."""
    return f"<gml:posList>{numbers(points)}</gml:posList>"


def single_positions(points):
    """Points, each by itself."""
    return "".join(f"<gml:pos>{numbers(point)}</gml:pos>" for point in points)


def old_coordinates(points):
    """Points as GML had them once."""
    text = " ".join(numbers(point, ",") for point in points)
    return f"<gml:coordinates>{text}</gml:coordinates>"


def polygon(points, *, holes=(), write=pos_list, attributes=""):
    """An area with holes."""
    rings = [("exterior", points)]
    rings += [("interior", hole) for hole in holes]

    body = ""
    for kind, ring in rings:
        told = write([*ring, ring[0]])
        body += f"<gml:{kind}><gml:LinearRing>{told}</gml:LinearRing></gml:{kind}>"

    return f"<gml:Polygon {attributes}>{body}</gml:Polygon>"


def members(polygons):
    """Areas as members of a surface."""
    return "".join(
        f"<gml:surfaceMember>{text}</gml:surfaceMember>" for text in polygons
    )


def faces(**options):
    """The six sides of the house."""
    return [polygon(BOX[face] + ORIGIN, **options) for face in FACES]


def solid(level=2, shell=None):
    """The house as a solid of a level of detail."""
    if shell is None:
        shell = members(faces())
    return (
        f"<bldg:lod{level}Solid><gml:Solid><gml:exterior><gml:CompositeSurface>{shell}"
        f"</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod{level}Solid>"
    )


def multi_surface(polygons, level=2, name="MultiSurface"):
    """Areas of a level of detail."""
    return (
        f"<bldg:lod{level}{name}><gml:MultiSurface>{members(polygons)}"
        f"</gml:MultiSurface></bldg:lod{level}{name}>"
    )


def city(
    body, *, version="2.0", srs="urn:ogc:def:crs:EPSG::25833", feature="bldg:Building"
):
    """A file with one feature."""
    core = f"http://www.opengis.net/citygml/{version}"
    building = f"http://www.opengis.net/citygml/building/{version}"
    envelope = ""
    if srs:
        envelope = (
            f'<gml:boundedBy><gml:Envelope srsName="{srs}"><gml:lowerCorner>0 0'
            " 0</gml:lowerCorner></gml:Envelope></gml:boundedBy>"
        )
    return (
        f'<CityModel xmlns="{core}" xmlns:bldg="{building}" '
        'xmlns:gml="http://www.opengis.net/gml"'
        ' xmlns:xlink="http://www.w3.org/1999/xlink">'
        f'{envelope}<cityObjectMember><{feature} gml:id="house">{body}</{feature}>'
        "</cityObjectMember></CityModel>"
    )


@pytest.fixture
def read(tmp_path):
    """A function that reads a file with a text."""

    def build(text):
        path = tmp_path / "city.gml"
        path.write_text(text)
        return read_citygml(path)

    return build


def volume(thing):
    """Volume of a thing. [m3]"""
    return volume_m3(thing.vertices_m, thing.triangles)


def bounded(kind, surface):
    """A surface of a kind that bounds the house."""
    return (
        f"<bldg:boundedBy><bldg:{kind}Surface>{multi_surface([surface])}"
        f"</bldg:{kind}Surface></bldg:boundedBy>"
    )


BOUNDED = "".join(map(bounded, KINDS, faces()))
REFERRED = ""
REFERENCES = ""
TURNED = []
for number, (surface_kind, corners) in enumerate(zip(KINDS, FACES, strict=True)):
    named = polygon(BOX[corners] + ORIGIN, attributes=f'gml:id="p{number}"')
    REFERRED += bounded(surface_kind, named)
    REFERENCES += f'<gml:surfaceMember xlink:href="#p{number}"/>'
    TURNED.append(
        '<gml:OrientableSurface orientation="-"><gml:baseSurface>'
        f"{polygon((BOX[corners] + ORIGIN)[::-1])}"
        "</gml:baseSurface></gml:OrientableSurface>"
    )
REFERRED += solid(shell=REFERENCES)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    "body",
    [
        solid(1),
        solid(2),
        solid(3),
        BOUNDED,
        BOUNDED.replace("boundedBy", "boundary"),
        REFERRED,
        multi_surface(TURNED),
        multi_surface(faces()),
        multi_surface(faces(write=single_positions)),
        multi_surface(faces(write=old_coordinates)),
        solid(1, faces()[:3]) + solid(2),
        multi_surface(faces()[:2]) + solid(2),
        multi_surface(faces()[:2], level=4) + solid(2),
    ],
)
def test_a_house_is_the_same_however_it_is_written(read, version, body):
    source = read(city(body, version=version))
    (thing,) = source.things

    assert source.crs == "EPSG:25833"
    assert source.heights == "absolute"
    assert thing.id == "house"
    assert_allclose(thing.vertices_m.min(axis=0), ORIGIN)
    assert_allclose(thing.vertices_m.max(axis=0), ORIGIN + [6, 8, 5])
    assert is_closed(thing.triangles)
    assert volume(thing) == pytest.approx(240.0)


def test_holes_are_left_out(read):
    floor = BOX[FACES[4]] + ORIGIN
    hole = (
        np.array(
            [
                [2.0, 2.0, 0.0],
                [4.0, 2.0, 0.0],
                [4.0, 4.0, 0.0],
                [2.0, 4.0, 0.0],
            ]
        )
        + ORIGIN
    )
    body = multi_surface([polygon(floor, holes=[hole])])
    (thing,) = read(city(body)).things
    a, b, c = np.swapaxes(thing.vertices_m[thing.triangles], 0, 1)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    assert areas.sum() == pytest.approx(44.0)


FLOOR = BOX[[0, 4, 6, 2]] + ORIGIN


@pytest.mark.parametrize("name", ["FootPrint", "RoofEdge"])
@pytest.mark.parametrize(
    ("unit", "height_m"),
    [
        ("m", 7.0),
        ("urn:ogc:def:uom:UCUM::m", 7.0),
        ("ft", 2.1336),
    ],
)
def test_footprints_are_raised_by_their_measured_height(read, name, unit, height_m):
    flat = multi_surface([polygon(FLOOR)], level=0, name=name)
    body = f'<bldg:measuredHeight uom="{unit}">7.0</bldg:measuredHeight>{flat}'
    (thing,) = read(city(body)).things

    assert volume(thing) == pytest.approx(48.0 * height_m)
    assert not thing.is_height_assumed


def test_footprints_in_two_dimensions_are_read_as_such(read):
    square = FLOOR[:, :2]
    ring = [*square, square[0], square[0]]  # 12 numbers: also four points of three
    text = f"<gml:posList>{numbers(ring)}</gml:posList>"
    flat = (
        "<bldg:lod0FootPrint><gml:MultiSurface"
        ' srsDimension="2"><gml:surfaceMember><gml:Polygon>'
        f"<gml:exterior><gml:LinearRing>{text}</gml:LinearRing></gml:exterior></gml:Polygon>"
        "</gml:surfaceMember></gml:MultiSurface></bldg:lod0FootPrint>"
    )
    (thing,) = read(city(flat)).things

    assert_allclose(np.ptp(thing.vertices_m[:, :2], axis=0), [6, 8])
    assert thing.is_height_assumed


def test_parts_are_things_and_their_buildings_footprint_is_none(read):
    part = (
        '<bldg:consistsOfBuildingPart><bldg:BuildingPart gml:id="part">'
        f"{solid()}</bldg:BuildingPart></bldg:consistsOfBuildingPart>"
    )
    flat = multi_surface([polygon(FLOOR)], level=0, name="FootPrint")
    source = read(city(flat + part))

    assert [thing.id for thing in source.things] == ["part"]


def test_northing_first_is_turned(read):
    origin = np.array([4_590_000.0, 5_820_000.0, 30.0])
    box = [polygon((BOX[face] + origin)[:, [1, 0, 2]]) for face in FACES]
    source = read(city(multi_surface(box), srs="urn:ogc:def:crs:EPSG::31468"))

    (thing,) = source.things
    assert_allclose(thing.vertices_m.min(axis=0), origin)
    assert volume(thing) == pytest.approx(240.0)


def test_geographic_coordinates_become_metres(read):
    lat_lon = np.array(
        [
            [35.68, 139.76, 0.0],
            [35.68, 139.761, 0.0],
            [35.681, 139.761, 0.0],
        ]
    )
    flat = multi_surface([polygon(lat_lon)], level=0, name="FootPrint")
    source = read(city(flat, srs="http://www.opengis.net/def/crs/EPSG/0/6697"))

    width, depth = np.ptp(source.things[0].vertices_m[:, :2], axis=0)

    assert width == pytest.approx(90.5, rel=0.01)
    assert depth == pytest.approx(111.0, rel=0.01)


def test_bridges_and_rooms_are_left_out_and_counted(read):
    room = f"<bldg:interiorRoom><bldg:Room>{solid()}</bldg:Room></bldg:interiorRoom>"
    text = city(solid() + room).replace(
        "</CityModel>",
        f"<cityObjectMember><bldg:Bridge>{solid()}</bldg:Bridge></cityObjectMember></CityModel>",
    )
    source = read(text)

    assert len(source.things) == 1
    assert [skip.what for skip in source.skipped] == ["1 Bridge", "1 Room"]


DOUBLING = "".join(
    f'<gml:CompositeSurface gml:id="c{index}">'
    + f'<gml:surfaceMember xlink:href="#c{index + 1}"/>' * 2
    + "</gml:CompositeSurface>"
    for index in range(60)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (city(""), "no building"),
        (city("", feature="bldg:Bridge"), "1 Bridge"),
        (city(solid()).replace("citygml", "nonsense"), "namespace"),
        ("<root/>", "CityModel"),
        ("<CityModel>", "well-formed"),
        (city(solid()).replace("390006.000", "far"), "numbers"),
        (city(solid()).replace("390006.000", "NaN"), "finite"),
        (city(solid()).replace("390006.000", ""), "3 for every point"),
        (
            city(solid() + '<a srsName="EPSG:25832"/>'),
            "several coordinate reference systems",
        ),
        (
            city(f"<bldg:lod2MultiSurface>{DOUBLING}</bldg:lod2MultiSurface>"),
            "nested too deeply",
        ),
        (
            '<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]>'
            + city("<gml:name>&c;</gml:name>"),
            "without entities",
        ),
        (
            city(multi_surface([polygon(np.repeat(ORIGIN[None], 4, axis=0))])),
            "no surface with an area",
        ),
    ],
)
def test_broken_files_are_refused_in_one_line(read, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)


def test_references_in_a_circle_are_refused(read):
    ring = (
        '<bldg:lod2MultiSurface><gml:MultiSurface gml:id="m"><gml:surfaceMember'
        ' xlink:href="#m"/></gml:MultiSurface></bldg:lod2MultiSurface>'
    )
    with pytest.raises(InputError, match="nested too deeply"):
        read(city(ring))


@pytest.mark.long
def test_both_encodings_of_a_real_model_give_the_same_houses(real_input):
    gml = read_citygml(real_input("buildings/lod2_buildings_v3.gml"))
    other = read_cityjson(real_input("buildings/lod2_buildings_v2.city.json"))
    in_json = {thing.id: thing for thing in other.things}

    assert gml.crs == ""
    assert "EPSG:3068" in gml.skipped[0].what
    assert {thing.id for thing in gml.things} == set(in_json)
    assert len(in_json) == 100
    for thing in gml.things:
        twin = in_json[thing.id]
        assert is_closed(thing.triangles)
        assert volume(thing) == pytest.approx(volume(twin), abs=1e-6)
        bounds = [
            (one.vertices_m.min(axis=0), one.vertices_m.max(axis=0))
            for one in (thing, twin)
        ]
        assert_allclose(*bounds, atol=1e-3, rtol=1e-5)
