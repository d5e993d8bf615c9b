import copy

import pytest

from geometry.errors import InputError
from scenarios import cases

GOOD = {
    "X": {
        "label": "X-50",
        "title": "an adult crosses",
        "kind": "crossing",
        "vru_actor": "adult",
        "vru_speed_kmh": 5.0,
        "vut_speed_kmh": {"min": 20.0, "max": 30.0, "step": 5.0},
        "impact_percent": 50.0,
    }
}


def _load(monkeypatch, table):
    """What ``load_cases`` makes of a table; nothing is remembered."""
    monkeypatch.setattr(cases, "load_toml", lambda source: table)
    return cases.load_cases.__wrapped__()


def _changed(**changes):
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
def test_cases_are_those_of_the_study(name, kind, actor, vru_speed_kmh, first_kmh, n_speeds):
    case = cases.load_cases()[name]
    assert (case.name, case.label, case.kind) == (name, name, kind)
    assert (case.vru.name, case.vru_speed_kmh) == (actor, vru_speed_kmh)
    assert case.vut_speeds_kmh == tuple(first_kmh + 5.0 * step for step in range(n_speeds))
    assert case.vut_speeds_kmh[-1] == 60.0
    assert case.impact_percent == 50.0


def test_a_new_table_is_a_new_case(monkeypatch):
    (case,) = _load(monkeypatch, GOOD).values()
    assert case.name == "X"
    assert case.vut_speeds_kmh == (20.0, 25.0, 30.0)
    assert case.vru.class_name == "pedestrian"


def test_a_single_speed_is_allowed(monkeypatch):
    table = _changed(vut_speed_kmh={"min": 40.0, "max": 40.0, "step": 5.0})
    assert _load(monkeypatch, table)["X"].vut_speeds_kmh == (40.0,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"kind": "turning"},
            "cases.toml: X.kind: got 'turning'; expected one of crossing, longitudinal",
        ),
        ({"kind": None}, "cases.toml: X.kind: got nothing; expected a value"),
        ({"label": None}, "cases.toml: X.label: got nothing; expected a value"),
        (
            {"vut_speed_kmh": {"min": 30.0, "max": 20.0, "step": 5.0}},
            "cases.toml: X.vut_speed_kmh: got {'min': 30.0, 'max': 20.0, 'step': 5.0}; "
            "expected 0 < min <= max, step > 0",
        ),
        (
            {"vut_speed_kmh": {"min": 20.0, "max": 30.0, "step": 0.0}},
            "cases.toml: X.vut_speed_kmh: got {'min': 20.0, 'max': 30.0, 'step': 0.0}; "
            "expected 0 < min <= max, step > 0",
        ),
        (
            {"vut_speed_kmh": {"min": 20.0, "max": 30.0}},
            "cases.toml: X.vut_speed_kmh.step: got nothing; expected a value",
        ),
        (
            {"vut_speed_kmh": 40.0},
            "cases.toml: X.vut_speed_kmh: got 40.0; expected a table with min, max and step",
        ),
        (
            {"vru_speed_kmh": "fast"},
            "cases.toml: X.vru_speed_kmh: got 'fast'; expected a finite number",
        ),
    ],
)
def test_cases_say_what_is_wrong(monkeypatch, changes, message):
    with pytest.raises(InputError) as caught:
        _load(monkeypatch, _changed(**changes))
    assert str(caught.value) == message


def test_an_unknown_body_lists_the_known_ones(monkeypatch, actors):
    with pytest.raises(InputError) as caught:
        _load(monkeypatch, _changed(vru_actor="horse"))
    assert str(caught.value) == (
        f"cases.toml: X.vru_actor: got 'horse'; expected one of {', '.join(sorted(actors))}"
    )
