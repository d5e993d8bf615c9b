"""Places where runs end in an impact, and how many are avoided there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.figures.axes import NARROW_IN, root_figure, to_png
from experiments.figures.dangers import SHADES, find_places, plot_dangers
from placement.layout import Layout, load_carlancap_layout


@pytest.fixture
def layout():
    return Layout(name="two", units=load_carlancap_layout().units[:2])


def marks(axes, name):
    """Artists of a name."""
    return [artist for artist in axes.get_children() if artist.get_gid() == name]


def impacts(*points):
    """Runs that end at some places."""
    runs = [
        SimpleNamespace(vru_position_m=np.array([[9.0, 9.0], point]))
        for point in points
    ]
    return SimpleNamespace(runs=runs)


def test_impacts_within_six_metres_are_one_place():
    setting = impacts((0.0, 0.0), (20.0, 0.0), (3.0, 4.0), (20.0, 6.1))
    places = find_places(setting)

    assert [place.runs.tolist() for place in places] == [[0, 2], [1], [3]]
    assert places[0].position_m.tolist() == [1.5, 2.0]
    assert [place.runs.tolist() for place in find_places(impacts((1.0, 2.0)))] == [[0]]


def test_every_run_is_at_one_place_and_none_is_wide(small_setting):
    places = find_places(small_setting)
    rows = np.concatenate([place.runs for place in places])

    assert sorted(rows.tolist()) == list(range(small_setting.axis.n_runs))

    for place in places:
        points = [small_setting.runs[run].vru_position_m[-1] for run in place.runs]
        assert max(np.hypot(*(a - b)) for a in points for b in points) <= 6.0


def test_each_place_shows_its_share_by_weight_the_darker_the_more_is_left(
    small_setting, layout
):
    """Where all is avoided there is a mark without a number."""
    places = find_places(small_setting)
    weight = np.arange(1.0, small_setting.axis.n_runs + 1.0)
    axis = replace(small_setting.axis, weight=weight / weight.sum())
    setting = replace(small_setting, axis=axis)
    is_avoided = np.zeros(axis.n_runs, dtype=bool)
    is_avoided[places[0].runs] = True
    several = next((place for place in places[1:] if len(place.runs) > 1), None)
    expected = {"0"}
    if several is not None:
        is_avoided[several.runs[0]] = True
        share = axis.weight[several.runs[0]] / axis.weight[several.runs].sum()
        expected.add(f"{round(100.0 * share)}")
    axes = plot_dangers(setting, layout, is_avoided)

    assert len(marks(axes, "place")) == len(places)
    assert {text.get_text() for text in marks(axes, "share")} == expected
    assert len(marks(axes, "share")) == len(places) - 1

    colours = {tuple(mark.get_markerfacecolor()) for mark in marks(axes, "place")}
    assert {SHADES(0.0), SHADES(1.0)} <= colours
    assert len(marks(axes, "unit")) == 2


@pytest.mark.long
def test_places_that_do_not_count_are_left_out_and_a_narrow_figure_is_drawn(
    small_setting, layout
):
    places = find_places(small_setting)
    weight = np.ones(small_setting.axis.n_runs)
    weight[places[0].runs] = 0.0
    axis = replace(small_setting.axis, weight=weight / weight.sum())
    none = np.zeros(axis.n_runs, dtype=bool)
    axes = plot_dangers(
        replace(small_setting, axis=axis),
        layout,
        none,
        width_in=NARROW_IN,
    )

    assert len(marks(axes, "place")) == len(places) - 1
    assert root_figure(axes).get_figwidth() == NARROW_IN
    assert to_png(axes).startswith(b"\x89PNG")


def test_what_is_not_quite_none_or_all_is_not_shown_as_it(small_setting, layout):
    place = find_places(impacts(*[(0.0, 0.0)] * 1000))[0]
    axis = SimpleNamespace(weight=np.full(1000, 1e-3), n_runs=1000)
    setting = SimpleNamespace(scene=small_setting.scene, axis=axis)

    for n_avoided, text in (
        (0, "0"),
        (1, "1"),
        (999, "99"),
    ):
        axes = plot_dangers(
            setting,
            layout,
            np.arange(1000) < n_avoided,
            places=[place],
        )
        assert [mark.get_text() for mark in marks(axes, "share")] == [text]
