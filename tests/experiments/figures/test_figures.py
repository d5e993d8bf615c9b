"""Heatmaps of evaluations: cells, marks, words; and names that can be drawn."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from made_verdicts import made_evaluation
from matplotlib.axes import Axes

from experiments.figures.axes import describe_run, to_png, unit_labels
from experiments.figures.evaluation import plot_heatmaps
from placement.evaluation import Verdict

matplotlib.use("agg")
RED = "#CC0000"


def build_evaluation(axis, *, name="mine", ids=("RSU0", "RSU1"), seed=0):
    """Random detections and verdicts that need not belong together."""
    rng = np.random.default_rng(seed)

    def verdict():
        confirmation = rng.choice([np.inf, -0.1, -0.2], axis.n_runs)
        detected = rng.random(axis.n_frames) < 0.5
        is_avoided = rng.random(axis.n_runs) < 0.5
        return Verdict(
            detected=detected,
            confirmation_time_s=confirmation,
            onset_time_s=confirmation,
            is_avoided=is_avoided,
        )

    made = made_evaluation(
        axis,
        verdict(),
        name=name,
        ids=ids,
        vut=verdict(),
        vut_and_rsus=verdict(),
    )
    return replace(made, units={unit_id: verdict() for unit_id in ids})


@pytest.fixture
def evaluation(frame_axis):
    """Three runs, of which no braking avoids the last one."""
    return build_evaluation(frame_axis)


def texts(figure):
    """All that is written in a figure."""
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text)]


def heatmap(evaluation, run_index):
    """The only panel of a run."""
    (panel,) = plot_heatmaps(evaluation, [run_index])
    return panel


def rows_of(evaluation):
    """What the rows of a heatmap show, from above."""
    return [evaluation.vut, *evaluation.units.values(), evaluation.rsu_all]


def brake_lines(axes):
    """Lines at the last brake time: one, or none where no braking helps."""
    lines = axes.get_lines()
    return [line for line in lines if line.get_gid() == "last brake time"]


def test_heatmap_cells_are_the_detections(evaluation):
    rows = rows_of(evaluation)
    panels = plot_heatmaps(evaluation, [0, 1, 2])

    for run_index, axes in enumerate(panels):
        (image,) = axes.get_images()
        cells = np.asarray(image.get_array())
        frames = evaluation.axis.frames_of(run_index)
        detected = [row.detected[frames] for row in rows]
        np.testing.assert_array_equal(cells, detected)

        labels = [label.get_text() for label in axes.get_yticklabels()]
        assert labels == ["VUT", "RSU0", "RSU1", "all RSUs"]


def test_heatmap_cells_are_centred_on_their_frames(evaluation):
    """Cells reach half a frame to both sides, and half a row up and down."""
    for run_index in range(evaluation.axis.n_runs):
        axes = heatmap(evaluation, run_index)
        frames = evaluation.axis.frames_of(run_index)
        times = evaluation.axis.time_s[frames]
        (image,) = axes.get_images()
        left, right, bottom, top = image.get_extent()
        edges = np.linspace(left, right, len(times) + 1)
        middles = 0.5 * (edges[1:] + edges[:-1])

        np.testing.assert_allclose(middles, times, atol=1e-12)
        assert bottom == 3.5
        assert top == -0.5


def test_heatmap_draws_the_last_brake_time_as_a_dashed_red_line(evaluation):
    last_brake_time_s = evaluation.axis.last_brake_time_s[:2]

    for run_index, last_brake_s in enumerate(last_brake_time_s):
        axes = heatmap(evaluation, run_index)
        (line,) = brake_lines(axes)

        assert list(line.get_xdata()) == [last_brake_s] * 2
        assert line.get_color() == RED
        assert line.is_dashed()


def test_heatmap_says_so_where_no_braking_helps(evaluation):
    # The last brake time of this run is minus infinity.
    axes = heatmap(evaluation, 2)
    words = texts(axes.figure)

    assert not brake_lines(axes)
    assert any("any braking is too late" in text for text in words)


def test_heatmap_marks_confirmations_and_names_outcomes(evaluation):
    """At the right, a word for each row."""
    rows = rows_of(evaluation)

    for run_index in range(evaluation.axis.n_runs):
        axes = heatmap(evaluation, run_index)
        (marks,) = [line for line in axes.get_lines() if line.get_marker() == "D"]
        times = [row.confirmation_time_s[run_index] for row in rows]
        assert list(marks.get_xdata()) == times

        (outcomes,) = axes.child_axes
        labels = outcomes.get_yticklabels()
        for label, row in zip(labels, rows, strict=True):
            expected = outcome_of(evaluation, row, run_index)
            assert label.get_text() == expected


def outcome_of(evaluation, row, run_index):
    """What became of a run by one row's detections, in words."""
    frames = evaluation.axis.frames_of(run_index)
    if row.is_avoided[run_index]:
        return "avoided"
    if not row.detected[frames].any():
        return "never seen"
    if np.isfinite(row.confirmation_time_s[run_index]):
        return "too late"
    return "never confirmed"


def test_a_heatmap_names_tracks_that_were_lost_again(evaluation):
    """Confirmed, but without an onset of braking."""
    late = evaluation.rsu_all
    is_confirmed = np.isfinite(late.confirmation_time_s)
    too_late = np.flatnonzero(is_confirmed & ~late.is_avoided)
    run_index = int(too_late[0])
    onset = late.onset_time_s.copy()
    onset[run_index] = np.inf
    lost = replace(late, onset_time_s=onset)

    axes = heatmap(replace(evaluation, rsu_all=lost), run_index)
    (outcomes,) = axes.child_axes
    last = outcomes.get_yticklabels()[-1]

    assert last.get_text() == "lost again"


@pytest.mark.long
def test_figures_are_the_same_bytes_each_time(evaluation):
    first = to_png(heatmap(evaluation, 0))
    again = to_png(heatmap(evaluation, 0))

    assert first == again


def test_figures_leave_no_trace_in_pyplot(evaluation):
    """Figures that pyplot knows stay in memory until they are closed."""
    import matplotlib.pyplot as plt

    panel = heatmap(evaluation, 0)

    assert isinstance(panel, Axes)
    assert plt.get_fignums() == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["$x^{", "_hidden", "雪", "a\\b", "%s {}"])
def test_any_name_can_be_drawn(frame_axis, name):
    """Matplotlib takes some signs for formulas, or for what is to be hidden."""
    evaluation = build_evaluation(frame_axis, name=name, ids=(name, f"{name}2"))
    picture = to_png(heatmap(evaluation, 0))

    assert picture.startswith(b"\x89PNG")


def test_unit_labels_are_ids_only_where_all_are_short(frame_axis):
    short = build_evaluation(frame_axis).layout
    assert unit_labels(short) == {"RSU0": "RSU0", "RSU1": "RSU1"}

    long = build_evaluation(frame_axis, ids=("RSU0", "corner-ne/7m/45")).layout
    assert unit_labels(long) == {"RSU0": "#1", "corner-ne/7m/45": "#2"}


def test_a_run_in_words_names_its_weather_unless_it_is_day(frame_axis):
    axis = replace(frame_axis, weathers=("day", "night", "rain"))
    words = [describe_run(axis, index) for index in range(3)]
    place = [
        f"{case} from the {approach} at {speed:g} km/h"
        for case, approach, speed in zip(
            axis.cases,
            axis.approaches,
            axis.vut_speed_kmh,
            strict=True,
        )
    ]

    assert words == [place[0], f"{place[1]}, night", f"{place[2]}, rain"]

    panel = heatmap(build_evaluation(axis), 1)
    title = f"{words[1]}: "

    assert any(text.startswith(title) for text in texts(panel))
