"""From wishes to a layout: proven, repeated, cached, refused."""

import logging
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused_with
from tiny_worlds import crossing_candidates, crossing_setting, unit_at

from placement import pipeline
from placement.compute import Compute
from placement.layout import check_layout
from placement.optimiser import (
    Effort,
    is_better,
    is_feasible,
    placement_value,
    solve_greedy,
    solve_sturdily,
)
from placement.pipeline import Assembly, pick_layout, place
from placement.sampling.tables import obtain_table
from placement.wishes import Wishes


@pytest.fixture(scope="module")
def setting(runs, rule):
    """The crossing's runs."""
    return crossing_setting(runs, rule=rule)


@pytest.fixture(scope="module")
def candidates(setting, camera):
    """Poses at the crossing."""
    return crossing_candidates(setting.scene, camera)


@pytest.fixture(scope="module")
def asked(setting, candidates):
    """Builds an instance of these from wishes, and other fields."""

    def build(*, candidates=candidates, effort=Effort(), compute=Compute(), **wishes):  # noqa: B008
        return Assembly(
            setting=setting,
            candidates=candidates,
            wishes=Wishes(**wishes),
            effort=effort,
            compute=compute,
        )

    return build


@pytest.fixture(scope="module")
def placement(asked):
    """The best two units."""
    return place(asked(budget_units=2))


def _best(problem):
    """Brute force over all layouts of any size."""
    best = None
    best_units = ()

    for n_units in range(1, problem.limits.max_units + 1):
        for units in combinations(range(problem.table.n_poses), n_units):
            if is_feasible(problem, units):
                value = placement_value(problem, units)
                if best is None or is_better(value, best):
                    best = value
                    best_units = units

    return best, best_units


def test_the_best_layout_is_proven_feasible_and_that_of_brute_force(
    placement, setting, candidates
):
    assert len(candidates) == 12
    assert placement.certificate.is_proven
    assert is_feasible(placement.problem, placement.pose_index)

    best, _ = _best(placement.problem)

    value = placement_value(placement.problem, placement.pose_index)

    assert not is_better(best, value)
    assert tuple(value) == pytest.approx(tuple(best), abs=1e-9)

    # Worth the test: neither nothing nor everything is avoided by any pose.
    single = [placement_value(placement.problem, [c]).apr for c in range(12)]

    assert max(single) > 0.0
    assert min(single) < max(single)


def test_the_certificate_is_about_the_layout(placement):
    value = placement_value(placement.problem, placement.pose_index)
    stages = {stage.name: stage for stage in placement.certificate.stages}

    assert stages["apr"].objective == pytest.approx(value.apr, abs=1e-9)

    for name, stage in stages.items():
        expected = getattr(value, name)
        assert stage.objective == pytest.approx(expected, abs=1e-6)
        assert stage.bound >= stage.objective - 1e-9


def test_the_layout_names_the_candidates_that_were_chosen(
    placement, setting, candidates
):
    layout = placement.layout

    assert layout.name == "best-2"
    assert [unit.id for unit in layout.units] == ["U1", "U2"]

    for unit, index in zip(layout.units, placement.pose_index, strict=True):
        assert unit.pose is candidates[index].pose
        assert unit.site_id == candidates[index].site_id
        assert unit.sensor == candidates[index].sensor

    check_layout(layout, setting.scene)
    expected = tuple(c.id for c in candidates)

    assert placement.problem.table.pose_ids == expected
    assert repr(placement) == f"Placement({layout!r}, proven)"
    assert set(placement.seconds) == {"detection_table", "optimise", "greedy"}
    assert min(placement.seconds.values()) >= 0.0


def test_the_greedy_layout_is_as_large_and_never_better(placement, candidates):
    assert placement.greedy.name == "greedy-2"

    index = solve_greedy(placement.problem)

    expected = [candidates[i].pose for i in index]

    assert [unit.pose for unit in placement.greedy.units] == expected

    greedy = placement_value(placement.problem, index)

    assert not is_better(
        greedy, placement_value(placement.problem, placement.pose_index)
    )


def test_the_same_question_gets_the_same_answer(asked, placement):
    again = place(asked(budget_units=2, compute=Compute(workers=2)))
    assert again.pose_index == placement.pose_index
    assert np.array_equal(again.problem.table.packed, placement.problem.table.packed)


# Budget


UNITS = "a whole number of units"


@pytest.mark.parametrize(
    ("budget", "message"),
    [
        (0, f"budget: got 0; expected {UNITS}, at least 1"),
        (
            5,
            f"budget: got 5; expected {UNITS}, 1 to 4 (what town05's sites can carry)",
        ),
        ("2", f"budget: got '2'; expected {UNITS}, at least 1"),
        (
            None,
            "budget: got nothing; expected `budget`, `budget_cost` or `target`",
        ),
    ],
)
def test_a_budget_that_cannot_be_is_refused_before_anything_is_computed(
    asked, budget, message
):
    def never(stage, done, total):
        raise AssertionError(stage)

    with refused_with(message):
        place(asked(budget_units=budget, compute=Compute(progress=never)))


def test_every_budget_that_the_sites_can_carry_is_allowed(asked):
    for budget in (1, 2, 3, 4):
        assert asked(budget_units=budget).limits.budget_units == budget


# Cache and progress


def _stages(calls):
    """Stages of progress in their order."""
    return list(dict.fromkeys(stage for stage, _, _ in calls))


def test_a_second_call_takes_the_table_from_the_cache(asked, placement, tmp_path):
    first = []
    second = []
    folder = tmp_path / "cache"

    for calls in (first, second):

        def told(*call, calls=calls):
            calls.append(call)

        compute = Compute(cache_folder=folder, progress=told)

        found = place(asked(budget_units=2, compute=compute))

        assert_array_equal(found.problem.table.packed, placement.problem.table.packed)
        assert found.pose_index == placement.pose_index

    assert _stages(first)[0] == "detection table"
    assert ("detection table", 2, 2) in first  # two mount positions
    assert _stages(second)[0] == "detection table (cached)"
    assert "detection table" not in _stages(second)
    assert _stages(second)[1] == "optimise"
    assert _stages(first)[-1] == "greedy"

    kept = sorted(path.name.split("-")[0] for path in folder.iterdir())

    assert kept == ["answer", "table"]


def test_a_proven_answer_is_solved_once_for_the_same_table_wishes_and_effort(
    asked, tmp_path, monkeypatch
):
    solved = []

    def count(problem, *arguments, **options):
        solved.append(problem)
        return solve_sturdily(problem, *arguments, **options)

    monkeypatch.setattr(pipeline, "solve_sturdily", count)

    def ask(budget, **options):
        compute = Compute(cache_folder=tmp_path)
        return place(asked(budget_units=budget, compute=compute, **options))

    first = ask(2)
    again = ask(2)

    assert len(solved) == 1
    assert again.certificate == first.certificate
    assert again.pose_index == first.pose_index
    assert repr(again.greedy) == repr(first.greedy)
    assert again.next_unit == first.next_unit
    assert again.presolved().statistics == first.presolve

    ask(1)
    ask(2, effort=Effort(time_limit_s=50.0))

    assert len(solved) == 3


@pytest.mark.parametrize("gap", [0.0, 0.1])
def test_only_a_proven_answer_is_kept(asked, tmp_path, monkeypatch, gap):
    def solve(problem, *arguments, **options):
        solution, sturdy = solve_sturdily(problem, *arguments, **options)
        first, *others = solution.certificate.stages
        stages = (replace(first, gap=gap), *others)
        certificate = replace(solution.certificate, stages=stages)
        return replace(solution, certificate=certificate), sturdy

    monkeypatch.setattr(pipeline, "solve_sturdily", solve)
    compute = Compute(cache_folder=tmp_path)

    place(asked(budget_units=1, compute=compute))

    assert any(tmp_path.glob("answer-*")) == (gap == 0.0)


def test_other_inputs_do_not_get_the_cached_table(setting, candidates, tmp_path):
    stages = []
    for seed in (0, 1, 0):
        calls = []

        def told(*call, calls=calls):
            calls.append(call)

        compute = Compute(
            seed=seed,
            workers=1,
            cache_folder=tmp_path,
            progress=told,
        )
        obtain_table(setting, candidates, compute=compute)
        stages.append(calls[0][0])

    assert stages == ["detection table", "detection table", "detection table (cached)"]


def test_a_damaged_cached_table_is_made_anew_and_replaced(
    asked, placement, tmp_path, caplog
):
    for _ in range(2):
        found = place(asked(budget_units=1, compute=Compute(cache_folder=tmp_path)))
        (path,) = tmp_path.glob("table-*")
        path.write_bytes(path.read_bytes()[:100])

    assert np.array_equal(found.problem.table.packed, placement.problem.table.packed)

    (record,) = caplog.records

    assert record.levelno == logging.WARNING


def test_a_cache_folder_that_cannot_be_is_no_error(asked, placement, tmp_path, caplog):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("", encoding="utf-8")

    found = place(asked(budget_units=2, compute=Compute(cache_folder=in_the_way)))

    assert found.pose_index == placement.pose_index
    assert any("nothing is cached" in message for message in caplog.messages)


# Poses of no site


def test_poses_of_no_site_stand_alone_on_sites_of_their_own(
    asked, setting, candidates, camera
):
    def extra(name, site_id):
        return unit_at(
            name,
            [-126.0, -1.0, 9.0],
            pitch_deg=-80.0,
            site_id=site_id,
            sensor=camera,
        )

    poses = (
        extra("drone", ""),
        *candidates[:2],
        extra("mast-w", "elsewhere"),  # named like a site, and not of it
        extra("kite", ""),
        candidates[6],
    )

    problem = asked(candidates=poses, budget_units=2).problem
    limits = problem.limits
    sites = limits.site_index.tolist()

    assert limits.site_capacity[sites].tolist() == [1, 2, 2, 1, 1, 2]
    assert sites[1] == sites[2]
    assert len(set(sites)) == 5
    assert replace(limits, budget_units=None).max_units == 6
    assert problem.rule is setting.rule


def test_poses_by_name_keep_their_names(asked, candidates):
    named = replace(candidates[0], id="RSU1")
    found = place(asked(candidates=[named], budget_units=1))

    assert [unit.id for unit in found.layout.units] == ["RSU1"]


def test_a_unit_kept_from_an_earlier_result_keeps_its_name_and_no_other_gets_it(
    candidates,
):
    kept = replace(candidates[0], id="U2")
    layout = pick_layout([*candidates[1:4], kept], (0, 1, 2, 3), "more")

    assert [unit.id for unit in layout.units] == ["U1", "U3", "U4", "U2"]


def test_without_candidates_nothing_is_placed(asked):
    with refused_with("candidates: got none; expected at least one pose"):
        place(asked(candidates=[], budget_units=1))


def test_more_units_than_the_candidates_allow_are_refused(asked, candidates):
    with refused_with(
        "budget: got 2; expected at most 1: candidates and their sites allow no more"
    ):
        place(asked(candidates=candidates[:1], budget_units=2))


def test_wishes_that_contradict_each_other_are_named_with_ways_out(asked):
    with refused_with(
        "`target` 1 and `budget` 1: got demands that no layout meets together; "
        "expected one of them to give way: `target` 0 or `budget` 3"
    ):
        place(asked(budget_units=1, target=1.0, survive=1))

    told = []
    compute = Compute(progress=lambda *stage: told.append(stage[0]))

    with refused_with(
        "`budget` 1 and `force_site` corner-ne,mast-w: got demands that no layout"
        " meets together; expected one of them to give way: `budget` 2 or"
        " `force_site` without corner-ne"
    ):
        place(
            asked(budget_units=1, forced_sites=("corner-ne", "mast-w"), compute=compute)
        )

    assert told[-1] == "find conflicting requirements"
