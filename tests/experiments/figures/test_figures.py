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
        return Verdict(
            detected=rng.random(axis.n_frames) < 0.5,
            confirmation_time_s=confirmation,
            onset_time_s=confirmation,
            is_avoided=rng.random(axis.n_runs) < 0.5,
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
    return build_evaluation(frame_axis)


def texts(figure):
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text)]


def test_heatmap_cells_are_the_detections(evaluation):
    panels = plot_heatmaps(evaluation, [0, 1, 2])
    for run_index, axes in enumerate(panels):
        (image,) = axes.get_images()
        frames = evaluation.axis.frames_of(run_index)
        rows = [evaluation.vut, *evaluation.units.values(), evaluation.rsu_all]
        np.testing.assert_array_equal(
            np.asarray(image.get_array()), [row.detected[frames] for row in rows]
        )

        labels = [label.get_text() for label in axes.get_yticklabels()]
        assert labels == ["VUT", "RSU0", "RSU1", "all RSUs"]


def test_heatmap_cells_are_centred_on_their_frames(evaluation):
    for run_index in range(evaluation.axis.n_runs):
        axes = plot_heatmaps(evaluation, [run_index])[0]
        times = evaluation.axis.time_s[evaluation.axis.frames_of(run_index)]
        left, right, bottom, top = axes.get_images()[0].get_extent()
        edges = np.linspace(left, right, len(times) + 1)

        np.testing.assert_allclose(0.5 * (edges[1:] + edges[:-1]), times, atol=1e-12)
        assert bottom == 3.5
        assert top == -0.5


def test_heatmap_draws_the_last_brake_time_as_a_dashed_red_line(evaluation):
    for run_index, last_brake_s in enumerate(evaluation.axis.last_brake_time_s[:2]):
        axes = plot_heatmaps(evaluation, [run_index])[0]
        (line,) = [
            line for line in axes.get_lines() if line.get_gid() == "last brake time"
        ]

        assert list(line.get_xdata()) == [last_brake_s] * 2
        assert line.get_color() == RED
        assert line.is_dashed()


def test_heatmap_says_so_where_no_braking_helps(evaluation):
    axes = plot_heatmaps(evaluation, [2])[0]  # its last brake time is minus infinity
    assert not [
        line for line in axes.get_lines() if line.get_gid() == "last brake time"
    ]
    assert any("any braking is too late" in text for text in texts(axes.figure))


def test_heatmap_marks_confirmations_and_names_outcomes(evaluation):
    for run_index in range(evaluation.axis.n_runs):
        axes = plot_heatmaps(evaluation, [run_index])[0]
        (marks,) = [line for line in axes.get_lines() if line.get_marker() == "D"]
        rows = [evaluation.vut, *evaluation.units.values(), evaluation.rsu_all]
        times = [row.confirmation_time_s[run_index] for row in rows]
        assert list(marks.get_xdata()) == times

        (outcomes,) = axes.child_axes
        for label, row, time_s in zip(
            outcomes.get_yticklabels(),
            rows,
            times,
            strict=True,
        ):
            if np.isfinite(time_s):
                late = "too late"
            else:
                late = "never confirmed"
            if not row.detected[evaluation.axis.frames_of(run_index)].any():
                late = "never seen"
            assert label.get_text() == (
                "avoided" if row.is_avoided[run_index] else late
            )


def test_a_heatmap_names_tracks_that_were_lost_again(evaluation):
    late = evaluation.rsu_all
    run_index = int(
        np.flatnonzero(~late.is_avoided & np.isfinite(late.confirmation_time_s))[0]
    )
    onset = late.onset_time_s.copy()
    onset[run_index] = np.inf
    axes = plot_heatmaps(
        replace(evaluation, rsu_all=replace(late, onset_time_s=onset)), [run_index]
    )[0]
    (outcomes,) = axes.child_axes

    assert outcomes.get_yticklabels()[-1].get_text() == "lost again"


@pytest.mark.long
def test_figures_are_the_same_bytes_each_time(evaluation):
    assert to_png(plot_heatmaps(evaluation, [0])[0]) == to_png(
        plot_heatmaps(evaluation, [0])[0]
    )


def test_figures_leave_no_trace_in_pyplot(evaluation):
    import matplotlib.pyplot as plt

    assert isinstance(plot_heatmaps(evaluation, [0])[0], Axes)
    assert plt.get_fignums() == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["$x^{", "_hidden", "雪", "a\\b", "%s {}"])
def test_any_name_can_be_drawn(frame_axis, name):
    evaluation = build_evaluation(frame_axis, name=name, ids=(name, f"{name}2"))
    assert to_png(plot_heatmaps(evaluation, [0])[0]).startswith(b"\x89PNG")


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

    drawn = texts(plot_heatmaps(build_evaluation(axis), [1])[0])
    assert any(text.startswith(f"{words[1]}: ") for text in drawn)
