"""Sites along kerbs, and lists of sites tidied."""

from itertools import combinations

import numpy as np
import pytest
from geometry_text import array_of
from hypothesis import given
from hypothesis import strategies as st
from plane_vectors import lengths, unit_vectors
from refusal_words import refused_about

from geometry.maps.place_lists import SiteWish
from geometry.maps.sites import SETBACK_M, kerb_sites, tidy_sites
from geometry.maps.source_map import Thing, extrude
from geometry.scene import Lane

SQUARE = array_of("-8 -8, 8 -8, 8 8, -8 8")


def lane(name, points_m, *, width_m=3.0, kind="driving"):
    """A lane of a scene through two points."""
    line = np.array(points_m, dtype=float)
    return Lane(
        id=name,
        kind=kind,
        width_m=width_m,
        centreline_m=line,
    )


def east(name, y, *, begin=8.0, end=100.0, **options):
    """A lane that leads east."""
    return lane(name, [(begin, y), (end, y)], **options)


def positions(sites):
    """Where sites stand, (n, 2)."""
    return np.array([site.position_m for site in sites]).reshape(-1, 2)


def test_sites_line_both_kerbs_from_the_corners_outwards():
    sites = kerb_sites([east("in", 1.5), east("out", -1.5)], SQUARE, 15.0)
    found = positions(sites)
    x = [8.5, 23.5, 38.5, 53.5]  # half a metre off the outline, to 60 m from it

    for side, name in ((1.0, "in"), (-1.0, "out")):
        kerb = found[np.sign(found[:, 1]) == side]
        expected = [(along, side * (3.0 + SETBACK_M)) for along in x]
        assert kerb == pytest.approx(np.array(expected))
        assert sum(site.id.startswith(f"kerb {name} ") for site in sites) == 4
    assert {site.kind for site in sites} == {"kerb"}
    assert len({site.id for site in sites}) == 8


def test_the_direction_of_a_lane_does_not_matter():
    there = kerb_sites([lane("a", [(8, 0), (100, 0)])], SQUARE, 10.0)
    back = kerb_sites([lane("a", [(100, 0), (8, 0)])], SQUARE, 10.0)
    assert sorted(positions(there).tolist()) == sorted(positions(back).tolist())


def test_parked_cars_are_beside_the_kerb_and_paths_are_not():
    lanes = [
        east("a", 0.0),
        east("p", 2.5, width_m=2.0, kind="parking"),
        east("w", 4.5, width_m=2.0, kind="walking"),
        east("c", -2.5, kind="cycling"),
    ]
    found = positions(kerb_sites(lanes, SQUARE, 20.0))
    kerbs = sorted(set(found[:, 1]))

    assert kerbs == pytest.approx([-1.5 - SETBACK_M, 3.5 + SETBACK_M])


@pytest.mark.parametrize("gap_m", [0.0, 0.5, 2.0, 5.0])
def test_medians_get_no_sites(gap_m):
    lanes = [east("a", 1.5 + 0.5 * gap_m), east("b", -1.5 - 0.5 * gap_m)]
    found = positions(kerb_sites(lanes, SQUARE, 20.0))
    assert np.abs(found[:, 1]).min() == pytest.approx(3.0 + 0.5 * gap_m + SETBACK_M)


def test_lanes_in_pieces_are_followed_and_those_of_other_roads_are_not():
    lanes = [
        east("a", 0.0, end=30.0),
        east("b", 0.0, begin=30.2, end=100.0),
        east("far", 30.0, begin=20.0),
    ]
    found = positions(kerb_sites(lanes, SQUARE, 10.0))

    assert found[:, 0].max() == pytest.approx(58.5, abs=0.5)
    assert np.abs(found[:, 1]).max() == 1.5 + SETBACK_M


@pytest.mark.parametrize("spacing_m", [0.0, -1.0, np.nan, np.inf])
def test_impossible_spacings_are_refused(spacing_m):
    with refused_about("spacing_m"):
        kerb_sites([east("a", 0.0)], SQUARE, spacing_m)
    with refused_about("outline_m"):
        kerb_sites([east("a", 0.0)], SQUARE[:2], 10.0)


@pytest.mark.long
@given(
    twelfths=st.lists(st.integers(0, 11), min_size=1, max_size=5, unique=True),
    spacing_m=st.floats(5.0, 40.0),
    widths_m=st.lists(st.floats(2.0, 5.0), min_size=5, max_size=5),
)
def test_no_site_stands_on_the_road_and_neighbours_on_a_kerb_keep_their_distance(
    twelfths, spacing_m, widths_m
):
    """Roads of two lanes leave a round junction, each in its twelfth of the circle."""
    lanes = []
    for twelfth, width_m in zip(twelfths, widths_m, strict=False):
        angle = twelfth * np.pi / 6
        ahead = unit_vectors(angle)
        left = np.array([-ahead[1], ahead[0]])
        for side in (-0.5, 0.5):
            points = np.outer([12.0, 90.0], ahead) + side * width_m * left
            lanes.append(lane(f"{twelfth}{side}", points, width_m=width_m))

    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    outline = 12.0 * unit_vectors(turn)
    sites = kerb_sites(lanes, outline, spacing_m)

    found = positions(sites)
    assert len(sites) >= 2 * len(twelfths)
    assert (lengths(found) <= 12.0 + 60.0 + 0.1).all()
    for road in lanes:
        begin, end = road.centreline_m[:, :2]
        ahead = (end - begin) / lengths(end - begin)
        along_m = (found - begin) @ ahead
        across_m = np.abs((found - begin) @ [-ahead[1], ahead[0]])
        beside_m = across_m[(along_m > 0.0) & (along_m < 78.0)]

        assert (beside_m >= 0.5 * road.width_m + SETBACK_M - 0.06).all()
        for side in ("left", "right"):
            start = f"kerb {road.id} {side} "
            kerb = positions([one for one in sites if one.id.startswith(start)])
            gaps_m = lengths(np.diff(kerb, axis=0))
            assert (gaps_m >= spacing_m - 1e-2).all()


def wish(name, x, y, **said):
    """A site of a list, and what is said of it."""
    return SiteWish(id=name, position_m=np.array([x, y], dtype=float), **said)


def house(*, class_name="building", holes=()):
    """A building from (0, 0) to (10, 10), in metres."""
    corners = array_of("0 0, 10 0, 10 10, 0 10")
    vertices, triangles = extrude(corners, bottom_m=0.0, top_m=6.0, holes_m=holes)
    return Thing(
        id="h",
        class_name=class_name,
        vertices_m=vertices,
        triangles=triangles,
    )


def test_of_sites_at_one_place_the_one_with_more_said_stays():
    sites = [
        wish("a", 0, 0),
        wish("b", 0.6, 0, cost_eur=5.0),
        wish("c", 3, 0),
        wish("d", 3, 0),
    ]
    kept, skipped = tidy_sites(sites)

    assert [site.id for site in kept] == ["b", "c"]
    assert [skip.what for skip in skipped] == ["site a", "site d"]
    assert "beside b" in skipped[0].why


def test_sites_in_buildings_are_dropped_with_the_building_named():
    sites = [
        wish("in", 5, 5),
        wish("edge", 5, 5.5),
        wish("out", 12, 5),
        wish("on", 10, 5),
    ]
    kept, skipped = tidy_sites(sites, things=[house()])

    assert [site.id for site in kept] == ["out", "on"]
    assert {skip.why for skip in skipped} == {"inside building h"}


YARD = array_of("3 3, 7 3, 7 7, 3 7")


@pytest.mark.parametrize("thing", [house(holes=[YARD]), house(class_name="vegetation")])
def test_courtyards_and_trees_are_no_buildings(thing):
    kept, _ = tidy_sites([wish("a", 5, 5)], things=[thing])
    assert len(kept) == 1


SAID = ({}, {"cost_eur": 1.0}, {"cost_eur": 1.0, "z_m": 0.0}, {"has_power": True})
ROW = st.tuples(st.floats(0, 10), st.floats(0, 10), st.sampled_from(SAID))


@given(st.lists(ROW, max_size=25))
def test_what_is_kept_is_apart_and_what_is_dropped_is_near_something_kept(rows):
    sites = [wish(f"{index}", x, y, **said) for index, (x, y, said) in enumerate(rows)]
    kept, skipped = tidy_sites(sites)

    assert len(kept) + len(skipped) == len(sites)
    for one, other in combinations(kept, 2):
        assert lengths(one.position_m - other.position_m) > 1.0

    by_id = {site.id: site for site in sites}
    for skip in skipped:
        gone = by_id[skip.what.removeprefix("site ")]
        better = [site for site in kept if site.n_said >= gone.n_said]
        away_m = [lengths(gone.position_m - site.position_m) for site in better]
        assert min(away_m) <= 1.0


def test_no_sites_give_no_sites():
    assert tidy_sites([], things=[house()]) == ((), ())
    assert kerb_sites([], SQUARE, 10.0) == ()
