"""Placements and comparisons with cars that see, from the question to the checked
folder.
"""

import shutil
from dataclasses import fields, replace

import numpy as np
import pytest
from json_files import read_json, write_json
from small_results import (
    build_small_baseline,
    build_small_grid,
    lay_runs_of,
    place_small,
)

from experiments.cli.running import cache_folder
from experiments.jobs import placement
from experiments.jobs.evaluation import run_comparison
from experiments.jobs.verify import run_verification
from experiments.parts import baselines
from experiments.parts.added import MAX_UNITS, build_added
from experiments.parts.headline import by_unit
from experiments.progress import StageProgress
from geometry.errors import InputError
from placement import candidates as poses
from placement import pipeline
from placement.compute import Compute, silent
from placement.detectors import load_detector, load_planning_detector
from placement.evaluation import apr_one_failed
from placement.evaluator import evaluate_layout, with_sight
from placement.explain.contributions import find_failures
from placement.explain.tolerances import find_standing
from placement.layout import Layout
from placement.live import table_verdict
from placement.pipeline import assemble
from placement.question import Question
from placement.sampling.out_of_sample import out_of_sample_layouts
from placement.sampling.uncertainty import load_drawn

pytestmark = pytest.mark.usefixtures("without_figures")


def cached(progress=silent):
    """Tables of worlds that were asked about before are not built again."""
    return Compute(workers=2, cache_folder=cache_folder(), progress=progress)


def asked(out, **options):
    """Plain result of a placement for two units."""
    return place_small(Question(budget=2, **options), out, cache_folder=cache_folder())


def failed(folder):
    """Names of the checks that fail."""
    checks = run_verification(folder, progress=StageProgress()).checks
    return [check.name for check in checks if not check.passed]


@pytest.fixture(scope="module")
def answers(small_setting, tables, tmp_path_factory):
    """Folder and summaries of blind cars, of those that see, and of some that do."""
    folder = tmp_path_factory.mktemp("cars")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PLACE_RSUS_CACHE", str(tables))
        lay_runs_of(patch, small_setting)
        patch.setattr(pipeline, "N_JUDGED", 2)
        patch.setattr(poses, "load_candidate_grid", build_small_grid)
        patch.setattr(baselines, "load_candidate_grid", build_small_grid)
        patch.setattr(placement, "find_baseline", build_small_baseline)
        patch.setattr(placement, "write_report", lambda *given, **options: None)
        return folder, {
            cars: asked(folder / cars, cars=cars) for cars in ("blind", "see", "0.3")
        }


@pytest.mark.long
def test_answers_are_judged_by_what_cars_see(answers):
    folder, summaries = answers
    for cars, summary in summaries.items():
        share = summary["cars"]
        evaluation = summary["evaluation"]
        assert share == {"blind": 0.0, "see": 1.0, "0.3": 0.3}[cars]

        blind = evaluation["rsu_all"]["all"]
        seeing = evaluation["vut_and_rsus"]["all"]
        judged = (evaluation["headline"] or evaluation["rsu_all"])["all"]

        assert judged == pytest.approx(share * seeing + (1.0 - share) * blind)
        # Table and evaluator see the same with the car's own sensors as without.
        assert summary["apr"] == pytest.approx(judged, abs=0.05)
        assert summary["greedy"]["evaluation"]["headline"] is None or cars != "blind"
        assert all(stage["gap"] == 0.0 for stage in summary["stages"])
        assert failed(folder / cars) == []

    assert (
        summaries["see"]["apr"] >= summaries["0.3"]["apr"] >= summaries["blind"]["apr"]
    )
    assert (
        summaries["see"]["apr_without_worst_unit"]
        >= summaries["see"]["evaluation"]["vut"]["all"]
    )


@pytest.mark.long
def test_another_share_of_cars_is_found_out(answers, tmp_path):
    shutil.copytree(answers[0], tmp_path, dirs_exist_ok=True)
    for cars, other in (
        ("see", 0.5),
        ("0.3", 0.5),
        ("blind", 1.0),
    ):
        path = tmp_path / cars / "summary.json"
        summary = read_json(path)
        write_json(path, summary | {"cars": other})
        assert "summary.json: cars" in failed(tmp_path / cars)

        write_json(path, summary)
    certificate = tmp_path / "see/certificate.json"
    document = read_json(certificate)
    document["model"]["cars"] = 0.5
    write_json(certificate, document)

    assert "model" in failed(tmp_path / "see")

    document["model"]["cars"] = 1.0
    del document["model"]["in_words"]["cars"]
    write_json(certificate, document)

    assert "model in words" in failed(tmp_path / "see")


def test_blind_cars_are_asked_about_as_before(small_study):
    without = assemble(Question(budget=2), compute=cached())
    blind = assemble(Question(budget=2, cars="0"), compute=cached())
    see = assemble(Question(budget=2, cars="1"), compute=cached())

    assert without.problem.seen_by_vut is blind.problem.seen_by_vut is None
    assert with_sight(small_study) is small_study
    assert see.problem.table.n_poses == blind.problem.table.n_poses
    assert see.problem.seen_by_vut is not None


@pytest.mark.long
def test_comparisons_follow(small_study, tmp_path):
    layout = build_small_baseline(small_study.scene)
    assert layout is not None

    first = replace(layout, name="first", units=layout.units[:1])
    for cars in ("see", "0.3"):
        progress = StageProgress()
        result = run_comparison(
            Question(cars=cars),
            layouts=[first, layout],
            out=tmp_path / cars,
            compute=cached(progress),
            command="place-rsus compare",
            progress=progress,
        )

        assert result.apr == result.evaluation.judged.all
        assert result.evaluation.judged.all >= result.evaluation.rsu_all.all

        left = result.compared[0].evaluation.apr_without_worst_unit
        assert left >= result.cars * result.evaluation.vut.all - 1e-9


def test_what_units_add_is_told_one_by_one(small_study):
    layout = build_small_baseline(small_study.scene)
    evaluation = evaluate_layout(layout, small_study)
    for fusion in ("any", "single"):
        found = build_added(small_study, evaluation, fusion=fusion)
        everything = found.groups[0]
        assert everything.gain == pytest.approx(everything.with_units - everything.vut)

        gains = [unit.gain for unit in found.units]
        assert {unit.unit for unit in found.units} == {unit.id for unit in layout.units}
        assert everything.vut + sum(gains) == pytest.approx(
            everything.with_units, abs=1e-9
        )
        assert fusion == "single" or everything.with_units == pytest.approx(
            evaluation.vut_and_rsus.is_avoided @ small_study.axis.weight
        )

        first = found.units[0]
        told = by_unit(found.units)

        assert told.startswith(f"{first.unit} adds {100.0 * first.gain:.1f} points")
        assert {unit.unit for unit in found.alone} == {unit.id for unit in layout.units}

        blind = evaluation.rsu_all.is_avoided
        if fusion == "single":
            alone = [one.is_avoided for one in evaluation.units.values()]
            blind = np.any(alone, axis=0)
        gains = [unit.gain for unit in found.alone]
        assert sum(gains) == pytest.approx(blind @ small_study.axis.weight, abs=1e-9)

        kinds = {group.kind for group in found.groups}
        assert kinds >= {"all", "case"}
    unit = layout.units[0]
    names = [f"unit {number}" for number in range(MAX_UNITS + 1)]
    many = replace(layout, units=tuple(replace(unit, id=name) for name in names))

    assert build_added(small_study, replace(evaluation, layout=many)).units == ()
    assert by_unit(()) == by_unit(found.units[:1]) == ""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"cars": "some"},
            "cars: got 'some'; expected blind, see, or the share of cars that see",
        ),
        ({"cars": "nan"}, "cars: got 'nan'; expected blind, see, or the share"),
        ({"cars": "1.01"}, "cars: got '1.01'; expected blind, see, or the share"),
        (
            {"cars": "0.5", "refine": True},
            "cars: got '0.5'; expected blind or see beside `refine`",
        ),
    ],
)
def test_words_that_mean_nothing_are_refused(options, message):
    with pytest.raises(InputError) as caught:
        assemble(Question(budget=1, **options))
    assert str(caught.value).startswith(message)
    assert "cars" in {field.name for field in fields(Question)}


# Quickly: tests/placement/optimiser/test_cars.py
@pytest.mark.long
@pytest.mark.parametrize("detector", ["geometric", "response"])
def test_cars_see_in_sampled_worlds(small_study, tmp_path, monkeypatch, detector):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 2)
    question = Question(
        budget=2,
        cars="see",
        samples=2,
        detector=detector,
    )
    if detector == "response":
        change = {"detector": load_detector("response")}
        change["table_detector"] = load_planning_detector("response")
        lay_runs_of(monkeypatch, replace(small_study, **change))
    assembly = assemble(question, compute=cached())
    seen = assembly.problem.seen_by_vut
    n_frames = small_study.axis.n_frames

    assert seen.shape == (2 * n_frames,)

    worlds = seen.reshape(2, n_frames)
    planned = assembly.setting.seen_by_vut

    assert worlds.any(axis=1).all()
    if detector == "response":  # each world has misses of its own
        assert not np.array_equal(*worlds)
        assert not np.array_equal(worlds[0], planned)

    summary = asked(tmp_path / "out", cars="see", samples=2)
    (subject, *_) = summary["sampled"]["layouts"]

    assert 0.0 < subject["mean"] <= 1.0
    assert failed(tmp_path / "out") == []

    layout = Layout(name="two", units=tuple(assembly.candidates[:2]))
    drawn = load_drawn(question, assembly.scene, n_samples=3)
    blind = replace(assembly.setting, cars=0.0, seen_by_vut=None)
    seeing, by_units = (
        out_of_sample_layouts(setting, [layout], drawn, n_samples=3)[0].apr_by_sample
        for setting in (assembly.setting, blind)
    )

    assert (seeing >= by_units).all()
    assert seeing.sum() > by_units.sum()


@pytest.mark.long
def test_nothing_is_lost_where_the_car_sees_all(small_study):
    layout = build_small_baseline(small_study.scene)
    everything = np.ones(small_study.axis.n_frames, dtype=bool)
    setting = replace(small_study, cars=1.0, seen_by_vut=everything)
    best = table_verdict(
        [], np.zeros((0, len(everything)), dtype=bool), setting, with_vut=True
    )
    apr = best.is_avoided @ setting.axis.weight
    standing = find_standing(setting, layout.units)

    assert standing.worst.apr == pytest.approx(apr)
    assert standing.worst.lost_run_ids == ()

    half = replace(setting, cars=0.5)
    blind = find_standing(small_study, layout.units)
    assert find_standing(half, layout.units).worst.apr == pytest.approx(
        0.5 * apr + 0.5 * blind.worst.apr
    )


def test_whose_failure_costs_what_with_and_without_the_car(small_study):
    layout = build_small_baseline(small_study.scene)
    evaluation = evaluate_layout(layout, small_study)
    axis = small_study.axis
    by_units = find_failures(evaluation, small_study.rule)
    seeing = replace(evaluation, cars=1.0)
    with_car = find_failures(seeing, small_study.rule)

    assert with_car.none_failed.apr == pytest.approx(
        seeing.headline.is_avoided @ axis.weight
    )
    assert with_car.one_failed[0].apr == apr_one_failed(seeing, small_study.rule)
    assert by_units.one_failed[0].apr == apr_one_failed(evaluation, small_study.rule)
    assert apr_one_failed(replace(evaluation, cars=0.3), small_study.rule) >= (
        0.3 * with_car.one_failed[0].apr + 0.7 * by_units.one_failed[0].apr - 1e-12
    )

    one = replace(seeing, layout=replace(layout, units=layout.units[:1]))
    assert (
        apr_one_failed(one, small_study.rule) == evaluation.vut.is_avoided @ axis.weight
    )
