"""The report: its first screen, its tables, and what it must not have."""

import base64
import html
import math
import re
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser

import numpy as np
import pytest
from made_verdicts import live_verdict
from msgspec.structs import replace as replace_fields
from partial_pages import blank_pictures, build_result

from experiments.jobs.evaluation import build_comparison_result
from experiments.parts.accidents import case_titles, is_weighted
from experiments.parts.dangers import build_dangers
from experiments.report.page import build_report
from experiments.results.numbers import percent
from experiments.results.record import StageRecord, build_evaluation_record
from geometry.study_scene import load_study_scene
from placement.evaluation import Evaluation, apr
from placement.layout import Layout, layout_records, load_carlancap_layout
from placement.question import Question
from placement.setting import build_setting
from scenarios.aeb import load_aeb_rule
from scenarios.runs import build_frame_axis

pytestmark = pytest.mark.long

VOID = {"source", "meta", "img", "br", "hr", "link", "input"}
COMMAND = "place-rsus --budget 2 --out 'a <folder>'"
EVIL = "<script>alert(1)</script>"


def _page_of(result, setting, evaluations, command=COMMAND):
    """Text of a report."""
    page, _ = build_report(result, setting, evaluations, command=command)
    return page


class Page(HTMLParser):
    """Checks that tags close in order; collects tags, images and text."""

    def __init__(self, page):
        super().__init__()
        self.open = []
        self.tags = []
        self.images = []
        self.text = ""
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag == "img":
            self.images.append(dict(attributes))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.text += data

    @property
    def words(self):
        return " ".join(self.text.split())


@pytest.fixture(scope="module")
def setting():
    """The study's cases, whose runs count alike."""
    return build_setting(
        Question(cases="CPNC-50,CBNA,CBLA", along_arms="0", weights="run"),
        load_study_scene(),
    )


def build_evaluation(setting, layout, *, seed, share=0.9):
    """Detections by lot; nobody sees some of the runs."""
    axis = setting.axis
    rng = np.random.default_rng(seed)

    verdict = partial(live_verdict, axis, rule=setting.rule)
    detected = rng.random((len(layout.units) + 1, axis.n_frames)) < share
    # Nobody sees some runs, so that not everything is avoided.
    detected &= np.repeat(
        rng.random((len(detected), axis.n_runs)) < 0.7, np.diff(axis.run_start), axis=1
    )
    return Evaluation(
        layout=layout,
        axis=axis,
        vut=verdict(detected[0]),
        units={
            unit.id: verdict(row)
            for unit, row in zip(layout.units, detected[1:], strict=True)
        },
        rsu_all=verdict(detected[1:].any(axis=0)),
        vut_and_rsus=verdict(detected.any(axis=0)),
    )


@pytest.fixture(scope="module")
def evaluations(setting):
    """A layout found, greedy choice's, and the study's."""
    baseline = load_carlancap_layout()
    found = Layout(
        name="found",
        units=tuple(
            replace(unit, id=f"{unit.site_id}/7m/{index}")
            for index, unit in enumerate(baseline.units[:2])
        ),
    )
    greedy = Layout(name="greedy", units=baseline.units[2:4])
    return {
        layout.name: build_evaluation(setting, layout, seed=seed)
        for seed, layout in enumerate([found, greedy, baseline])
    }


def plain_result(evaluation, **changes):
    """A result of an evaluation, or of what `changes` make of it."""
    parts = {
        "runs": evaluation.axis.n_runs,
        "seconds": {"evaluation": 1.25},
        "versions": {"place-rsus": "0.1.0"},
    }
    layout = evaluation.layout
    parts["vut_sensors"] = ["camera"]
    parts["is_weighted"] = is_weighted(evaluation.axis)
    parts["evaluation"] = build_evaluation_record(evaluation, load_aeb_rule())
    result = build_result(layout.name, layout_records(layout), **(parts | changes))
    dangers = build_dangers(evaluation.rsu_all.is_avoided, evaluation.axis)
    return replace_fields(result, dangers=dangers)


@pytest.fixture(scope="module")
def placement_result(evaluations):
    """A placement of which all but one objective are proven."""
    result = plain_result(
        evaluations["found"],
        budget=2,
        candidates=4032,
        apr=0.97,
        bound=0.97,
        gap=0.0,
        apr_without_worst_unit=0.8125,
        stages=[
            {
                "name": "apr",
                "objective": 0.97,
                "bound": 0.97,
                "gap": 0.0,
                "seconds": 2.5,
            },
            {
                "name": "smallest_margin_s",
                "objective": 0.0,
                "bound": 0.5,
                "gap": None,
                "seconds": 60.0,
            },
        ],
        solver="HiGHS 1.15.1",
        surrogate_disagreement=2 / 104,
    )
    evaluation = replace_fields(result.evaluation, apr_without_worst_unit=0.75)
    return replace_fields(result, evaluation=evaluation)


@pytest.fixture(scope="module")
def placement_page(placement_result, setting, evaluations):
    """Report of a placement."""
    return _page_of(placement_result, setting, evaluations)


@pytest.fixture(scope="module")
def comparison_page(setting, evaluations):
    """Report of a comparison."""
    pair = {name: evaluations[name] for name in ("found", "carlancap-12")}
    with blank_pictures():
        result = build_comparison_result(setting, pair["found"], [pair["carlancap-12"]])
        return _page_of(result, setting, pair)


@pytest.fixture(scope="module")
def evaluation_page(setting, evaluations):
    """Report of an evaluation."""
    one = {"found": evaluations["found"]}
    with blank_pictures():
        return _page_of(plain_result(one["found"]), setting, one)


@pytest.fixture(params=["placement_page", "comparison_page", "evaluation_page"])
def page(request):
    """Each kind of report."""
    return request.getfixturevalue(request.param)


def test_page_is_well_formed_and_stands_alone(page):
    parsed = Page(page)
    assert len(page.encode()) < 8_000_000
    assert not re.search(r"https?://|//\w+\.\w+", _without_scripts(page))

    tags = {tag for tag, _ in parsed.tags}
    assert not tags & {"link", "iframe", "object", "base", "form"}
    for _, attributes in parsed.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith(("data:", "#"))


def _without_scripts(page):
    """A page less its scripts."""
    return re.sub(r"<script\b.*?</script>", "", page, flags=re.S)


def test_every_figure_is_a_png_or_jpeg_with_an_alt_text(page):
    images = Page(page).images
    assert len(images) >= 3

    for image in images:
        assert len(image["alt"]) > 40

        kind, _, data = image["src"].removeprefix("data:image/").partition(";base64,")
        begin = {"png": b"\x89PNG", "jpeg": b"\xff\xd8\xff"}[kind]
        assert base64.b64decode(data).startswith(begin)
    assert len({image["src"] for image in images}) == len(images)


def test_every_unit_and_every_run_appears(page, setting):
    words = Page(page).words
    for unit in ("corner-se/7m/0", "corner-ne/7m/1"):
        assert unit in words

    rows = re.findall(r'<th scope="row">(?:CBNA|CBLA|CPNC-50)/\w+/\d+</th>', page)
    assert len(rows) == setting.axis.n_runs


def test_placement_page_opens_with_the_answer(placement_page, evaluations):
    words = Page(placement_page).words
    found = evaluations["found"]
    n_avoided = int(found.rsu_all.is_avoided.sum())

    assert 0 < n_avoided < 104  # else this test is worth little

    in_full = words[words.index("The answer in full") :]
    assert f"of the simulated collisions ({n_avoided} of 104 runs)" in words

    proven = (
        "Proven in the planning model: no choice among 4032 candidate poses prevents"
        " more."
    )
    assert proven in in_full


def _first_screen(page):
    """Text of the page's head, without the answer in full."""
    start = page.index("<header>")
    end = page.index("<details")
    return " ".join(re.sub("<[^>]*>", " ", page[start:end]).split())


def test_the_first_screen_has_a_figure_for_each_kind_of_cars(
    placement_page, evaluations
):
    words = html.unescape(_first_screen(placement_page))
    found = evaluations["found"]
    share, own, together = (
        f"{100.0 * apr(verdict, found.axis):.1f} %"
        for verdict in (found.rsu_all, found.vut, found.vut_and_rsus)
    )
    n_avoided = int(found.rsu_all.is_avoided.sum())

    assert (
        "For cars that rely on the roadside alone, two cameras on two poles prevent"
        f" {share} of the simulated collisions ({n_avoided} of 104 runs), and 75.0 %"
        " if one sensor fails" in words
    )

    raised = f"they raise the share from {own} to {together}"
    assert f"For cars with their own camera, {raised}" in words
    assert "no other choice prevents more: proven." in words
    for cars, figure in (
        ("that rely on the roadside alone", share),
        ("with their own camera", together),
    ):
        assert f"Cars {cars} {figure} of the simulated collisions" in words
    assert "If a sensor fails 75.0 %" in words
    assert (
        "Proof proven best no other choice does better among 4,032 possible mountings"
        in words
    )
    assert re.search(r"Cost [\d,]+ EUR", words)


@pytest.mark.usefixtures("with_blank_pictures")
def test_the_first_screen_needs_no_code_and_no_abbreviation(
    placement_result, setting, evaluations
):
    found = evaluations["found"]
    dangers = build_dangers(
        found.rsu_all.is_avoided, found.axis, titles=case_titles(setting.runs)
    )
    page = _page_of(
        replace_fields(placement_result, dangers=dangers), setting, {"found": found}
    )
    words = html.unescape(_first_screen(page))

    for case in {run.case.name for run in setting.runs}:
        assert case not in words
    for unknown in ("APR", "VUT", "RSU", "HiGHS", "detection table"):
        assert unknown not in words

    worst = dangers.by_case[0]
    titles = {run.case.name: run.case.title for run in setting.runs}
    title = titles[worst.name].replace("VUT", "car")

    assert (
        f"{title[:1].upper()}{title[1:]}: {worst.not_avoided} of {worst.runs} not"
        " prevented." in words
    )


@pytest.mark.usefixtures("with_blank_pictures")
def test_the_first_screen_tells_weights_once_and_no_proof_that_there_is_not(
    placement_result, setting, evaluations
):
    axis = setting.axis
    weight = np.where(np.arange(axis.n_runs) % 2, 3.0, 1.0)
    weighted = replace(setting, axis=replace(axis, weight=weight / weight.sum()))
    found = evaluations["found"]
    found = replace(found, axis=weighted.axis)
    page = _page_of(
        replace_fields(
            placement_result,
            bound=0.99,
            stages=(
                StageRecord(
                    name="apr",
                    objective=0.9,
                    bound=0.99,
                    gap=0.1,
                    seconds=1.0,
                ),
            ),
        ),
        weighted,
        {"found": found},
    )
    words = html.unescape(_first_screen(page))
    n_avoided = int(found.rsu_all.is_avoided.sum())

    assert words.count("All shares on this page are weighted;") == 1

    said = f"{n_avoided} of 104 are prevented ({100.0 * n_avoided / 104:.1f} %)"
    assert f"without weights, {said}" in words
    assert "no other choice" not in words
    assert "Proof at most 9.0 points could be gained by a better choice" in words


@pytest.mark.usefixtures("with_blank_pictures")
@pytest.mark.parametrize(
    ("detector", "is_told"),
    [
        ("geometric", False),
        ("response", True),
    ],
)
def test_a_plan_by_a_detector_that_misses_by_chance_says_so(
    placement_result, setting, evaluations, detector, is_told
):
    page = _page_of(
        replace_fields(placement_result, detector=detector),
        setting,
        {"found": evaluations["found"]},
    )
    assert (
        "--samples 8 optimises the mean of eight worlds" in _first_screen(page)
    ) == is_told


def test_a_layout_that_was_given_is_not_said_to_be_proven(evaluation_page):
    assert "this layout was given, not optimised" in _first_screen(evaluation_page)


def test_at_most_ten_sections_are_in_sight(page):
    in_sight = re.sub(r'<details class="part">.*?</summary>', "", page, flags=re.DOTALL)
    assert 3 < len(re.findall("<h2 id=", in_sight[in_sight.index("<main>") :])) <= 12
    assert page.count('<details class="part">') >= 5


def test_placement_page_shows_the_certificate(placement_page):
    words = Page(placement_page).words
    assert "Partly: all objectives except smallest time to spare are proven." in words
    assert "HiGHS 1.15.1" in words
    assert "97.0 %" in words
    assert "they disagree on 1.9 % of the runs" in words


@pytest.mark.usefixtures("with_blank_pictures")
def test_each_by_itself_where_one_unit_must_confirm(
    placement_result, setting, evaluations
):
    found = evaluations["found"]
    avoided = np.any([unit.is_avoided for unit in found.units.values()], axis=0)
    result = replace_fields(
        placement_result, fusion="single", dangers=build_dangers(avoided, found.axis)
    )
    page = _page_of(result, setting, {"found": found})
    n_avoided = int(avoided.sum())

    assert f"prevent {n_avoided} of 104 simulated collisions" in Page(page).words


def test_page_without_optimisation_leaves_its_parts_out(
    evaluation_page, comparison_page
):
    for page in (evaluation_page, comparison_page):
        words = Page(page).words
        for part in (
            "proven",
            "Solver",
            "detection table",
            "disagree",
            "candidate poses",
            "Budget",
        ):
            assert part not in words


@pytest.mark.usefixtures("with_blank_pictures")
def test_names_are_escaped(setting, evaluations):
    unit = load_carlancap_layout().units[0]
    evil = replace(unit, id=f'"{EVIL}', site_id=EVIL)
    layout = Layout(name=EVIL, units=(evil,))
    evaluation = build_evaluation(setting, layout, seed=7)
    result = plain_result(evaluation, versions={EVIL: EVIL}, seconds={EVIL: 1.0})
    page = _page_of(
        result, setting, {EVIL: evaluation, "b": evaluations["found"]}, command=EVIL
    )
    plain = _without_scripts(page)

    assert "<script" not in plain

    parsed = Page(plain)
    assert parsed.text.count(EVIL) > 5
    assert page.count("<script") == page.count("</script>")


def table_rows(page, caption):
    """Cells of the table with this caption, head first."""
    (table,) = [
        text
        for text in re.findall(r"<table>.*?</table>", page, re.DOTALL)
        if f"<caption>{caption}" in text
    ]
    return [
        [
            html.unescape(cell)
            for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
        ]
        for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)
    ]


def page_of(setting, layout, *, seed=5):
    """Report and evaluation of a layout."""
    evaluation = build_evaluation(setting, layout, seed=seed)
    page = _page_of(plain_result(evaluation), setting, {"found": evaluation})
    return page, evaluation


@pytest.fixture(scope="module")
def layout():
    """One of the study's units."""
    return Layout(name="found", units=load_carlancap_layout().units[:1])


def with_weights(setting, weight):
    """A setting whose runs have these weights."""
    return replace(setting, axis=replace(setting.axis, weight=weight))


def test_every_case_is_listed_with_its_runs_and_last_moments(evaluation_page, setting):
    head, *rows = table_rows(
        evaluation_page, "Cases; from all: east, north, west, south<"
    )
    assert "weight" not in head
    assert [row[0] for row in rows] == ["CPNC-50", "CBNA", "CBLA"]

    for name, title, who, speeds, approaches, n_runs, earliest, latest in rows:
        runs = [run for run in setting.runs if run.case.name == name]
        case = runs[0].case

        assert title == case.title
        assert who == f"{case.vru.name}, {case.vru_speed_kmh:g}\xa0km/h"

        driven = [run.vut_speed_kmh for run in runs]
        assert speeds == f"{min(driven):g} to {max(driven):g} by 5"
        assert set(driven) == set(np.arange(min(driven), max(driven) + 5.0, 5.0))
        assert approaches == "all"
        assert int(n_runs) == len(runs)

        last_s = [run.last_brake_time_s for run in runs]
        for text, value in (
            (earliest, min(last_s)),
            (latest, max(last_s)),
        ):
            assert text == f"{value:.2f}".replace("-", "\N{MINUS SIGN}")


@pytest.mark.usefixtures("with_blank_pictures")
def test_a_case_that_some_approaches_do_not_carry_names_the_others(setting, layout):
    keeps = [
        not (run.case.name == "CBNA" and run.approach in ("north", "west"))
        and not (run.case.name == "CBLA" and run.vut_speed_kmh not in (25.0, 60.0))
        for run in setting.runs
    ]
    runs = tuple(run for run, kept in zip(setting.runs, keeps, strict=True) if kept)
    axis = build_frame_axis(runs, np.full(len(runs), 1.0 / len(runs)))
    _, *rows = table_rows(
        page_of(replace(setting, runs=runs, axis=axis), layout)[0], "Cases"
    )
    by_case = {row[0]: (row[3], row[4]) for row in rows}

    assert by_case == {
        "CPNC-50": ("20 to 60 by 5", "all"),
        "CBNA": ("20 to 60 by 5", "east, south"),
        "CBLA": ("25, 60", "all"),
    }


@pytest.mark.usefixtures("with_blank_pictures")
def test_what_no_braking_avoids_is_told(setting, layout):
    runs = tuple(
        replace(run, last_brake_time_s=-math.inf) if run.id == "CBNA/east/60" else run
        for run in setting.runs
    )
    hopeless = replace(
        setting, runs=runs, axis=build_frame_axis(runs, setting.axis.weight)
    )
    page, _ = page_of(hopeless, layout)

    assert "Braking cannot avoid the impact in 1 run of CBNA." in Page(page).words
    assert "inf" not in "".join(table_rows(page, "Cases")[2])
    assert "no braking avoids" not in Page(page_of(setting, layout)[0]).words


def test_equal_weights_are_told_and_take_no_column(evaluation_page):
    words = Page(evaluation_page).words
    assert "Every run counts the same." in words
    assert "by weight" not in words
    assert table_rows(evaluation_page, "Runs")[0][:2] == ["run", "last moment (s)"]


@pytest.mark.usefixtures("with_blank_pictures")
def test_unequal_weights_are_told_by_case_and_run(setting, layout):
    is_counted = np.array([run.case.name != "CBNA" for run in setting.runs])
    weight = np.where(is_counted, np.arange(1.0, len(is_counted) + 1.0), 0.0)
    weight /= weight.sum()
    weighted = with_weights(setting, weight)
    page, evaluation = page_of(weighted, layout)
    words = Page(page).words

    assert "is the share of the runs, by weight, in which the car brakes" in words

    share = percent(apr(evaluation.rsu_all, weighted.axis))
    assert f"prevents {share} of the simulated collisions by weight" in words

    lightest = percent(weight[weight > 0.0].min())
    assert f"from {lightest} to {percent(weight.max())} of the whole each." in words
    assert (
        f"{int((~is_counted).sum())} runs of weight 0 are simulated but not counted."
        in words
    )

    head, *rows = table_rows(page, "Cases")
    share = {row[0]: row[head.index("weight")] for row in rows}
    for name in ("CPNC-50", "CBNA", "CBLA"):
        of_case = np.array([run.case.name == name for run in setting.runs])
        assert share[name] == percent(float(weight[of_case].sum()))
    head, *rows = table_rows(page, "Runs")
    index_of = {run.id: index for index, run in enumerate(setting.runs)}

    assert all(
        row[head.index("weight")] == percent(weight[index_of[row[0]]]) for row in rows
    )

    apr_of = {
        row[0]: row[1:] for row in table_rows(page, "Accident prevention ratio by case")
    }
    assert apr_of["CBNA"] == ["\N{EN DASH}"] * 3


def test_runs_that_are_hit_come_first_and_are_counted(evaluation_page, evaluations):
    head, *rows = table_rows(evaluation_page, "Runs")
    outcomes = [row[head.index("found")].split(",")[0] for row in rows]
    n_hit = int((~evaluations["found"].rsu_all.is_avoided).sum())

    assert 0 < n_hit < len(rows)
    assert outcomes == ["HIT"] * n_hit + ["avoided"] * (len(rows) - n_hit)
    assert f"{len(rows)} runs, {n_hit} with an impact, " in Page(evaluation_page).words


@pytest.mark.usefixtures("with_blank_pictures")
def test_several_weathers_are_told_and_have_a_column(evaluation_page):
    question = Question(
        cases="CBLA",
        along_arms="0",
        approaches="east",
        weather="day,night",
    )
    setting = build_setting(question, load_study_scene())
    page, _ = page_of(
        setting, Layout(name="found", units=load_carlancap_layout().units[:1])
    )
    words = Page(page).words

    assert "day, night. Bad weather reduces the contrast that cameras see" in words
    assert "No recordings at night, in rain or in fog were compared" in words

    head, *rows = table_rows(page, "Runs")
    assert head[1] == "weather"
    assert {row[1] for row in rows} == {"day", "night"}
    assert all(("/night" in row[0]) == (row[1] == "night") for row in rows)
    assert "weather" not in table_rows(evaluation_page, "Runs")[0]
    assert "Bad weather reduces" not in Page(evaluation_page).words


@pytest.mark.usefixtures("with_blank_pictures")
def test_braking_and_the_moment_of_the_frames_are_told(
    setting, layout, evaluation_page
):
    words = Page(evaluation_page).words
    assert "constant from the onset" in words
    assert "One frame falls on the moment of the impact." in words

    question = Question(
        cases="CBLA",
        along_arms="0",
        approaches="east",
        build_up_s=0.3,
    )
    slow = build_setting(question, load_study_scene())
    words = Page(page_of(slow, layout)[0]).words

    assert "reached linearly 0.3 s after the onset" in words


def test_five_questions_are_answered_in_sight_and_all_else_is_folded(placement_page):
    sections = set(re.findall(r'<h2 id="([a-z-]+)"', placement_page))
    folded = set(
        re.findall(
            r'<details class="part">\s*<summary><h2 id="([a-z-]+)"', placement_page
        )
    )
    in_sight = {"units", "failures", "bill", "accidents", "dangers"}

    assert in_sight <= sections - folded
    assert {"proof", "comparison", "runs", "cases"} <= folded

    differ = "Runs that only one of two layouts avoids"
    assert f"<summary>{differ}</summary>" in placement_page
