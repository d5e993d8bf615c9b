"""Explanations in sentences, as tables, on a terminal and in the report."""

import msgspec
import pytest
from partial_pages import render_section

from experiments.cli.answers import explanation_parts
from experiments.cli.terminal import answer_text
from experiments.parts.explanation import (
    ExplainedRecord,
    missed_section,
    missed_sentences,
    missed_table,
)


def explained(**parts):
    """A record of what is missed, if anything."""
    plain = {"not_avoided": [], "runs_without_weight": 0}
    return msgspec.convert(plain | parts, ExplainedRecord)


def missed(
    run, outcome="never seen", *, late_s=None, reasons=(), rescue=None, unit="a"
):
    """A run that is not avoided, as results have it."""
    return {
        "run": run,
        "outcome": outcome,
        "late_s": late_s,
        "frames_in_time": 30,
        "frames_seen": 2,
        "unit": unit,
        "reasons": [
            {"cause": cause, "thing": thing, "frames": frames}
            for cause, thing, frames in reasons
        ],
        "rescue": rescue,
    }


HELPER = {
    "unit": "c",
    "site": "pole",
    "distance_m": 12.34,
    "margin_s": 0.5,
}
MISSED = [
    missed(
        "r5",
        reasons=[
            ("hidden", "wall-ne-1", 20),
            ("out of view", "", 8),
        ],
        rescue=HELPER,
    ),
    missed(
        "r6", reasons=[("hidden", "wall-ne-1", 28)], rescue=HELPER | {"distance_m": 0.0}
    ),
    missed("r7", "too late", late_s=0.125, reasons=[("too far", "", 28)]),
    missed("r8", "hopeless", unit=""),
]


def test_runs_that_are_not_avoided_are_told_with_causes_and_remedies():
    found = explained(not_avoided=MISSED)
    assert missed_sentences(found) == [
        (
            "On the detection table, 4 runs are not avoided: 2 never seen, 1 confirmed"
            " too late, 1 too short for any unit."
        ),
        "The most frequent cause: hidden by wall-ne-1, in 2 runs.",
        "2 runs could each be avoided with one more unit.",
    ]
    assert missed_sentences(explained()) == [
        "On the detection table, every run is avoided."
    ]

    rows = missed_table(found).rows
    assert rows[0] == [
        "r5",
        "never seen",
        "for a: hidden by wall-ne-1 in 20 of 30 frames; out of view in 8 of 30 frames",
        "c, 12.3 m away, 0.50 s to spare",
    ]
    assert rows[1][3] == "c, at the same mount, 0.50 s to spare"
    assert rows[2][1:] == [
        "confirmed too late, by 0.12 s",
        (
            "for a: road user too small in the image, or too little of it visible in 28"
            " of 30 frames"
        ),
        "\N{EN DASH}",
    ]
    assert rows[3][2] == "the road user appears too late to be confirmed in time"


HIDDEN = [("hidden", "wall-ne-1", 20)]


@pytest.mark.parametrize(
    ("runs", "sentences"),
    [
        (
            [missed("r", "hopeless", unit="")],
            ["1 run is not avoided: too short for any unit."],
        ),
        (
            [missed("r", reasons=HIDDEN, rescue=HELPER)],
            [
                "1 run is not avoided: never seen.",
                "The main cause: hidden by wall-ne-1.",
                "It could be avoided with one more unit.",
            ],
        ),
        (
            [
                missed("r", reasons=HIDDEN, rescue=HELPER),
                missed("s", reasons=[("too far", "", 3)]),
            ],
            [
                "2 runs are not avoided: all never seen.",
                "1 run could be avoided with one more unit.",
            ],
        ),
        (
            [missed("r", reasons=HIDDEN, rescue=HELPER), missed("s", rescue=HELPER)],
            [
                "2 runs are not avoided: all never seen.",
                "The most frequent cause: hidden by wall-ne-1, in 1 run.",
                "Each of them could be avoided with one more unit.",
            ],
        ),
    ],
)
def test_one_run_is_told_as_one_and_several_as_several(runs, sentences):
    told = missed_sentences(explained(not_avoided=runs))
    assert len(told) == len(sentences)
    for sentence, expected in zip(told, sentences, strict=True):
        assert expected in sentence


def test_runs_without_weight_are_counted_in_one_sentence_and_nowhere_else():
    found = explained(runs_without_weight=1)
    assert missed_sentences(found) == [
        "On the detection table, every run that counts is avoided.",
        "Left out: 1 run of weight 0.",
    ]

    found = explained(not_avoided=MISSED[2:3], runs_without_weight=7)
    assert missed_sentences(found)[:2] == [
        "On the detection table, 1 run is not avoided: confirmed too late.",
        "Left out: 7 runs of weight 0.",
    ]
    assert "Left out: 7 runs of weight 0." in " ".join(terminal(found).split())


def terminal(found):
    """What the terminal says."""
    return answer_text(explanation_parts(found), is_verbose=True)


def test_a_terminal_shows_it_in_80_columns():
    runs = [missed(f"run-{i}", reasons=[("hidden", f"wall-{i}", 3)]) for i in range(10)]
    text = terminal(explained(not_avoided=MISSED + runs))
    assert max(map(len, text.splitlines())) <= 80

    words = " ".join(text.split())
    for expected in (
        "r5, r6: never seen; for a hidden by wall-ne-1; avoidable with c",
        "r7: confirmed too late; for a road user too",
        "and 5 more in summary.json",
    ):
        assert expected in words


def render(found):
    """What the report shows."""
    return render_section(missed_section(found))


def test_the_report_has_a_section_on_what_is_missed():
    page = render(explained())
    assert "every run is avoided" in page
    assert "<details" not in page

    page = render(explained(not_avoided=MISSED))
    assert "Runs that are not avoided</h2>" in page
    assert "hidden by wall-ne-1 in 20 of 30 frames" in page
    assert page.count("<table>") == page.count("</table>") == 1
    assert "4 runs: why, and what would avoid them" in page
    assert "1 run: why, and what would avoid it" in render(
        explained(not_avoided=MISSED[:1])
    )
