"""Levels of a score: as runs of their own to the optimiser, and as plain loops."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracles import simulated_track_s
from problems import problems
from tiny_worlds import crossing_candidates, crossing_setting

from geometry.errors import InputError
from placement.city.fronts import value_at
from placement.city.junction import find_front
from placement.compute import Compute
from placement.detection_table import level_axis, level_table, pack_table, plain_axis
from placement.evaluation import score
from placement.evaluator import evaluate_layout
from placement.latency import apr_by_latency
from placement.optimiser import (
    Effort,
    UnmetError,
    apr,
    placement_value,
    solve_placement,
)
from placement.optimiser.front import pareto_front
from placement.pipeline import Assembly, assemble, place
from placement.question import Question
from placement.setting import build_setting
from placement.verification.certificates import (
    build_certificate,
    load_certificate,
    save_certificate,
)
from placement.verification.instances import load_problem
from placement.verification.recomputation import margins_s
from placement.verification.verify import verify_certificate
from placement.wishes import Wishes, build_problem
from scenarios.scores import Levels, build_levels

TOLERANCE_S = 1e-9


@st.composite
def scored(draw):
    """A small problem of runs, levels of them, and the problem of the levels."""
    problem = draw(problems())
    axis = problem.table.axis
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = []
    for run, last_s in enumerate(axis.last_brake_time_s.tolist()):
        n_more = int(rng.integers(0, 4))
        begin_s = max(last_s, -0.7)
        later = np.sort(
            rng.uniform(
                begin_s,
                0.0,
                n_more,
            )
        )
        if last_s == -np.inf:
            later[rng.random(n_more) < 0.2] = -np.inf
        shares = np.sort(
            rng.choice(
                [0.25, 0.5, 0.75],
                n_more,
                replace=False,
            )
        )[::-1]
        gains = -np.diff([1.0, *shares, 0.0])
        rows += [
            (run, below, gain, at_s)
            for below, gain, at_s in zip(
                [0.0, 10.0, 20.0, 30.0], gains, [last_s, *np.sort(later)], strict=False
            )
        ]

    run_index, below, gain, deadline = map(np.array, zip(*rows, strict=True))
    levels = Levels(
        score="made up",
        run_index=run_index,
        below_kmh=below,
        gain=gain,
        deadline_s=deadline,
    )
    table = level_table(problem.table, levels, problem.rule)
    seen = problem.seen_by_vut
    if seen is not None:
        seen = seen[
            level_axis(
                axis,
                levels,
                problem.rule,
            )[1]
        ]
    return (
        problem,
        levels,
        replace(
            problem,
            table=table,
            seen_by_vut=seen,
        ),
    )


def looped_score(problem, levels, chosen):
    """Score of a set of poses, frame by frame and run by run."""
    axis = problem.table.axis
    rule = problem.rule
    detected = problem.detected(list(chosen)).astype(bool)
    if problem.fusion == "any":
        eyes = [detected.any(axis=0)]
    else:
        eyes = list(detected)
    total = 0.0
    for run in range(axis.n_runs):
        frames = axis.frames_of(run)
        last_s = float(axis.last_brake_time_s[run])
        times = axis.time_s[frames].tolist()
        onset_s = math.inf

        for eye in eyes if len(detected) else []:
            seen = [bool(each) for each in eye[frames]]
            live_s = simulated_track_s(
                seen,
                times,
                until_s=last_s - rule.latency_s,
                memory_s=rule.track_memory_s,
                n=rule.n_confirmations,
            )
            if live_s < math.inf:
                onset_s = -math.inf
            for frame in range(rule.n_confirmations - 1, len(times)):
                known_s = times[frame] + rule.latency_s
                window = seen[frame + 1 - rule.n_confirmations : frame + 1]
                if all(window) and known_s > last_s + TOLERANCE_S:
                    onset_s = min(onset_s, known_s)

        for level in np.flatnonzero(levels.run_index == run):
            deadline_s = float(levels.deadline_s[level])
            is_avoided = onset_s == -math.inf
            if is_avoided or onset_s <= deadline_s + TOLERANCE_S:
                total += float(axis.weight[run]) * float(levels.gain[level])

    return total


def all_sets(problem):
    poses = range(problem.table.n_poses)
    most = problem.limits.budget_units
    for size in range(1, most + 1):
        for chosen in combinations(poses, size):
            at = np.bincount(problem.limits.site_index[list(chosen)], minlength=1)
            if (at <= problem.limits.site_capacity[: len(at)]).all():
                yield chosen


@settings(max_examples=40)
@given(scored())
def test_score_of_every_layout_is_that_of_plain_loops(case):
    problem, levels, by_levels = case
    for chosen in all_sets(problem):
        expected = looped_score(problem, levels, chosen)
        assert apr(by_levels, chosen) == pytest.approx(expected, abs=1e-12)

        margin_s = margins_s(by_levels, np.array([chosen]))[0]
        weight = by_levels.table.axis.weight

        assert weight[margin_s > -np.inf].sum() == pytest.approx(expected, abs=1e-12)


@settings(max_examples=20)
@given(scored())
def test_the_optimiser_finds_and_proves_the_best_score_of_all_layouts(case):
    problem, levels, by_levels = case
    best = max(
        looped_score(
            problem,
            levels,
            chosen,
        )
        for chosen in all_sets(problem)
    )
    solution = solve_placement(by_levels)
    stage = solution.certificate.stages[0]

    assert (stage.name, stage.gap) == ("apr", 0.0)
    assert stage.objective == pytest.approx(best, abs=1e-9)
    assert looped_score(
        problem,
        levels,
        solution.pose_index,
    ) == pytest.approx(best, abs=1e-9)

    front = pareto_front(by_levels, max_units=by_levels.limits.budget_units)

    assert front.is_proven

    for point in front.points:
        most = max(
            looped_score(problem, levels, chosen)
            for chosen in all_sets(problem)
            if len(chosen) <= point.units
        )
        assert point.value.apr == pytest.approx(most, abs=1e-9)


@given(scored())
def test_margins_of_levels_are_those_to_the_last_moment(case):
    problem, levels, by_levels = case
    everything = list(range(problem.table.n_poses))
    value = placement_value(by_levels, everything)
    plain = placement_value(problem, everything)
    assume(plain.apr > 0.0 and (levels.gain[levels.first] > 0.0).all())

    assert value.smallest_margin_s <= plain.smallest_margin_s + TOLERANCE_S


@given(problems(), st.integers(0, 2**32 - 1))
def test_one_level_for_each_run_changes_nothing(problem, seed):
    axis = problem.table.axis
    levels = Levels(
        score="avoided",
        run_index=np.arange(axis.n_runs),
        below_kmh=np.zeros(axis.n_runs),
        gain=np.ones(axis.n_runs),
        deadline_s=axis.last_brake_time_s,
    )
    again, frames = level_axis(axis, levels, problem.rule)

    assert np.array_equal(frames, np.arange(axis.n_frames))

    for name in ("run_ids", "weight", "last_brake_time_s", "time_s", "run_start"):
        assert np.array_equal(getattr(again, name), getattr(axis, name))
    table = level_table(problem.table, levels, problem.rule)

    assert np.array_equal(table.packed, problem.table.packed)


def test_a_level_has_its_runs_name_weight_and_frames_up_to_its_deadline(
    frame_axis,
    rule,
):
    levels = Levels(
        score="made up",
        run_index=np.array([0, 0, *range(1, frame_axis.n_runs)]),
        below_kmh=np.array([0.0, 20.0, *[0.0] * (frame_axis.n_runs - 1)]),
        gain=np.array([0.5, 0.5, *[1.0] * (frame_axis.n_runs - 1)]),
        deadline_s=np.array([-np.inf, 0.0, *frame_axis.last_brake_time_s[1:]]),
    )
    table = pack_table(
        ("a",),
        frame_axis,
        np.ones((1, frame_axis.n_frames), dtype=bool),
    )
    axis = level_table(table, levels, rule).axis
    first = frame_axis.run_ids[0]

    assert axis.run_ids[:2] == (first, f"{first}<20")
    assert axis.weight[:2] == pytest.approx([0.5 * frame_axis.weight[0]] * 2)

    in_time = (
        frame_axis.time_s[frame_axis.frames_of(0)] + rule.latency_s <= 1e-9
    ).sum()

    assert np.diff(axis.run_start)[1] == in_time


@settings(max_examples=10)
@given(scored())
def test_a_citys_front_of_a_junction_has_the_best_score_for_any_number_of_units(case):
    problem, levels, by_levels = case
    try:
        front, layouts = find_front(
            by_levels,
            effort=Effort,
            begin=lambda _: None,
        )
    except UnmetError:
        return
    most = {
        n: max(
            looped_score(problem, levels, chosen)
            for chosen in all_sets(problem)
            if len(chosen) <= n
        )
        for n in range(1, by_levels.limits.budget_units + 1)
    }
    for point, layout in zip(front.points, layouts, strict=True):
        expected = looped_score(problem, levels, layout)
        assert point.apr == pytest.approx(expected, abs=1e-9)
    for n, best in most.items():
        reached = max(point.apr for point in front.points if point.units <= n)
        assert reached == pytest.approx(best, abs=1e-9)
        assert value_at(front.by_units, n) >= best - 1e-9


# ---------- a junction


@pytest.fixture(scope="module")
def setting(runs, rule):
    plain = crossing_setting(runs, rule=replace(rule, track_memory_s=0.5))
    levels = build_levels(plain.runs, "rating-2026", plain.rule)

    assert len(levels.gain) > 1.5 * len(plain.runs)

    return replace(plain, levels=levels)


@pytest.fixture(scope="module")
def assembly(setting, camera):
    candidates = crossing_candidates(setting.scene, camera)
    return Assembly(
        setting=setting,
        candidates=candidates,
        wishes=Wishes(budget_units=2),
    )


def test_a_placement_by_score_is_the_best_of_all_layouts_in_plain_loops(
    assembly,
    setting,
):
    found = place(assembly)
    base = build_problem(
        setting, assembly.candidates, assembly.table, wishes=assembly.wishes
    )
    scores = {
        chosen: looped_score(
            base,
            setting.levels,
            chosen,
        )
        for chosen in all_sets(base)
    }

    assert len({round(value, 9) for value in scores.values()}) > 5
    assert found.certificate.is_proven

    stage = found.certificate.stages[0]

    assert (
        stage.objective == stage.bound == pytest.approx(max(scores.values()), abs=1e-9)
    )
    assert scores[found.pose_index] == pytest.approx(max(scores.values()), abs=1e-9)
    # As they are, the same units avoid what the base table says.
    assert found.nominal.table.axis.run_ids == setting.axis.run_ids
    assert apr(found.nominal, found.nominal_index) == apr(base, found.pose_index)
    assert apr(found.nominal, found.nominal_index) <= stage.objective + 1e-9


def test_the_certificate_of_a_score_holds_and_says_so(assembly, tmp_path):
    found = place(assembly)
    document = build_certificate(
        found.problem,
        found.certificate,
        pose_index=found.pose_index,
        units=[{"id": unit.id, "site": unit.site_id} for unit in found.layout.units],
        presolve=found.presolve,
        seconds={"optimise": 1.0},
        versions={"place-rsus": "0"},
    )
    save_certificate(tmp_path, document, found.problem)
    problem = load_problem(tmp_path / "instance.npz")

    assert problem.table.axis.run_ids == found.problem.table.axis.run_ids

    shown = [dict(entry["unit"]) for entry in document["layout"]]
    stored = load_certificate(tmp_path / "certificate.json")
    verified = verify_certificate(problem, stored, shown)

    assert verified.passed
    assert all(proof.is_proven_again for proof in verified.proofs[:1])
    assert "level of the run" in document["model"]["in_words"]["levels"]

    # A run's levels weigh what it does.
    plain = plain_axis(problem.table.axis)

    assert plain.run_ids == assembly.setting.axis.run_ids
    assert plain.weight == pytest.approx(assembly.setting.axis.weight)
    assert plain.cases == assembly.setting.axis.cases

    # Another score is found out.
    worse = {**document, "stages": [dict(stage) for stage in document["stages"]]}
    worse["stages"][0]["objective"] += 0.01
    save_certificate(tmp_path, worse, found.problem)
    stored = load_certificate(tmp_path / "certificate.json")

    assert not verify_certificate(problem, stored, shown).passed


def test_the_evaluator_scores_by_bodies_what_the_table_scores_by_onsets(
    assembly,
    setting,
):
    found = place(assembly)
    evaluation = evaluate_layout(found.layout, setting)

    assert evaluation.levels is setting.levels

    by_table = apr(found.problem, found.pose_index)

    assert score(
        evaluation.rsu_all,
        setting.axis,
        setting.levels,
    ) == pytest.approx(by_table, abs=0.1)

    latencies_s = [setting.rule.latency_s, *np.linspace(0.0, 1.0, 11)]
    curve = apr_by_latency(evaluation, setting.rule, latencies_s)["rsu_all"]
    onsets = setting.levels.of_onsets(evaluation.rsu_all.onset_time_s, TOLERANCE_S)

    assert curve[0] == pytest.approx(onsets @ setting.axis.weight)

    without = replace(evaluation, levels=None)
    plain = apr_by_latency(without, setting.rule, latencies_s)["rsu_all"]

    assert (curve >= plain - 1e-12).all()


@pytest.mark.parametrize(("field", "value"), [("samples", 2), ("refine", True)])
def test_sampled_worlds_and_refinement_do_not_know_scores(field, value):
    question = Question(
        budget=1,
        score="rating-2026",
        **{field: value},
    )
    with pytest.raises(InputError) as error:
        assemble(question)
    assert (
        str(error.value)
        == f"score: got 'rating-2026'; expected avoided beside `{field}`"
    )


def test_a_question_with_a_score_has_levels_and_one_without_has_none(tmp_path):
    words = {
        "cases": "CPNCO-50",
        "approaches": "north",
        "speeds": "50,60",
        "along_arms": "0",
    }
    compute = Compute(cache_folder=tmp_path)
    plain = build_setting(Question(**words), compute=compute)
    scored = build_setting(Question(**words, score="rating-2026"), compute=compute)
    again = build_setting(Question(**words, score="rating-2026"), compute=compute)

    assert plain.levels is None
    assert scored.levels.below_kmh.tolist() == [0.0, 10.0, 20.0, 30.0] * len(
        scored.runs
    )
    assert np.array_equal(scored.levels.deadline_s, again.levels.deadline_s)
    assert np.array_equal(plain.axis.weight, scored.axis.weight)
