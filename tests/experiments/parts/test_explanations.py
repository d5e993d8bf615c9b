"""Explanations as plain objects: what the library has found."""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments.cli.answers import explanation_parts
from experiments.cli.terminal import answer_text
from experiments.parts.explanation import build_explained_record, missed_table
from experiments.results.record import to_plain
from placement.detection_table import pack_table
from placement.explain.unavoided import find_unavoided
from placement.layout import load_carlancap_layout
from placement.pipeline import Assembly, place
from placement.wishes import Wishes


@pytest.fixture(scope="module")
def candidates():
    return load_carlancap_layout().units


@pytest.fixture(scope="module")
def placement(small_setting, candidates):
    return place(
        Assembly(
            setting=small_setting, candidates=candidates, wishes=Wishes(budget_units=2)
        )
    )


@pytest.fixture(scope="module")
def summary(placement, small_setting, candidates):
    """The record as JSON has it."""
    found = to_plain(build_explained_record(placement, small_setting, candidates))
    return json.loads(json.dumps(found, allow_nan=False))


def test_the_summary_says_what_the_library_found(
    summary, placement, small_setting, candidates
):
    problem = placement.problem
    chosen = placement.pose_index
    missed = find_unavoided(small_setting, problem, candidates, chosen)

    assert [record["run"] for record in summary["not_avoided"]] == [
        e.run for e in missed
    ]


def test_what_one_unit_misses_is_explained_run_by_run(small_setting, candidates):
    placement = place(
        Assembly(
            setting=small_setting,
            candidates=candidates[8:9],
            wishes=Wishes(budget_units=1),
        )
    )
    found = build_explained_record(placement, small_setting, candidates[8:9])

    assert len(found.not_avoided) > 0
    for entry in found.not_avoided:
        assert entry.unit == candidates[8].id
        assert sum(reason.frames for reason in entry.reasons) == (
            entry.frames_in_time - entry.frames_seen
        )
        assert entry.rescue is None  # there is no other candidate

    table = missed_table(found)
    assert len(table.rows) == len(found.not_avoided)

    text = answer_text(explanation_parts(found), is_verbose=True)
    assert f"{len(found.not_avoided)} runs are not avoided" in " ".join(text.split())


def test_what_no_ratio_knows_is_in_no_list(small_setting, candidates):
    """The runs of one unit, with weight and without: all lists and counts say the
    same.
    """
    poses = candidates[8:9]
    everything = place(
        Assembly(setting=small_setting, candidates=poses, wishes=Wishes(budget_units=1))
    )
    found = build_explained_record(everything, small_setting, poses)

    assert found.runs_without_weight == 0

    missed_runs = {entry.run for entry in found.not_avoided}
    axis = small_setting.axis
    saved_runs = set(axis.run_ids) - missed_runs

    assert missed_runs
    assert len(saved_runs) > 1

    out = {*missed_runs, min(saved_runs)}
    weight = np.array([0.0 if run in out else 1.0 for run in axis.run_ids])
    weighted = replace(small_setting, axis=replace(axis, weight=weight / weight.sum()))
    placement = place(
        Assembly(setting=weighted, candidates=poses, wishes=Wishes(budget_units=1))
    )
    found = build_explained_record(placement, weighted, poses)

    assert found.not_avoided == ()
    assert missed_table(found).rows == []
    assert found.runs_without_weight == len(out)
    assert "not avoided" not in answer_text(explanation_parts(found), is_verbose=True)


@pytest.mark.long
def test_sampled_worlds_are_explained_in_the_world_as_planned(
    placement, small_setting, candidates
):
    alone = list(placement.pose_index)
    table = placement.problem.table
    nominal = replace(
        placement.problem,
        table=pack_table(
            tuple(table.pose_ids[pose] for pose in alone),
            table.axis,
            table.detected(alone) & False,
        ),
        limits=placement.problem.limits.of_poses(np.array(alone)),
    )
    sampled = replace(
        placement, nominal=nominal, nominal_index=tuple(range(len(alone)))
    )
    found = build_explained_record(sampled, small_setting, candidates)

    assert {entry.run for entry in found.not_avoided} == set(table.axis.run_ids)
    assert all(entry.rescue is None for entry in found.not_avoided)
