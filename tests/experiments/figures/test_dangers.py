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
    """The study's first two cameras."""
    units = load_carlancap_layout().units[:2]
    return Layout(name="two", units=units)


def marks(axes, name):
    """Artists of a name."""
    return [artist for artist in axes.get_children() if artist.get_gid() == name]


def texts(axes):
    """What is written at the places of a figure."""
    return [mark.get_text() for mark in marks(axes, "share")]


def rows_of(places):
    """Runs of each place, by their indices."""
    return [place.runs.tolist() for place in places]


def impacts(*points):
    """Runs that end at some places."""
    runs = []
    for point in points:
        way = np.array([[9.0, 9.0], point])
        runs.append(SimpleNamespace(vru_position_m=way))

    return SimpleNamespace(runs=runs)


def with_weights(setting, weight):
    """A setting whose runs have other weights."""
    axis = replace(setting.axis, weight=weight / weight.sum())
    return replace(setting, axis=axis)


def test_impacts_within_six_metres_are_one_place():
    """By the last frame of who is met, not by the first."""
    setting = impacts(
        (0.0, 0.0),
        (20.0, 0.0),
        (3.0, 4.0),
        (20.0, 6.1),
    )
    places = find_places(setting)
    alone = find_places(impacts((1.0, 2.0)))

    assert rows_of(places) == [[0, 2], [1], [3]]
    assert places[0].position_m.tolist() == [1.5, 2.0]
    assert rows_of(alone) == [[0]]


def test_every_run_is_at_one_place_and_none_is_wide(small_setting):
    """No two impacts of a place are more than 6 m apart."""
    places = find_places(small_setting)
    rows = np.concatenate([place.runs for place in places])
    everything = list(range(small_setting.axis.n_runs))

    assert sorted(rows.tolist()) == everything

    for place in places:
        ends = [small_setting.runs[run].vru_position_m[-1] for run in place.runs]
        points = np.array(ends)
        apart = points[:, None] - points
        apart_m = np.linalg.norm(apart, axis=-1)
        assert apart_m.max() <= 6.0


def test_each_place_shows_its_share_by_weight_the_darker_the_more_is_left(
    small_setting, layout
):
    """Where all is avoided there is a mark without a number."""
    first, *others = find_places(small_setting)
    weight = np.arange(1.0, small_setting.axis.n_runs + 1.0)
    setting = with_weights(small_setting, weight)
    is_avoided = np.zeros(setting.axis.n_runs, dtype=bool)
    is_avoided[first.runs] = True
    # Of one place with several runs, the first run is avoided.
    shared = [place.runs for place in others if len(place.runs) > 1]
    expected = {"0"}
    if shared:
        runs = shared[0]
        is_avoided[runs[0]] = True
        share = weight[runs[0]] / weight[runs].sum()
        expected.add(f"{round(100.0 * share)}")

    axes = plot_dangers(setting, layout, is_avoided)
    shown = marks(axes, "place")
    shares = texts(axes)

    assert len(shown) == 1 + len(others)
    assert set(shares) == expected
    assert len(shares) == len(others)

    colours = {tuple(mark.get_markerfacecolor()) for mark in shown}
    extremes = {SHADES(0.0), SHADES(1.0)}

    assert extremes <= colours
    assert len(marks(axes, "unit")) == 2


@pytest.mark.long
def test_places_that_do_not_count_are_left_out_and_a_narrow_figure_is_drawn(
    small_setting, layout
):
    places = find_places(small_setting)
    n_runs = small_setting.axis.n_runs
    weight = np.ones(n_runs)
    weight[places[0].runs] = 0.0
    none = np.zeros(n_runs, dtype=bool)

    axes = plot_dangers(
        with_weights(small_setting, weight),
        layout,
        none,
        width_in=NARROW_IN,
    )

    assert len(marks(axes, "place")) == len(places) - 1
    assert root_figure(axes).get_figwidth() == NARROW_IN
    assert to_png(axes).startswith(b"\x89PNG")


def test_what_is_not_quite_none_or_all_is_not_shown_as_it(small_setting, layout):
    """One of a thousand is not 0 %, and all but one are not 100 %."""
    n_runs = 1000
    points = [(0.0, 0.0)] * n_runs
    (place,) = find_places(impacts(*points))
    weight = np.full(n_runs, 1.0 / n_runs)
    axis = SimpleNamespace(weight=weight, n_runs=n_runs)
    setting = SimpleNamespace(scene=small_setting.scene, axis=axis)

    for n_avoided, text in (
        (0, "0"),
        (1, "1"),
        (999, "99"),
    ):
        is_avoided = np.arange(n_runs) < n_avoided
        axes = plot_dangers(
            setting,
            layout,
            is_avoided,
            places=[place],
        )
        assert texts(axes) == [text]
