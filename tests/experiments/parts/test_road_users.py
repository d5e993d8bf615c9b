"""Results by the kind of road user."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.parts.road_users import build_road_users, section, table, words
from experiments.results.drives import describe_driven
from experiments.results.record import to_plain
from placement.question import Question
from placement.setting import build_setting
from scenarios.runs import Refusal

MET = ("on foot", "on foot", "bicycle")


@pytest.fixture
def evaluation(frame_axis):
    """Runs that weigh 0.5, 0.25 and 0.25; units avoid the first and the last, the VUT
    the last.
    """
    axis = replace(frame_axis, weight=np.array([0.5, 0.25, 0.25]))

    def verdict(avoided, left_kmh):
        return SimpleNamespace(
            is_avoided=np.array(avoided, dtype=bool),
            impact_speed_kmh=np.array(left_kmh),
        )

    return SimpleNamespace(
        axis=axis,
        rsu_all=verdict([1, 0, 1], [0.0, 12.0, 0.0]),
        vut_and_rsus=verdict([1, 1, 1], [0.0, 0.0, 0.0]),
        cars=0.0,
        vut=verdict([0, 0, 1], [30.0, 15.0, 0.0]),
    )


def setting_of(met=MET, refusals=()):
    """Runs that meet some groups."""
    return SimpleNamespace(
        runs=[SimpleNamespace(road_user=group) for group in met], refusals=refusals
    )


def refusal(name, left_out):
    """A case that is not driven."""
    return Refusal(
        case=SimpleNamespace(name=name),
        approach="north",
        speeds_kmh=(30.0,),
        reason="why",
        is_possible=False,
        left_out=left_out,
    )


def test_each_group_has_its_own_runs_by_weight(evaluation):
    record = build_road_users(setting_of(), {"mine": evaluation})
    weights = {group.road_user: (group.runs, group.weight) for group in record.groups}
    assert weights == {"on foot": (2, 0.75), "bicycle": (1, 0.25)}

    mine, vut = (to_plain(party) for party in record.groups[0].parties)
    assert mine == {
        "name": "mine",
        "runs_avoided": 1,
        "apr": pytest.approx(2.0 / 3.0),
        "mean_impact_speed_kmh": pytest.approx(4.0),  # 0.25 of 0.75 at 12 km/h
    }
    assert vut == {
        "name": "VUT alone",
        "runs_avoided": 0,
        "apr": 0.0,
        "mean_impact_speed_kmh": pytest.approx(25.0),
    }
    assert [row[0] for row in table(record).rows] == ["on foot"] * 2 + ["bicycle"] * 2


def test_runs_of_all_groups_are_all_runs(evaluation):
    record = build_road_users(setting_of(), {"mine": evaluation, "other": evaluation})
    assert sum(group.runs for group in record.groups) == 3
    assert sum(group.weight for group in record.groups) == pytest.approx(1.0)

    avoided = sum(group.parties[1].runs_avoided for group in record.groups)
    assert avoided == evaluation.rsu_all.is_avoided.sum()


def test_each_road_user_has_a_sentence_and_so_has_who_is_left_out(evaluation):
    refusals = (refusal("CCCscp", "unprotected"), refusal("CPRA", "not laid"))
    record = build_road_users(setting_of(refusals=refusals), {"mine": evaluation})

    assert record.unprotected == ("CCCscp",)
    assert words(record) == [
        "Pedestrians: 66.7 % of 2 runs.",
        "Cyclists: 100.0 % of 1 run.",
        "Left out: 1 case in which a car is hit.",
    ]
    assert section(record) is not None


def test_nothing_is_said_where_all_runs_meet_the_same_and_nobody_is_left_out(
    evaluation,
):
    record = build_road_users(setting_of(("bicycle",) * 3), {"mine": evaluation})
    assert words(record) == []
    assert section(record) is None


def test_cars_and_cases_laid_nowhere_are_not_called_impossible():
    question = Question(
        cases="CPNCO-50,CCFtap,CPRA",
        approaches="north",
        speeds="20,30",
        along_arms="0",
    )
    driven = describe_driven(build_setting(question))
    text = " ".join(driven)

    assert "Only vulnerable road users are protected: CCFtap" in text
    assert "--protect all also counts cars" in text
    assert "Not simulated at any junction: CPRA" in text
    assert not any(
        "CCFtap" in one or "CPRA" in one for one in driven if "possible" in one.lower()
    )


def test_a_group_of_two_classes_of_bodies_is_there_once(evaluation):
    record = build_road_users(
        setting_of(("car", "car", "on foot")), {"mine": evaluation}
    )
    assert [(group.road_user, group.runs) for group in record.groups] == [
        ("on foot", 1),
        ("car", 2),
    ]
