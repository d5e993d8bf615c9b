"""Greedy choice's layout in place of the one found, where fresh worlds prefer it."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from placement import pipeline
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.optimiser import apr
from placement.pipeline import Assembly, place
from placement.sampling.out_of_sample import SampledApr
from placement.sampling.uncertainty import load_uncertainty
from placement.wishes import Wishes

AHEAD = [0.8, 0.9, 0.9]
BEHIND = [0.5, 0.6, 0.5]


@pytest.fixture
def asked(setting, candidates, monkeypatch):
    """Builds an assembly; greedy choice takes a row, and fresh worlds say what they are
    told to.

    Each pose is there twice, so that there are ties.
    """

    def build(
        *,
        greedy,
        fresh=(BEHIND, AHEAD),
        n_samples=2,
        detector=None,
        cars=0.0,
        **wishes,
    ):
        monkeypatch.setattr(
            pipeline, "solve_greedy", lambda problem, reduced: (greedy,)
        )
        pairs = zip(("found", "greedy"), fresh, strict=True)
        told = dict(pairs)

        def judged(self, layouts, **how):
            return [
                SampledApr(
                    layout=layout,
                    axis=self.setting.axis,
                    apr_by_sample=told[layout.name],
                    avoided_share=np.ones(self.setting.axis.n_runs),
                )
                for layout in layouts
            ]

        monkeypatch.setattr(Assembly, "in_fresh_worlds", judged)
        detector = detector or setting.table_detector
        return Assembly(
            setting=replace(setting, table_detector=detector, cars=cars),
            candidates=[
                *candidates,
                *(replace(one, id=f"{one.id}'") for one in candidates),
            ],
            wishes=Wishes(budget_units=1, **wishes),
            uncertainty=replace(load_uncertainty("default"), packet_loss=0.3),
            n_samples=n_samples,
            compute=Compute(workers=1, seed=4),
        )

    return build


def values_of(assembly):
    """APR of each row alone."""
    n_poses = len(assembly.candidates)
    return [apr(assembly.problem, [row]) for row in range(n_poses)]


@pytest.mark.long
def test_fresh_worlds_take_greedy_choice_and_leave_the_bound(asked):
    before = place(asked(greedy=0))
    values = values_of(asked(greedy=0))
    greedy = int(np.argmin(values))

    question = asked(greedy=greedy)
    found = place(question, asks_worlds=True)
    names = [one.layout.name for one in found.preferred]

    assert values[before.pose_index[0]] == max(values)
    assert found.pose_index == (greedy,)
    assert names == ["greedy", "found"]

    stage, *others = found.certificate.stages

    assert stage.objective == pytest.approx(values[greedy])
    assert stage.bound == pytest.approx(max(values))
    assert not found.is_proven

    later = before.certificate.stages[1:]
    for one, other in zip(others, later, strict=True):
        assert one.name == other.name
        is_cost = one.name == "cost_eur"
        assert (one.bound <= one.objective) if is_cost else (one.bound >= one.objective)

    question_of_first = asked(greedy=0)
    candidate = question_of_first.candidates[greedy]
    expected = candidate.pose
    unit = found.layout.units[0]

    assert unit.pose == expected
    assert found.nominal.table.n_poses == 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("changed", "is_asked"),
    [
        ({"fresh": (AHEAD, BEHIND)}, True),
        ({"fresh": ([0.5, 0.9, 0.7], [0.9, 0.5, 0.7])}, True),  # as good
        ({"target": 0.01}, False),
        ({"min_case_apr": 0.01}, False),
        ({"tail": 0.5}, False),
        ({"n_samples": 0}, False),  # as planned, by rule and for blind cars
    ],
)
def test_what_was_found_stays_where_worlds_do_not_prefer_another(
    asked, changed, is_asked
):
    values = values_of(asked(greedy=0))
    worst = np.argmin(values)
    last = int(worst)
    question = asked(greedy=last, **changed)
    plain = place(question)
    found = asked(greedy=last, **changed)

    found = place(found, asks_worlds=True)

    assert found.pose_index == plain.pose_index

    expected = [stage.bound for stage in plain.certificate.stages]
    bounds = [stage.bound for stage in found.certificate.stages]

    assert bounds == expected
    assert (found.preferred is not None) == is_asked
    assert plain.preferred is None


@pytest.mark.long
@pytest.mark.parametrize(
    ("chance", "takes_worse"),
    [
        ({"cars": 1.0}, False),
        ({"detector": load_planning_detector("response")}, True),
    ],
)
def test_the_plan_is_overruled_where_it_cannot_tell_or_detections_are_drawn(
    asked, chance, takes_worse
):
    asked_of = {"n_samples": 0, **chance}
    question = asked(greedy=0, **asked_of)
    values = values_of(question)

    placed = place(question)
    best = placed.pose_index[0]
    as_good = [
        row for row, value in enumerate(values) if value == values[best] and row != best
    ]
    worse = [row for row, value in enumerate(values) if value < values[best] - 1e-6]

    for row, is_taken in (
        (as_good[0], True),
        (worse[0], takes_worse),
    ):
        other_question = asked(greedy=row, **asked_of)
        found = place(other_question, asks_worlds=True)

        assert found.pose_index == ((row,) if is_taken else (best,))
        assert (found.preferred is not None) == is_taken

        stage = found.certificate.stages[0]

        assert stage.bound == pytest.approx(values[best])
        assert stage.objective == pytest.approx(values[found.pose_index[0]])


@pytest.mark.long
@pytest.mark.parametrize("loses", ["little", "much"])
def test_a_layout_that_gives_up_more_than_may_be_given_up_is_not_called_sturdy(
    asked, loses, monkeypatch
):
    response = {"n_samples": 0, "detector": load_planning_detector("response")}
    build = asked(greedy=0, **response)
    two = Wishes(budget_units=2, give_up=0.0)
    n_poses = len(build.candidates)
    pairs = [*combinations(range(n_poses), 2)]

    values = {pair: apr(replace(build, wishes=two).problem, pair) for pair in pairs}
    highest = max(values.values())
    lowest = min(values.values())
    lost = highest - lowest

    assert lost > 0.01

    greedy = min(pairs, key=values.__getitem__)
    monkeypatch.setattr(pipeline, "solve_greedy", lambda problem, reduced: greedy)
    if loses == "little":
        give_up = lost + 0.01
    else:
        give_up = 0.5 * lost

    wishes = replace(two, give_up=give_up)
    plan = replace(build, wishes=wishes)
    found = place(plan, asks_worlds=True)
    if place(plan).pose_index == greedy:
        pytest.fail("the worst pair bears failures best: nothing is compared")

    assert found.pose_index == greedy
    assert (found.highest is None) == (loses == "much")

    by_name = {one.name: one for one in found.certificate.stages}
    stage = by_name["apr"]

    assert stage.objective == pytest.approx(lowest)
    assert stage.bound >= lowest

    if loses == "much":
        assert stage.bound == pytest.approx(highest)
