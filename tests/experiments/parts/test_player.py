"""Data of the report's interactive part, and its page."""

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from interactive_pages import (
    EVIL,
    build_evaluation,
    build_layout,
    page_around,
    with_evil_names,
)
from packed_bits import unpack_bits

from experiments.parts.player import (
    AVOIDED,
    NOT_AVOIDED,
    SHOWN_ABOVE,
    interactive_part,
    pack_bits,
    plan_record,
    to_script_json,
)


@pytest.fixture(scope="module")
def evaluation(small_setting):
    return build_evaluation(small_setting, build_layout(5), share=0.1)


def read(part, key="player_json"):
    return json.loads(part[key])


# ---------------------------------------------------------------- text in scripts


@given(
    st.recursive(
        st.text(max_size=9),
        lambda inner: st.dictionaries(st.text(max_size=9), inner, max_size=3),
        max_leaves=3,
    )
)
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
        run = by_id[record["id"]]
        index = axis.run_ids.index(record["id"])
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
            verdicts,
            record["confirmed"],
            record["onset"],
            record["avoided"],
            strict=True,
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

        # Where the car is at the last moment: between its places in the frames around
        # it.
        after = int(np.searchsorted(run.time_s, run.last_brake_time_s))
        place = np.array(record["lastPlace"]) / 100.0
        ends = run.vut_position_m[after - 1 : after + 1]

        assert (place >= ends.min(axis=0) - 0.02).all()
        assert (place <= ends.max(axis=0) + 0.02).all()


# ---------------------------------------------------------------- plan


def test_runs_asked_for_come_first_then_those_not_avoided_each_once(small_setting):
    evaluation = build_evaluation(small_setting, build_layout(2), share=0.02, seed=1)
    axis = evaluation.axis
    verdict = evaluation.headline
    first = axis.run_ids[3]
    runs = read(
        interactive_part(small_setting, {"a": evaluation}, first_runs=[first, first])
    )["runs"]

    assert sorted(run["id"] for run in runs) == sorted(axis.run_ids)
    assert runs[0]["id"] == first
    assert runs[0]["group"] == SHOWN_ABOVE

    avoided = [
        bool(verdict.is_avoided[axis.run_ids.index(run["id"])]) for run in runs[1:]
    ]
    assert avoided == sorted(avoided)
    assert set(avoided) == {False, True}
    assert [run["group"] == AVOIDED for run in runs[1:]] == avoided
    assert {run["group"] for run in runs[1:]} == {AVOIDED, NOT_AVOIDED}


def test_the_page_opens_with_a_run_not_avoided_in_which_units_detect(small_setting):
    evaluation = build_evaluation(small_setting, build_layout(2), share=0.03, seed=4)
    axis = evaluation.axis
    verdict = evaluation.rsu_all
    lost = np.flatnonzero(~verdict.is_avoided)

    assert 0 < len(lost) < axis.n_runs

    detected = verdict.detected.copy()
    # Two frames confirm nobody.
    detected[axis.frames_of(lost[-1])][:2] = True
    seen = replace(evaluation, rsu_all=replace(verdict, detected=detected))
    player = read(interactive_part(small_setting, {"a": seen}))

    assert player["runs"][player["first"]]["id"] == axis.run_ids[lost[-1]]

    asked = interactive_part(small_setting, {"a": seen}, first_runs=[axis.run_ids[3]])
    assert read(asked)["first"] == 0


def test_runs_that_do_not_fit_are_left_out(small_setting, evaluation, monkeypatch):
    monkeypatch.setattr("experiments.parts.player._MAX_BYTES", 1)
    part = interactive_part(
        small_setting, {"a": evaluation}, first_runs=["CBLA/east/25"]
    )

    assert part["n_runs"] == 1
    assert part["n_all"] == evaluation.axis.n_runs
    assert read(part)["runs"][0]["id"] == "CBLA/east/25"


def test_plan_holds_the_road(small_setting):
    record = plan_record(small_setting.scene)
    assert {"lane", "junction", "building", "wall"} <= {
        part["name"] for part in record["classes"]
    }
    for part in record["classes"]:
        assert re.fullmatch(r"(M-?\d+ -?\d+(L-?\d+ -?\d+){2,}Z)+", part["path"])
    assert {arm["name"] for arm in record["arms"]} == {"north", "east", "south", "west"}


# ---------------------------------------------------------------- the whole part


class Tags(HTMLParser):
    """Ids and the number of scripts of a page."""

    def __init__(self, page):
        super().__init__()
        self.ids = []
        self.scripts = 0
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        self.ids += [value for name, value in attributes if name == "id"]


def test_a_page_stays_whole_whatever_things_are_called(small_setting):
    setting = with_evil_names(small_setting)
    printable = EVIL.replace("\u2028", "")
    layout = build_layout(
        3, name=printable, ids=[f"{printable}{index}" for index in range(3)]
    )
    evil = build_evaluation(setting, layout)
    tame = page_around(
        interactive_part(
            small_setting, {"a": build_evaluation(small_setting, build_layout(3))}
        )
    )
    page = page_around(interactive_part(setting, {EVIL: evil, f"{EVIL}2": evil}))

    assert Tags(page).scripts == Tags(tame).scripts
    assert Tags(page).ids == Tags(tame).ids
    assert len(set(Tags(page).ids)) == len(Tags(page).ids)
    assert "alert(1)</script>" not in page
    assert "https://" not in page


# Quickly: the other tests of this file.
@pytest.mark.long
def test_two_hundred_units_fit_into_the_page(part_of_many):
    assert len(part_of_many["player_json"]) < 0.5e6

    names = [party["name"] for party in read(part_of_many)["parties"]]
    assert names[-2:] == ["VAM", "all sources"]
    assert len(names) == 205
