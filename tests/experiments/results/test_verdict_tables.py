"""Tables of ratios and of runs, against the evaluation."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from made_verdicts import live_verdict
from numpy.testing import assert_allclose

from experiments.results.tables import apr_records, margin_s, parties, runs_table
from placement.evaluation import Evaluation, apr, apr_by_position


@pytest.fixture
def evaluation(layout, frame_axis, rule):
    """Three units and a car that detect by lot; one unit detects nothing."""
    rng = np.random.default_rng(5)

    quick = replace(rule, n_confirmations=2)
    verdict = partial(live_verdict, frame_axis, rule=quick)
    detected = rng.random((4, frame_axis.n_frames)) < 0.7
    detected[1] = False
    return Evaluation(
        layout=layout,
        axis=frame_axis,
        vut=verdict(detected[3]),
        units={
            unit.id: verdict(detected[index]) for index, unit in enumerate(layout.units)
        },
        rsu_all=verdict(detected[:3].any(axis=0)),
        vut_and_rsus=verdict(detected.any(axis=0)),
    )


def assert_is_of(row, verdict, axis, mask):
    """A row of the table is about these runs."""
    assert row.apr == apr(verdict, axis, mask)
    assert row.n_runs == mask.sum()
    assert row.n_avoided == (verdict.is_avoided & mask).sum()


def _apr_table(evaluations):
    """The table of ratios."""
    return pd.DataFrame(apr_records(evaluations))


def test_apr_table_agrees_with_the_evaluation(evaluation):
    table = _apr_table({"mine": evaluation})
    assert list(table.columns) == [
        "layout",
        "party",
        "case",
        "approach",
        "position",
        "weather",
        "vut_speed_kmh",
        "apr",
        "n_runs",
        "n_avoided",
    ]
    for party, verdict in parties(evaluation).items():
        is_wanted = (table.party == party) & (table.approach == "all")
        rows = table[is_wanted & (table.vut_speed_kmh == "all")].set_index("case")

        assert set(rows.weather) == {"all"}  # there is but one
        assert rows.loc["all", "apr"] == apr(verdict, evaluation.axis)
        assert rows.loc["all", "n_runs"] == 3
        assert rows.loc["all", "n_avoided"] == verdict.is_avoided.sum()
        assert rows.loc["A", "apr"] == apr(
            verdict, evaluation.axis, np.array([True, True, False])
        )
        assert rows.loc["B", "n_avoided"] == verdict.is_avoided[2]


def test_apr_table_tells_several_weathers_apart(evaluation):
    axis = replace(evaluation.axis, weathers=("day", "night", "day"))
    evaluation = replace(evaluation, axis=axis)
    table = _apr_table({"mine": evaluation})

    assert not table.duplicated(
        ["party", "case", "approach", "weather", "vut_speed_kmh"]
    ).any()

    table = table[table.vut_speed_kmh == "all"].set_index(
        ["party", "case", "approach", "weather"]
    )
    for party, verdict in parties(evaluation).items():
        for weather in ("day", "night"):
            mask = np.array([word == weather for word in axis.weathers])
            row = table.loc[(party, "all", "all", weather)]

            assert_is_of(row, verdict, axis, mask)
        assert table.loc[(party, "all", "all", "all")].apr == apr(verdict, axis)
    runs = runs_table({"mine": evaluation}).to_pandas()

    assert runs.weather.tolist() == list(axis.weathers) * len(parties(evaluation))


def test_apr_table_tells_several_positions_apart(evaluation):
    axis = replace(evaluation.axis, positions=("0", "-15", "0"))
    evaluation = replace(evaluation, axis=axis)
    table = _apr_table({"mine": evaluation})
    keys = ["party", "case", "approach", "position", "weather", "vut_speed_kmh"]

    assert not table.duplicated(keys).any()

    told = table[table.position != "all"]
    assert set(told.vut_speed_kmh) == set(told.weather) == {"all"}

    for party, verdict in parties(evaluation).items():
        rows = told[told.party == party].set_index(["case", "approach", "position"])
        for case, approach, position in rows.index:
            mask = np.array(axis.positions) == position
            mask &= (case == "all") | (np.array(axis.cases) == case)
            mask &= (approach == "all") | (np.array(axis.approaches) == approach)
            row = rows.loc[(case, approach, position)]

            assert_is_of(row, verdict, axis, mask)

        assert {
            ("all", "all", "-15"),
            ("A", "all", "-15"),
            ("all", "north", "0"),
        } <= set(rows.index)
        assert apr_by_position(verdict, axis) == {
            position: rows.loc[("all", "all", position)].apr
            for position in ("-15", "0")
        }
    runs = runs_table({"mine": evaluation}).to_pandas()
    assert runs.position.tolist() == list(axis.positions) * len(parties(evaluation))


def test_apr_table_tells_several_speeds_apart(evaluation):
    table = _apr_table({"mine": evaluation})
    told = table[(table.vut_speed_kmh != "all") & (table.party == "rsu_all")]
    assert set(told.approach) == set(told.weather) == {"all"}

    verdict = evaluation.rsu_all
    axis = evaluation.axis
    got = {
        (row.case, row.vut_speed_kmh): (row.apr, row.n_runs)
        for row in told.itertuples()
    }
    runs = {
        ("all", "20"): [True, False, True],
        ("all", "30"): [False, True, False],
        ("A", "20"): [True, False, False],
        ("A", "30"): [False, True, False],
        ("B", "20"): [False, False, True],
    }

    assert got == {
        key: (apr(verdict, axis, np.array(mask)), sum(mask))
        for key, mask in runs.items()
    }

    same = replace(evaluation, axis=replace(axis, vut_speed_kmh=np.full(3, 20.0)))
    assert set(_apr_table({"mine": same}).vut_speed_kmh) == {"all"}


def test_apr_table_leaves_the_ratio_of_runs_without_weight_open(evaluation):
    axis = replace(evaluation.axis, weight=np.array([0.5, 0.5, 0.0]))
    table = _apr_table({"mine": replace(evaluation, axis=axis)})
    rows = table[(table.case == "B") & (table.approach == "all")]

    assert set(rows.vut_speed_kmh) == {"all", "20"}  # nobody drives it at 30
    assert len(rows) == 12
    assert rows.apr.isna().all()
    assert (rows.n_runs == 1).all()


def test_runs_table_has_one_row_per_party_and_run(evaluation, tmp_path):
    table = runs_table({"mine": evaluation, "again": evaluation}).to_pandas()
    axis = evaluation.axis

    assert len(table) == 2 * 6 * axis.n_runs
    assert not np.isinf(table.select_dtypes("number").to_numpy()).any()

    for party, verdict in parties(evaluation).items():
        rows = table[(table.layout == "mine") & (table.party == party)]
        assert rows.run.tolist() == list(axis.run_ids)
        assert rows.is_avoided.tolist() == verdict.is_avoided.tolist()
        assert rows.weight.tolist() == axis.weight.tolist()
        np.testing.assert_array_equal(
            rows.confirmation_time_s.isna(), np.isinf(verdict.confirmation_time_s)
        )
        assert_allclose(
            rows.detected_share,
            [
                verdict.detected[axis.frames_of(index)].mean()
                for index in range(axis.n_runs)
            ],
        )

        timely = rows[rows.margin_s.notna()]
        assert (timely.is_avoided == (timely.margin_s >= -1e-9)).all()
        assert not rows[rows.margin_s.isna()].is_avoided.any()
    path = tmp_path / "runs.parquet"
    table.to_parquet(path)

    pd.testing.assert_frame_equal(pd.read_parquet(path), table)


def test_margin_is_minus_infinity_where_nothing_is_confirmed_or_nothing_helps(
    evaluation, rule
):
    for verdict in parties(evaluation).values():
        margin = margin_s(verdict, evaluation.axis)
        hopeless = np.isinf(verdict.confirmation_time_s) | np.isinf(
            evaluation.axis.last_brake_time_s
        )
        np.testing.assert_array_equal(np.isneginf(margin), hopeless)

        last_s = evaluation.axis.last_brake_time_s[~hopeless]
        onset_s = verdict.confirmation_time_s[~hopeless] + rule.latency_s
        assert_allclose(margin[~hopeless], last_s - onset_s)
