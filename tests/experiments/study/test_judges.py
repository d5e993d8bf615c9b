"""Programs of others on what this project writes; skipped where they cannot be had."""

import importlib.util
import re
from dataclasses import replace

import pytest

from experiments.export import openlabel, openscenario
from experiments.study import judges
from geometry.errors import MissingExtraError

pytestmark = pytest.mark.judges


@pytest.fixture(scope="module")
def all_runs():
    return judges.lay_all_cases()


def ask(judge, *arguments, **options):
    try:
        return judge(*arguments, **options)
    except MissingExtraError as error:
        pytest.skip(str(error))


def test_asams_checker_finds_no_issue_in_any_case(all_runs):
    found = ask(judges.judge_openscenario, all_runs)
    assert found.is_passed, found
    assert "147 cases" in found.checked
    assert re.search(r"2,?499 completed", found.checked)  # 17 checks of each


def test_asams_checker_finds_an_actor_that_is_nobody(all_runs, monkeypatch):
    write = openscenario.to_openscenario
    monkeypatch.setattr(
        openscenario,
        "to_openscenario",
        lambda *given, **options: write(*given, **options).replace(
            '<EntityRef entityRef="vru"', '<EntityRef entityRef="nobody"', 1
        ),
    )
    found = ask(judges.judge_openscenario, all_runs[:1])
    assert not found.is_passed
    assert "Entity not declared" in found.result


def test_commonroad_finds_the_impacts_within_a_hundredth_of_a_second(all_runs):
    found = ask(judges.judge_impacts, all_runs)
    assert found.is_passed, found


def test_commonroad_finds_a_body_that_is_too_long(all_runs):
    run = all_runs[0]
    longer = replace(run.encounter.vut, length_m=run.encounter.vut.length_m + 1.0)
    wrong = replace(run, encounter=replace(run.encounter, vut=longer))
    assert not ask(judges.judge_impacts, [wrong], n_runs=1).is_passed


@pytest.mark.skipif(
    importlib.util.find_spec("openlabel_checker") is None, reason="openlabel-checker is missing"
)
def test_openlabel_checker_finds_no_issue_but_those_made(monkeypatch):
    assert judges.judge_openlabel().is_passed
    write = openlabel.to_openlabel
    monkeypatch.setattr(
        openlabel, "to_openlabel", lambda layout: write(layout).replace('"sensor_cs"', "7")
    )
    assert not judges.judge_openlabel().is_passed
