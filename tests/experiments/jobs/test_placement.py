"""Placements, evaluations and comparisons as jobs: what they return and write."""

import re
from dataclasses import fields, replace

import pytest
from json_files import as_json, read_json

from experiments.cli.running import cache_folder
from experiments.jobs import placement
from experiments.jobs.evaluation import run_comparison, run_evaluation
from experiments.jobs.verify import run_verification
from experiments.progress import StageProgress
from geometry.errors import InputError
from placement import certify, pipeline
from placement.compute import Compute
from placement.layout import Layout, load_carlancap_layout, load_layout
from placement.question import Question


def place(out, **options):
    """Plain result of a placement for one unit, unless another is asked for."""
    progress = options.get("progress", StageProgress())
    given = {
        "out": out,
        "compute": Compute(workers=2, cache_folder=cache_folder(), progress=progress),
        "command": "place-rsus --budget 1 <&>",
        "progress": progress,
    }
    asked = {"budget": 1, "time_limit_s": 60.0}
    names = {field.name for field in fields(Question)} & set(options)
    asked |= {name: options.pop(name) for name in names}
    question = options.pop("question", Question())
    result = placement.run_placement(replace(question, **asked), **(given | options))
    return as_json(result)


def evaluate(layout, out=None):
    """Plain result of an evaluation."""
    progress = StageProgress()
    result = run_evaluation(
        Question(),
        layout=layout,
        out=out,
        compute=Compute(workers=2, progress=progress),
        command="place-rsus",
        progress=progress,
    )
    return as_json(result)


def compare(layouts, out, **asked):
    """Plain result of a comparison."""
    result = run_comparison(
        Question(**asked),
        layouts=layouts,
        out=out,
        compute=Compute(workers=2, cache_folder=cache_folder()),
        command="place-rsus",
        progress=StageProgress(),
    )
    return as_json(result)


def named(name: str, n_units: int = 1) -> Layout:
    """Some of the study's units under a name."""
    return Layout(name=name, units=load_carlancap_layout().units[:n_units])


@pytest.mark.long
@pytest.mark.usefixtures("own_cache")
def test_a_placement_is_written_as_it_is_returned(small_study, tmp_path):
    progress = StageProgress()
    summary = place(tmp_path / "out", progress=progress)

    assert read_json(tmp_path / "out/summary.json") == summary
    assert load_layout(tmp_path / "out/layout.json").name == "best-1"

    stages = ["setting", "detection table", "optimise", "greedy", "explain"]
    assert list(summary["seconds"]) == [
        "start",
        *stages,
        "other priorities",
        "evaluate",
        "study's cases",
        "tolerances",
        "write results",
        "total",
    ]

    page = (tmp_path / "out/report.html").read_text()
    assert "place-rsus --budget 1 &lt;&amp;&gt;" in page
    assert "1 <&>" not in page
    assert len(summary["front"]["sentences"]) == 1
    assert summary["explained"]["runs_without_weight"] == 0
    assert "Runs that are not avoided" in page
    assert progress.kept == f"the results are in {tmp_path}/out"


# Quickly: tests/placement/sampling/test_certify.py, parts/test_uncertainty_summary.py
@pytest.mark.long
@pytest.mark.usefixtures("small_study", "without_figures")
def test_the_number_of_worlds_is_told_and_gives_the_same_answer(tmp_path, monkeypatch):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 3)
    monkeypatch.setattr(certify, "N_JUDGED", 2)
    monkeypatch.setattr(pipeline, "N_JUDGED", 2)
    found = place(tmp_path / "auto", samples="auto")
    growth = found["sampled"]["growth"]

    assert found["sampled"]["chosen_in"] == growth["taken"]
    assert [one["worlds"] for one in growth["rounds"]][-1] >= growth["taken"]

    again = place(tmp_path / "number", samples=growth["taken"])
    assert again["layout"] == found["layout"]
    assert again["apr"] == found["apr"]
    assert again["sampled"] == found["sampled"] | {"growth": None}


@pytest.mark.usefixtures("small_study", "without_figures")
def test_a_layout_brings_its_own_sensors_along(tmp_path, monkeypatch):
    # The study's poses.
    monkeypatch.setattr(pipeline, "find_baseline", lambda scene: None)
    catalogue = tmp_path / "mine.toml"
    catalogue.write_text(
        """
        [cameras.wide]
        width_px = 1920
        height_px = 1080
        horizontal_fov_deg = 120.0
        frame_rate_hz = 10.0
        near_m = 0.5
        price_eur = 100.0
        """
    )
    summary = place(tmp_path / "out", sensors=f"{catalogue}:wide")

    assert summary["layout"][0]["camera"] == "wide"

    catalogue.unlink()
    layout = load_layout(tmp_path / "out/layout.json")

    assert layout.units[0].sensor.horizontal_fov_deg == 120.0
    assert evaluate(layout)["cost_eur"] == 100.0

    catalogue.write_text("[cameras]")
    with pytest.raises(InputError, match="got no model"):
        place(tmp_path / "out", sensors=str(catalogue))


def test_a_budget_that_is_too_large_is_refused_before_anything_else(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(pipeline, "build_setting", pytest.fail)
    with pytest.raises(InputError, match="budget: got 10000; expected a whole number"):
        place(tmp_path / "a/b", budget=10_000)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_where_no_folder_is_given(
    small_study, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    summary = evaluate(named("one"))

    assert list(tmp_path.iterdir()) == []
    assert list(summary["seconds"]) == ["start", "setting", "evaluate", "total"]


def test_an_evaluation_of_one_unit_is_that_of_all(small_study):
    evaluation = evaluate(named("one"))["evaluation"]
    assert evaluation["units"] == {"RSU0": evaluation["rsu_all"]}
    assert evaluation["vut_and_rsus"]["all"] >= evaluation["rsu_all"]["all"]


@pytest.mark.long
def test_layouts_of_the_same_name_are_told_apart(small_study, tmp_path):
    layouts = [named("twin", 2), named("twin", 1), named("other", 3)]
    summary = compare(layouts, tmp_path / "out")

    assert summary["name"] == "twin"
    assert [other["name"] for other in summary["compared"]] == ["twin (2)", "other"]
    assert summary["compared"][0]["runs_lost"] == []

    names = re.findall(
        r"^([^,]*),vut,all,all,all,all,", (tmp_path / "out/apr.csv").read_text(), re.M
    )
    assert list(dict.fromkeys(names)) == ["twin", "twin (2)", "other", "expert rule"]
    assert [other["name"] for other in summary["compared"]] == ["twin (2)", "other"]

    page = (tmp_path / "out/report.html").read_text()
    assert all(name in page for name in names)


def test_a_layout_may_be_called_greedy(small_study):
    assert evaluate(named("greedy"))["name"] == "greedy (2)"


@pytest.mark.long
def test_a_layout_is_chosen_in_sampled_worlds_and_judged_in_fresh_ones(
    small_study, tmp_path, monkeypatch
):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 3)
    summary = place(
        tmp_path / "out",
        samples=2,
        risk="worst",
        budget=2,
        packet_loss=0.25,
    )
    sampled = summary["sampled"]

    assert sampled["samples"] == 3
    assert sampled["uncertainty"]["packet_loss"] == 0.25
    assert sampled["tail"] == 0.5

    subject, *others = sampled["layouts"]
    assert subject["name"] == "best-2"
    assert [other["name"] for other in others] == [
        "greedy-2",
        "expert-2",
        "carlancap-12",
    ]
    assert len(subject["apr_by_sample"]) == 3
    assert subject["worst"] == min(subject["apr_by_sample"])
    assert summary["surrogate_disagreement"] is not None

    page = (tmp_path / "out/report.html").read_text()
    assert "If the world is not as planned" in page
    assert "25.0 % of the messages lost" in page


@pytest.mark.long
@pytest.mark.parametrize(
    "asked",
    [
        {"budget": 2},
        pytest.param(
            {"target": "0.5", "least": "cost", "budget": None}, marks=pytest.mark.long
        ),
    ],
)
def test_a_layout_chosen_in_worlds_is_verified_and_has_an_apr_there(
    small_study, tmp_path, monkeypatch, asked
):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 1)
    summary = place(tmp_path / "out", samples=2, **asked)
    first = summary["stages"][0]
    in_worlds = summary["sampled"]["layouts"][0]["in_sample"]

    assert 0.0 < in_worlds <= 1.0
    assert (first["name"] == "cost_eur") == ("least" in asked)
    if first["name"] == "apr":
        assert in_worlds == pytest.approx(first["objective"])

    checked = run_verification(tmp_path / "out", progress=StageProgress())
    assert [check for check in checked.checks if not check.passed] == []


def test_refinement_is_refused_where_poses_are_given(tmp_path):
    with pytest.raises(
        InputError, match="refine: got it beside `within`; expected one of them"
    ):
        place(tmp_path / "out", refine=True, within="carlancap-12")
