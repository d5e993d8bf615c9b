import math
from dataclasses import replace
from statistics import median

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_verdicts import made_evaluation, made_verdict
from partial_pages import pictures_of, render_section, tables_of
from strategies import frame_axes

from experiments.parts.margins import (
    margin_m,
    margin_notes,
    margin_tables,
    margins_section,
    summarise_margins,
)
from experiments.results.numbers import NOTHING


@pytest.fixture
def axis(frame_axis):
    """At 36, 72 and 36 km/h, from two directions, with last moments at -0.1, -0.2 and
    -1 s.
    """
    return replace(
        frame_axis,
        approaches=("north", "<i>south</i>", "north"),
        vut_speed_kmh=np.array([36.0, 72.0, 36.0]),
        last_brake_time_s=np.array([-0.1, -0.2, -1.0]),
    )


@pytest.fixture
def build(axis):
    def build_evaluation(name, onset_s, vut_s, axis=axis):
        vut = made_verdict(axis, vut_s)
        return made_evaluation(axis, made_verdict(axis, onset_s), name=name, vut=vut)

    return build_evaluation


def test_metres_are_what_the_car_covers_in_the_margin(axis):
    party = made_verdict(axis, [-0.6, 0.3, np.inf])
    assert margin_m(party, axis)[:2] == pytest.approx([0.5 * 10.0, -0.5 * 20.0])
    assert margin_m(party, axis)[2] == -np.inf


def test_metres_are_the_way_between_two_places_of_the_run_as_it_is_driven(runs):
    """Where the VUT of a real run is at the onset, and where at the last moment: along
    its path.
    """
    for run in runs[::13]:
        motion = run.encounter.vut_motion
        last_s = run.last_brake_time_s
        onset_s = max(last_s - 0.7, motion.start_time_s)
        way_m = motion.distance_m(np.array(last_s)) - motion.distance_m(
            np.array(onset_s)
        )
        margin = (last_s - onset_s) * run.vut_speed_kmh / 3.6
        assert way_m == pytest.approx(margin, abs=1.0e-9)


@given(frame_axes(), st.data())
def test_a_summary_is_what_counting_run_by_run_gives(axis, data):
    n = axis.n_runs
    weight = np.array(
        [data.draw(st.sampled_from([0.0, 1.0])) for _ in range(n - 1)] + [1.0]
    )
    axis = replace(
        axis,
        weight=weight / weight.sum(),
        vut_speed_kmh=np.array(
            [data.draw(st.sampled_from([18.0, 36.0])) for _ in range(n)]
        ),
        last_brake_time_s=np.array(
            [data.draw(st.sampled_from([-0.7, -0.2, -np.inf])) for _ in range(n)]
        ),
    )
    onset = np.array(
        [data.draw(st.sampled_from([-0.9, -0.3, 0.1, np.inf])) for _ in range(n)]
    )
    lucky = np.array([data.draw(st.booleans()) for _ in range(n)])
    avoided = np.isfinite(onset) & np.isfinite(axis.last_brake_time_s)
    avoided &= (onset <= axis.last_brake_time_s) | lucky
    lost = ~np.isfinite(onset) & np.array([data.draw(st.booleans()) for _ in range(n)])
    party = replace(
        made_verdict(axis, onset, is_avoided=avoided),
        confirmation_time_s=np.where(lost, -0.9, onset),
    )
    mask = np.array([data.draw(st.booleans()) for _ in range(n)])
    summary = summarise_margins(party, axis, mask)

    chosen = [run for run in range(n) if mask[run] and axis.weight[run] > 0.0]
    margins_s = []
    late_s = []
    never = 0
    lost_again = 0
    hopeless = 0
    for run in chosen:
        last = axis.last_brake_time_s[run]
        if avoided[run]:
            margins_s.append((last - onset[run], axis.vut_speed_kmh[run] / 3.6))
        elif last == -np.inf:
            hopeless += 1
        elif onset[run] == np.inf:
            never += not lost[run]
            lost_again += bool(lost[run])
        else:
            late_s.append((onset[run] - last, axis.vut_speed_kmh[run] / 3.6))
    metres = [seconds * speed for seconds, speed in margins_s]
    seconds = [seconds for seconds, _ in margins_s]
    assert summary.n_runs == len(chosen)
    assert summary.n_avoided == len(margins_s)
    n_missed = summary.n_runs - summary.n_avoided
    assert n_missed == never + lost_again + hopeless + len(late_s)
    assert summary.n_never == never
    assert summary.n_lost == lost_again
    for got, expected in (
        (summary.smallest_s, min(seconds, default=math.nan)),
        (summary.smallest_m, min(metres, default=math.nan)),
        (summary.median_s, median(seconds) if seconds else math.nan),
        (summary.median_m, median(metres) if metres else math.nan),
        (summary.worst_late_s, max((late for late, _ in late_s), default=math.nan)),
        (summary.worst_late_m, max((late * v for late, v in late_s), default=math.nan)),
    ):
        assert got == pytest.approx(expected, nan_ok=True)


def test_tables_tell_groups_layouts_and_the_car_apart(build):
    found = build("mine", [-0.6, -0.3, 0.0], [0.0, np.inf, np.inf])
    other = build("VUT alone", [-0.2, -0.2, np.inf], [0.0, np.inf, np.inf])
    by_case, by_speed, by_direction = margin_tables({"mine": found, "VUT alone": other})
    assert [row[:2] for row in by_case.rows] == [
        [group, name]
        for group in ("all runs", "A", "B")
        for name in ("mine", "VUT alone", "VUT alone")
    ]
    assert [row[0] for row in by_speed.rows[3::3]] == ["36", "72"]
    assert [row[0] for row in by_direction.rows[3::3]] == ["north", "<i>south</i>"]
    assert by_case.rows[0][2:] == [
        "3",
        "100",
        "2.0",
        "300",
        "3.5",
        "1",
        "0",
        "1000",
        "10.0",
    ]
    car = by_case.rows[2][2:]
    assert car == ["3", NOTHING, NOTHING, NOTHING, NOTHING, "3", "2", "100", "1.0"]
    nothing_late = by_speed.rows[3 + 3][2:]
    assert nothing_late == [
        "1",
        "100",
        "2.0",
        "100",
        "2.0",
        "0",
        NOTHING,
        NOTHING,
        NOTHING,
    ]
    assert {len(row) for row in by_case.rows} == {len(by_case.columns)}


def test_notes_tell_only_what_applies(build, axis):
    plain = build("mine", [-0.6, -0.3, -1.0], [np.inf] * 3)
    assert margin_notes({"mine": plain}) == []
    hopeless = replace(
        axis,
        last_brake_time_s=np.array([-0.1, -0.2, -np.inf]),
        weight=np.array([0.0, 0.5, 0.5]),
    )
    late = build("mine", [-0.6, 0.3, 0.0], [np.inf] * 3, axis=hopeless)
    lucky = replace(
        late, rsu_all=made_verdict(hopeless, [-0.6, 0.3, 0.0], is_avoided=[1, 1, 0])
    )
    without, no_braking, luck = margin_notes({"mine": lucky})
    assert without == "Left out: 1 run of weight 0."
    assert "In 1 run no braking" in no_braking
    assert luck.startswith("A negative margin")
    assert summarise_margins(lucky.rsu_all, hopeless).smallest_s == pytest.approx(-0.5)


def test_the_part_renders_with_names_escaped_and_a_table_behind_the_figure(build):
    evaluations = {
        name: build(name, [-0.6, -0.3, 0.0], [0.0, np.inf, -2.0])
        for name in ("<script>$x$", "b", "c", "d", "e")
    }
    part = margins_section(evaluations)
    (picture,) = pictures_of(part)
    assert "2 more layouts are in the tables" in picture.caption
    page = render_section(part)
    assert "<script>" not in page
    assert "<i>south" not in page
    assert page.count("<table>") == 3
    assert page.count("&lt;script&gt;$x$</td>") == sum(
        row[1] == "<script>$x$" for table in tables_of(part) for row in table.rows
    )
