"""The evaluator's choice among the layouts that lead, written beside the one found."""

import pytest
from command_results import output
from json_files import read_json

from experiments.parts import alternatives
from placement.layout import load_layout
from placement.optimiser import Effort


@pytest.mark.long
def test_what_the_evaluator_recommends_is_written_and_what_is_proven_still_verified(
    small_study, run, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        alternatives, "recommend", lambda runners, mounted_wrongly: (1, "apr")
    )
    out = tmp_path / "out"
    command = ("--budget 2 --give-up 0 --out", out, "--workers 2")
    told = output(run(*command, "--verbose"))
    summary = read_json(out / "summary.json")
    found = summary["front_runners"]
    names = [one["name"] for one in found["layouts"]]

    assert (
        names[0] == summary["name"] == load_layout(out / "layout.json").name == "best-2"
    )

    recommended = load_layout(out / "recommended.json")
    assert recommended.name == found["recommended"] == names[1] != "best-2"

    sentence = f"Recommended: {names[1]}, in recommended.json."
    assert sentence in told
    assert sentence in (out / "report.html").read_text()
    assert 0 < told.index("Recommended:") < told.index("The highest APR with fewer")
    assert summary["mounting"]["worst"]["unit_id"] in {"U1", "U2"}

    output(run("verify", out, "--quiet"))


@pytest.mark.long
@pytest.mark.usefixtures("small_study")
def test_where_the_layout_found_is_recommended_nothing_is_written_beside_it(
    run, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        alternatives, "recommend", lambda runners, mounted_wrongly: (0, "order")
    )
    told = output(run("--budget 2 --give-up 0 --out", tmp_path / "out", "--workers 2"))

    assert not (tmp_path / "out/recommended.json").exists()
    assert "Recommended:" not in told


@pytest.mark.parametrize(
    ("weights", "asks"),
    [
        ("", True),
        ("case", True),
        ("run", False),
    ],
)
def test_weights_that_somebody_chose_are_meant(weights, asks, monkeypatch):
    asked = []
    monkeypatch.setattr(
        alternatives, "find_by_runs", lambda *given, **options: asked.append(1)
    )
    nothing = type(
        "Nothing", (), {"problem": None, "pose_index": (), "cache_folder": None}
    )
    question = type("Asked", (), {"weights": weights, "effort": Effort()})
    alternatives.find_other_weights(
        nothing, question, question, compute=nothing, progress=lambda *given: None
    )

    assert bool(asked) == asks
