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
from geometry.maps.opendrive.roads import Offset, Road, read_road

_ONE_LANE = section(right=[lane(-1, width=3.0)])
_CURVATURE = st.floats(-0.2, 0.2)


def _road(text: str, offset: Offset | None = None) -> Road:
    return read_road(ET.fromstring(text), "made.xodr", offset or Offset())


def _line(
    shape: str, length: float, s: np.ndarray, **start: float
) -> tuple[np.ndarray, ...]:
    plan = geometry(shape, length=length, **start)
    return _road(road(plan=plan, length=length)).line.at(s)


def _integrated(heading, s: float) -> np.ndarray:
    along = quad(lambda u: np.cos(heading(u)), 0.0, s, limit=400)[0]
    across = quad(lambda u: np.sin(heading(u)), 0.0, s, limit=400)[0]
    return np.array([along, across])


def test_an_arc_lies_on_its_circle():
    s = np.linspace(0.0, 30.0, 7)
    points, heading = _line('<arc curvature="0.1"/>', 30.0, s)
    assert_allclose(np.hypot(*(points - [0.0, 10.0]).T), 10.0)
    assert_allclose(heading, 0.1 * s)


def test_an_arc_starts_where_and_as_its_record_says():
    points, heading = _line(
        '<arc curvature="-0.05"/>', 30.0, np.array([0.0]), x=3.0, y=4.0, hdg=1.0
    )
    assert_allclose(points, [[3.0, 4.0]])
    assert_allclose(heading, [1.0])


@given(start=_CURVATURE, end=_CURVATURE, length=st.floats(0.5, 80.0))
def test_a_spiral_is_what_integrating_its_heading_gives(start, end, length):
    shape = f'<spiral curvStart="{start!r}" curvEnd="{end!r}"/>'
    points, heading = _line(shape, length, np.array([0.0, 0.6 * length, length]))

    def turned(u):
        return start * u + 0.5 * (end - start) / length * u * u

    assert_allclose(points[1], _integrated(turned, 0.6 * length), atol=1e-6)
    assert_allclose(points[2], _integrated(turned, length), atol=1e-6)
    assert_allclose(heading[2], turned(length), atol=1e-9)


@pytest.mark.parametrize("change", [1e-15, 1e-12, 1e-9, 1e-7, 1e-5])
def test_a_spiral_that_hardly_bends_more_than_an_arc_is_as_exact(change):
    shape = f'<spiral curvStart="0.01" curvEnd="{0.01 + change!r}"/>'
    points, _ = _line(shape, 100.0, np.array([100.0]))
    expected = _integrated(lambda u: 0.01 * u + 0.5 * change / 100.0 * u * u, 100.0)
    assert_allclose(points[0], expected, atol=1e-6)


def test_both_ranges_of_a_parametric_cubic_draw_the_same_curve():
    coefficients = np.array([0.0, 1.0, 0.001, -1e-4, 0.0, 0.0, 0.02, 1e-4])
    powers = 20.0 ** np.array([0, 1, 2, 3, 0, 1, 2, 3])
    keys = ["aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"]
    s = np.linspace(0.0, 20.0, 9)
    drawn = [
        _line(
            "<paramPoly3 "
            + " ".join(
                f'{key}="{value!r}"'
                for key, value in zip(keys, map(float, k), strict=True)
            )
            + f' pRange="{p_range}"/>',
            20.0,
            s,
        )
        for k, p_range in (
            (coefficients, "arcLength"),
            (coefficients * powers, "normalized"),
        )
    ]
    u = s + 0.001 * s**2 - 1e-4 * s**3
    v = 0.02 * s**2 + 1e-4 * s**3
    assert_allclose(drawn[0][0], np.stack([u, v], axis=1), atol=1e-9)
    assert_allclose(drawn[0][0], drawn[1][0], atol=1e-9)
    assert_allclose(drawn[0][1], drawn[1][1], atol=1e-9)


def test_a_parametric_cubic_without_range_is_normalized():
    shape = '<paramPoly3 aU="0" bU="20" cU="0" dU="0" aV="0" bV="0" cV="4" dV="0"/>'
    points, heading = _line(shape, 21.0, np.array([21.0]))
    assert_allclose(points, [[20.0, 4.0]])
    assert_allclose(heading, np.arctan2(8.0, 20.0))


def test_a_parametric_cubic_that_starts_standing_still_looks_where_it_goes():
    shape = '<paramPoly3 aU="0" bU="0" cU="10" dU="0" aV="0" bV="0" cV="10" dV="0"/>'
    _, heading = _line(shape, 14.0, np.array([0.0]))
    assert_allclose(heading, np.pi / 4)


def test_a_cubic_over_its_own_axis_is_measured_along_the_curve():
    points, heading = _line(
        '<poly3 a="0" b="0.75" c="0" d="0"/>', 10.0, np.array([5.0, 10.0])
    )
    assert_allclose(points, [[4.0, 3.0], [8.0, 6.0]], atol=1e-6)
    assert_allclose(heading, np.arctan(0.75))


def test_where_two_pieces_meet_the_later_one_holds():
    plan = geometry(length=10.0) + geometry(
        '<arc curvature="0.1"/>', s=10.0, x=10.0, length=10.0, hdg=0.5
    )
    line = _road(road(plan=plan, length=20.0)).line
    _, heading = line.at(np.array([10.0, 10.0]), np.array([9.0, 11.0]))
    assert_allclose(heading, [0.0, 0.5])


def test_a_piece_of_no_length_is_passed_over():
    plan = geometry(length=0.0, hdg=2.0) + geometry(
        '<arc curvature="0.1"/>', length=20.0
    )
    assert len(_road(road(plan=plan, length=20.0)).line.starts_m) == 1


def test_the_header_moves_and_turns_a_road():
    offset = Offset(x_m=1000.0, y_m=2000.0, z_m=30.0, heading_rad=np.pi / 2)
    moved = _road(
        road(plan=geometry(x=5.0), elevation=cubic("elevation", 0.0, 2.0, 0.1)), offset
    )
    points, heading = moved.place(np.array([10.0]), np.array([1.0]))
    assert_allclose(points, [[999.0, 2015.0, 33.0]])
    assert_allclose(heading, np.pi / 2)


@given(
    start=_CURVATURE,
    end=_CURVATURE,
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
        sections=_ONE_LANE,
    )
    (sampled,) = sample_road(_road(text))
    points = sampled.points_m[:, :2]
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert steps.max() <= 5.0 + 1e-6
    assert np.isclose(steps.sum(), length, rtol=5e-3, atol=1e-3)
    for t_m in (sampled.lanes[-1].inner_m, sampled.lanes[-1].outer_m):
        edge = sampled.points_at(t_m)[:, :2]
        assert_allclose(np.hypot(*(edge - points).T), np.abs(t_m), atol=1e-9)
        assert np.hypot(*np.diff(edge, axis=0).T).max() <= 5.0 + 1e-6
        line = _road(text).line
        between = 0.5 * (sampled.s_m[1:] + sampled.s_m[:-1])
        on_line, heading = line.at(between)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        curve = on_line + t_m[:1] * left
        chord = edge[1:] - edge[:-1]
        distance = np.abs(
            chord[:, 0] * (curve - edge[:-1])[:, 1]
            - chord[:, 1] * (curve - edge[:-1])[:, 0]
        ) / np.maximum(np.hypot(*chord.T), 1e-9)
        assert distance.max() <= 0.03


def test_edges_are_the_offset_and_the_widths_added_up():
    text = road(
        offset=cubic("laneOffset", 0.0, 1.0) + cubic("laneOffset", 40.0, 1.0, 0.05),
        sections=section(
            left=[
                lane(
                    1,
                    width=cubic("width", 0.0, 3.0)
                    + cubic("width", 50.0, 3.0, 0.02, 0.001),
                )
            ],
            right=[lane(-2, width=2.0), lane(-1, width=3.5)],
        ),
    )
    (sampled,) = sample_road(_road(text))
    s = sampled.s_m
    center = 1.0 + np.where(s > 40.0, 0.05 * (s - 40.0), 0.0)
    width = 3.0 + np.where(s > 50.0, 0.02 * (s - 50.0) + 0.001 * (s - 50.0) ** 2, 0.0)
    assert_allclose(sampled.lanes[1].inner_m, center)
    assert_allclose(sampled.lanes[1].outer_m, center + width)
    assert_allclose(sampled.lanes[-1].outer_m, center - 3.5)
    assert_allclose(sampled.lanes[-2].inner_m, center - 3.5)
    assert_allclose(sampled.lanes[-2].outer_m, center - 5.5)
    assert_allclose(sampled.lanes[-2].width_m, 2.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_borders_are_edges_whichever_sign_is_used_on_the_right(sign):
    borders = [
        lane(-1, width=cubic("border", 0.0, sign * 3.0)),
        lane(-2, width=cubic("border", 0.0, sign * 5.0)),
    ]
    left = [lane(1, width=cubic("border", 0.0, 4.0))]
    (sampled,) = sample_road(_road(road(sections=section(left=left, right=borders))))
    assert_allclose(sampled.lanes[-1].outer_m, -3.0)
    assert_allclose(sampled.lanes[-2].width_m, 2.0)
    assert_allclose(sampled.lanes[1].outer_m, 4.0)


def test_widths_hold_where_a_lane_has_borders_too():
    both = cubic("width", 0.0, 3.0) + cubic("border", 0.0, -9.0)
    (sampled,) = sample_road(
        _road(road(sections=section(right=[lane(-1, width=both)])))
    )
    assert_allclose(sampled.lanes[-1].outer_m, -3.0)


def test_a_jump_of_the_offset_between_sections_belongs_to_the_later_one():
    text = road(
        offset=cubic("laneOffset", 0.0, 0.0) + cubic("laneOffset", 50.0, 3.5),
        sections=section(right=[lane(-1, after=-2)])
        + section(s=50.0, right=[lane(-1), lane(-2, before=-1)]),
    )
    before, after = sample_road(_road(text))
    assert_allclose(before.lanes[-1].inner_m, 0.0)
    assert_allclose(after.lanes[-2].inner_m, 0.0)
