"""Layouts that locate road users, and layouts by the decision to brake."""

from dataclasses import replace

import pytest

from experiments.jobs import placement
from experiments.parts.aims import words
from experiments.parts.decision_judging import false_brakings_per_hour
from experiments.parts.decision_section import build_part, build_section
from experiments.parts.reading import load_result
from experiments.progress import StageProgress
from geometry.errors import InputError
from placement.compute import Compute
from placement.detectors import load_detector
from placement.question import Question
from placement.setting import check_question
from placement.wishes import read_wishes
from scenarios.decision import load_decision_rule

pytestmark = pytest.mark.usefixtures("small_study")


def place(out, **options):
    """Result of a placement."""
    progress = StageProgress()
    return placement.run_placement(
        Question(budget=2, **options),
        out=out,
        compute=Compute(progress=progress),
        command="place-rsus",
        progress=progress,
    )


@pytest.mark.long
def test_a_located_layout_gives_up_no_more_than_may_be_and_is_the_same_again(tmp_path):
    usual = place(tmp_path / "usual")
    first = place(tmp_path / "first", located_m=0.4, decision="default")
    again = place(tmp_path / "again", located_m=0.4)

    assert first.layout == again.layout
    assert first.located == again.located
    assert first.located.share >= first.located.share_before
    assert first.located.n_judged >= 1

    highest = usual.highest.stages[0].objective
    assert first.apr >= highest - 0.01 - 1.0e-9

    of_aims, of_choice = words(first.aims, first.located)
    assert "within 0.4 m at the last moment" in of_choice

    known, by_eye = first.aims.layouts[0].located
    assert f"{100 * known:.1f} % of the runs; with aims known to 1°, " in of_aims
    assert f"{100 * by_eye:.1f} %." in of_aims

    decided = first.decision.layouts[0]
    by_eye = decided.by_aim["by eye"]
    assert decided.by_aim["calibrated"].located["0.40"] >= by_eye.located["0.40"]

    for one in decided.by_aim.values():
        # Who asks for more braking for nothing avoids no less.
        avoided = [rule.avoided for rule in one.best]
        assert avoided == sorted(avoided)
        assert one.avoided <= decided.detected + 1.0e-9
    assert build_part(first.decision).table.rows
    assert build_section(first.decision).blocks[-1].width_px > 0
    assert load_result(tmp_path / "first").summary.located == first.located


def test_tracks_of_nothing_brake_as_often_as_the_decision_lets_them_through():
    rule = replace(load_decision_rule(), false_tracks=40, false_tracks_braked_for=10)
    detector = load_detector("pole-2015")
    rate = detector.false_tracks_per_hour
    found = false_brakings_per_hour(detector, rule)

    # Wilson's interval of 10 of 40: 14.2 to 40.2 %.
    assert found.value == pytest.approx(0.25 * rate.value)
    assert found.low == pytest.approx(0.142 * rate.low, rel=2e-3)
    assert found.high == pytest.approx(0.402 * rate.high, rel=2e-3)
    assert false_brakings_per_hour(load_detector(), rule) is None


def test_more_tracks_of_nothing_than_there_are_cannot_be_braked_for(tmp_path):
    path = tmp_path / "rule.toml"
    path.write_text("false_tracks_braked_for = 88\n")
    with pytest.raises(InputError, match="at most the 87 of false_tracks"):
        load_decision_rule(str(path))


def test_nothing_is_said_where_nothing_was_asked():
    assert words(None, None) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": "0.9"}, "it beside `target`"),
        ({"fusion": "single"}, "it beside `fusion`"),
        ({"cars": "see"}, "it beside `cars`"),
        ({"survive": "1"}, "it beside `survive`"),
    ],
)
def test_locating_goes_with_no_other_objective(options, message):
    with pytest.raises(InputError, match=message):
        read_wishes(Question(budget=2, located_m=0.4, **options))


@pytest.mark.parametrize("name", ["none-of-them", "missing.toml"])
def test_a_rule_that_is_not_there_is_refused_before_anything_is_computed(name):
    with pytest.raises(InputError):
        check_question(Question(budget=2, decision=name))
