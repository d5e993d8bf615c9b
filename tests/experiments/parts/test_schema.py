"""Results of every kind against their JSON schema, and that against the
documentation.
"""

import copy
import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from command_results import answer
from json_files import as_json, read_json
from private_garden import write_garden
from small_results import build_small_baseline, build_small_grid, lay_runs_of

from experiments.export.json import to_json
from experiments.jobs import placement
from experiments.parts.reading import load_result
from experiments.parts.schema import SCHEMA_FILE, schema_text
from placement import candidates as poses
from placement import pipeline
from placement.explain.agreement import Disagreement
from placement.layout import RESULT_SCHEMAS, Layout, load_carlancap_layout
from placement.setting import Radio
from scenarios.runs import build_frame_axis

DOCUMENT = read_json(files("experiments") / "data/result.schema.json")
VALIDATOR = jsonschema.Draft202012Validator(DOCUMENT)
# Asked alone, it ends at the first fault.
PLACEMENT = jsonschema.Draft202012Validator(
    {"$ref": "#/$defs/placement_result", "$defs": DOCUMENT["$defs"]}
)
DOCS = Path(__file__).parents[3] / "docs"


KINDS = ("placement_result", "evaluation_result", "comparison_result")


def messages(summary):
    """What is wrong with a summary, by the schema."""
    return [
        f"{error.json_path}: {error.message}"
        for error in VALIDATOR.iter_errors(summary)
    ]


def parts(node, where="$"):
    """Every object of a schema that says what it is for, and where it stands."""
    if isinstance(node, dict):
        yield where, node
        for key, value in node.items():
            yield from parts(value, f"{where}.{key}")
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from parts(value, f"{where}[{index}]")


def with_first_of_each(node):
    """A summary whose lists of objects hold the first one only: the others are
    alike.
    """
    if isinstance(node, dict):
        return {key: with_first_of_each(value) for key, value in node.items()}
    if isinstance(node, list) and all(isinstance(item, dict) for item in node):
        return [with_first_of_each(item) for item in node[:1]]
    return node


# ---------------------------------------------------------------- the schema itself


def test_the_schema_is_that_of_the_types():
    """Else: python -m experiments.parts.schema."""
    assert SCHEMA_FILE.read_text() == schema_text()


@pytest.mark.long
def test_the_schema_is_one_and_leaves_nothing_open_or_unsaid():
    jsonschema.Draft202012Validator.check_schema(DOCUMENT)
    kinds = [DOCUMENT["$defs"][kind] for kind in KINDS]
    assert (
        tuple(kind["properties"]["schema"]["const"] for kind in kinds) == RESULT_SCHEMAS
    )

    n_keys = 0
    for where, node in parts(DOCUMENT):
        if node.get("type") == "object" and where != "$":
            assert "additionalProperties" in node, where
        if isinstance(node.get("properties"), dict) and node.get("type") == "object":
            assert node["additionalProperties"] is False, where
            assert set(node["required"]) <= set(node["properties"]), where
            for name, value in node["properties"].items():
                n_keys += 1
                assert value.get("description", "").endswith("."), f"{where}.{name}"
    assert n_keys > 200


def test_names_that_end_in_a_unit_say_so_in_words_too():
    units = {
        "_m": "metres",
        "_s": "seconds",
        "_deg": "degrees",
        "_eur": "EUR",
        "_kmh": "km/h",
    }
    n_named = 0
    for where, node in parts(DOCUMENT):
        if node.get("type") == "object":
            properties = node.get("properties", {})
        else:
            properties = {}
        for name, value in properties.items():
            unit = next(
                (words for end, words in units.items() if name.endswith(end)), None
            )
            if unit is not None:
                n_named += 1
                assert unit in value["description"], f"{where}.{name}"

    assert n_named > 20


def test_every_part_of_the_schema_is_used():
    text = json.dumps(DOCUMENT)
    for name in DOCUMENT["$defs"]:
        assert f'"#/$defs/{name}"' in text, name
    for name in re.findall(r'"#/\$defs/([a-z_]+)"', text):
        assert name in DOCUMENT["$defs"], name


def test_every_key_of_the_schema_is_in_the_documentation_and_no_other():
    text = (DOCS / "formats.md").read_text()
    section = text.split("## summary.json", 1)[1].split("\n## ", 1)[0]
    rows = re.findall(r"^\| (`[^|]*`) \|", section, re.M)
    documented = re.findall(r"`([a-z_]+)`", " ".join(rows))
    keys = {key for kind in KINDS for key in DOCUMENT["$defs"][kind]["properties"]}

    assert set(documented) == keys
    assert all(schema in section for schema in RESULT_SCHEMAS)
    assert "experiments/data/result.schema.json" in section


# ---------------------------------------------------------------- results of every kind


@pytest.fixture
def garden(tmp_path):
    return write_garden(tmp_path)


@pytest.fixture
def layout_files(tmp_path):
    """One of the study's units, and two."""
    paths = []
    for n_units in (1, 2):
        units = load_carlancap_layout().units[:n_units]
        path = tmp_path / f"layout-{n_units}.json"
        path.write_text(to_json(Layout(name=f"first-{n_units}", units=units)))
        paths.append(path)
    return paths


def written(run, out, *arguments):
    """A command's summary as it lies in the folder, which is what it prints."""
    printed = answer(run(*arguments, "--out", out, "--json --quiet"))
    summary = read_json(out / "summary.json")
    assert json.loads(printed) == summary
    return summary


PLACEMENTS = {
    "plain": (["--budget", "2"], {"front", "stages", "explained"}),
    "cheapest": (["--target", "max", "--least", "cost"], {"goal"}),
    "single": (["--budget", "2", "--fusion", "single", "--survive", "1"], {"stages"}),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", PLACEMENTS)
def test_placements_are_as_the_schema_says(
    kind, small_study, without_figures, run, tmp_path
):
    options, expected = PLACEMENTS[kind]
    check_placement(run, tmp_path / "out", options, expected)


def check_placement(run, out, options, expected):
    """Its summary, which is as the schema says and has these keys."""
    summary = written(run, out, *options)
    assert messages(summary) == []
    assert expected <= set(summary)
    assert summary["schema"] == RESULT_SCHEMAS[0]
    assert as_json(load_result(out).summary) == summary
    return summary


# Quickly: tests/experiments/test_language.py asks for a refined placement.
@pytest.mark.long
def test_a_refined_placement_is_no_worse_and_as_the_schema_says(
    small_study, without_figures, run, tmp_path
):
    less = written(run, tmp_path / "plain", "--budget", "1")
    options = ["--budget", "1", "--refine"]
    refined = check_placement(run, tmp_path / "out", options, {"refinement"})

    assert refined["candidates"] >= less["candidates"]
    assert refined["apr"] >= less["apr"]


@pytest.mark.long
def test_private_ground_is_in_the_schema(
    small_study, without_figures, run, tmp_path, garden, layout_files
):
    summary = written(
        run, tmp_path / "out", "--budget", 1, "--no-look", garden, "--no-look-share", 1
    )
    assert messages(summary) == []
    assert summary["private_ground"]["areas"][0]["name"] == "garden"

    printed = answer(
        run("compare", *layout_files, "--no-look", garden, "--json --quiet")
    )
    assert messages(json.loads(printed)) == []
    assert "private_ground" in json.loads(printed)["compared"][0]


@pytest.mark.long
def test_weights_weathers_and_announcements_are_in_the_schema(
    small_study, without_figures, run, tmp_path, monkeypatch, layout_files
):
    foggy = [
        replace(run, id=f"{run.id}/fog", weather="fog") for run in small_study.runs[:3]
    ]
    runs = (*small_study.runs, *foggy)
    weight = np.array([0.0 if item.case.name == "CBLA" else 1.0 for item in runs])
    setting = replace(
        small_study,
        runs=runs,
        axis=build_frame_axis(runs, weight / weight.sum()),
        radio=Radio(packet_loss=0.1, vam_rate=0.5),
    )
    lay_runs_of(monkeypatch, setting)
    summary = written(run, tmp_path / "out", "--budget", 1)

    assert messages(summary) == []
    assert summary["evaluation"]["rsu_all"]["by_case"]["CBLA"] is None
    assert "all_sources" in summary["evaluation"]
    assert summary["weathers"] == ["day", "fog"]
    assert summary["explained"]["runs_without_weight"] == int((weight == 0.0).sum()) > 0

    result = load_result(tmp_path / "out")
    assert result.apr["apr"].isna().any()
    assert set(result.runs["weather"]) == {"day", "fog"}


@pytest.mark.long
@pytest.mark.usefixtures("small_study", "without_figures")
def test_evaluations_and_comparisons_are_as_the_schema_says(
    run, tmp_path, layout_files
):
    one, two = layout_files
    summary = written(run, tmp_path / "one", "evaluate", "--layout", one)
    assert messages(summary) == []

    printed = answer(run("evaluate --layout", one, "--json --quiet"))
    assert messages(json.loads(printed)) == []

    summary = written(run, tmp_path / "both", "compare", two, one, "--samples", 2)
    assert messages(summary) == []
    assert {"compared", "differences", "sampled"} <= set(summary)

    result = load_result(tmp_path / "both")
    assert result.layout.name == "first-2"
    assert set(result.runs["layout"]) == {"first-1", "first-2", "expert rule"}


# Quickly: test_the_schema_is_one_and_leaves_nothing_open_or_unsaid
@pytest.mark.long
@pytest.mark.usefixtures("without_figures")
def test_what_is_changed_in_a_summary_is_noticed(run, tmp_path, monkeypatch):
    """Every key of it is needed or known, and every number is a number."""
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 2)
    monkeypatch.setattr(pipeline, "N_JUDGED", 2)
    monkeypatch.setattr(placement, "find_baseline", build_small_baseline)
    monkeypatch.setattr(poses, "load_candidate_grid", build_small_grid)
    cases = ("--cases", "CPNCO-50,CBLA", "--speeds", "30,40", "--along-arms", "0")
    options = ("--budget", 2, "--samples", 2, *cases)
    summary = written(run, tmp_path / "out", *options)

    assert messages(summary) == []
    assert as_json(load_result(tmp_path / "out").summary) == summary

    summary = with_first_of_each(summary)
    assert summary["disagreements"] == []  # in so small a question

    disagreement = Disagreement(
        party="U1",
        run_id="CBLA/east/30",
        on_table=True,
        n_frames=1,
        cause="hidden",
    )
    summary["disagreements"] = [as_json(disagreement)]
    assert messages(summary) == []

    optional = {"front", "private_ground", "refinement", "preferred", "sampled"}
    optional |= {
        "highest",
        "next_unit",
        "road_users",
        "study_cases",
        "heavy_runs",
        "cars",
        "added",
        "without_effect",
        "mounting",
        "front_runners",
        "by_runs",
        "assumptions",
        "assumed_prices",
        "existing",
        "is_weighted",
        "aims",
        "decision",
        "located",
        "sensors_eur",
        "sites_eur",
        "asked",
        "cheaper",
    }
    for key in summary:
        less = {name: value for name, value in summary.items() if name != key}
        assert PLACEMENT.is_valid(less) == (key in optional), key
        assert not PLACEMENT.is_valid(summary | {key: {"what": object}}), key

    assert messages(summary | {"schema": "place-rsus/result/1"})

    n_changed = 0
    for path in [path for path, _ in parts(summary)]:
        is_mapping = path.endswith(
            (
                "seconds",
                "versions",
                "by_case",
                "units",
                "uncertainty.latency",
                "question",
            )
        )
        if is_mapping or re.search(r"\[[1-9]", path):  # those after the first are alike
            continue
        damaged = copy.deepcopy(summary)
        for where, part in parts(damaged):
            if where == path:
                part["note"] = "new"
        assert not PLACEMENT.is_valid(damaged), path

        n_changed += 1
    assert n_changed > 80
