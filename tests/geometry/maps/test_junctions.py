"""Which junction of a map is meant: the largest, or one that is told."""

from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import InputError
from geometry.frames import WGS84, transform
from geometry.maps.importing import choose_junction, survey_junctions
from geometry.maps.source_map import MapJunction, MapLane, SourceMap

SQUARE_M = 8.0 * np.array(
    [
        [1.0, -1.0],
        [1.0, 1.0],
        [-1.0, 1.0],
        [-1.0, -1.0],
    ]
)


def junction(name, middle, n_arms):
    """A junction and its lanes: one in and one out on each arm, from the east on."""
    lanes = []
    for index in range(n_arms):
        angle = 0.5 * np.pi * index
        ahead = np.array([np.cos(angle), np.sin(angle)])
        left = np.array([-ahead[1], ahead[0]])
        near = middle + 8.0 * ahead
        far = middle + 60.0 * ahead
        coming = MapLane(
            id=f"{name}-{index}-in",
            kind="driving",
            width_m=3.0,
            centreline_m=in_space(far + 1.5 * left, near + 1.5 * left),
            to_junction=name,
        )
        leaving = MapLane(
            id=f"{name}-{index}-out",
            kind="driving",
            width_m=3.0,
            centreline_m=in_space(near - 1.5 * left, far - 1.5 * left),
            from_junction=name,
        )
        lanes += [coming, leaving]

    outline_m = SQUARE_M + middle
    return MapJunction(id=name, name=f"{name} Street", outline_m=outline_m), lanes


def in_space(*points):
    """Points of the plane at height zero."""
    return np.column_stack([points, np.zeros(len(points))])


@pytest.fixture
def source():
    """A map with a junction of four arms and two of three, in a row."""
    junctions = []
    lanes = []
    for name, east_m, n_arms in (("small", 0, 3), ("large", 500, 4), ("other", 900, 3)):
        one, own = junction(name, (east_m, 0.0), n_arms)
        junctions.append(one)
        lanes += own

    return SourceMap(
        name="m.xodr",
        crs="",
        junctions=tuple(junctions),
        lanes=tuple(lanes),
    )


def test_junctions_are_listed_by_arms_and_the_first_is_taken(source):
    found = survey_junctions(source)
    listed = [(one.junction.id, len(one.arms), one.n_lanes) for one in found]

    assert listed == [
        ("large", 4, 8),
        ("other", 3, 6),  # nearer to the middle of the map
        ("small", 3, 6),
    ]
    assert choose_junction(source, found).junction.id == "large"
    assert choose_junction(source, found, name="OTHER street").junction.id == "other"
    assert choose_junction(source, found, name="small").junction.id == "small"
    assert choose_junction(source, found, at=(910.0, 30.0)).junction.id == "other"


@pytest.mark.parametrize(
    ("named", "name"),
    [
        ("Main Street / North 3rd Avenue", "Main St / N 3rd Ave"),
        ("3rd Avenue North / Main Street", "3RD AVENUE NORTH & main street"),
        ("3rd Avenue North / Main Street", "main st. and 3rd ave n"),
        ("Hauptstraße / St.-Georg-Platz", "Hauptstr. / Sankt-Georg-Platz"),
        ("Hauptstraße / St.-Georg-Platz", "St. Georg Pl. x Hauptstraße"),
    ],
)
def test_streets_go_by_their_short_names(source, named, name):
    one, *rest = source.junctions
    renamed = replace(one, name=named)
    found = survey_junctions(replace(source, junctions=(renamed, *rest)))

    assert choose_junction(source, found, name=name).junction.name == named


def test_a_name_that_no_junction_has_lists_those_like_it_first(source):
    with pytest.raises(InputError, match="got 'Othr Street'; expected one of other"):
        choose_junction(source, survey_junctions(source), name="Othr Street")


def test_a_junction_is_chosen_by_latitude_and_longitude(source):
    crs = "EPSG:32633"
    junctions = []
    for one in source.junctions:
        outline_m = one.outline_m + [500_000.0, 5_800_000.0]
        junctions.append(replace(one, outline_m=outline_m))

    moved = replace(
        source,
        crs=crs,
        source_crs=crs,
        junctions=tuple(junctions),
        lanes=(),
    )
    found = survey_junctions(moved)
    lon_deg, lat_deg = transform(np.array([500_905.0, 5_800_010.0]), crs, WGS84)
    chosen = choose_junction(moved, found, name=f"{lat_deg:.6f}, {lon_deg:.6f}")

    assert chosen.junction.id == "other"
    with pytest.raises(
        InputError, match=r"junction: got 10\.5,20\.5; expected a point within"
    ):
        choose_junction(moved, found, name="10.5,20.5")
    with pytest.raises(InputError, match="does not say where it lies"):
        choose_junction(source, survey_junctions(source), name="52.5,13.4")


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"name": "street"}, "junction: got 'street'; expected one of large"),
        ({"name": "lane"}, "junction: got 'lane'"),
        ({"at": (0.0, 500.0)}, "X,Y: it is the other way round"),
        ({"at": (0.0, 300.0)}, "the nearest one, small, is at 0, 0"),
    ],
)
def test_who_is_not_meant_is_told(source, choice, message):
    with pytest.raises(InputError, match=message):
        choose_junction(source, survey_junctions(source), **choice)


def test_a_map_without_junctions_is_told(source):
    empty = replace(source, junctions=())
    with pytest.raises(
        InputError, match=r"m\.xodr: got no junction; expected a map in which"
    ):
        choose_junction(empty, survey_junctions(empty))


def test_a_junction_that_no_lane_reaches_has_no_arms(source):
    lonely = MapJunction(id="lonely", name="", outline_m=SQUARE_M + 5000.0)
    junctions = (*source.junctions, lonely)
    found = survey_junctions(replace(source, junctions=junctions))

    assert found[-1].arms == ()
