"""Cases: what the packaged ones are, and what is told of a table of others."""

import copy

import pytest
from refusals import refused_with

from geometry.errors import InputError
from scenarios import cases

GOOD = {
    "X": {
        "source": "protocol-4.5.1",
        "title": "an adult crosses",
        "kind": "crossing",
        "vru": "adult",
        "vru_speed_kmh": 5.0,
        "vru_from": "near",
        "vru_line": {"along": "crosswalk"},
        "vru_reference": "reference",
        "start_distance_m": 4.0,
        "acceleration_distance_m": 1.0,
        "vut_speed_kmh": {"min": 20.0, "max": 30.0, "step": 5.0},
        "impact_percent": 50.0,
    }
}


def _load(monkeypatch, table):
    """What ``load_cases`` makes of a table; nothing is remembered."""
    monkeypatch.setattr(cases, "load_data", lambda package, name: table)
    return cases.load_cases.__wrapped__()


def _changed(**changes):
    """The table of a good case with other values; without those that are None."""
    table = copy.deepcopy(GOOD)
    for key, value in changes.items():
        if value is None:
            del table["X"][key]
        else:
            table["X"][key] = value
    return table


@pytest.mark.parametrize(
    ("name", "kind", "actor", "vru_speed_kmh", "first_kmh", "n_speeds"),
    # CarlaNCAP study, table of scenarios.
    [
        ("CPNC-50", "crossing", "adult", 5.0, 20.0, 9),
        ("CBNA", "crossing", "cyclist", 15.0, 20.0, 9),
        ("CBLA", "longitudinal", "cyclist", 15.0, 25.0, 8),
    ],
)
def test_cases_are_those_of_the_study(
    name, kind, actor, vru_speed_kmh, first_kmh, n_speeds
):
    case = cases.load_cases()[name]
    assert case.name == name
    assert case.kind == kind
    assert case.vru.name == actor
    assert case.vru_speed_kmh == vru_speed_kmh
    assert case.vut_speeds_kmh == tuple(
        first_kmh + 5.0 * step for step in range(n_speeds)
    )
    assert case.vut_speeds_kmh[-1] == 60.0
    assert case.impact_percent == 50.0


def test_a_new_table_is_a_new_case(monkeypatch):
    (case,) = _load(monkeypatch, GOOD).values()
    assert case.name == "X"
    assert case.vut_speeds_kmh == (20.0, 25.0, 30.0)
    assert case.vru.class_name == "pedestrian"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"kind": "flying"},
            (
                "cases.toml: X.kind: got 'flying'; expected one of crossing,"
                " longitudinal, turning, recorded"
            ),
        ),
        ({"kind": None}, "cases.toml: X.kind: got nothing; expected a value"),
        ({"source": None}, "cases.toml: X.source: got nothing; expected a value"),
        (
            {"steady_distance_m": 3.0},
            (
                "cases.toml: X: got ['start_distance_m', 'steady_distance_m']; "
                "expected one of start_distance_m, steady_distance_m, steady_time_s"
            ),
        ),
        (
            {"vru_from": "ahead"},
            "cases.toml: X.vru_from: got 'ahead'; expected one of far, near",
        ),
        (
            {"impact_percent": 130.0},
            "cases.toml: X.impact_percent: got 130.0; expected -25 to 125",
        ),
        (
            {"impact_face": "rear"},
            "cases.toml: X.impact_face: got 'rear'; expected one of front, side",
        ),
        (
            {"vru_line": {"along": "river"}},
            (
                "cases.toml: X.vru_line.along: got 'river'; expected one of crosswalk,"
                " kerb, lane, through"
            ),
        ),
        (
            {"obstruction": {"kind": "tree"}},
            (
                "cases.toml: X.obstruction.kind: got 'tree'; "
                "expected one of beside-vut, beside-road, beside-vru, wall"
            ),
        ),
        (
            {"as": "Y"},
            "cases.toml: X.as: got 'Y'; expected another case, not in a circle",
        ),
        (
            {"as": "X"},
            "cases.toml: X.as: got 'X'; expected another case, not in a circle",
        ),
        (
            {"vut_speed_kmh": {"min": 30.0, "max": 20.0, "step": 5.0}},
            (
                "cases.toml: X.vut_speed_kmh: got {'min': 30.0, 'max': 20.0, 'step':"
                " 5.0}; expected 0 < min <= max, step > 0"
            ),
        ),
        (
            {"vut_speed_kmh": {"min": 20.0, "max": 30.0, "step": 0.0}},
            (
                "cases.toml: X.vut_speed_kmh: got {'min': 20.0, 'max': 30.0, 'step':"
                " 0.0}; expected 0 < min <= max, step > 0"
            ),
        ),
        (
            {"vut_speed_kmh": {"min": 20.0, "max": 30.0}},
            "cases.toml: X.vut_speed_kmh.step: got nothing; expected a value",
        ),
        (
            {"vut_speed_kmh": 40.0},
            (
                "cases.toml: X.vut_speed_kmh: got 40.0; expected a table with min, max"
                " and step"
            ),
        ),
        (
            {"vru_speed_kmh": "fast"},
            "cases.toml: X.vru_speed_kmh: got 'fast'; expected a finite number",
        ),
    ],
)
def test_cases_say_what_is_wrong(monkeypatch, changes, message):
    with refused_with(message):
        _load(monkeypatch, _changed(**changes))


def test_an_unknown_body_lists_the_known_ones(monkeypatch, actors):
    with refused_with(
        f"cases.toml: X.vru: got 'horse'; expected one of {', '.join(sorted(actors))}"
    ):
        _load(monkeypatch, _changed(vru="horse"))


def test_a_case_like_another_says_only_what_differs(monkeypatch):
    table = {
        **GOOD,
        "Y": {"as": "X", "impact_percent": 25.0},
        "Z": {"as": "Y", "title": "last"},
    }
    cases_by_name = _load(monkeypatch, table)

    assert (
        cases_by_name["Y"].impact_percent == cases_by_name["Z"].impact_percent == 25.0
    )
    assert cases_by_name["Z"].title == "last"
    assert cases_by_name["Z"].vru == cases_by_name["X"].vru


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("CBNA", ["CBNA"]),  # the study's own, not the family of CBNA-50
        ("CPNA", ["CPNA-25", "CPNA-75"]),
        ("CBTAfs", ["CBTAfs-100", "CBTAfs-side"]),
        ("CPNA, CPNA-75,CPFA-50", ["CPNA-25", "CPNA-75", "CPFA-50"]),
    ],
)
def test_cases_are_picked_by_name_or_family_each_once(text, names):
    assert [case.name for case in cases.pick_cases(text, "cases")] == names


def test_a_set_is_picked_with_its_own_speeds():
    picked = {case.name: case for case in cases.pick_cases("study", "cases")}
    assert picked["CPNCO-50"].vut_speeds_kmh[0] == 20.0
    assert cases.load_cases()["CPNCO-50"].vut_speeds_kmh[0] == 10.0

    every = {**cases.load_cases(), **cases.load_unlaid_cases()}
    assert {case.name for case in cases.load_case_sets()["all"]} == set(every)


@pytest.mark.parametrize("text", ["CPXX", "", "study,,CBLA", "cbla"])
def test_unknown_cases_list_sets_and_cases(text):
    with pytest.raises(
        InputError, match=r"cases: got '.*'; expected one of default, study, protocol"
    ):
        cases.pick_cases(text, "cases")


def test_the_vru_is_never_read_off_the_letters_of_a_case():
    assert cases.load_cases()["CPNC-50"].vru.name == "adult"
    assert cases.load_cases()["CPNCO-50"].vru.name == "child"


OWN = """
[SCHOOL]
as = "CPNA-25"
title = "a child runs across"
vru = "child"
vru_speed_kmh = 10.0
vut_speed_kmh = { min = 30, max = 40, step = 10 }

[SCHOOL-FAR]
as = "SCHOOL"
vru_from = "far"
"""


def test_own_cases_are_read_from_a_file_and_may_be_like_ours(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    near, far, ours = cases.pick_cases(f"{path},CBLA", "cases")
    like = cases.load_cases()["CPNA-25"]

    assert near.name == "SCHOOL"
    assert far.name == "SCHOOL-FAR"
    assert ours.name == "CBLA"
    assert near.vru.name == "child"
    assert near.vru_speed_kmh == 10.0
    assert near.vut_speeds_kmh == (30.0, 40.0)
    assert near.impact_percent == like.impact_percent
    assert near.vru_line == like.vru_line
    assert near.vru_side == "near"
    assert far.vru_side == "far"
    assert "SCHOOL" not in cases.load_cases()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": got no case; expected a table for each case"),
        ("budget = 3", ": budget: got 3; expected a table, which is a case"),
        (
            '["CBLA"]\nas = "CPNA-25"',
            ": CBLA: got 'CBLA'; expected a name that no case or set",
        ),
        (
            '[all]\nas = "CPNA-25"',
            ": all: got 'all'; expected a name that no case or set",
        ),
        (
            '[X]\nas = "CPXX"',
            ": X.as: got 'CPXX'; expected another case, not in a circle",
        ),
        ("[X]\nas = 3", ": X.as: got 3; expected another case, not in a circle"),
        (
            '[X]\nas = "CBLA"\nvru = "dog"',
            ": X.vru: got 'dog'; expected one of adult, ",
        ),
    ],
)
def test_own_cases_that_are_wrong_are_told_with_file_and_field(tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(text)

    with pytest.raises(InputError) as caught:
        cases.pick_cases(str(path), "cases")
    assert str(caught.value).startswith(f"{path}{message}")


def test_in_all_a_case_of_2026_drives_what_that_of_2023_does_not():
    every = cases.load_case_sets()["all"]
    driven = {case.name: case for case in cases.pick_cases("all", "cases")}
    of_2023 = cases.twins(every)

    assert of_2023["CPNA-2026-25"].name == "CPNA-25"
    for case in every:
        if case.name in driven:
            speeds = set(driven[case.name].vut_speeds_kmh)
        else:
            speeds = set()
        twin = of_2023.get(case.name)

        if case.range == "extended":
            assert not speeds
            continue
        if twin is None:
            assert speeds == set(case.vut_speeds_kmh)
            continue
        assert speeds.isdisjoint(twin.vut_speeds_kmh)
        assert speeds | set(twin.vut_speeds_kmh) >= set(case.vut_speeds_kmh)
        assert case.vru == twin.vru
        assert case.impact_percent == twin.impact_percent
