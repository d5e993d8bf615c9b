"""Random layouts and an expert's rule beside layouts found, and beside layouts
compared.
"""

from dataclasses import replace

import numpy as np
import pytest
from json_files import as_json
from small_results import place_small

from experiments.cli.running import cache_folder
from experiments.jobs import placement
from experiments.jobs.evaluation import run_comparison
from experiments.parts import baselines
from experiments.progress import StageProgress
from placement.compute import Compute
from placement.layout import Layout, layout_from_records, load_carlancap_layout
from placement.question import Question

pytestmark = pytest.mark.usefixtures("without_figures")


@pytest.fixture(autouse=True)
def alone(small_study, monkeypatch):
    """No study's layout is compared: it does not matter here."""
    monkeypatch.setattr(placement, "find_baseline", lambda scene: None)


def place(out, seed=0, **asked):
    """Plain result of a placement for two units."""
    question = Question(**({"budget": 2, "time_limit_s": 60.0} | asked))
    return place_small(question, out, seed=seed, cache_folder=cache_folder())


def compare(layouts, **asked):
    """Plain result of a comparison."""
    result = run_comparison(
        Question(**asked),
        layouts=layouts,
        out=None,
        compute=Compute(workers=2, cache_folder=cache_folder()),
        command="place-rsus",
        progress=StageProgress(),
    )
    return as_json(result)


def study_units(n_units):
    return load_carlancap_layout().units[:n_units]


# Quickly: tests/placement/test_baselines.py
@pytest.mark.long
def test_a_placement_is_shown_beside_random_layouts_and_an_experts(
    small_study, tmp_path
):
    summary = place(tmp_path / "out")
    random = summary["baselines"]["random"]
    expert = summary["baselines"]["expert"]

    assert random["layouts"] == 100
    assert random["units"] == 2
    assert random["low"] <= random["mean"] <= random["high"] <= summary["apr"]
    assert random["in_worlds"] is None
    assert len(expert["corners"]) == len(expert["layout"]) == 2

    # The evaluator says the same of the expert's layout by itself.
    layout = layout_from_records("expert", expert["layout"], "summary")
    (alone, *_) = compare([layout, Layout(name="other", units=study_units(1))])[
        "evaluation"
    ]["rsu_all"].values()

    assert expert["score"]["all"] == alone
    assert expert["score"]["units"] == 2

    other = place(tmp_path / "other", seed=1)["baselines"]
    assert other["expert"] == expert
    assert other["random"] != random

    tables = (tmp_path / "out/apr.csv").read_text()
    assert "\nexpert rule,rsu_all,all," in tables


@pytest.mark.long
def test_the_limits_hold_for_what_it_is_compared_with(small_study, tmp_path):
    asked = {"forbid_site": "corner-se", "separation_m": 30.0}
    expert = place(tmp_path / "out", **asked)["baselines"]["expert"]
    assert "corner-se" not in [unit["site"] for unit in expert["layout"]]

    places = np.array([[unit["x_m"], unit["y_m"]] for unit in expert["layout"]])
    assert np.hypot(*(places[0] - places[-1])) >= 30.0


@pytest.mark.long
def test_an_experts_layout_is_told_from_one_that_is_called_so(small_study):
    layouts = [
        Layout(name="expert-1", units=study_units(1)),
        Layout(name="b", units=study_units(2)),
    ]
    summary = compare(layouts, samples=2)

    assert [item["name"] for item in summary["sampled"]["layouts"]] == [
        "expert-1",
        "b",
        "expert-1 (2)",
    ]
    assert summary["baselines"]["expert"]["name"] == "expert-1 (2)"


def test_where_sites_cannot_carry_as_many_there_is_nothing_to_compare_with(small_study):
    few = replace(small_study.scene, sites=small_study.scene.sites[:1])  # for two units
    setting = replace(small_study, scene=few)
    layout = Layout(name="three", units=study_units(3))

    assert baselines.compare_layout(layout, setting, compute=Compute()) is None

    compute = Compute(workers=2, cache_folder=cache_folder())
    two = baselines.compare_layout(
        Layout(name="two", units=study_units(2)), setting, compute=compute
    )

    assert len(two.random.apr) == 100
    assert len(two.expert.units) == 1  # a corner has one camera

    bare = replace(small_study, scene=replace(few, sites=()))
    assert baselines.compare_layout(layout, bare, compute=Compute()) is None
