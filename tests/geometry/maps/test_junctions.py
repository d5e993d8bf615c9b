from dataclasses import replace

import numpy as np
import pytest
from plane_vectors import unit_vectors
from refusal_words import refused_about
from text_tables import changes_of

from geometry.frames import WGS84, transform
from geometry.maps.importing import choose_junction, survey_junctions
from geometry.maps.source_map import MapJunction, MapLane, SourceMap

SQUARE_M = 8.0 * np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])


def junction(name, middle, n_arms):
    turns = np.radians(90.0 * np.arange(n_arms))
    lanes = []
    for index, (east, north) in enumerate(unit_vectors(turns)):
        for is_in, side in ((True, 1.5), (False, -1.5)):
            near, far = (
                np.array([r * east - side * north, r * north + side * east]) + middle
                for r in (8.0, 60.0)
            )
            points = np.array([far, near] if is_in else [near, far])
            lanes.append(
                MapLane(
                    id=f"{name}-{index}-{is_in}",
                    kind="driving",
                    width_m=3.0,
                    centreline_m=np.column_stack([points, np.zeros(2)]),
                    to_junction=name if is_in else "",
                    from_junction="" if is_in else name,
                )
            )

    return (
        MapJunction(id=name, name=f"{name} Street", outline_m=SQUARE_M + middle),
        lanes,
    )


@pytest.fixture
def source():
    parts = [
        junction("small", (0.0, 0.0), 3),
        junction("large", (500.0, 0.0), 4),
        junction("other", (900.0, 0.0), 3),
    ]
    return SourceMap(
        name="m.xodr",
        crs="",
        junctions=tuple(one for one, _ in parts),
        lanes=tuple(lane for _, lanes in parts for lane in lanes),
    )


def test_junctions_are_listed_by_arms_and_the_first_is_taken(source):
    found = survey_junctions(source)
    assert [(one.junction.id, len(one.arms), one.n_lanes) for one in found] == [
        ("large", 4, 8),
        ("other", 3, 6),  # nearer to the middle of the map
        ("small", 3, 6),
    ]
    assert choose_junction(source, found).junction.id == "large"
    assert choose_junction(source, found, name="OTHER street").junction.id == "other"
    assert choose_junction(source, found, name="small").junction.id == "small"
    assert choose_junction(source, found, at=(910.0, 30.0)).junction.id == "other"


@pytest.mark.parametrize(
    "name",
    [
        *(
            "Main St / N 3rd Ave",
            "3RD AVENUE NORTH & main street",
            "main st. and 3rd ave n",
        ),
        *("Hauptstr. / Sankt-Georg-Platz", "St. Georg Pl. x Hauptstraße"),
    ],
)
def test_streets_go_by_their_short_names(source, name):
    is_german = "aupt" in name
    if is_german:
        named = "Hauptstraße / St.-Georg-Platz"
    else:
        named = "Main Street / North 3rd Avenue"
    if name.startswith("3RD") or name.endswith(" n"):
        named = "3rd Avenue North / Main Street"
    one, *rest = source.junctions
    found = survey_junctions(
        replace(source, junctions=(replace(one, name=named), *rest))
    )

    assert choose_junction(source, found, name=name).junction.name == named


def test_a_name_that_no_junction_has_lists_those_like_it_first(source):
    with refused_about("got 'Othr Street'; expected one of other"):
        choose_junction(source, survey_junctions(source), name="Othr Street")


def test_a_junction_is_chosen_by_latitude_and_longitude(source):
    crs = "EPSG:32633"
    moved = replace(
        source,
        crs=crs,
        source_crs=crs,
        junctions=tuple(
            replace(one, outline_m=one.outline_m + [500_000.0, 5_800_000.0])
            for one in source.junctions
        ),
        lanes=(),
    )
    found = survey_junctions(moved)
    lon_deg, lat_deg = transform(np.array([500_905.0, 5_800_010.0]), crs, WGS84)
    chosen = choose_junction(moved, found, name=f"{lat_deg:.6f}, {lon_deg:.6f}")

    assert chosen.junction.id == "other"
    with refused_about(r"junction: got 10\.5,20\.5; expected a point within"):
        choose_junction(moved, found, name="10.5,20.5")
    with refused_about("does not say where it lies"):
        choose_junction(source, survey_junctions(source), name="52.5,13.4")


@pytest.mark.parametrize(
    ("choice", "message"),
    changes_of("""
    name='street'   | junction: got 'street'; expected one of large
    name='lane'     | junction: got 'lane'
    at=(0.0, 500.0) | X,Y: it is the other way round
    at=(0.0, 300.0) | the nearest one, small, is at 0, 0
"""),
)
def test_who_is_not_meant_is_told(source, choice, message):
    with refused_about(message):
        choose_junction(source, survey_junctions(source), **choice)


def test_a_map_without_junctions_is_told(source):
    empty = replace(source, junctions=())
    with refused_about(r"m\.xodr: got no junction; expected a map in which"):
        choose_junction(empty, survey_junctions(empty))


def test_a_junction_that_no_lane_reaches_has_no_arms(source):
    lonely = MapJunction(id="lonely", name="", outline_m=SQUARE_M + 5000.0)
    found = survey_junctions(replace(source, junctions=(*source.junctions, lonely)))
    assert found[-1].arms == ()
