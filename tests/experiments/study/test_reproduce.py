"""The study's published figures beside those of this program."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from experiments.study import reproduction
from experiments.study.reproduction import (
    BEHIND,
    FARTHEST,
    TURNING,
    StudyVariant,
    build_additional_variants,
    build_variants,
    load_published,
    quantities,
    write_reproduction,
)
from placement.compute import Compute
from placement.evaluation import apr, detected_share
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from scenarios.runs import build_frame_axis
from scenarios.weights import weight_per_run

SOME = ("CPNC-50/east/55", "CBNA/east/60", "CBLA/east/50", "CPNC-50/west/20")


@pytest.fixture(scope="module")
def small():
    """Two variants of the study on four of its runs."""
    first, *_, last = build_variants()
    variants = []
    for variant in (first, last):
        runs = tuple(run for run in variant.setting.runs if run.id in SOME)
        weight = weight_per_run(runs)
        axis = build_frame_axis(runs, weight)
        setting = replace(variant.setting, runs=runs, axis=axis)
        variants.append(
            StudyVariant(
                name=variant.name,
                setting=setting,
                layout=variant.layout,
            )
        )

    return tuple(variants)


def test_the_published_figures_are_those_of_the_study():
    """CarlaNCAP study, results in daylight."""
    published = load_published().figures
    figures = {}
    for figure in published:
        figures[figure.quantity, figure.case] = figure.value

    assert figures["frames of the VUT", "CPNC-50"] == 0.1397
    assert figures["frames of the VUT", "CBLA"] == 0.8920
    assert figures["frames of the VUT", "CBNA"] == 0.0512
    assert figures["frames of any RSU", "CPNC-50"] == 0.9893
    assert figures["APR of the VUT", "CPNC-50"] == 0.6563

    uses = {figure.use for figure in published}
    assert uses == {"set by it", "compared"}


@pytest.mark.long
def test_quantities_are_shares_by_case(small):
    """Of the runs of each case alone."""
    variant = small[0]
    layout = Layout(name="two", units=variant.layout.units[2:4])
    evaluation = evaluate_layout(layout, variant.setting)
    found = quantities(evaluation)
    axis = evaluation.axis

    for case in ("CPNC-50", "CBNA", "CBLA"):
        mask = np.array(axis.cases) == case
        by_vut = apr(evaluation.vut, axis, mask)
        by_unit = apr(evaluation.units["RSU3"], axis, mask)
        seen = detected_share(evaluation.rsu_all, axis, mask)

        assert found["APR of the VUT", case] == by_vut
        assert found["APR of RSU3", case] == by_unit
        assert found["frames of any RSU", case] == seen


# Quickly: the other tests of this file.
@pytest.mark.long
def test_the_page_has_every_published_figure_and_a_range(small, tmp_path, monkeypatch):
    """With two small variants in place of all."""
    monkeypatch.setattr(reproduction, "build_variants", lambda: small)
    monkeypatch.setattr(reproduction, "build_additional_variants", lambda: small[:1])
    monkeypatch.setattr(reproduction, "DETECTORS", ())
    stages = []
    compute = Compute(workers=2, progress=lambda *step: stages.append(step))
    write_reproduction(tmp_path, compute=compute)
    text = (tmp_path / "reproduction.md").read_text()

    for figure in load_published().figures:
        percent = f"{100 * figure.value:.2f} %"
        row = f"| {figure.quantity} | {figure.case} | {percent} |"
        assert row in text

    assert "| field of view 90 deg, not 110 |" in text
    assert "## Predictions" in text

    rows = text.splitlines()
    published = next(row for row in rows if row.startswith("| published |"))

    for figure in load_published().additional:
        assert figure.published in published

    # The small variants do not drive these cases.
    assert "| as it is | - | - | - | - |" in text

    heatmaps = tmp_path / "reproduction_heatmaps.png"
    picture = heatmaps.read_bytes()
    names = [path.name for path in tmp_path.iterdir()]

    assert picture.startswith(b"\x89PNG")
    assert stages[0] == ("evaluate variants", 0, 3)
    assert sorted(names) == [
        "reproduction.md",
        "reproduction_heatmaps.png",
    ]


def test_a_use_that_does_not_exist_is_named(monkeypatch):
    """By its place in the file of published figures."""
    entry = {
        "quantity": "x",
        "case": "y",
        "value": 0.5,
        "use": "fitted",
        "depends_on": "z",
    }
    data = {"figures": [entry], "additional": []}
    monkeypatch.setattr(reproduction, "load_data", lambda *path: data)
    load_published.cache_clear()

    with pytest.raises(msgspec.ValidationError, match=r"figures\[0\]\.use"):
        load_published()

    load_published.cache_clear()


# Quickly: test_variants.py, of the other cases
@pytest.mark.long
def test_the_additional_cases_are_changed_in_one_thing_at_a_time():
    """Rule, recordings, position, or who comes from where."""
    variants = {}
    for variant in build_additional_variants():
        variants[variant.name] = variant.setting
    base = variants["as it is"]

    assert set(base.axis.cases) == {"CPNCO-50", "CPLA-50", "CBTAno-50", "CBTAfo-50"}
    assert set(base.axis.positions) == {"0"}
    assert base.rule.track_memory_s == np.inf

    live = variants["a track lives for 1 s"]
    assert live.rule == replace(base.rule, track_memory_s=1.0)
    assert live.axis is base.axis

    short = variants["recordings of the last 3 s before the impact"]
    assert short.axis.run_ids == base.axis.run_ids

    for run, whole in zip(short.runs, base.runs, strict=True):
        n_frames = len(run.time_s)
        end_m = whole.vru_position_m[-n_frames:]
        assert n_frames == min(31, len(whole.time_s))
        assert (run.vru_position_m == end_m).all()

    near = variants["15 m before the crosswalk"].axis
    far = variants["30 m before the crosswalk"].axis

    assert set(near.positions) == {"-15"}
    assert far.cases.count("CPNCO-50") >= 4

    for run in variants[BEHIND].runs:
        yaw = np.radians(run.vut_yaw_deg[0])
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        assert ahead @ way_of(run) > 0.9

    farther = {run.id: run for run in variants[FARTHEST].runs}
    for run in base.runs:
        if run.case.name in TURNING:
            end_m = run.vru_position_m[-1]
            moved_m = farther[run.id].vru_position_m[-1] - end_m
            east, north = way_of(run)
            left_m = east * moved_m[1] - north * moved_m[0]
            assert abs(left_m) == pytest.approx(30.0, abs=0.1)


def way_of(run):
    """Unit vector from where the VRU starts to where it ends."""
    begin_m = run.vru_position_m[0]
    end_m = run.vru_position_m[-1]
    way_m = (end_m - begin_m)[:2]
    return way_m / np.linalg.norm(way_m)
