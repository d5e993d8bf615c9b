"""``place-rsus retrofit`` on a few runs and poses; its table and words."""

import csv
import io
import json
import re
from pathlib import Path

import msgspec
import pytest
from command_results import answer, refusal
from json_files import UNIT, read_json, write_json

from experiments import main
from experiments.cli.pareto import retrofit, retrofit_text
from experiments.parts.retrofit import RetrofitResult, words
from experiments.results.record import to_plain
from placement.layout import layout_from_records
from placement.retrofit import load_labour

ON_MAST = UNIT | {"site": "mast-e"}


@pytest.fixture
def layout_file(tmp_path):
    """Two units at one place that look apart."""
    units = [ON_MAST, ON_MAST | {"id": "B", "yaw_deg": 40.0}]
    path = tmp_path / "mine.json"
    write_json(path, {"name": "mine", "layout": units})
    return path


@pytest.fixture
def run_retrofit(run, small_study, layout_file):
    """Runs the command on a few runs."""
    main.cli.add_command(retrofit)
    return lambda *arguments: run("retrofit --quiet --layout", layout_file, *arguments)


# The whole command


@pytest.mark.long
def test_every_kind_of_change_is_found_priced_and_proven(run_retrofit):
    folder = Path("there/retrofit")
    summary = json.loads(
        answer(run_retrofit("--budget-cost 2100 --site-cost 0 --out", folder, "--json"))
    )
    labour = load_labour()
    before = summary["before"]

    assert [change["actions"][0]["action"] for change in summary["removals"]] == [
        "remove"
    ] * 2
    assert {change["price_eur"] for change in summary["removals"]} == {
        labour.remove_eur
    }
    assert {change["price_eur"] for change in summary["re_aims"]} == {labour.re_aim_eur}
    assert before["apr"] <= before["apr_cars_see"] <= 1.0
    for change in summary["removals"]:
        assert change["apr"] <= before["apr"]
        assert change["apr"] <= change["apr_cars_see"] <= before["apr_cars_see"]
        assert len(change["layout"]) == 1
        assert not change["gained"]

    for change in summary["re_aims"]:
        (action,) = change["actions"]
        moved = {record["id"]: record for record in change["layout"]}[action["unit"]]

        assert moved["x_m"] == -115.0
        assert moved["y_m"] == 8.6
        assert moved["z_m"] == 8.0

        bearing_deg = (90.0 - moved["yaw_deg"]) % 360.0
        assert f"to bearing {bearing_deg:.1f}, tilt " in action["words"]
        assert change["compared"] == 2 * 4
    addition = summary["addition"]
    combination = summary["combination"]

    assert addition["price_eur"] == 1500.0
    assert [record["id"] for record in addition["layout"]] == ["A", "B", "N1"]

    layout_from_records("any", addition["layout"], "retrofit.json")
    assert combination["price_eur"] <= 2100.0
    assert combination["is_better"]

    every = [*summary["removals"], *summary["re_aims"], addition, combination]
    assert all(change["is_proven"] for change in every)

    best_alone = max(
        (c["apr"], c["apr_one_failed"]) for c in [*summary["re_aims"], addition]
    )
    assert (combination["apr"], combination["apr_one_failed"]) >= best_alone

    assert {path.name for path in folder.iterdir()} == {"retrofit.csv", "retrofit.json"}
    assert read_json(folder / "retrofit.json") == summary

    rows = list(csv.DictReader(io.StringIO((folder / "retrofit.csv").read_text())))
    assert [row["kind"] for row in rows] == [
        "as it is",
        *["remove"] * 2,
        *["re-aim"] * 2,
        "add",
        "combine",
    ]
    assert rows[1]["change"] == summary["removals"][0]["actions"][0]["words"]


def test_the_text_is_narrow_and_has_the_users_price(run_retrofit):
    out = answer(run_retrofit("--visit-cost 123"))
    assert max(map(len, out.splitlines())) <= 80
    assert len(re.findall(r"^ +remove [AB] +123 ", out, re.MULTILINE)) == 2

    words = " ".join(out.split())
    assert "A visit costs 123 EUR: --visit-cost." in words
    assert "together:" not in words


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--visit-cost", "-1"), "--visit-cost: got '-1'; expected euros, at least 0"),
        (("--keep", "carlancap-12"), "No such option '--keep'"),
    ],
)
def test_what_cannot_be_is_one_line(run_retrofit, arguments, message):
    Path("mine.txt").write_text("a file")
    assert refusal(run_retrofit(*arguments)).startswith(f"{message}")


# Words


def change(
    words, *, better=True, gained=(), lost=(), price_eur=500.0, proven=True, apr=0.9
):
    """A change of a layout, as results have it."""
    return {
        "actions": [
            {"action": word.split()[0], "unit": word.split()[1], "words": word}
            for word in words
        ],
        "price_eur": price_eur,
        "apr": apr,
        "apr_cars_see": 0.95,
        "apr_one_failed": 0.8,
        "smallest_margin_s": 0.1,
        "mean_margin_s": 1.234,
        "cost_eur": 0.0,
        "gained": list(gained),
        "lost": list(lost),
        "is_better": better,
        "is_proven": proven,
        "compared": 9,
        "stages": [],
        "solver": None,
        "layout": [],
    }


def summary_of(**changes):
    """A plain result with one change of each kind."""
    return {
        "name": "mine",
        "layout": [ON_MAST, ON_MAST | {"id": "B"}],
        "candidates": 9,
        "runs": 10,
        "fusion": "any",
        "before": {
            "apr": 0.9,
            "apr_cars_see": 0.95,
            "apr_one_failed": 0.8,
            "smallest_margin_s": 0.1,
            "mean_margin_s": 1.0,
            "cost_eur": 0.0,
        },
        "budget_eur": 3000.0,
        "labour": to_plain(load_labour())
        | {"people": 0.0, "lift_eur": 500.0, "source": "a test"},
        "removals": [change(["remove B"], better=False, lost=["r1"])] * 2,
        "re_aims": [
            change(["re-aim A to yaw 0, pitch -15"], gained=["r1", "r2"], lost=["r3"])
        ],
        "addition": change(["add N1 at mast-e"], price_eur=1500.0, gained=["r4"]),
        "combination": change(
            ["re-aim A to yaw 0, pitch -15", "add N1 at mast-e"],
            price_eur=2000.0,
            proven=False,
        ),
        "command": "place-rsus retrofit",
        "cases": [],
        "weathers": [],
        "detector": "surrogate",
        "vut_sensors": [],
        "packet_loss": 0.0,
        "vam_rate": 0.0,
        "track_memory_s": None,
        "not_driven": [],
        "possible_runs": 1,
        "driven": [],
        "sentences": [],
        "seconds": {},
        "versions": {},
        **changes,
    }


def test_sentences_tell_where_nothing_is_better():
    def said(**changes):
        return words(msgspec.convert(summary_of(**changes), RetrofitResult))

    assert said() == []

    useless = change(["re-aim A to yaw 0, pitch -15"], better=False)
    nothing = {"re_aims": [useless], "addition": None, "combination": None}
    assert said(removals=[change(["remove A"])], **nothing) == [
        "A is the only unit: without it, only the car itself is left.",
        "No re-aiming improves the current layout.",
        "No additional unit within 3,000 EUR improves the current layout.",
        "No combination of re-aiming and additional units improves the current layout.",
    ]


def test_the_table_has_a_row_for_every_change():
    text = retrofit_text(msgspec.convert(summary_of(), RetrofitResult), Path("there"))
    assert re.search(
        r"^  remove B +500 +90\.0 % +95\.0 % +80\.0 % +0 +1$",
        text,
        re.MULTILINE,
    )
    assert re.search(
        r"^  add N1 at mast-e +1,500 +90\.0 % +95\.0 % +80\.0 % +1 +0$",
        text,
        re.MULTILINE,
    )
    assert "(open)" in text  # of what is combined
    assert text.endswith("Written to there: retrofit.csv and retrofit.json.")
    assert max(map(len, text.splitlines())) <= 80
