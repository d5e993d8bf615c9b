from dataclasses import replace

import numpy as np
import pytest
from made_verdicts import made_verdict

from experiments.figures.axes import to_png
from experiments.parts.margins import MAX_COLUMNS, plot_margins


@pytest.fixture
def axis(frame_axis):
    return replace(
        frame_axis,
        cases=("$A_{", "_B", "$A_{"),
        approaches=("north", "_south$", "north"),
        last_brake_time_s=np.array([-0.1, -0.2, -1.0]),
    )


def marks(axes, *, is_filled):
    """Margins in milliseconds of the marks in data coordinates, and how many lie at the
    edge.
    """
    places = []
    n_edge = 0
    for line in axes.get_lines():
        is_white = line.get_markerfacecolor() == "white"
        if line.get_linestyle() != "None" or is_white == is_filled:
            continue
        if line.get_transform() == axes.get_yaxis_transform():
            n_edge += len(line.get_xdata())
        else:
            places += np.asarray(line.get_xdata()).tolist()
    return sorted(places), n_edge


def test_every_run_has_one_mark_where_its_margin_is(axis):
    (axes,) = plot_margins([("all", made_verdict(axis, [-0.6, 0.3, np.inf]))], axis)
    places, n_edge = marks(axes, is_filled=True)
    assert places == pytest.approx([500.0])
    assert n_edge == 0
    places, n_edge = marks(axes, is_filled=False)
    assert places == pytest.approx([-500.0])
    assert n_edge == 1
    low_ms, high_ms = axes.get_xlim()
    assert low_ms < -500.0 < 500.0 < high_ms
    assert "too late" in [text.get_text() for text in axes.texts]


def test_runs_without_weight_are_not_drawn(axis):
    axis = replace(axis, weight=np.array([0.0, 1.0, 0.0]))
    (axes,) = plot_margins([("all", made_verdict(axis, [-0.6, -0.3, np.inf]))], axis)
    assert marks(axes, is_filled=True) == (pytest.approx([100.0]), 0)
    assert marks(axes, is_filled=False) == ([], 0)


def test_panels_share_their_scale_and_names_are_drawn_letter_by_letter(axis):
    parties = [
        ("$\\bad{", made_verdict(axis, [-0.6, 0.3, np.inf])),
        ("_hidden", made_verdict(axis, [-9.0, -8.0, -7.0])),
    ]
    panels = plot_margins(parties, axis)
    assert len({panel.get_xlim() for panel in panels}) == 1
    assert panels[0].get_xlim()[1] > 8900.0
    assert panels[0].get_title() == "\\$\\bad{\n1 of 3 avoided"
    assert panels[1].get_title() == " _hidden\n3 of 3 avoided"
    (legend,) = panels[0].get_figure(root=True).legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "from: north",
        "from: _south\\$",
        "hollow: not avoided",
    ]
    assert to_png(panels[0].get_figure(root=True)).startswith(b"\x89PNG")


@pytest.mark.filterwarnings("error")
def test_the_most_columns_and_many_directions_fit(axis):
    n = 9
    wide = replace(
        axis,
        run_ids=tuple(f"r{i}" for i in range(n)),
        cases=tuple(f"case-{i // 3}" for i in range(n)),
        approaches=tuple(
            f"arm {i} of a long name that is told in full" for i in range(n)
        ),
        weathers=("day",) * n,
        vut_speed_kmh=np.full(n, 30.0),
        weight=np.full(n, 1.0 / n),
        last_brake_time_s=np.full(n, -0.5),
        run_start=np.arange(n + 1),
        time_s=np.zeros(n),
        positions=("0",) * n,
    )
    never = made_verdict(wide, np.full(n, np.inf))
    panels = plot_margins([("x" * 40, never)] * MAX_COLUMNS, wide)
    assert to_png(panels[0].get_figure(root=True)).startswith(b"\x89PNG")
    assert marks(panels[-1], is_filled=False) == ([], n)
