import json
from importlib.resources import files

import numpy as np
import pytest
from jinja2 import Environment, FunctionLoader, StrictUndefined

from experiments.explanation_tables import (
    contribution_sentences,
    contribution_table,
    explanation_text,
    missed_sentences,
    missed_table,
    pool_sentences,
    pool_table,
    report_part,
    site_table,
)
from experiments.explanations import summarise_explanations
from experiments.study import load_carlancap_layout
from placement.explain import find_contributions, find_pool, find_unavoided
from placement.pipeline import place
from placement.wishes import Wishes


@pytest.fixture(scope="module")
def candidates():
    return load_carlancap_layout().units


@pytest.fixture(scope="module")
def placement(small_setting, candidates):
    return place(small_setting, candidates, wishes=Wishes(budget_units=2))


@pytest.fixture(scope="module")
def summary(placement, small_setting, candidates):
    found = summarise_explanations(placement, small_setting, candidates, n_pool=4, tolerance=0.2)
    return json.loads(json.dumps(found, allow_nan=False))


def test_the_summary_says_what_the_library_found(summary, placement, small_setting, candidates):
    problem, chosen = placement.problem, placement.pose_index
    ids = problem.table.pose_ids
    for record, part in zip(
        summary["contributions"], find_contributions(problem, chosen), strict=True
    ):
        assert record["unit"] == ids[part.pose_index]
        assert len(record["only_runs"]) == len(part.only_runs)
        assert record["marginal_apr"] == part.marginal_apr
        assert record["without"] == part.without._asdict()
    missed = find_unavoided(small_setting, problem, candidates, chosen)
    assert [record["run"] for record in summary["not_avoided"]] == [e.run_id for e in missed]
    pool = find_pool(problem, chosen, n_sets=4, tolerance=0.2)
    record = summary["pool"]
    assert record["is_complete"] == (pool.scope == "all")
    assert record["within"] == pool.n_within
    assert record["sets"][0]["units"] == [ids[pose] for pose in pool.sets[0].pose_index]
    assert [entry["apr"] for entry in record["sets"]] == [e.value.apr for e in pool.sets]
    shares = [entry["share"] for entry in record["poses"]]
    assert sorted(shares, reverse=True) == shares
    assert sum(shares) == pytest.approx(pool.pose_share.sum())
    by_site = {entry["site"]: entry["share"] for entry in record["sites"]}
    assert set(by_site) <= {candidate.site_id for candidate in candidates}
    assert max(by_site.values()) == pytest.approx(pool.site_share.max())


def test_what_one_unit_misses_is_explained_run_by_run(small_setting, candidates):
    placement = place(small_setting, candidates[8:9], wishes=Wishes(budget_units=1))
    found = summarise_explanations(placement, small_setting, candidates[8:9])
    assert found["pool"] is None
    assert len(found["not_avoided"]) > 0
    for entry in found["not_avoided"]:
        assert entry["unit"] == candidates[8].id
        assert sum(r["frames"] for r in entry["reasons"]) == (
            entry["frames_in_time"] - entry["frames_seen"]
        )
        assert entry["rescue"] is None  # there is no other candidate
    assert pool_sentences(found) == []
    table = missed_table(found)
    assert len(table["rows"]) == len(found["not_avoided"])
    text = explanation_text(found)
    assert f"{len(found['not_avoided'])} runs are not avoided" in " ".join(text.split())


def explained(**parts):
    without = {
        "apr": 0.5,
        "apr_one_failed": 0.0,
        "smallest_margin_s": 0.25,
        "mean_margin_s": 1.5,
        "cost_eur": 1500.0,
    }
    part = {
        "unit": "a",
        "only_runs": ["r1", "r2", "r3", "r4"],
        "marginal_apr": 0.4,
        "first_share": 0.7,
        "mean_delay_s": 0.3,
        "max_delay_s": 0.9,
        "without": without,
    }
    other = part | {"unit": "b", "only_runs": [], "marginal_apr": 0.0}
    return {"contributions": [part, other], "not_avoided": [], "pool": None} | parts


def missed(run, outcome="never seen", *, late_s=None, reasons=(), rescue=None, unit="a"):
    return {
        "run": run,
        "outcome": outcome,
        "late_s": late_s,
        "frames_in_time": 30,
        "frames_seen": 2,
        "unit": unit,
        "reasons": [
            {"cause": cause, "thing": thing, "frames": frames} for cause, thing, frames in reasons
        ],
        "rescue": rescue,
    }


HELPER = {"unit": "c", "site": "pole", "distance_m": 12.34, "margin_s": 0.5}
MISSED = [
    missed("r5", reasons=[("hidden", "wall-ne-1", 20), ("out of view", "", 8)], rescue=HELPER),
    missed("r6", reasons=[("hidden", "wall-ne-1", 28)], rescue=HELPER | {"distance_m": 0.0}),
    missed("r7", "too late", late_s=0.125, reasons=[("too far", "", 28)]),
    missed("r8", "hopeless", unit=""),
]
POOL = {
    "stage": "apr",
    "tolerance": 0.0,
    "is_complete": True,
    "within": 1234,
    "sets": [
        {
            "units": ["a", "b"],
            "objective": 0.9,
            "apr": 0.9,
            "apr_one_failed": 0.5,
            "smallest_margin_s": 0.25,
            "mean_margin_s": 1.5,
            "cost_eur": 3000.0,
        }
    ],
    "sites": [{"site": "pole", "share": 1.0}, {"site": "mast", "share": 0.25}],
    "poses": [],
}


def test_units_that_something_hangs_on_are_counted():
    both = explained()
    assert contribution_sentences(both) == ["Of 2 units, 1 saves runs that no other one saves."]
    first, other = both["contributions"]
    each = explained(contributions=[first, first])
    assert contribution_sentences(each) == ["Each unit saves runs that no other one saves."]
    none = explained(contributions=[other, other])
    assert contribution_sentences(none)[0].startswith("No run hangs on a single unit")
    one = explained(contributions=[first])
    assert contribution_sentences(one) == ["Everything that is avoided hangs on this one unit."]
    table = contribution_table(both, {"a": "#1"})
    assert table["rows"][0] == [
        "#1", "4", "40.0 %", "50.0 %", "0.25", "1.50", "0.30", "0.90", "70.0 %",
    ]  # fmt: skip
    assert {len(row) for row in table["rows"]} == {len(table["columns"])}
    alone = first | {"without": first["without"] | {"apr": 0.0}}
    row = contribution_table(explained(contributions=[alone]))["rows"][0]
    assert row[4:8] == ["\N{EN DASH}"] * 4


def test_runs_that_are_not_avoided_are_told_with_causes_and_remedies():
    found = explained(not_avoided=MISSED)
    assert missed_sentences(found) == [
        "On the detection table, 4 runs are not avoided: 2 never seen, 1 confirmed too late, "
        "1 too short for any unit.",
        "What is in the way most often: hidden by wall-ne-1, in 2 runs.",
        "A further unit could save 2 of them; c is the nearest one that does for 2 runs.",
    ]
    assert missed_sentences(explained()) == ["On the detection table, every run is avoided."]
    rows = missed_table(found)["rows"]
    assert rows[0] == [
        "r5",
        "never seen",
        "for a: hidden by wall-ne-1 in 20 of 30 frames; out of view in 8 of 30 frames",
        "c, 12.3 m away, 0.50 s to spare",
    ]
    assert rows[1][3] == "c, at the same mount, 0.50 s to spare"
    assert rows[2][1:] == [
        "confirmed too late, by 0.12 s",
        "for a: too small or too thin at that distance in 28 of 30 frames",
        "\N{EN DASH}",
    ]
    assert rows[3][2] == "the road user is there too late for any confirmation in time"


@pytest.mark.parametrize(
    ("pool", "sentences"),
    [
        (
            POOL,
            [
                "All choices were gone through: 1,234 layouts with the best APR.",
                "The best one is listed.",
                "Each of them has a unit at pole.",
            ],
        ),
        (
            POOL | {"tolerance": 0.01, "within": 1},
            [
                "All choices were gone through: 1 layout with the best APR, or up to 1.0 % of the "
                "runs less."
            ],
        ),
        (
            POOL | {"stage": "cost_eur", "tolerance": 0.1, "within": 1},
            ["All choices were gone through: 1 layout with the least cost, or up to 10.0 % more."],
        ),
        (
            POOL | {"is_complete": False, "within": 20},
            [
                "Found by exchanging units one for one: 20 layouts with the best APR. There may be "
                "more, and better ones among them in what comes after."
            ],
        ),
    ],
)
def test_a_pool_says_what_it_holds_and_whether_that_is_all(pool, sentences):
    assert pool_sentences(explained(pool=pool)) == sentences


def test_tables_of_the_pool_have_a_row_for_each_layout_and_site():
    found = explained(pool=POOL)
    assert pool_table(found)["rows"] == [["a + b", "90.0 %", "50.0 %", "0.25", "1.50", "3,000"]]
    assert site_table(found) == {
        "caption": "How often each site carries a unit, of all 1,234 layouts",
        "columns": ["site", "share of the layouts"],
        "rows": [["pole", "100.0 %"], ["mast", "25.0 %"]],
    }
    found["pool"] = POOL | {"is_complete": False, "within": 20}
    assert "of the listed 20 layouts" in site_table(found)["caption"]


def test_a_terminal_shows_it_in_80_columns():
    sets = [POOL["sets"][0] | {"units": [f"a-rather-long-name-of-a-pose-{i}"]} for i in range(7)]
    runs = [missed(f"run-{i}", reasons=[("hidden", f"wall-{i}", 3)]) for i in range(10)]
    text = explanation_text(explained(not_avoided=MISSED + runs, pool=POOL | {"sets": sets}))
    assert max(map(len, text.splitlines())) <= 80
    words = " ".join(text.split())
    for expected in (
        "a: only it saves 4 runs (r1, r2, r3 and 1 more), 40.0 % of the APR; without it what the "
        "others save is confirmed 0.30 s later on average",
        "b: no run hangs on it alone",
        "r5, r6: never seen; for a hidden by wall-ne-1; would be saved by c",
        "r7: confirmed too late; for a too small",
        "and 5 more in summary.json",
        "and 2 more in summary.json",
        "a-rather-long-name-of-a-pose-0: APR 90.0 %, if one fails 50.0 %, 0.25 s to spare",
        "sites: pole 100.0 %, mast 25.0 %",
    ):
        assert expected in words
    assert "pose-5" not in text


def render(part):
    """The page's part, with the report's own macros."""
    folder = files("experiments") / "templates"

    def read(name):
        return (folder / name).read_text(encoding="utf-8")

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(read),
    )
    macros = read("report.html.j2").partition("<!DOCTYPE")[0]
    page = environment.from_string(macros + '{% include "explanations.html.j2" %}')
    return page.render(explained=part)


def test_the_report_has_a_section_for_each_question():
    assert render(report_part(None, {})).strip() == ""
    page = render(report_part(explained(), {}))
    assert "<h2>Why these poses</h2>" in page
    assert "every run is avoided" in page
    assert "Other layouts" not in page
    assert "<details" not in page
    page = render(report_part(explained(not_avoided=MISSED, pool=POOL), {"a": "<#1>"}))
    assert "&lt;#1&gt;" in page
    assert "<h2>Runs that are not avoided</h2>" in page
    assert "hidden by wall-ne-1 in 20 of 30 frames" in page
    assert "<h2>Other layouts as good</h2>" in page
    assert "1,234 layouts" in page
    assert page.count("<table>") == page.count("</table>") == 4


def test_sampled_worlds_are_explained_in_the_world_as_planned(placement, small_setting, candidates):
    from dataclasses import replace

    from placement.detection_table import pack_table

    alone = list(placement.pose_index)
    table = placement.problem.table
    nominal = replace(
        placement.problem,
        table=pack_table(
            tuple(table.pose_ids[pose] for pose in alone), table.axis, table.detected(alone) & False
        ),
        limits=placement.problem.limits.of_poses(np.array(alone)),
    )
    sampled = replace(placement, nominal=nominal, nominal_index=tuple(range(len(alone))))
    found = summarise_explanations(sampled, small_setting, candidates)
    assert {entry["run"] for entry in found["not_avoided"]} == set(table.axis.run_ids)
    assert all(entry["rescue"] is None for entry in found["not_avoided"])
    assert [part["unit"] for part in found["contributions"]] == [table.pose_ids[c] for c in alone]
