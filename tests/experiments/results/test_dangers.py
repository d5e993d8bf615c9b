from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace as replace_fields
from partial_pages import build_result

from experiments.report.answer import danger_sentences, position_words
from experiments.report.next_unit import (
    next_unit_section,
    next_unit_sentence,
    other_sensor_sentence,
)
from experiments.results.baselines import ExchangeRecord, NextUnitRecord
from experiments.results.dangers import avoided_runs, build_dangers_record


def evaluation(together, **units):
    return SimpleNamespace(
        rsu_all=SimpleNamespace(is_avoided=np.array(together)),
        units={name: SimpleNamespace(is_avoided=np.array(runs)) for name, runs in units.items()},
    )


def test_what_is_avoided_is_what_the_fusion_asks_for():
    item = evaluation([True, True, False], a=[True, False, False], b=[False, False, False])
    assert avoided_runs(item, "any").tolist() == [True, True, False]
    assert avoided_runs(item, "single").tolist() == [True, False, False]


def test_what_is_left_is_counted_by_case_and_position_the_largest_share_first(frame_axis):
    axis = replace(frame_axis, positions=("0", "-15", "-15"))  # cases A, A, B
    record = build_dangers_record(np.array([True, True, False]), axis)
    assert record.not_avoided == 1
    assert [(g.name, g.runs, g.not_avoided) for g in record.by_case] == [("B", 1, 1), ("A", 2, 0)]
    groups = [(g.name, g.runs, g.not_avoided) for g in record.by_position]
    assert groups == [("-15", 2, 1), ("0", 1, 0)]
    assert build_dangers_record(np.ones(3, dtype=bool), frame_axis).by_position == ()


def result_of(axis, is_avoided, **changes):
    record = build_dangers_record(np.array(is_avoided), axis)
    return build_result("any", runs=axis.n_runs, dangers=record, **changes)


def test_an_answer_begins_with_what_is_not_avoided(frame_axis):
    assert danger_sentences(result_of(frame_axis, [True, False, False])) == [
        "2 of 3 runs are not avoided: in B 1 of 1 and in A 1 of 2."
    ]
    axis = replace(frame_axis, positions=("0", "-15", "+30"))
    assert danger_sentences(result_of(axis, [True, True, False])) == [
        "1 of 3 runs is not avoided: in B 1 of 1. By place: 30 m beyond the crosswalk ahead 1 of 1."
    ]
    assert danger_sentences(result_of(axis, [True] * 3)) == ["No run is left: all 3 are avoided."]
    assert danger_sentences(build_result("any")) == []


def test_of_many_groups_the_worst_are_named_and_the_others_counted(frame_axis):
    n_runs = 10
    axis = replace(
        frame_axis,
        run_ids=tuple(map(str, range(n_runs))),
        cases=tuple("AABBCCDDEE"),
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        positions=(),
        vut_speed_kmh=np.full(n_runs, 20.0),
        weight=np.full(n_runs, 0.1),
        last_brake_time_s=np.zeros(n_runs),
        run_start=np.arange(n_runs + 1),
        time_s=np.zeros(n_runs),
    )
    left = [True, False, False, False, True, False, False, True, True, True]
    assert danger_sentences(result_of(axis, left)) == [
        "5 of 10 runs are not avoided: in B 2 of 2, in A 1 of 2, in C 1 of 2 and in other cases 1."
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("0", "at the junction"),
        ("-15", "15 m before the junction"),
        ("+0", "at the crosswalk ahead"),
        ("+7.5", "7.5 m beyond the crosswalk ahead"),
    ],
)
def test_positions_in_words(name, words):
    assert position_words(name) == words


def test_what_the_next_unit_buys_and_how_that_is_known():
    unit = NextUnitRecord(pose="mast-w/7m", site="mast-w", apr=0.974, gain=0.064)
    assert next_unit_sentence(build_result("any", next_unit=unit)) == (
        "One more unit would add 6.4 points of APR: 97.4 % with mast-w/7m (on the detection table, "
        "by greedy choice)"
    )
    useless = NextUnitRecord(pose="mast-w/7m", site="mast-w", apr=0.9, gain=0.0)
    assert next_unit_sentence(build_result("any", next_unit=useless)) == (
        "One more unit among the candidates would avoid nothing more (on the detection table, by "
        "greedy choice)"
    )
    assert next_unit_sentence(build_result("any")) == ""


LENS = ExchangeRecord(
    model="basler-aca1920-50gc-16mm",
    kind="camera",
    unit="U2",
    horizontal_fov_deg=38.0,
    yaw_deg=-60.0,
    pitch_deg=-15.0,
    apr=0.974,
    gain=0.064,
    extra_eur=400.0,
    all_units=3,
    apr_all=0.7,
    apr_as_they_hang=0.5,
    extra_all_eur=1200.0,
)


def test_what_a_longer_lens_buys_and_how_that_is_known():
    assert other_sensor_sentence(build_result("any", other_sensors=(LENS,))) == (
        "basler-aca1920-50gc-16mm (38 deg wide) in place of U2 would add 6.4 points of APR: 97.4 % "
        "for 400 EUR more (on the detection table, at the same mounts, turned by up to 45 deg)"
    )
    worse = replace_fields(LENS, apr=0.9, gain=-0.01, extra_eur=-100.0)
    assert other_sensor_sentence(build_result("any", other_sensors=(worse, worse))) == (
        "None of 2 other models in place of one of these would add anything: "
        "basler-aca1920-50gc-16mm (38 deg wide) in place of U2 would come closest, with 90.0 % (on "
        "the detection table, at the same mounts, turned by up to 45 deg)"
    )
    assert other_sensor_sentence(build_result("any")) == ""


def test_the_section_has_a_row_per_model_and_both_sentences():
    unit = NextUnitRecord(pose="mast-w/7m", site="mast-w", apr=0.974, gain=0.064)
    result = build_result("any", next_unit=unit, other_sensors=(LENS,))
    section = next_unit_section(result)
    said, table = section.blocks
    assert said == f"{next_unit_sentence(result)}. {other_sensor_sentence(result)}."
    assert table.rows == [
        [LENS.model, "38", "U2", "97.4 %", "+6.4", "+400", "70.0 %", "50.0 %", "+1,200"]
    ]
    assert next_unit_section(build_result("any")) is None
