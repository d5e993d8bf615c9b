"""What is said of layouts that were judged in sampled worlds."""

import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from tiny_worlds import unit_at

from experiments.language import speaking
from experiments.parts.sampled_worlds import (
    build_pair_record,
    build_sampled_record,
    build_uncertainty_record,
    growth_sentences,
    overtaken_sentences,
    preferred_sentences,
    table,
    uncertainty_sentences,
    what_is_uncertain,
)
from experiments.results.numbers import percent
from experiments.results.record import to_plain
from placement.growth import Growth, Round
from placement.latency import load_latency_budget
from placement.layout import Layout
from placement.sampling.out_of_sample import SampledApr
from placement.sampling.uncertainty import LatencyJitter, Uncertainty, load_uncertainty


@pytest.fixture
def judge(frame_axis):
    """Builds what sampled worlds say of a layout."""
    unit = unit_at("U1")

    def build(name, apr_by_sample, avoided_share=(1.0, 0.5, 0.25)):
        return SampledApr(
            layout=Layout(name=name, units=(unit,)),
            axis=frame_axis,
            apr_by_sample=apr_by_sample,
            avoided_share=np.array(avoided_share),
        )

    return build


@pytest.fixture
def judged(judge):
    """Two layouts, the second surely worse."""
    return [judge("best-3", [0.9, 0.8, 1.0, 0.9]), judge("study", [0.5, 0.5, 0.6, 0.5])]


@pytest.fixture
def summary(judged):
    return build_sampled_record(
        judged,
        load_uncertainty(),
        tail=0.5,
        seed=7,
        planned_apr={"best-3": 1.0, "study": 0.55},
        chosen_apr={"best-3": 0.95},
    )


def test_the_summary_holds_the_numbers_of_the_judgement(summary, judged):
    summary = to_plain(summary)
    ours, theirs = summary["layouts"]

    assert summary | {"samples": 4, "seed": 7, "tail": 0.5} == summary
    assert theirs | {"name": "study", "planned": 0.55, "in_sample": None} == theirs

    expected = {
        "name": "best-3",
        "planned": 1.0,
        "in_sample": 0.95,
        "mean": pytest.approx(0.9),
        "cvar": pytest.approx(0.85),
        "worst": 0.8,
        "apr_by_sample": [0.9, 0.8, 1.0, 0.9],
        "low": judged[0].estimate.low,
        "high": judged[0].estimate.high,
        "least_sure_runs": [
            {"run": "B/north/20", "avoided_share": 0.25},
            {"run": "A/north/30", "avoided_share": 0.5},
        ],
    }
    assert ours | expected == ours


def test_a_gain_is_taken_world_by_world(summary, judge):
    (gain,) = to_plain(summary)["pairs"]
    assert gain["second"] == "study"
    assert gain["mean"] == pytest.approx(0.375)

    differences = np.array([0.4, 0.3, 0.4, 0.4])
    assert gain["standard_error"] == pytest.approx(differences.std(ddof=1) / 2.0)

    # Worlds that are bad for both take nothing from a difference that is always the
    # same.
    pair = [
        judge("a", np.linspace(0.1, 0.9, 60) + 0.05),
        judge("b", np.linspace(0.1, 0.9, 60)),
    ]
    (sure,) = build_sampled_record(pair, Uncertainty(), tail=1.0, seed=0).gains

    assert sure.mean == pytest.approx(0.05)
    assert 0.0 <= sure.high - sure.low < 0.15


def test_that_fresh_worlds_prefer_another_layout_is_said(judge):
    apr = np.array([0.9, 0.8, 1.0, 0.9])
    worse = apr - [0.1, 0.12, 0.08, 0.1]
    pair = [judge("best-3", worse), judge("greedy-3", apr)]

    def told(judged, **options):
        return overtaken_sentences(
            build_sampled_record(judged, Uncertainty(), seed=0, **options)
        )

    (sentence,) = told(pair, tail=0.5, chosen_in=2)

    assert sentence.startswith(
        "greedy-3 does better in 4 fresh worlds: 10.0 points of APR more"
    )
    assert "in the worst 50.0 % of them, 85.0 % instead of 74.0 %" in sentence
    assert "the 2 worlds used to choose best-3 are too few" in sentence
    assert "worst" not in told(pair, tail=1.0, chosen_in=2)[0]
    assert not told(pair, tail=0.5)  # nobody chose it in worlds
    assert not told(pair[::-1], tail=0.5, chosen_in=2)

    unsure = [judge("best-3", apr), judge("greedy-3", [0.8, 1.0, 0.9, 0.91])]
    assert not told(unsure, tail=0.5, chosen_in=2)

    (unit,) = pair[1].layout.units
    larger = replace(pair[1].layout, units=(unit, replace(unit, id="U2")))
    assert not told([pair[0], replace(pair[1], layout=larger)], tail=0.5, chosen_in=2)


def test_what_is_uncertain_is_recorded_under_the_names_of_its_file(summary):
    record = to_plain(summary)["uncertainty"]
    assert record["name"] == "default"
    assert record["mounting"] == {
        "yaw_sd_deg": 1.0,
        "pitch_sd_deg": 1.0,
        "height_sd_m": 0.05,
    }
    assert record["packet_loss"] == 0.05
    assert record["draws_detections"]
    assert "vehicles" not in record["traffic"]
    assert (
        record["traffic"]["waiting_share"] == load_uncertainty().traffic.waiting_share
    )
    assert list(record["vehicles"])[-1] == "bus"

    drawn = Uncertainty(latency=LatencyJitter(budget=load_latency_budget("cpm-50ms")))
    latency = to_plain(build_uncertainty_record(drawn))["latency"]
    assert latency == {"budget": "cpm-50ms", "drawn_per": "run"}


def test_sentences_say_mean_interval_plan_and_what_is_least_sure(summary):
    first, chosen, unsure = uncertainty_sentences(summary)
    ours = summary.layouts[0]

    assert first.startswith(
        "In 4 fresh sampled worlds (units off by 1\N{DEGREE SIGN} in yaw, "
    )
    assert first.endswith(
        "best-3 avoids 90.0 % of the accidents on average (95 % interval: Student's t,"
        f" 4 samples: {100 * ours.low:.1f} % to {100 * ours.high:.1f} %); as planned"
        " 100.0 %."
    )
    assert (
        chosen
        == "In the worlds used to choose it, it avoids 95.0 %; a layout looks better in"
        " those worlds than in others."
    )
    assert (
        unsure
        == "Least certain runs, with the share of worlds that avoid them: B/north/20 "
        "(25.0 %), A/north/30 (50.0 %)."
    )


@pytest.mark.parametrize(
    ("alone", "of_all"),
    [(0.0, 0.27), (0.7, 0.76)],
)
def test_with_v2x_in_some_cars_the_accidents_of_all_are_told(judged, alone, of_all):
    """30 % of the cars avoid 90 %, the others what they avoid alone."""
    uncertainty = replace(load_uncertainty(), v2x_share=0.3)
    judged = [replace(item, alone=alone) for item in judged]
    found = build_sampled_record(judged, uncertainty, tail=1.0, seed=7)

    assert found.layouts[0].of_all == pytest.approx(of_all)
    assert (
        uncertainty_sentences(found)[1]
        == f"With V2X in 30.0 % of the cars, these are {100.0 * of_all:.1f} % of the"
        " accidents of all cars."
    )


def test_a_tail_of_few_worlds_is_warned_of(judged):
    def sentences(tail, chosen_in):
        found = build_sampled_record(
            judged, Uncertainty(), tail=tail, seed=0, chosen_in=chosen_in
        )
        return " ".join(uncertainty_sentences(found))

    said = (
        "The worst 25.0 % of the 8 worlds used to choose it are 2 worlds, too few to"
        " choose by"
    )

    assert said in sentences(0.25, 8)
    assert "too few" not in sentences(0.25, 32)  # eight of them
    assert "too few" not in sentences(1.0, 2)
    assert "too few" not in sentences(0.25, None)


def test_the_worst_worlds_have_an_error_and_layouts_are_compared_by_what_was_asked_for(
    judge,
):
    rng = np.random.default_rng(1)
    steady = judge("steady", np.full(40, 0.9))
    mixed = judge("mixed", np.where(rng.random(40) < 0.3, 0.6, 1.0) + 0.0)
    found = build_sampled_record(
        [mixed, steady], Uncertainty(), tail=0.25, seed=0, chosen_in=40
    )
    errors = [layout.cvar_error for layout in found.layouts]

    assert errors[1] == pytest.approx(0.0, abs=1e-12)
    assert errors[0] > 0.0

    (pair,) = found.pairs
    assert (
        pair.cvar_low
        <= found.layouts[0].cvar - found.layouts[1].cvar
        <= pair.cvar_high
        < 0.0
    )

    (said,) = overtaken_sentences(found)
    assert said.startswith("steady does better in 40 fresh worlds")

    # By the mean of all worlds the same two are alike.
    alike = build_sampled_record(
        [mixed, steady], Uncertainty(), tail=1.0, seed=0, chosen_in=40
    )
    assert alike.layouts[0].cvar_error is None
    assert overtaken_sentences(alike) == []


def test_sentences_say_where_nothing_is_uncertain(judge):
    close = [judge("a", [0.5, 0.6, 0.5]), judge("b", [0.55, 0.5, 0.5])]
    said, *_ = uncertainty_sentences(
        build_sampled_record(close, Uncertainty(), tail=1.0, seed=0)
    )

    assert "(nothing is uncertain)" in said
    assert "as planned" not in said


def test_nothing_is_least_sure_where_all_is_avoided(judge, frame_axis):
    sure = judge("a", [1.0, 1.0], avoided_share=(1.0, 1.0, 1.0))
    summary = build_sampled_record([sure], Uncertainty(), tail=1.0, seed=0)

    assert summary.layouts[0].least_sure_runs == ()
    assert not any("Least certain" in s for s in uncertainty_sentences(summary))

    # A run of no weight is nobody's worry.
    free = replace(frame_axis, weight=np.array([0.5, 0.5, 0.0]))
    item = replace(
        judge("a", [1.0]), axis=free, avoided_share=np.array([1.0, 1.0, 0.0])
    )
    alone = build_sampled_record([item], Uncertainty(), tail=1.0, seed=0)

    assert alone.layouts[0].least_sure_runs == ()
    assert math.isnan(alone.layouts[0].standard_error)


def test_every_uncertainty_has_its_words(judge):
    def words(uncertainty):
        item = judge("a", [1.0])
        return what_is_uncertain(
            build_sampled_record([item], uncertainty, tail=1.0, seed=0)
        )

    assert (
        words(load_uncertainty())
        == "units off by 1\N{DEGREE SIGN} in yaw, 1\N{DEGREE SIGN} in pitch and 5 cm in"
        " height, messages 10 ms later on average, 5.0 % of the messages lost in"
        " bursts (drawn anew after 3 frames), detections drawn where the detector"
        " gives a probability (20.0 % of the noise for a whole run), units out of"
        " order in 2.0 % and poles in 0.5 % of the runs, 1.0 % of the cameras dirty,"
        " low sun in 11.5 % of the runs by day, 50.0 % of the parking places taken,"
        " vehicles waiting in 30.0 % of the lanes"
    )

    drawn = Uncertainty(latency=LatencyJitter(budget=load_latency_budget("cpm-50ms")))
    assert words(drawn) == "latency drawn from the budget cpm-50ms"


def test_the_table_has_a_row_for_each_layout(summary, judge):
    shown = table(summary)
    assert list(shown.columns)[:3] == ["layout", "planned", "mean"]
    assert [row[:3] for row in shown.rows] == [
        ["best-3", "100.0 %", "90.0 %"],
        ["study", percent(summary.layouts[1].planned), "52.5 %"],
    ]
    assert "worst 50 %" in shown.columns or summary.tail == 1.0

    item = judge("a layout with a name that goes on and on", [0.5, 0.6])
    whole = table(build_sampled_record([item], Uncertainty(), tail=1.0, seed=0))

    assert "\N{HORIZONTAL ELLIPSIS}" in whole.rows[0][0]
    assert len(whole.columns) == len(shown.columns) - (summary.tail < 1.0)


# Pairs


def test_every_pair_of_layouts_is_compared_world_by_world(judge):
    judged = [
        judge("a", [0.9, 0.8, 1.0, 0.9]),
        judge("b", [0.5, 0.9, 1.0, 0.5]),
        judge("c", [0.6, 0.6, 0.6, 0.6]),
    ]
    found = build_sampled_record(judged, load_uncertainty(), tail=1.0, seed=0)
    assert [gain.second for gain in found.gains] == ["b", "c"]

    summary = to_plain(found)
    named = {(pair["first"], pair["second"]): pair for pair in summary["pairs"]}
    assert list(named) == [
        ("a", "b"),
        ("a", "c"),
        ("b", "c"),
    ]

    first = named["a", "b"]
    expected = {
        "more_share": 0.5,
        "equal_share": 0.25,
        "less_share": 0.25,
        "mean": pytest.approx(np.mean([0.4, -0.1, 0.0, 0.4])),
    }
    assert first | expected == first

    json.dumps(summary)


def growth(stopped, ahead):
    """Rounds in 4, 8 and 16 worlds, of which 8 were taken."""

    def of(worlds, ahead):
        low, high = ahead
        return Round(
            worlds=worlds,
            in_sample=0.97,
            bound=0.98,
            mean=0.95,
            low=low,
            high=high,
        )

    rounds = (of(4, (None, None)), of(8, (0.001, 0.003)), of(16, ahead))
    return Growth(
        taken=8,
        compared_in=60,
        stopped=stopped,
        rounds=rounds,
    )


@pytest.mark.parametrize(
    ("stopped", "ahead", "words"),
    [
        (
            "same",
            (None, None),
            "Choosing in 8 worlds is enough (--samples 8): 16 worlds give the same ",
        ),
        (
            "no better",
            (-0.001, 0.0025),
            (
                "Choosing in 8 worlds is enough (--samples 8): in 60 fresh worlds,"
                " the layout from 16 worlds prevents -0.10 to +0.25 points more (95"
                " %)"
            ),
        ),
        ("time", (0.001, 0.002), "A longer --time-limit tries more worlds"),
        ("memory", (0.001, 0.002), "twice as many do not fit into the memory"),
        ("most", (0.001, 0.002), "was still improving"),
    ],
)
def test_it_is_told_how_many_worlds_are_enough_and_why(stopped, ahead, words):
    (told,) = growth_sentences(growth(stopped, ahead))
    assert words in told
    assert "--samples 8" in told
    assert growth_sentences(None) == []

    with speaking("de"):
        (german,) = growth_sentences(growth(stopped, ahead))
    assert "8 Welten" in german


def test_it_is_told_when_fresh_worlds_took_greedy_choice(judge):
    better = judge("greedy", [0.9, 0.8, 1.0, 0.9])
    worse = judge("found", [0.8, 0.75, 0.9, 0.8])
    taken = build_pair_record(better, worse)
    (planned,) = preferred_sentences(taken, None)
    (sampled,) = preferred_sentences(taken, 8)
    points = f"{100.0 * taken.mean:.2f} points more (95 %: {100.0 * taken.low:.2f} to "

    assert "The plan ignores chance, but in 60 sampled worlds the greedy" in planned
    assert "is better in the 8 worlds used for choosing" in sampled
    assert points in planned
    assert points in sampled
    assert taken.mean == pytest.approx(0.0875)
    assert preferred_sentences(build_pair_record(worse, better), 8) == []
    assert preferred_sentences(None, None) == []


def test_how_many_worlds_are_enough_is_the_second_sentence(summary):
    grown = growth("same", (None, None))
    _, told, *_ = uncertainty_sentences(msgspec.structs.replace(summary, growth=grown))
    assert told == f"{growth_sentences(grown)[0]}."
