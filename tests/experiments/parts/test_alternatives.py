"""What would change an answer, in sentences."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.parts.alternatives import (
    FrontRunners,
    LeadingLayout,
    doubt_sentences,
    find_heavy_runs,
    recommended_sentences,
)
from placement.explain.alternatives import ByRuns
from placement.explain.tolerances import MountingError, Standing


def said(*, heavy_runs=(), by_runs=None, mounting=None):
    """Sentences of doubt about an answer for 482 runs."""
    return doubt_sentences(heavy_runs, by_runs, mounting, n_runs=482)


def standing(aim_deg, height_m, apr=1.0, lost=(), error="pitch", step=1.0):
    """Errors that lose nothing, and the worst of those that are compared."""
    worst = MountingError(
        unit_id="U3",
        kind=error,
        step=step,
        apr=apr,
        lost_run_ids=lost,
    )
    return Standing(aim_deg=aim_deg, height_m=height_m, worst=worst)


def heavy(*weight):
    """Heavy runs among runs of these weights."""
    names = tuple(f"CBTAno-50/north/{index}" for index in range(len(weight)))
    return find_heavy_runs(SimpleNamespace(weight=np.array(weight), run_ids=names))


def test_heavy_runs_are_named_the_heaviest_first():
    many = [0.8 / 79] * 79
    assert heavy(0.02, 0.0204, *[0.9596 / 98] * 98) == ()  # both are 2.0 % in print
    assert heavy(*[0.05] * 20) == ()  # all alike: the question is that small
    assert said(heavy_runs=heavy(0.2, *many)) == [
        "One run alone counts 20.0 % of the APR: CBTAno-50/north/0."
    ]
    assert said(heavy_runs=heavy(0.05, 0.15, *many)) == [
        "2 runs count 5.0 % to 15.0 % of the APR each: CBTAno-50/north/1,"
        " CBTAno-50/north/0."
    ]


@pytest.mark.parametrize(
    ("here", "is_proven", "text"),
    [
        (
            435,
            True,
            "If every run counted the same, no layout would be better than this one.",
        ),
        (
            435,
            False,
            (
                "No layout was found that would be better if every run counted the "
                "same. The search ran out of time, so one may exist."
            ),
        ),
        (
            432,
            True,
            (
                "If every run counted the same (--weights run), another layout would be"
                " best: it avoids 435 of 482 runs, this one 432 (on the detection"
                " table)."
            ),
        ),
    ],
)
def test_it_is_said_whether_the_layout_is_the_same_by_runs(here, is_proven, text):
    record = ByRuns(
        units=("a",),
        runs_avoided=435,
        runs_avoided_here=here,
        is_proven=is_proven,
    )
    assert said(by_runs=record) == [text]


def test_what_errors_of_mounting_cost_is_said():
    def of_mounting(*given, **options):
        return said(mounting=standing(*given, **options))[0]

    assert (
        of_mounting(2.0, 0.05)
        == "No run is lost if a unit is 2 degrees off its aim, or 5 cm too high or too"
        " low."
    )
    assert (
        of_mounting(0.0, 0.0, 0.931, ("a", "b"))
        == "Mount exactly: an aiming error of half a degree or a height error of 5 cm"
        " already loses a run. In the worst case, an error of 1 degree or 5 cm loses 2"
        " runs: with U3 tilted 1 degree up, the APR is 93.1 %."
    )
    assert of_mounting(0.0, 0.05, 0.9, ("a",), "yaw", -1.0).endswith(
        "a height error of 5 cm loses none. In the worst case, an error of 1 degree or"
        " 5 cm loses 1 run: with U3 turned 1 degree to the right, the APR is 90.0 %."
    )
    assert (
        of_mounting(1.0, 0.0, 0.9, ("a",), "height", -0.05)
        == "No run is lost if a unit is 1 degree off its aim, but a height error of 5 "
        "cm already loses one. In the worst case, an error of 1 degree or 5 cm "
        "loses 1 run: with U3 5 cm too low, the APR is 90.0 %."
    )


@pytest.mark.parametrize(
    ("decided_by", "why"),
    [
        (
            "apr",
            (
                "APR 90.2 % against 90.0 %, and 48.2 % against 36.5 % if any one unit"
                " fails"
            ),
        ),
        (
            "apr_one_failed",
            "the same APR, 90.0 %, and 48.2 % against 36.5 % if any one unit fails",
        ),
        (
            "mounting",
            (
                "the same APR, and 95.0 % against 93.0 % if a unit is mounted 1 degree"
                " or 5 cm off"
            ),
        ),
    ],
)
def test_the_evaluator_recommends_and_the_proof_is_about_the_other(decided_by, why):
    def runner(name, apr, left, wrongly):
        return LeadingLayout(
            name=name,
            layout=(None, None),
            apr=apr,
            apr_one_failed=left,
            mounting=standing(0.5, 0.05, wrongly),
        )

    record = FrontRunners(
        recommended="greedy-3",
        decided_by=decided_by,
        equal_within=0.001,
        layouts=(
            runner("best-3", 0.9, 0.365, 0.93),
            runner("greedy-3", 0.902, 0.482, 0.95),
        ),
    )

    assert recommended_sentences(record, is_proven=True) == [
        "Recommended: greedy-3, in recommended.json. The evaluator prefers it to"
        f" best-3: {why}. All else here is about best-3, which is proven best on the"
        " detection table."
    ]
    assert recommended_sentences(None, is_proven=True) == []
