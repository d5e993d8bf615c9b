import base64
import gzip
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from interactive_pages import EVIL, build_evaluation, build_layout, page_around, with_evil_names
from packed_bits import unpack_bits

from experiments.parts.player import (
    ALL_OTHERS,
    LEAST_TIME,
    NOT_AVOIDED,
    ONE_PER_CASE,
    SHOWN_ABOVE,
    choose_runs,
    interactive_part,
    pack_bits,
    plan_record,
)
from experiments.parts.view_3d import (
    dashes,
    nearest_triangles,
    packed_plotly,
    plotly_script,
    road_area,
    to_script_json,
    view_border,
    view_record,
)
from geometry.errors import InputError
from geometry.lidar import LidarModel
from geometry.sensors import project_points


@pytest.fixture(scope="module")
def evaluation(small_setting):
    return build_evaluation(small_setting, build_layout(5), share=0.1)


def read(part, key="player_json"):
    return json.loads(part[key])


# ---------------------------------------------------------------- text in scripts


@given(st.recursive(st.text(), lambda inner: st.dictionaries(st.text(), inner), max_leaves=5))
def test_no_text_breaks_out_of_a_script_and_all_come_back(value):
    text = to_script_json(value)
    assert json.loads(text) == value
    assert text.isascii()
    assert not set("<>&\n\r") & set(text)


def test_an_infinity_is_refused_not_written_as_no_json():
    with pytest.raises(ValueError, match="Out of range"):
        to_script_json(math.inf)


@given(st.integers(1, 6), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_bits_come_back(n_rows, n, seed):
    bits = np.random.default_rng(seed).random((n_rows, n)) < 0.5
    assert (unpack_bits(pack_bits(bits), n_rows=n_rows, n=n) == bits).all()


# ---------------------------------------------------------------- runs


def test_records_say_what_runs_and_evaluation_say(small_setting, evaluation):
    other = build_evaluation(small_setting, build_layout(2, name="other"), seed=3)
    part = interactive_part(small_setting, {"ours": evaluation, "other": other})
    player = read(part)
    names = [party["name"] for party in player["parties"]]
    assert names[0] == "VUT"
    assert names[-3:] == ["all RSUs", "VUT and RSUs", "other: all RSUs"]
    by_id = {run.id: run for run in small_setting.runs}
    assert {record["id"] for record in player["runs"]} == set(by_id)
    verdicts = [
        evaluation.vut,
        *evaluation.units.values(),
        evaluation.rsu_all,
        evaluation.vut_and_rsus,
        other.rsu_all,
    ]
    axis = evaluation.axis
    for record in player["runs"]:
        run, index = by_id[record["id"]], axis.run_ids.index(record["id"])
        n = len(run.time_s)
        bits = unpack_bits(record["bits"], n_rows=len(verdicts), n=n)
        for row, verdict in zip(bits, verdicts, strict=True):
            assert (row == verdict.detected[axis.frames_of(index)]).all()
        assert np.abs(np.array(record["time"]) / 1000.0 - run.time_s).max() <= 0.0005
        for key, position, yaw in (
            ("car", run.vut_position_m, run.vut_yaw_deg),
            ("road", run.vru_position_m, run.vru_yaw_deg),
        ):
            shown = np.stack([record[key]["x"], record[key]["y"]], axis=1) / 100.0
            assert np.abs(shown - position).max() <= 0.00501
            assert np.abs(np.array(record[key]["yaw"]) / 10.0 - yaw).max() <= 0.0501
        for verdict, confirmed, onset, avoided in zip(
            verdicts, record["confirmed"], record["onset"], record["avoided"], strict=True
        ):
            for shown, time_s in (
                (confirmed, verdict.confirmation_time_s[index]),
                (onset, verdict.onset_time_s[index]),
            ):
                if np.isfinite(time_s):
                    assert shown / 1000.0 == pytest.approx(time_s, abs=0.00051)
                else:
                    assert shown is None
            assert avoided == verdict.is_avoided[index]
        assert len(record["parked"]) == len(run.obstruction)
        # Where the car is at the last moment: between its places in the frames around it.
        after = int(np.searchsorted(run.time_s, run.last_brake_time_s))
        place = np.array(record["lastPlace"]) / 100.0
        ends = run.vut_position_m[after - 1 : after + 1]
        assert (place >= ends.min(axis=0) - 0.02).all()
        assert (place <= ends.max(axis=0) + 0.02).all()


def test_runs_are_chosen_in_groups_each_once(small_setting):
    evaluation = build_evaluation(small_setting, build_layout(2), share=0.02, seed=1)
    first = "CBLA/east/25"
    chosen = choose_runs(evaluation, first_runs=[first, "unknown", first])
    indices = [index for index, _ in chosen]
    assert sorted(indices) == list(range(6))
    assert chosen[0] == (evaluation.axis.run_ids.index(first), SHOWN_ABOVE)
    for index, group in chosen[1:]:
        is_avoided = evaluation.rsu_all.is_avoided[index]
        assert group in (LEAST_TIME if is_avoided else NOT_AVOIDED, ONE_PER_CASE)
    assert NOT_AVOIDED in dict(chosen).values()


@pytest.mark.parametrize("max_runs", [1, 2, 3, 5])
def test_no_more_runs_than_asked_for(small_setting, evaluation, max_runs):
    assert len(choose_runs(evaluation, max_runs=max_runs)) == max_runs
    firsts = small_setting.axis.run_ids[:4]
    chosen = choose_runs(evaluation, first_runs=firsts, max_runs=max_runs)
    assert len(chosen) == max_runs
    assert [index for index, _ in chosen[:4]] == list(range(4))[:max_runs]
    with pytest.raises(InputError, match="max_runs"):
        choose_runs(evaluation, max_runs=0)


def test_runs_evaluated_on_other_frames_are_not_played(small_setting, evaluation):
    odd = small_setting.runs[0]
    fewer = replace(odd, time_s=odd.time_s[1:])
    setting = replace(small_setting, runs=(fewer, *small_setting.runs[1:]))
    played = {run["id"] for run in read(interactive_part(setting, {"a": evaluation}))["runs"]}
    assert played == {run.id for run in small_setting.runs[1:]}
    assert interactive_part(replace(setting, runs=(fewer,)), {"a": evaluation}) is None
    with pytest.raises(InputError, match="evaluations"):
        interactive_part(setting, {})


# ---------------------------------------------------------------- view and plan


@pytest.mark.parametrize("index", [0, 1])
def test_view_borders_lie_on_the_border_of_the_sensor(index):
    unit = build_layout(2).units[index]
    ends = view_border(unit, max_range_m=35.0)
    offsets = ends - unit.pose.position_m
    length = np.linalg.norm(offsets, axis=1)
    assert ends[:, 2].min() >= -1.0e-9
    assert (np.isclose(length, 35.0) | (np.isclose(ends[:, 2], 0.0) & (length < 35.0))).all()
    if isinstance(unit.sensor, LidarModel):
        bearing = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) - unit.pose.yaw_deg
        assert np.abs((bearing + 180.0) % 360.0 - 180.0).max() <= 90.0
        return
    column, row, depth = project_points(ends, unit.pose, unit.sensor).T
    off_border = np.minimum.reduce(
        [np.abs(column), np.abs(column - unit.sensor.width_px)]
        + [np.abs(row), np.abs(row - unit.sensor.height_px)]
    )
    assert off_border.max() < 1.0e-6
    assert depth.min() > 0.0


@given(
    st.lists(st.floats(0.3, 20.0), min_size=1, max_size=6),
    st.sampled_from([(1.6, 1.0), (1.8, 0.6, 0.4, 0.6), (0.4, 0.6)]),
)
def test_dashes_leave_the_share_of_a_line_that_the_pattern_says(steps, pattern):
    line = np.zeros((len(steps) + 1, 3))
    line[1:, 0] = np.cumsum(steps)
    pieces = dashes(line, pattern)
    drawn = sum(float(piece[-1, 0] - piece[0, 0]) for piece in pieces)
    fine = (np.arange(200_000) + 0.5) * line[-1, 0] / 200_000
    ends = np.cumsum(pattern)
    is_dash = np.searchsorted(ends, fine % ends[-1], side="right") % 2 == 0
    assert drawn == pytest.approx(is_dash.mean() * line[-1, 0], abs=0.01)
    assert dashes(line, ())[0] is line


def test_far_triangles_are_left_out_and_that_is_said(small_setting, monkeypatch):
    scene = small_setting.scene
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    kept = nearest_triangles(scene, middle, 400)
    assert len(kept) == 400
    corners = scene.vertices_m[scene.triangles][..., :2]
    gap = np.maximum(corners.min(axis=1) - middle, middle - corners.max(axis=1))
    distance = np.hypot(*np.maximum(gap, 0.0).T)
    left_out = np.setdiff1d(np.arange(len(scene.triangles)), kept)
    assert distance[kept].max() <= distance[left_out].min()
    whole = view_record(scene, build_layout(2))
    assert whole["note"] == ""
    assert sum("names" in trace for trace in whole["traces"]) == 5
    monkeypatch.setattr("experiments.parts.view_3d.MAX_TRIANGLES", 400)
    assert view_record(scene, build_layout(2))["note"].startswith("866 of the scene's 1266")


def test_shades_do_not_depend_on_how_triangles_wind(small_setting):
    scene = small_setting.scene
    turned = replace(scene, triangles=scene.triangles[:, ::-1])
    one, other = (view_record(item, build_layout(1))["traces"] for item in (scene, turned))
    shades = [trace["intensity"] for trace in one if trace["name"] == "building"]
    assert shades == [trace["intensity"] for trace in other if trace["name"] == "building"]
    bright = np.frombuffer(base64.b64decode(shades[0]["bdata"]), dtype=np.uint8)
    (mesh,) = (trace for trace in one if trace["name"] == "building")
    heights = np.frombuffer(base64.b64decode(mesh["z"]["bdata"]), dtype="<f4")
    corners = np.stack(
        [heights[np.frombuffer(base64.b64decode(mesh[key]["bdata"]), "<u2")] for key in "ijk"]
    )
    is_flat = np.ptp(corners, axis=0) == 0.0
    assert (bright[is_flat] == 255).all()
    assert (bright[~is_flat] < 200).all()


def test_no_name_is_markup_to_the_library(small_setting):
    setting = with_evil_names(small_setting)
    name = EVIL.replace("\u2028", "")
    layout = build_layout(2, name=name, ids=[f"{name}{index}" for index in range(2)])
    for trace in view_record(setting.scene, layout, [layout])["traces"]:
        texts = [trace["name"], *trace.get("names", []), *trace.get("text", [])]
        assert not any("<" in text for text in [*texts, *trace.get("hovertext", [])])


def test_every_run_can_be_watched_those_that_stand_out_first(small_setting, evaluation):
    part = interactive_part(small_setting, {"a": evaluation}, max_runs=3)
    runs = read(part)["runs"]
    assert {run["id"] for run in runs} == set(evaluation.axis.run_ids)
    assert part["n_runs"] == part["n_all"] == len(runs)
    assert ALL_OTHERS not in {run["group"] for run in runs[:3]}
    assert {run["group"] for run in runs[3:]} == {ALL_OTHERS}


def test_runs_that_do_not_fit_are_left_out_but_never_those_that_stand_out(
    small_setting, evaluation, monkeypatch
):
    monkeypatch.setattr("experiments.parts.player._MAX_BYTES", 1)
    part = interactive_part(small_setting, {"a": evaluation}, max_runs=3)
    assert (part["n_runs"], part["n_all"]) == (3, evaluation.axis.n_runs)


def test_plan_holds_the_units_and_the_road(small_setting):
    record = plan_record(small_setting.scene, np.array([[-127.0, 41.0]]))
    assert record["half"] >= 4100
    assert {"lane", "junction", "building", "wall"} <= {part["name"] for part in record["classes"]}
    for part in record["classes"]:
        assert re.fullmatch(r"(M-?\d+ -?\d+(L-?\d+ -?\d+){2,}Z)+", part["path"])
    assert {arm["name"] for arm in record["arms"]} == {"north", "east", "south", "west"}
    assert road_area(small_setting.scene).area > 1000.0


# ---------------------------------------------------------------- the whole part


class Tags(HTMLParser):
    def __init__(self, page):
        super().__init__()
        self.ids, self.scripts = [], 0
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        self.ids += [value for name, value in attributes if name == "id"]


def test_a_page_stays_whole_whatever_things_are_called(small_setting):
    setting = with_evil_names(small_setting)
    printable = EVIL.replace("\u2028", "")
    layout = build_layout(3, name=printable, ids=[f"{printable}{index}" for index in range(3)])
    evil = build_evaluation(setting, layout)
    tame = page_around(
        interactive_part(small_setting, {"a": build_evaluation(small_setting, build_layout(3))})
    )
    page = page_around(interactive_part(setting, {EVIL: evil, f"{EVIL}2": evil}))
    assert Tags(page).scripts == Tags(tame).scripts
    assert Tags(page).ids == Tags(tame).ids
    assert len(set(Tags(page).ids)) == len(Tags(page).ids)
    assert "alert(1)</script>" not in page
    assert "https://" not in re.sub(r'(?s)<script type="text/plain".*?</script>', "", page)


def test_two_hundred_units_fit_into_the_page(small_setting):
    evaluation = build_evaluation(small_setting, build_layout(200), with_vam=True)
    part = interactive_part(small_setting, {"many": evaluation})
    assert len(page_around(part).encode()) < 6.0e6
    assert len(part["player_json"]) < 0.5e6
    assert len(part["view_json"]) < 0.8e6
    names = [party["name"] for party in read(part)["parties"]]
    assert names[-2:] == ["VAM", "all sources"]
    assert len(names) == 205


def test_without_the_library_there_is_a_player_and_no_view(small_setting, evaluation, monkeypatch):
    monkeypatch.setattr("experiments.parts.view_3d.packed_plotly", lambda: "")
    page = page_around(interactive_part(small_setting, {"a": evaluation}))
    assert 'id="player-run"' in page
    assert "view-show" not in page
    without = page_around(None)
    assert "watch" not in Tags(without).ids
    assert "makeTablesSortable" in without
    assert "<noscript>" in without


def test_the_library_is_packed_and_comes_back_whole():
    pytest.importorskip("plotly")
    packed = packed_plotly()
    assert not set("<>&") & set(packed)
    assert gzip.decompress(base64.b64decode(packed)).decode() == plotly_script()
    assert 1_000_000 < len(packed) < 0.5 * len(plotly_script())
