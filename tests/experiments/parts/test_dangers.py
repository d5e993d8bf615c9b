"""Where it is still dangerous, in words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.parts.dangers import avoided_runs, build_dangers, position_words
from experiments.parts.dangers import words as danger_words


def evaluation(together, *, vut=(), cars=0.0, **units):
    """Who avoids which of three runs: all together, units, and the car."""
    return SimpleNamespace(
        headline=SimpleNamespace(is_avoided=np.array(together)),
        units={
            name: SimpleNamespace(is_avoided=np.array(runs))
            for name, runs in units.items()
        },
        vut=SimpleNamespace(is_avoided=np.array(vut)),
        cars=cars,
    )


def test_what_is_avoided_is_what_the_fusion_asks_for():
    item = evaluation(
        [True, True, False], a=[True, False, False], b=[False, False, False]
    )
    assert avoided_runs(item, "any").tolist() == [True, True, False]
    assert avoided_runs(item, "single").tolist() == [True, False, False]

    of_cars = [
        avoided_runs(
            evaluation([True] * 3, a=[True, False, False], vut=[0, 0, 1], cars=cars),
            how,
        )
        for cars, how in (
            (0.3, "single"),
            (1.0, "single"),
            (1.0, "any"),
        )
    ]
    assert [runs.tolist() for runs in of_cars] == [
        [True, False, False],
        [True, False, True],
        [True, True, True],
    ]


def test_what_is_left_is_counted_by_case_and_position_the_largest_share_first(
    frame_axis,
):
    axis = replace(frame_axis, positions=("0", "-15", "-15"))  # cases A, A, B
    record = build_dangers(np.array([True, True, False]), axis)

    assert record.not_avoided == 1
    assert [(g.name, g.runs, g.not_avoided) for g in record.by_case] == [
        ("B", 1, 1),
        ("A", 2, 0),
    ]

    groups = [(g.name, g.runs, g.not_avoided) for g in record.by_position]
    assert groups == [
        ("-15", 2, 1),
        ("0", 1, 0),
    ]
    assert build_dangers(np.ones(3, dtype=bool), frame_axis).by_position == ()


def danger_sentences(axis, is_avoided):
    """What is said of runs that are avoided or not."""
    return danger_words(build_dangers(np.array(is_avoided), axis), axis.n_runs)


def test_an_answer_begins_with_what_is_not_avoided(frame_axis):
    assert danger_sentences(frame_axis, [True, False, False]) == [
        "2 of 3 runs (simulated collisions) are not avoided: in B 1 of 1 and in A 1"
        " of 2."
    ]

    axis = replace(frame_axis, positions=("0", "-15", "+30"))
    assert danger_sentences(axis, [True, True, False]) == [
        "1 of 3 runs (simulated collisions) is not avoided: in B 1 of 1. "
        "By place: 30 m beyond the crosswalk ahead 1 of 1."
    ]
    assert danger_sentences(axis, [True] * 3) == ["All 3 runs are avoided."]

    titled = build_dangers(
        np.array([True, True, False]), frame_axis, titles={"B": "child crosses"}
    )
    (said,) = danger_words(titled, frame_axis.n_runs)
    assert said.endswith("not avoided: in B (child crosses) 1 of 1.")


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

    assert danger_sentences(axis, left) == [
        "5 of 10 runs (simulated collisions) are not avoided: "
        "in B 2 of 2, in A 1 of 2, in C 1 of 2 and in other cases 1."
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
