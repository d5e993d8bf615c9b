"""Reference lines, offsets and widths against closed forms and fine integration."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from opendrive_text import cubic, geometry, lane, road, section
from scipy.integrate import quad

from geometry.maps.opendrive.lanes import sample_road
from geometry.maps.opendrive.roads import Offset, read_road

CURVATURE = st.floats(-0.2, 0.2)


def read(text, **offset):
    """A road of a text."""
    return read_road(ET.fromstring(text), "made.xodr", Offset(**offset))


def line(shape, length, s, **start):
    """Points and headings of a shape at distances along it."""
    plan = geometry(shape, length=length, **start)
    found = read(road(plan=plan, length=length))
    return found.line.at(np.array(s))


def sampled(**about):
    """The only section of a road, sampled."""
    (section_of_road,) = sample_road(read(road(**about)))
    return section_of_road


def parametric(u, v, p_range=""):
    """A parametric cubic with coefficients a, b, c and d along and across."""
    told = ""
    for axis, numbers in (("U", u), ("V", v)):
        for power, number in zip("abcd", numbers, strict=True):
            told += f'{power}{axis}="{number}" '
    return f"<paramPoly3 {told} {p_range}/>"


def integrated(heading, s):
    """Place at a distance along a line that begins at (0, 0), by integration."""
    along, _ = quad(lambda u: np.cos(heading(u)), 0.0, s, limit=400)
    across, _ = quad(lambda u: np.sin(heading(u)), 0.0, s, limit=400)
    return np.array([along, across])


def test_an_arc_lies_on_its_circle():
    s = np.linspace(0.0, 30.0, 7)
    points, heading = line('<arc curvature="0.1"/>', 30.0, s)

    assert_allclose(np.linalg.norm(points - [0.0, 10.0], axis=-1), 10.0)
    assert_allclose(heading, 0.1 * s)


def test_an_arc_starts_where_and_as_its_record_says():
    start = {"x": 3.0, "y": 4.0, "hdg": 1.0}
    points, heading = line('<arc curvature="-0.05"/>', 30.0, [0.0], **start)

    assert_allclose(points, [[3.0, 4.0]])
    assert_allclose(heading, [1.0])


@given(start=CURVATURE, end=CURVATURE, length=st.floats(0.5, 80.0))
def test_a_spiral_is_what_integrating_its_heading_gives(start, end, length):
    shape = f'<spiral curvStart="{start!r}" curvEnd="{end!r}"/>'
    points, heading = line(shape, length, [0.0, 0.6 * length, length])

    def turned(u):
        return start * u + 0.5 * (end - start) / length * u * u

    assert_allclose(points[1], integrated(turned, 0.6 * length), atol=1e-6)
    assert_allclose(points[2], integrated(turned, length), atol=1e-6)
    assert_allclose(heading[2], turned(length), atol=1e-9)


@pytest.mark.parametrize("change", [1e-15, 1e-12, 1e-9, 1e-7, 1e-5])
def test_a_spiral_that_hardly_bends_more_than_an_arc_is_as_exact(change):
    shape = f'<spiral curvStart="0.01" curvEnd="{0.01 + change!r}"/>'
    points, _ = line(shape, 100.0, [100.0])

    def turned(u):
        return 0.01 * u + 0.5 * change / 100.0 * u * u

    expected = integrated(turned, 100.0)
    assert_allclose(points[0], expected, atol=1e-6)


def test_both_ranges_of_a_parametric_cubic_draw_the_same_curve():
    s = np.linspace(0.0, 20.0, 9)
    by_length = parametric(
        (0.0, 1.0, 0.001, -0.0001), (0.0, 0.0, 0.02, 0.0001), 'pRange="arcLength"'
    )
    # The same with a parameter that is 1 at 20 m.
    by_share = parametric(
        (0.0, 20.0, 0.4, -0.8), (0.0, 0.0, 8.0, 0.8), 'pRange="normalized"'
    )
    points, heading = line(by_length, 20.0, s)
    points_too, heading_too = line(by_share, 20.0, s)
    u = s + 0.001 * s**2 - 1e-4 * s**3
    v = 0.02 * s**2 + 1e-4 * s**3

    assert_allclose(points, np.stack([u, v], axis=1), atol=1e-9)
    assert_allclose(points_too, points, atol=1e-9)
    assert_allclose(heading_too, heading, atol=1e-9)


def test_a_parametric_cubic_without_range_is_normalized():
    points, heading = line(
        parametric((0.0, 20.0, 0.0, 0.0), (0.0, 0.0, 4.0, 0.0)), 21.0, [21.0]
    )
    assert_allclose(points, [[20.0, 4.0]])
    assert_allclose(heading, np.arctan2(8.0, 20.0))


def test_a_parametric_cubic_that_starts_standing_still_looks_where_it_goes():
    _, heading = line(
        parametric((0.0, 0.0, 10.0, 0.0), (0.0, 0.0, 10.0, 0.0)), 14.0, [0.0]
    )
    assert_allclose(heading, np.pi / 4)


def test_a_cubic_over_its_own_axis_is_measured_along_the_curve():
    shape = '<poly3 a="0" b="0.75" c="0" d="0"/>'
    points, heading = line(shape, 10.0, [5.0, 10.0])

    assert_allclose(points, np.array([[4.0, 3.0], [8.0, 6.0]]), atol=1e-6)
    assert_allclose(heading, np.arctan(0.75))


def test_where_two_pieces_meet_the_later_one_holds():
    before = geometry(length=10.0)
    after = geometry('<arc curvature="0.1"/>', s=10.0, x=10.0, length=10.0, hdg=0.5)
    joined = read(road(plan=before + after, length=20.0)).line
    at_m = np.array([10.0, 10.0])
    of_piece_at_m = np.array([9.0, 11.0])
    _, heading = joined.at(at_m, of_piece_at_m)

    assert_allclose(heading, [0.0, 0.5])


def test_a_piece_of_no_length_is_passed_over():
    empty = geometry(length=0.0, hdg=2.0)
    arc = geometry('<arc curvature="0.1"/>', length=20.0)
    found = read(road(plan=empty + arc, length=20.0))

    assert len(found.line.starts_m) == 1


def test_the_header_moves_and_turns_a_road():
    offset = {"x_m": 1000.0, "y_m": 2000.0, "z_m": 30.0, "heading_rad": np.pi / 2}
    climb = cubic("elevation", 0.0, 2.0, 0.1)
    moved = read(road(plan=geometry(x=5.0), elevation=climb), **offset)
    (point,), heading = moved.place(np.array([10.0]), np.ones(1))

    assert_allclose(point, [999.0, 2015.0, 33.0])
    assert_allclose(heading, np.pi / 2)


@given(
    start=CURVATURE,
    end=CURVATURE,
    length=st.floats(5.0, 120.0),
    offset=st.floats(-4.0, 4.0),
    kind=st.sampled_from(["arc", "spiral"]),
)
def test_samples_follow_the_line_closely_and_keep_their_distance(
    start, end, length, offset, kind
):
    if kind == "arc":
        shape = f'<arc curvature="{start!r}"/>'
    else:
        shape = f'<spiral curvStart="{start!r}" curvEnd="{end!r}"/>'
    text = road(
        plan=geometry(shape, length=length),
        length=length,
        offset=cubic("laneOffset", 0.0, offset),
        sections=section(right=[lane(-1, width=3.0)]),
    )
    read_back = read(text)
    (samples,) = sample_road(read_back)
    points = samples.points_m[:, :2]
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=-1)

    assert steps_m.max() <= 5.0 + 1e-6
    assert np.isclose(steps_m.sum(), length, rtol=5e-3, atol=1e-3)

    between = 0.5 * (samples.s_m[1:] + samples.s_m[:-1])
    on_line, heading = read_back.line.at(between)
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)

    right = samples.lanes[-1]
    for t_m in (right.inner_m, right.outer_m):
        edge = samples.points_at(t_m)[:, :2]
        assert_allclose(np.linalg.norm(edge - points, axis=-1), np.abs(t_m), atol=1e-9)

        chord = np.diff(edge, axis=0)
        chord_m = np.linalg.norm(chord, axis=-1)

        assert chord_m.max() <= 5.0 + 1e-6

        away = on_line + t_m[:1] * left - edge[:-1]
        areas = np.abs(np.linalg.det(np.stack([chord, away], axis=1)))
        off_m = areas / np.maximum(chord_m, 1e-9)

        assert off_m.max() <= 0.03


def test_edges_are_the_offset_and_the_widths_added_up():
    widths = cubic("width", 0.0, 3.0) + cubic("width", 50.0, 3.0, 0.02, 0.001)
    right = [lane(-2, width=2.0), lane(-1)]
    samples = sampled(
        offset=(cubic("laneOffset", 0.0, 1.0) + cubic("laneOffset", 40.0, 1.0, 0.05)),
        sections=section(left=[lane(1, width=widths)], right=right),
    )
    s = samples.s_m
    after_40_m = np.maximum(s - 40.0, 0.0)
    after_50_m = np.maximum(s - 50.0, 0.0)
    center = 1.0 + 0.05 * after_40_m
    width = 3.0 + 0.02 * after_50_m + 0.001 * after_50_m**2

    left = samples.lanes[1]
    assert_allclose(left.inner_m, center)
    assert_allclose(left.outer_m, center + width)
    assert_allclose(samples.lanes[-1].outer_m, center - 3.5)

    outer = samples.lanes[-2]
    assert_allclose(outer.inner_m, center - 3.5)
    assert_allclose(outer.outer_m, center - 5.5)
    assert_allclose(outer.width_m, 2.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_borders_are_edges_whichever_sign_is_used_on_the_right(sign):
    inner = lane(-1, width=cubic("border", 0.0, sign * 3.0))
    outer = lane(-2, width=cubic("border", 0.0, sign * 5.0))
    left = lane(1, width=cubic("border", 0.0, 4.0))
    samples = sampled(sections=section(left=[left], right=[inner, outer]))

    assert_allclose(samples.lanes[-1].outer_m, -3.0)
    assert_allclose(samples.lanes[-2].width_m, 2.0)
    assert_allclose(samples.lanes[1].outer_m, 4.0)


def test_widths_hold_where_a_lane_has_borders_too():
    both = cubic("width", 0.0, 3.0) + cubic("border", 0.0, -9.0)
    samples = sampled(sections=section(right=[lane(-1, width=both)]))
    assert_allclose(samples.lanes[-1].outer_m, -3.0)


def test_a_jump_of_the_offset_between_sections_belongs_to_the_later_one():
    offset = cubic("laneOffset", 0.0, 0.0) + cubic("laneOffset", 50.0, 3.5)
    first = section(right=[lane(-1, after=-2)])
    second = section(right=[lane(-1), lane(-2, before=-1)], s=50.0)
    text = road(offset=offset, sections=first + second)
    before, after = sample_road(read(text))

    assert_allclose(before.lanes[-1].inner_m, 0.0)
    assert_allclose(after.lanes[-2].inner_m, 0.0)
