"""Sites along kerbs, and lists of sites tidied."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_lanes import build_lane

from geometry.errors import InputError
from geometry.junction import Line
from geometry.maps.place_lists import SiteWish
from geometry.maps.sites import SETBACK_M, kerb_sites, tidy_sites
from geometry.maps.source_map import Thing, extrude

SQUARE = np.array(
    [
        [-8.0, -8.0],
        [8.0, -8.0],
        [8.0, 8.0],
        [-8.0, 8.0],
    ]
)


def east(name, y, *, begin=8.0, end=100.0, **options):
    """A lane 3 m wide that leads east."""
    return lane(name, [(begin, y), (end, y)], **options)


def lane(name, points_m, *, width_m=3.0, **options):
    """A lane through points, 3 m wide by default."""
    return build_lane(name, points_m, width_m=width_m, **options)


def positions(sites):
    """Where sites stand, (n, 2)."""
    return np.array([site.position_m for site in sites]).reshape(-1, 2)


def kerb_positions(lanes, spacing_m):
    """Where sites stand along lanes that lead to a square."""
    return positions(kerb_sites(lanes, SQUARE, spacing_m))


def test_sites_line_both_kerbs_from_the_corners_outwards():
    sites = kerb_sites([east("in", 1.5), east("out", -1.5)], SQUARE, 15.0)
    x, y = positions(sites).T
    names = [site.id.split()[1] for site in sites]

    for side, name in ((1.0, "in"), (-1.0, "out")):
        kerb = np.sign(y) == side
        # Half a metre off the outline, to 60 m from it.
        assert x[kerb] == pytest.approx([8.5, 23.5, 38.5, 53.5])
        assert y[kerb] == pytest.approx(side * (3.0 + SETBACK_M))
        assert names.count(name) == 4
    assert {site.kind for site in sites} == {"kerb"}
    assert len({site.id for site in sites}) == 8


def test_the_direction_of_a_lane_does_not_matter():
    there = kerb_positions([east("a", 0)], 10.0)
    back = kerb_positions([east("a", 0, begin=100.0, end=8.0)], 10.0)
    assert sorted(there.tolist()) == sorted(back.tolist())


def test_parked_cars_are_beside_the_kerb_and_paths_are_not():
    lanes = [
        east("a", 0.0),
        east("p", 2.5, width_m=2.0, kind="parking"),
        east("w", 4.5, width_m=2.0, kind="walking"),
        east("c", -2.5, kind="cycling"),
    ]
    found = kerb_positions(lanes, 20.0)
    kerbs = sorted(set(found[:, 1]))

    assert kerbs == pytest.approx([-1.5 - SETBACK_M, 3.5 + SETBACK_M])


@pytest.mark.parametrize("gap_m", [0.0, 0.5, 2.0, 5.0])
def test_medians_get_no_sites(gap_m):
    aside_m = 1.5 + 0.5 * gap_m
    lanes = [east("a", aside_m), east("b", -aside_m)]
    found = kerb_positions(lanes, 20.0)
    nearest_m = np.abs(found[:, 1]).min()

    assert nearest_m == pytest.approx(aside_m + 1.5 + SETBACK_M)


def test_lanes_in_pieces_are_followed_and_those_of_other_roads_are_not():
    lanes = [
        east("a", 0.0, end=30.0),
        east("b", 0.0, begin=30.2, end=100.0),
        east("far", 30.0, begin=20.0),
    ]
    found = kerb_positions(lanes, 10.0)

    assert found[:, 0].max() == pytest.approx(58.5, abs=0.5)
    assert np.abs(found[:, 1]).max() == 1.5 + SETBACK_M


@pytest.mark.parametrize("spacing_m", [0.0, -1.0, np.nan, np.inf])
def test_impossible_spacings_are_refused(spacing_m):
    with pytest.raises(InputError, match="spacing_m"):
        kerb_positions([east("a", 0.0)], spacing_m)
    with pytest.raises(InputError, match="outline_m"):
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
        ahead = np.array([np.cos(angle), np.sin(angle)])
        left = np.array([-ahead[1], ahead[0]])
        for side in (-0.5, 0.5):
            points = np.outer([12.0, 90.0], ahead) + side * width_m * left
            lanes.append(lane(f"{twelfth}{side}", points, width_m=width_m))

    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    on_circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    outline = 12.0 * on_circle
    sites = kerb_sites(lanes, outline, spacing_m)

    found = positions(sites)
    assert len(sites) >= 2 * len(twelfths)
    assert (np.linalg.norm(found, axis=-1) <= 12.0 + 60.0 + 0.1).all()
    for road in lanes:
        begin, end = road.centreline_m[:, :2]
        middle = Line(point_m=begin, direction=end - begin)
        along_m, left_m = middle.coordinates(found).T
        is_beside = (along_m > 0.0) & (along_m < 78.0)
        least_m = 0.5 * road.width_m + SETBACK_M - 0.06

        assert (np.abs(left_m[is_beside]) >= least_m).all()
        for side in ("left", "right"):
            start = f"kerb {road.id} {side} "
            kerb = positions([one for one in sites if one.id.startswith(start)])
            gaps_m = np.linalg.norm(np.diff(kerb, axis=0), axis=-1)
            assert (gaps_m >= spacing_m - 1e-2).all()


def wish(name, x, y, **said):
    """A site of a list, and what is said of it."""
    position_m = np.array([x, y], dtype=float)
    return SiteWish(id=name, position_m=position_m, **said)


def house(*, class_name="building", holes=()):
    """A building from (0, 0) to (10, 10), in metres."""
    corners = np.array(
        [
            [0.0, 0.0],
            [10.0, 0.0],
            [10.0, 10.0],
            [0.0, 10.0],
        ]
    )
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


YARD = np.array(
    [
        [3.0, 3.0],
        [7.0, 3.0],
        [7.0, 7.0],
        [3.0, 7.0],
    ]
)


@pytest.mark.parametrize(
    "thing",
    [
        house(holes=[YARD]),
        house(class_name="vegetation"),
    ],
)
def test_courtyards_and_trees_are_no_buildings(thing):
    kept, _ = tidy_sites([wish("a", 5, 5)], things=[thing])
    assert len(kept) == 1


SAID = (
    {},
    {"cost_eur": 1.0},
    {"cost_eur": 1.0, "z_m": 0.0},
    {"has_power": True},
)
ROW = st.tuples(st.floats(0, 10), st.floats(0, 10), st.sampled_from(SAID))


@given(st.lists(ROW, max_size=25))
def test_what_is_kept_is_apart_and_what_is_dropped_is_near_something_kept(rows):
    sites = []
    for index, (x, y, said) in enumerate(rows):
        sites.append(wish(str(index), x, y, **said))

    kept, skipped = tidy_sites(sites)

    assert len(kept) + len(skipped) == len(sites)
    for one, other in combinations(kept, 2):
        assert np.linalg.norm(one.position_m - other.position_m) > 1.0

    by_id = {site.id: site for site in sites}
    for skip in skipped:
        gone = by_id[skip.what.removeprefix("site ")]
        better = [site for site in kept if site.n_said >= gone.n_said]
        away_m = [np.linalg.norm(gone.position_m - site.position_m) for site in better]
        assert min(away_m) <= 1.0


def test_no_sites_give_no_sites():
    assert tidy_sites([], things=[house()]) == ((), ())
    assert kerb_sites([], SQUARE, 10.0) == ()
