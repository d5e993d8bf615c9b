"""What placing, evaluating and comparing print: every number once, in 80 columns."""

import re
from functools import partial
from itertools import product
from pathlib import Path

import msgspec
import pytest
from partial_pages import build_result

from experiments.cli.answers import (
    comparison_parts,
    evaluation_parts,
    failure_notes,
    placement_parts,
)
from experiments.cli.terminal import answer_text
from experiments.results.numbers import percent
from experiments.results.record import EvaluationRecord, PartyAprRecord

OUT = Path("results/latest")


def ratios(n_cases, start=0.5):
    """APR of all runs, and of each case another."""
    return {
        "all": start,
        "by_case": {
            f"CBTAfs-{100 + case}": (start + 0.01 * case) % 1.0
            for case in range(n_cases)
        },
    }


def unit(unit_id):
    """A unit, as results have it."""
    return {
        "id": unit_id,
        "site": "corner-ne",
        "x_m": -115.4,
        "y_m": 8.85,
        "z_m": 5.0,
        "yaw_deg": -135.0,
        "pitch_deg": -45.0,
        "camera": "carla-ncap-rgb",
    }


def table(parts_of, summary, out, *, is_verbose=True):
    """What the terminal says of a result."""
    parts = parts_of(build_result(**summary), out)
    return answer_text(parts, is_verbose=is_verbose)


placement_table = partial(table, placement_parts)
evaluation_table = partial(table, evaluation_parts)
comparison_table = partial(table, comparison_parts)


def evaluation_summary(n_cases, ids, name="mine"):
    """Fields of an evaluation in which every ratio is another one."""
    return {
        "name": name,
        "runs": 240,
        "layout": [unit(unit_id) for unit_id in ids],
        "cost_eur": 4000.0 * len(ids),
        "evaluation": {
            "units": {
                unit_id: ratios(n_cases, 0.1 + 0.02 * index)
                for index, unit_id in enumerate(ids)
            },
            "rsu_all": ratios(n_cases, 0.9),
            "vut_and_rsus": ratios(n_cases, 1.0),
            "vut": ratios(n_cases, 0.3),
            "apr_without_worst_unit": 0.5,
        },
    }


def comparison_summary(n_cases, name="mine", other="carlancap-12", gained=(), lost=()):
    """Fields of a comparison with one other layout."""
    baseline = {
        "units": {},
        "rsu_all": ratios(n_cases, 0.4),
        "vut_and_rsus": ratios(n_cases, 0.6),
        "vut": ratios(n_cases, 0.3),
        "apr_without_worst_unit": 0.3,
    }
    runs = {"runs_gained": list(gained), "runs_lost": list(lost)}
    return evaluation_summary(n_cases, ["U1"], name) | {
        "differences": [],
        "compared": [
            {
                "name": other,
                "evaluation": baseline,
                "layout": [unit("RSU0")],
                "cost_eur": 0.0,
                **runs,
            }
        ],
    }


def placement_summary(n_cases, ids=("U1", "U2", "U3"), gap=0.0):
    """Fields of a placement, compared with the study's layout and greedy choice."""
    found = comparison_summary(n_cases)
    (baseline,) = found.pop("compared")
    del found["differences"]
    greedy = baseline["evaluation"] | {"rsu_all": ratios(n_cases, 0.7)}
    return found | {
        "layout": [unit(unit_id) for unit_id in ids],
        "candidates": 5772,
        "stages": [
            {
                "name": name,
                "objective": found,
                "bound": bound,
                "gap": gap_of,
                "seconds": 0.1,
            }
            for name, found, bound, gap_of in (
                ("apr", 0.97, 0.97, 0.0),
                ("apr_one_failed", 0.9, 0.9, 0.0),
                ("smallest_margin_s", 2.305, 2.305, 0.0),
                ("mean_margin_s", 6.718, 6.756, gap),
            )
        ],
        "baseline": baseline,
        "greedy": baseline | {"name": "greedy-3", "evaluation": greedy},
        "surrogate_disagreement": 0.0004,
        "disagreements": [],
    }


def cells(text):
    """What the table of ratios says: by case, its ratios from left to right, blocks
    joined.
    """
    found = {}
    for line in text.splitlines():
        if match := re.match(r"  (all runs|CBTAfs-\d+) +(.*%.*)$", line):
            found.setdefault(match[1], []).extend(re.split(r"(?<=%) +", match[2]))
    return found


def expected(*parties):
    """Cells of the table of ratios, by row."""
    rows = {"all runs": [percent(party["all"]) for party in parties]}
    for case in parties[0]["by_case"]:
        rows[case] = [percent(party["by_case"][case]) for party in parties]
    return rows


@pytest.mark.parametrize(("n_cases", "n_units"), [*product([1, 3, 13, 25], [1, 5, 12])])
def test_an_evaluation_shows_every_ratio_once_in_80_columns(n_cases, n_units):
    ids = [f"RSU{index}" for index in range(n_units)]
    summary = evaluation_summary(n_cases, ids)
    text = evaluation_table(summary, OUT)

    assert all(len(line) <= 80 and line == line.rstrip() for line in text.splitlines())

    evaluation = summary["evaluation"]
    assert cells(text) == expected(
        *evaluation["units"].values(),
        evaluation["rsu_all"],
        evaluation["vut_and_rsus"],
        evaluation["vut"],
    )

    heads = [line for line in text.splitlines() if line.startswith("  APR")]
    assert "".join(heads).split("APR", 1)[1].split()[0] == "RSU0"
    assert all(f" {unit_id}" in "".join(heads) for unit_id in ids)


@pytest.mark.parametrize("n_cases", [1, 13, 25])
def test_a_placement_shows_every_ratio_once_in_80_columns(n_cases):
    summary = placement_summary(n_cases)
    text = placement_table(summary, OUT)
    assert all(len(line) <= 80 for line in text.splitlines())

    evaluation = summary["evaluation"]
    assert cells(text) == expected(
        evaluation["rsu_all"],
        evaluation["vut_and_rsus"],
        evaluation["vut"],
        summary["greedy"]["evaluation"]["rsu_all"],
        summary["baseline"]["evaluation"]["rsu_all"],
    )
    assert "disagree on <0.1 % of the runs." in text
    assert "fused: a frame counts as detected if any unit detects; greedy: " in text


def test_the_first_five_disagreements_are_told_and_how_many_more_there_are():
    entry = {
        "party": "corner-ne/5m/-135/-45",
        "run_id": "CBTAfs-100/north/20",
        "on_table": True,
        "n_frames": 3,
        "cause": (
            "sample points and pixels differ at the limit (40.1 px high, 52 % seen, IoU"
            " 0.51)"
        ),
    }
    for n_entries in (1, 5, 7):
        entries = [entry | {"on_table": index % 2 == 0} for index in range(n_entries)]
        text = placement_table(placement_summary(1) | {"disagreements": entries}, OUT)
        assert all(len(line) <= 80 for line in text.splitlines())

        words = " ".join(text.split())
        told = "corner-ne/5m/-135/-45 in CBTAfs-100/north/20: avoided only by the"

        assert words.count(told) == min(n_entries, 5)
        assert words.count(f"{told} table; {entry['cause']}") == min(
            (n_entries + 1) // 2, 3
        )
        assert ("and 2 more in summary.json" in words) == (n_entries == 7)


def test_road_users_that_announce_themselves_have_columns_where_there_are_any():
    summary = evaluation_summary(3, ["U1"])
    assert "VAM" not in evaluation_table(summary, None)

    evaluation = summary["evaluation"]
    evaluation |= {"vam": ratios(3, 0.2), "all_sources": ratios(3, 0.95)}
    text = evaluation_table(summary, None)

    assert cells(text) == expected(
        evaluation["units"]["U1"],
        *(
            evaluation[key]
            for key in ("rsu_all", "vut_and_rsus", "vut", "vam", "all_sources")
        ),
    )


def test_the_cost_is_that_of_all_units_and_of_their_sites_as_far_as_known():
    summary = evaluation_summary(1, ["U1", "U2", "U3"])
    text = evaluation_table(summary, None)
    assert "cost: unknown: 3 sensors unknown (catalogue), poles unknown" in text

    summary |= {"sensors_eur": 12_000.0, "sites_eur": 7120.0}
    for prices, by in (
        ((), "own prices"),
        (("told",), "assumed"),
    ):
        told = " ".join(
            evaluation_table(summary | {"assumed_prices": prices}, None).split()
        )
        bought = "3 sensors 12,000 EUR (catalogue)"
        assert f"cost: 19,120 EUR: {bought}, poles 7,120 EUR ({by})." in told
    existing = {"existing": ("U1", "U2"), "sensors_eur": 4_000.0}
    told = evaluation_table(summary | existing, None)

    assert "1 new sensor 4,000 EUR (catalogue; 2 exist)" in told
    assert told.count("(existing)") == 2
    assert "three cameras (two exist) on one pole prevent" in " ".join(told.split())

    summary |= {"existing": ("U1", "U2", "U3")}
    assert "nothing to buy; all 3 sensors exist" in evaluation_table(summary, None)


@pytest.mark.parametrize("n_cases", [1, 13, 25])
def test_a_comparison_shows_every_ratio_once_and_the_runs_that_differ(n_cases):
    gained = [f"CBTAfs-{100 + run}/north/{run}" for run in range(60)]
    summary = comparison_summary(n_cases, gained=gained)
    text = comparison_table(summary, OUT)

    assert all(len(line) <= 80 for line in text.splitlines())

    evaluation = summary["evaluation"]
    baseline = summary["compared"][0]["evaluation"]

    assert cells(text) == expected(
        evaluation["rsu_all"],
        evaluation["vut_and_rsus"],
        baseline["rsu_all"],
        baseline["vut_and_rsus"],
        evaluation["vut"],
    )
    assert all(run in text for run in gained)
    assert "Runs lost:\n  none" in text


@pytest.mark.parametrize(
    "name",
    ["x" * 70, "a layout with a name of many words, none of them short", "-", "$x^{"],
)
def test_long_names_are_broken_not_cut(name):
    text = comparison_table(comparison_summary(13, name=name), OUT)
    lines = text.splitlines()
    assert all(len(line) <= 80 for line in lines)

    end = next(index for index, line in enumerate(lines) if "all runs" in line)
    begin = max(index for index, line in enumerate(lines[:end]) if not line)
    heads = lines[begin + 1 : end]
    first = len("  CBTAfs-100  ")
    cell = next(line for line in lines if "all runs" in line).index("%") + 1
    first_column = "".join(line[first:cell] for line in heads)

    assert first_column.replace(" ", "") == name.replace(" ", "")


@pytest.mark.parametrize(
    ("n_units", "n_blocks"),
    [
        (1, 1),
        (3, 1),
        (4, 1),
        (5, 2),
        (12, 2),
    ],
)
def test_columns_are_narrower_where_that_saves_a_block(n_units, n_blocks):
    ids = [f"U{index}" for index in range(n_units)]
    text = evaluation_table(evaluation_summary(13, ids), None)
    assert text.count("all runs") == n_blocks


def test_ids_are_cut_in_no_table():
    ids = ["corner-ne/5m/-135/-45/own-camera-of-a-long-name", "corner-ne/5m/-135/-30"]
    lines = evaluation_table(evaluation_summary(3, ids), None).splitlines()

    assert [line.split()[0] for line in lines if line.startswith("  corner")] == ids
    assert all(len(line) <= 80 for line in lines)


def test_a_case_without_weight_has_a_dash():
    summary = evaluation_summary(2, ["U1"])
    for party in (
        summary["evaluation"][key] for key in ("rsu_all", "vut_and_rsus", "vut")
    ):
        party["by_case"]["CBTAfs-101"] = None
    summary["evaluation"]["units"]["U1"]["by_case"]["CBTAfs-101"] = None
    text = evaluation_table(summary, None)

    assert "nan" not in text

    (row,) = (line for line in text.splitlines() if "CBTAfs-101" in line)
    assert row.split()[1:] == ["\N{EN DASH}"] * 4


@pytest.mark.parametrize(
    ("gap", "words"),
    [
        (0.0, "proven"),
        (0.0056, "0.6 %"),
        (float("inf"), "open"),
    ],
)
def test_a_gap_is_proven_or_a_number_or_open(gap, words):
    (row,) = (
        line
        for line in placement_table(placement_summary(1, gap=gap), OUT).splitlines()
        if line.startswith("  mean time to spare")
    )
    assert row.endswith(f" {words}       0.1")


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "100.0 %"),
        (0.9996, ">99.9 %"),
        (0.9994, "99.9 %"),
        (0.0, "0.0 %"),
        (0.0004, "<0.1 %"),
    ],
)
def test_percent_never_rounds_to_all_or_nothing(share, text):
    assert percent(share) == text


def test_percent_of_nothing_is_a_dash():
    assert percent(float("nan")) == "\N{EN DASH}"


def test_what_is_left_after_a_failure_is_told_for_units_and_for_poles():
    share = PartyAprRecord(all=0.9, by_case={}, by_position={})
    shares = {"vut": share, "rsu_all": share, "vut_and_rsus": share}
    two = EvaluationRecord(
        **shares, units={"a": share, "b": share}, apr_without_worst_unit=0.625
    )

    assert failure_notes(two) == []  # the table of all layouts has it

    on_one_pole = msgspec.structs.replace(two, apr_without_worst_site=0.0)
    assert failure_notes(on_one_pole) == [
        "if the most important pole fails with all its units, the others reach 0.0 %."
    ]


@pytest.mark.parametrize("n_cases", [1, 25])
def test_in_short_every_answer_fits_on_a_screen(n_cases):
    """Of 100 columns and 40 lines, with where the rest is; what matters comes first."""
    ids = [f"RSU{index}" for index in range(30)]
    texts = [
        placement_table(placement_summary(n_cases), OUT, is_verbose=False),
        evaluation_table(evaluation_summary(n_cases, ids), OUT, is_verbose=False),
        comparison_table(comparison_summary(n_cases), OUT, is_verbose=False),
    ]
    for text in texts:
        lines = text.splitlines()
        assert len(lines) <= 40
        assert max(map(len, lines)) <= 100
        assert " of the simulated collisions" in f"{lines[0]} {lines[1]}"
        assert "All 240 runs are avoided." in lines
        assert (
            lines[-1]
            == "--verbose adds the reasons, the APR by case and all other details."
        )
        assert f"Written to {OUT}: report.html and more." in lines
        assert "VUT alone" in text

    for words in (
        "Proven in the planning model",
        "greedy",
        "carlancap-12",
        "U1",
        "U2",
        "U3",
    ):
        assert words in texts[0]
