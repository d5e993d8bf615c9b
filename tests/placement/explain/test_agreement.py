"""Where the detection table and the full evaluation agree, and why not."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_worlds import setting_of, table_of

from geometry.study_scene import load_study_scene
from placement.detection_table import pack_table
from placement.detectors import load_planning_detector
from placement.evaluator import evaluate_layout
from placement.explain.agreement import FUSED, find_disagreements
from placement.layout import Layout, load_carlancap_layout
from placement.setting import Radio

RUNS = ("CPNC-50/east/40", "CBLA/east/50")


@pytest.fixture(scope="module")
def setting(runs, rule):
    """Two of the study's runs."""
    few = [run for run in runs if run.id in RUNS]
    planned = load_planning_detector()
    return setting_of(
        load_study_scene(),
        few,
        rule=rule,
        detector=planned,
    )


@pytest.fixture(scope="module")
def layout():
    """Two units of the study's layout."""
    units = load_carlancap_layout().units[2:4]
    return Layout(name="two", units=units)


@pytest.fixture(scope="module")
def evaluation(setting, layout):
    """The two units evaluated."""
    return evaluate_layout(layout, setting)


def _table(setting, layout, detected):
    """A table of the layout's units with these detections."""
    ids = tuple(unit.id for unit in layout.units)
    return pack_table(ids, setting.axis, detected)


def test_both_agree_on_runs_that_are_seen_well(setting, layout, evaluation):
    table = table_of(setting, layout.units)
    found = find_disagreements(setting, table, evaluation, [0, 1])

    assert evaluation.rsu_all.is_avoided.all()
    assert found == ()


def test_a_table_that_misses_everything_differs_where_the_evaluator_avoids(
    setting, layout, evaluation
):
    axis = setting.axis
    nothing_seen = np.zeros((2, axis.n_frames), dtype=bool)
    nothing = _table(setting, layout, nothing_seen)

    found = find_disagreements(setting, nothing, evaluation, [0, 1])

    expected = []
    for party, verdict in (*evaluation.units.items(), (FUSED, evaluation.rsu_all)):
        avoided = np.flatnonzero(verdict.is_avoided)
        expected += [(party, axis.run_ids[run]) for run in avoided]

    found_runs = [(entry.party, entry.run_id) for entry in found]

    assert found_runs == expected
    assert not any(entry.on_table for entry in found)

    for entry in found:
        run = axis.run_ids.index(entry.run_id)
        frames = axis.frames_of(run)
        in_time = axis.time_s[frames] <= axis.last_brake_time_s[run]
        seen = [
            verdict.detected[frames] & in_time
            for name, verdict in evaluation.units.items()
            if entry.party in (FUSED, name)
        ]
        seen_by_any = np.logical_or.reduce(seen)

        assert entry.n_frames == seen_by_any.sum()
        assert "sample points and pixels differ" in entry.cause


def test_what_was_lost_on_the_way_is_told_from_what_was_not_seen(
    setting, layout, evaluation
):
    rows = [verdict.detected for verdict in evaluation.units.values()]
    detected = np.array(rows)
    table = _table(setting, layout, detected)
    radio = Radio(packet_loss=1.0)
    lossy = evaluate_layout(layout, replace(setting, radio=radio))

    found = find_disagreements(setting, table, lossy, [0, 1])
    run_ids = {entry.run_id for entry in found if entry.party == FUSED}

    assert run_ids == set(RUNS)

    for entry in found:
        assert entry.on_table
        assert "chance or a lost message" in entry.cause


def test_latency_alone_can_make_the_difference(setting, layout, evaluation):
    rows = [verdict.detected for verdict in evaluation.units.values()]
    detected = np.array(rows)
    units = tuple(replace(unit, latency_s=60.0) for unit in layout.units)
    slow = replace(layout, units=units)

    table = _table(setting, slow, detected)

    # The table is asked with the units' own latencies, too: nothing differs.
    late = evaluate_layout(slow, setting)
    found = find_disagreements(setting, table, late, [0, 1])

    assert not late.rsu_all.is_avoided.any()
    assert found == ()
