"""LiDARs that scan all round, as they are drawn and told."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import PathPatch
from numpy.testing import assert_allclose, assert_array_equal
from tiny_worlds import unit_at

from experiments.figures.axes import new_axes
from experiments.figures.outlines import (
    blind_footprint,
    compass_word,
    ground_footprint,
    ground_rings,
    looking_words,
)
from experiments.figures.plan import plot_plan
from experiments.parts.player import unit_records
from experiments.parts.sheet import _direction, _draw_plan, _tilt
from experiments.parts.units import unit_table
from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.study_scene import load_study_scene
from placement.candidates import is_in_view
from placement.layout import Layout

CAMERA = load_cameras()["carla-ncap-rgb"]
RING = load_lidars()["ouster-os1-128"]
PLACE = np.array([-120.0, 3.0, 6.0])


def _unit(sensor=RING, yaw_deg=0.0, pitch_deg=0.0, unit_id="U1"):
    """A LiDAR that scans all round, 6 m high, or another sensor."""
    return unit_at(
        unit_id,
        PLACE,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        sensor=sensor,
    )


def _away_m(points):
    """Distances of places on the ground from the foot of the unit."""
    return np.linalg.norm(points - PLACE[:2], axis=-1)


def _two(first, second):
    """A layout of two units."""
    return Layout(name="two", units=(first, second))


def _legend_of(axes):
    """Texts of a figure's legend."""
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_level_ring_sees_the_ground_between_two_circles():
    """From where its lowest beam, 22.5 degrees down, meets the ground to its range."""
    unit = _unit(yaw_deg=70.0)
    outer, inner = ground_rings(unit, max_range_m=35.0)
    blind_m = 6.0 / math.tan(math.radians(22.5))

    assert_allclose(_away_m(outer), 35.0)
    assert_allclose(_away_m(inner), blind_m, atol=0.1)

    seen = ground_footprint(unit, max_range_m=35.0)
    blind = blind_footprint(unit, max_range_m=35.0)

    assert_array_equal(seen, outer)
    assert_array_equal(blind, inner)


def test_a_ring_sees_no_ground_where_its_lowest_beams_end_beyond():
    """2 degrees down, they meet the ground 172 m away."""
    narrow = replace(RING, vertical_fov_deg=4.0)
    flat = _unit(narrow)
    outer, inner = ground_rings(flat, max_range_m=35.0)

    assert len(outer) == 0
    assert len(inner) == 0
    assert ground_footprint(flat, max_range_m=35.0).shape == (0, 2)


@pytest.mark.parametrize("horizontal_fov_deg", [180.0, 270.0, 360.0])
@pytest.mark.parametrize("pitch_deg", [0.0, -30.0, -70.0])
def test_the_rings_hold_exactly_the_ground_in_view(horizontal_fov_deg, pitch_deg):
    """Random places are inside of what is drawn where the unit has them in view."""
    sensor = replace(RING, horizontal_fov_deg=horizontal_fov_deg)
    unit = _unit(
        sensor,
        yaw_deg=25.0,
        pitch_deg=pitch_deg,
    )
    outer, inner = ground_rings(unit, max_range_m=30.0)
    rng = np.random.default_rng(1)
    points = PLACE[:2] + rng.uniform(-32.0, 32.0, (4000, 2))
    ground = np.column_stack([points, np.zeros(4000)])

    is_seen = is_in_view(unit, ground)
    is_seen &= _away_m(points) < 30.0
    area = shapely.Polygon(outer).buffer(0.0)
    drawn = shapely.contains_xy(area, points)
    if len(inner):
        hole = shapely.Polygon(inner).buffer(0.0)
        drawn &= ~shapely.contains_xy(hole, points)

    # 2 degrees between bearings, and a tenth of a metre: only what is near to a border
    # may differ.
    assert (drawn == is_seen).mean() > 0.97
    assert 0.05 < is_seen.mean() < 0.9


def test_cameras_and_narrow_lidars_have_no_blind_disc():
    """They do not see behind themselves, so that nothing is cut out."""
    narrow = load_lidars()["carla-ncap-lidar"]

    for sensor in (CAMERA, narrow):
        unit = _unit(sensor, pitch_deg=-20.0)
        blind = blind_footprint(unit, max_range_m=35.0)
        assert len(blind) == 0


def test_the_words_say_that_it_scans_all_round():
    assert compass_word(_unit(yaw_deg=90.0)) == "all round"
    assert looking_words(_unit()) == "scanning all round"

    camera = _unit(CAMERA, yaw_deg=90.0, unit_id="U2")
    assert compass_word(camera) == "north"
    assert looking_words(camera) == "looking to the north"

    layout = Layout(name="two", units=(_unit(), camera))
    table = unit_table("two", layout, load_study_scene())

    assert [row[6] for row in table.rows] == ["all round", "0.0"]


@pytest.mark.long
def test_the_plan_marks_a_ring_by_a_disc_and_draws_its_blind_spot(small_setting):
    """It looks nowhere in particular, so that its mark has no tip."""
    camera = _unit(CAMERA, pitch_deg=-30.0, unit_id="U2")
    axes = plot_plan(small_setting, _two(_unit(), camera))
    marks = {line.get_gid(): line for line in axes.get_lines()}

    assert marks["unit:U1"].get_marker() == "o"
    assert marks["unit:U2"].get_marker() != "o"

    texts = _legend_of(axes)

    assert "two: LiDAR that scans all round" in texts
    assert any(text.startswith("two: camera") for text in texts)

    paths = [patch for patch in axes.patches if isinstance(patch, PathPatch)]
    fills = [path for path in paths if path.get_alpha() is not None]
    # What runs the other way round inside is a hole.
    ring, hole = fills[0].get_path().to_polygons()
    outer = shapely.LinearRing(ring)
    inner = shapely.LinearRing(hole)

    assert outer.is_ccw
    assert not inner.is_ccw
    assert shapely.Polygon(outer).contains(shapely.Polygon(inner))

    one = Layout(name="one", units=(_unit(),))
    alone = plot_plan(small_setting, one)

    assert not any("camera" in text for text in _legend_of(alone))


def test_the_sheet_says_how_a_ring_hangs_and_draws_an_arrow_only_where_it_helps():
    """An arrow tells where the front is, which counts only where it is tilted."""
    level = _unit(yaw_deg=90.0)
    tilted = _unit(yaw_deg=90.0, pitch_deg=-12.0)
    told = "all round: turning it changes its axes, not what it sees"

    assert _direction(level).startswith(told)
    assert _direction(tilted).startswith("all round\nits front to the north")
    assert _tilt(level) == "none: level, its axis upright"
    assert _tilt(tilted) == "front 12.0° down, back equally far up"

    arrows = []
    for unit in (level, tilted):
        axes = new_axes(4.0, 4.0)
        _draw_plan(
            axes,
            unit,
            "U1",
            load_study_scene(),
        )
        has_arrow = [text.arrow_patch is not None for text in axes.texts]
        arrows.append(sum(has_arrow))

    assert arrows == [0, 1]


def test_the_player_gets_a_round_sign():
    """Its kind says which sign is drawn."""
    camera = _unit(CAMERA, pitch_deg=-30.0, unit_id="U2")
    layout = _two(_unit(), camera)
    scene = load_study_scene()
    ring, other = unit_records(layout, scene)

    assert ring["kind"] == "ring"
    assert other["kind"] == "camera"
    assert "scans all round" in ring["title"]
    assert "scans all round" not in other["title"]


@given(st.floats(-720.0, 720.0), st.floats(-22.0, 22.0), st.floats(1.0, 60.0))
def test_nothing_beside_a_ring_is_out_of_its_view(
    azimuth_deg, elevation_deg, distance_m
):
    """At no azimuth, that of the seam included: what it does not detect is never to the
    side.
    """
    azimuth = math.radians(azimuth_deg)
    elevation = math.radians(elevation_deg)
    way = [
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    ]
    # The last two lie at the seam, where the angle jumps by a full turn.
    ways = np.array(
        [
            way,
            [-1.0, 0.0, 0.0],
            [-1.0, -0.0, 0.0],
        ]
    )
    points = PLACE + distance_m * ways
    turned = _unit(yaw_deg=math.remainder(azimuth_deg, 360.0))

    assert is_in_view(_unit(), points).all()
    assert is_in_view(turned, points).all()
