import base64
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from experiments.driving import build_setting
from experiments.question import Question
from experiments.report import render_report, write_report
from experiments.study import load_carlancap_layout
from geometry.errors import InputError
from geometry.scene_files import load_study_scene
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, apr
from placement.layout import Layout, layout_records
from scenarios.aeb import confirmation_time_s, is_in_time

VOID = {"meta", "img", "br", "hr", "link", "input"}
COMMAND = "place-rsus --budget 2 --out 'a <folder>'"
EVIL = "<script>alert(1)</script>"


class Page(HTMLParser):
    """Checks that tags close in order; collects tags, images and text."""

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.images, self.text = [], [], [], ""
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
        if "style" not in self.open:
            self.text += data

    @property
    def words(self):
        return " ".join(self.text.split())


@pytest.fixture(scope="module")
def setting():
    return build_setting(Question(cases="CPNC-50,CBNA,CBLA"), load_study_scene())


def build_evaluation(setting, layout, *, seed, share=0.9):
    axis, rule = setting.axis, setting.rule
    rng = np.random.default_rng(seed)

    def verdict(detected):
        confirmation = np.array(
            [
                confirmation_time_s(
                    detected[axis.frames_of(index)],
                    axis.time_s[axis.frames_of(index)],
                    n_confirmations=rule.n_confirmations,
                )
                for index in range(axis.n_runs)
            ]
        )
        return Verdict(
            detected=detected,
            confirmation_time_s=confirmation,
            is_avoided=is_in_time(confirmation, axis.last_brake_time_s, latency_s=rule.latency_s),
        )

    detected = rng.random((len(layout.units) + 1, axis.n_frames)) < share
    # Nobody sees some runs, so that not everything is avoided.
    detected &= np.repeat(
        rng.random((len(detected), axis.n_runs)) < 0.7, np.diff(axis.run_start), axis=1
    )
    return Evaluation(
        layout=layout,
        axis=axis,
        vut=verdict(detected[0]),
        units={unit.id: verdict(row) for unit, row in zip(layout.units, detected[1:], strict=True)},
        rsu_all=verdict(detected[1:].any(axis=0)),
        vut_and_rsus=verdict(detected.any(axis=0)),
    )


@pytest.fixture(scope="module")
def evaluations(setting):
    baseline = load_carlancap_layout()
    found = Layout(
        name="found",
        units=tuple(
            CandidatePose(
                id=f"{unit.site_id}/7m/{index}",
                site_id=unit.site_id,
                pose=unit.pose,
                camera=unit.camera,
            )
            for index, unit in enumerate(baseline.units[:2])
        ),
    )
    greedy = Layout(name="greedy", units=baseline.units[2:4])
    return {
        layout.name: build_evaluation(setting, layout, seed=seed)
        for seed, layout in enumerate([found, greedy, baseline])
    }


def plain_summary(evaluation):
    return {
        "name": evaluation.layout.name,
        "layout": layout_records(evaluation.layout),
        "runs": evaluation.axis.n_runs,
        "seconds": {"evaluation": 1.25},
        "versions": {"place-rsus": "0.1.0"},
    }


@pytest.fixture(scope="module")
def placement_summary(evaluations):
    return plain_summary(evaluations["found"]) | {
        "budget": 2,
        "fusion": "any",
        "candidates": 4032,
        "apr": 0.97,
        "bound": 0.97,
        "gap": 0.0,
        "apr_without_worst_unit": 0.8125,
        "evaluation": {"apr_without_worst_unit": 0.75},
        "stages": [
            {"name": "apr", "objective": 0.97, "bound": 0.97, "gap": 0.0, "seconds": 2.5},
            {
                "name": "smallest_margin_s",
                "objective": 0.0,
                "bound": 0.5,
                "gap": float("inf"),
                "seconds": 60.0,
            },
        ],
        "solver": "HiGHS 1.15.1",
        "surrogate_disagreement": 2 / 104,
    }


@pytest.fixture(scope="module")
def placement_page(placement_summary, setting, evaluations):
    return render_report(placement_summary, setting, evaluations, command=COMMAND)


@pytest.fixture(scope="module")
def comparison_page(setting, evaluations):
    pair = {name: evaluations[name] for name in ("found", "carlancap-12")}
    return render_report(plain_summary(pair["found"]), setting, pair, command=COMMAND)


@pytest.fixture(scope="module")
def evaluation_page(setting, evaluations):
    one = {"found": evaluations["found"]}
    return render_report(plain_summary(one["found"]), setting, one, command=COMMAND)


@pytest.fixture(params=["placement_page", "comparison_page", "evaluation_page"])
def page(request):
    return request.getfixturevalue(request.param)


def test_page_is_well_formed_and_stands_alone(page):
    parsed = Page(page)
    assert len(page.encode()) < 5_000_000
    assert not re.search(r"https?://|//\w+\.\w+", page)
    tags = {tag for tag, _ in parsed.tags}
    assert not tags & {"script", "link", "iframe", "object", "base", "form"}
    for _, attributes in parsed.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:")


def test_page_has_a_language_a_title_and_one_main_heading(page):
    tags = Page(page).tags
    assert ("html", {"lang": "en"}) in tags
    assert ("meta", {"charset": "utf-8"}) in tags
    assert [tag for tag, _ in tags].count("h1") == 1
    assert [tag for tag, _ in tags].count("title") == 1


def test_every_figure_is_a_png_with_an_alt_text(page):
    images = Page(page).images
    assert len(images) >= 5
    for image in images:
        assert len(image["alt"]) > 40
        data = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"))
        assert data.startswith(b"\x89PNG")
    assert len({image["src"] for image in images}) == len(images)


def test_every_table_has_a_caption_and_scoped_headers(page):
    tags = Page(page).tags
    names = [tag for tag, _ in tags]
    assert names.count("caption") == names.count("table") == names.count("thead")
    assert all(attributes.get("scope") in ("col", "row") for tag, attributes in tags if tag == "th")


def test_every_unit_and_every_run_appears(page, setting):
    words = Page(page).words
    for unit in ("corner-se/7m/0", "corner-ne/7m/1"):
        assert unit in words
    rows = re.findall(r'<th scope="row">(?:CBNA|CBLA|CPNC-50)/\w+/\d+</th>', page)
    assert len(rows) == setting.axis.n_runs


def test_placement_page_opens_with_the_answer(placement_page, evaluations):
    words = Page(placement_page).words
    found, baseline = evaluations["found"], evaluations["carlancap-12"]
    n_avoided = int(found.rsu_all.is_avoided.sum())
    assert 0 < n_avoided < 104  # else this test is worth little
    assert (
        f"2 cameras avoid {n_avoided} of 104 runs "
        f"(APR {100.0 * apr(found.rsu_all, found.axis):.1f} %). "
        "Proven on the detection table: no choice among 4032 candidate poses has a higher APR. "
        f"carlancap-12 (12 cameras) avoids {int(baseline.rsu_all.is_avoided.sum())} of 104 runs"
    ) in words
    assert "If any one camera fails, the others still reach an APR of 75.0 % or more." in words
    assert f"alone avoids {int(found.vut.is_avoided.sum())} of 104 runs" in words


def test_placement_page_shows_the_certificate(placement_page):
    words = Page(placement_page).words
    assert "Not in full: proven are all objectives but smallest time to spare." in words
    assert "HiGHS 1.15.1" in words
    assert "97.0 %" in words
    assert "They disagree on 1.9 % of the runs" in words


def test_open_gap_is_not_called_proven(placement_summary, setting, evaluations):
    stages = [{"name": "apr", "objective": 0.9, "bound": 0.95, "gap": 0.055556, "seconds": 60.0}]
    page = render_report(
        placement_summary | {"stages": stages},
        setting,
        {"found": evaluations["found"]},
        command=COMMAND,
    )
    words = Page(page).words
    assert "on the detection table, no other can exceed an APR of 95.0 %." in words
    assert "Proven on the detection table" not in words


def test_each_by_itself_where_one_camera_must_confirm(placement_summary, setting, evaluations):
    found = evaluations["found"]
    page = render_report(
        placement_summary | {"fusion": "single"}, setting, {"found": found}, command=COMMAND
    )
    n_avoided = int(np.any([unit.is_avoided for unit in found.units.values()], axis=0).sum())
    assert f"2 cameras, each by itself, avoid {n_avoided} of 104 runs" in Page(page).words


def test_page_without_optimisation_leaves_its_parts_out(evaluation_page, comparison_page):
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


def test_comparison_shows_both_layouts(comparison_page, evaluations):
    parsed = Page(comparison_page)
    ours, theirs = (evaluations[name].rsu_all.is_avoided for name in ("found", "carlancap-12"))
    assert (
        f"found avoids {int((ours & ~theirs).sum())} that carlancap-12 does not, "
        f"and carlancap-12 avoids {int((theirs & ~ours).sum())} that found does not."
    ) in parsed.words
    plans = [image for image in parsed.images if image["alt"].startswith("Plan")]
    heatmaps = [image for image in parsed.images if image["alt"].startswith("Heatmap")]
    assert (len(plans), len(heatmaps)) == (2, 6)
    assert all(f"RSU{index}" in parsed.words for index in range(12))


def test_names_are_escaped(setting, evaluations):
    unit = load_carlancap_layout().units[0]
    layout = Layout(
        name=EVIL,
        units=(CandidatePose(id=f'"{EVIL}', site_id=EVIL, pose=unit.pose, camera=unit.camera),),
    )
    evaluation = build_evaluation(setting, layout, seed=7)
    summary = plain_summary(evaluation) | {"versions": {EVIL: EVIL}, "seconds": {EVIL: 1.0}}
    page = render_report(
        summary, setting, {EVIL: evaluation, "b": evaluations["found"]}, command=EVIL
    )
    assert "<script" not in page
    parsed = Page(page)
    assert parsed.text.count(EVIL) > 5
    assert not any(tag == "script" for tag, _ in parsed.tags)


def test_runs_to_draw_can_be_chosen(setting, evaluations):
    one = {"found": evaluations["found"]}
    page = render_report(
        plain_summary(one["found"]),
        setting,
        one,
        command=COMMAND,
        heatmap_runs=["CPNC-50/east/55", "CBLA/west/50"],
    )
    alts = [image["alt"] for image in Page(page).images if image["alt"].startswith("Heatmap")]
    assert [alt.split(".")[0] for alt in alts] == [
        "Heatmap of CPNC-50 from the east at 55 km/h",
        "Heatmap of CBLA from the west at 50 km/h",
    ]


def test_unknown_run_is_named(setting, evaluations):
    with pytest.raises(InputError) as caught:
        render_report({}, setting, evaluations, command="", heatmap_runs=["CPNC-50/east/56"])
    assert str(caught.value) == "heatmap run: got 'CPNC-50/east/56'; expected the id of a run"


def test_write_report_writes_the_page(tmp_path, setting, evaluations, evaluation_page):
    one = {"found": evaluations["found"]}
    path = write_report(tmp_path, plain_summary(one["found"]), setting, one, command=COMMAND)
    assert path == tmp_path / "report.html"
    assert path.read_text(encoding="utf-8") == evaluation_page
