"""The plan of a junction with units, and what of the ground they see."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path
from matplotlib.text import Text
from tiny_worlds import unit_at

from experiments.figures.axes import GREY, to_png
from experiments.figures.outlines import ground_footprint
from experiments.figures.plan import plot_plan
from geometry.catalogue import load_cameras
from geometry.notes import Note
from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import build_setting

CAMERA = load_cameras()["carla-ncap-rgb"]


def study_layout(n_units):
    """The first of the study's units, as a layout."""
    units = load_carlancap_layout().units[:n_units]
    return Layout(name="mine", units=units)


def lines_of(axes):
    """Lines of a figure by their names."""
    return {line.get_gid(): line for line in axes.get_lines()}


def texts_of(shown):
    """Texts of a figure or of a legend."""
    return [text.get_text() for text in shown.findobj(Text)]


@pytest.fixture(scope="module")
def setting():
    """The study's cases at its junction."""
    question = Question(cases="CPNC-50,CBNA,CBLA", along_arms="0")
    return build_setting(question, load_study_scene())


def is_inside(points_m, corners_m):
    """Whether points lie in a convex counter-clockwise polygon; and how near to its
    edge.
    """
    edges = np.roll(corners_m, -1, axis=0) - corners_m
    lengths = np.linalg.norm(edges, axis=-1)
    is_edge = lengths > 1e-9
    edges = edges[is_edge]
    starts = corners_m[is_edge]
    inwards = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    normals = inwards / lengths[is_edge, None]

    # How far each point is to the left of each edge.
    ways = points_m[:, None] - starts
    left_m = (ways * normals).sum(axis=2)
    return left_m.min(axis=1)


@given(
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-85.0, 40.0),
    height_m=st.floats(2.0, 12.0),
    max_range_m=st.floats(5.0, 60.0),
)
def test_footprint_holds_exactly_the_ground_that_projects_into_the_image(
    yaw_deg, pitch_deg, height_m, max_range_m
):
    """Random places are inside where the camera projects them into its image."""
    # Somewhere: a footprint moves along with its unit.
    place_m = [3.0, -4.0, height_m]
    unit = unit_at(
        "u",
        place_m,
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    corners = ground_footprint(unit, max_range_m=max_range_m)

    rng = np.random.default_rng(0)
    away_m = rng.uniform(-1.1, 1.1, (400, 2)) * max_range_m
    points = place_m[:2] + away_m
    ground = np.column_stack([points, np.zeros(400)])
    pixels = project_points(ground, unit.pose, CAMERA)
    column, row, depth = pixels.T
    range_m = np.linalg.norm(away_m, axis=-1)
    seen = (
        (depth > 0.0)
        & (column >= 0.0)
        & (column <= CAMERA.width_px)
        & (row >= 0.0)
        & (row <= CAMERA.height_px)
        & (range_m <= max_range_m)
    )

    if len(corners) == 0:
        assert not seen.any()
        return

    inside = is_inside(points, corners)
    # The disc is a polygon of 180 corners: 0.02 % too small at most.
    clear = np.abs(inside) > 1e-3 * max_range_m
    is_drawn = inside > 0.0

    np.testing.assert_array_equal(is_drawn[clear], seen[clear])


def test_footprint_is_empty_above_the_horizon():
    unit = unit_at("u", pitch_deg=80.0)
    assert ground_footprint(unit, max_range_m=50.0).shape == (0, 2)


@pytest.mark.long
def test_plan_marks_every_unit_at_its_position(setting):
    """Its name points there, too."""
    layout = load_carlancap_layout()
    axes = plot_plan(setting, layout)
    marks = lines_of(axes)
    # Names are annotations: they have the place that they belong to.
    names = {text.get_text(): text for text in axes.texts}

    for unit in layout.units:
        place_m = unit.pose.position_m[:2]
        mark = marks[f"unit:{unit.id}"]
        np.testing.assert_array_equal(np.ravel(mark.get_data()), place_m)
        np.testing.assert_array_equal(names[unit.id].xy, place_m)


def test_plan_draws_other_layouts_but_labels_only_its_own(setting):
    """Marks of others are open."""
    baseline = load_carlancap_layout()
    axes = plot_plan(setting, study_layout(2), others=[baseline])
    open_marks = []
    for line in axes.get_lines():
        is_open = line.get_markerfacecolor() == "white"
        if is_open and isinstance(line.get_marker(), Path):
            open_marks.append(line)

    assert len(open_marks) == 12
    assert not {"RSU2", "RSU11"} & set(texts_of(axes))

    entries = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "the study's 12 cameras (carlancap-12): camera" in entries


def test_existing_units_are_grey_on_the_plan(setting):
    """And the legend says why."""
    axes = plot_plan(setting, study_layout(2), existing=["RSU1"])
    marks = lines_of(axes)
    existing = marks["unit:RSU1"]
    new = marks["unit:RSU0"]

    assert existing.get_markerfacecolor() == GREY
    assert new.get_markerfacecolor() != GREY

    words = texts_of(axes.get_legend())
    assert "existing: mounted already" in words


def test_plan_is_in_metres_north_up_around_the_junction(setting):
    axes = plot_plan(setting, load_carlancap_layout(), half_size_m=45.0)
    assert axes.get_aspect() == 1.0

    for limits, column in (
        (axes.get_xlim(), 0),
        (axes.get_ylim(), 1),
    ):
        outline = setting.scene.outline_m[:, column]
        low, high = limits
        assert high - low == pytest.approx(90.0)
        assert low < outline.min() < outline.max() < high

    assert "N" in texts_of(axes)


@pytest.mark.long
def test_plan_draws_a_scene_with_nothing_in_it(setting):
    bare = replace(setting.scene, lanes=(), sites=())
    nothing = replace(setting, scene=bare)
    axes = plot_plan(nothing, load_carlancap_layout())
    picture = to_png(axes)

    assert picture.startswith(b"\x89PNG")


def test_the_tip_of_a_camera_points_where_it_looks(setting):
    """The first corner of the mark is its tip."""
    layout = study_layout(4)
    axes = plot_plan(setting, layout)
    lines = lines_of(axes)

    for unit in layout.units:
        outline = lines[f"unit:{unit.id}"].get_marker()
        east, north = outline.vertices[0]
        yaw_deg = np.degrees(np.arctan2(north, east))
        np.testing.assert_allclose(yaw_deg, unit.pose.yaw_deg)


def test_two_units_on_a_pole_are_two_arrows_from_it(setting):
    """Those that look the same way stand in a row; a third looks the other way."""
    first = load_carlancap_layout().units[0]
    units = []
    for i, yaw_deg in enumerate((0.0, 5.0, 180.0)):
        pose = replace(first.pose, yaw_deg=yaw_deg)
        units.append(replace(first, id=f"U{i}", pose=pose))

    axes = plot_plan(setting, Layout(name="mine", units=tuple(units)))
    lines = lines_of(axes)
    ends = []  # of the darts, east of the pole in points
    for i in range(3):
        dart = lines[f"unit:U{i}"]
        outline = dart.get_marker().vertices
        scale = 0.5 * dart.get_markersize() / np.abs(outline).max()
        ends.append(scale * outline[:, 0])

    first_end, second_end, third_end = ends

    # East of the pole, and the last one west of it.
    assert first_end.min() >= 0.0
    assert third_end.max() <= 1e-9
    # Before the first one, which looks there, too.
    assert second_end.max() > 1.5 * first_end.max()
    assert {"U0, U1", "U2"} <= set(texts_of(axes))


def test_assumed_sites_and_arms_are_named(setting):
    unit = load_carlancap_layout().units[0]
    note = Note(
        what="a mast",
        why="none in the map",
        kind="sites",
        site_ids=(unit.site_id,),
    )
    scene = replace(setting.scene, notes=(note,))
    layout = Layout(name="mine", units=(replace(unit, id="U1"),))
    noted = replace(setting, scene=scene)
    axes = plot_plan(noted, layout)
    texts = set(texts_of(axes))
    legend = texts_of(axes.get_legend())

    assert {"U1 (assumed)", "north arm", "west arm"} <= texts
    assert "assumed site: not mapped there" in legend
