"""``place-rsus city`` on the command line: help, what it prints, errors of one line."""

import pytest
from city_maps import FEW_RUNS_OPTIONS, write_city
from command_results import refusal
from msgspec.structs import replace as replace_fields

from experiments.city import run as job
from experiments.city.answer import CityResult, load_manifest
from experiments.city.command import city_text
from experiments.cli.terminal import table


@pytest.fixture
def solved_here(monkeypatch):
    """Solves junctions in this process, and draws nothing."""
    monkeypatch.setattr(
        job, "write_city", lambda out, result, *args, **settings: result
    )
    monkeypatch.setattr(job, "_write_served", lambda *args: [])


@pytest.mark.long
def test_the_first_line_says_what_matters_and_json_says_all(
    run, ask, solved_here, tmp_path
):
    path = write_city(tmp_path)
    out = tmp_path / "city"
    few = ("--coarse", "--max-units", 1, "--junctions", "n1;n3", *FEW_RUNS_OPTIONS)
    few += ("--workers", 1)
    code, text, err = run("city", path, "--budget", 1, "--out", out, *few)

    assert code == 0
    assert text.startswith("1 sensor at 1 of 2 junctions for ")
    assert (
        "Junctions: 2 of 3; done already: 0. Weights: every junction counts the same."
        in err
    )

    result = ask("city", path, "--budget 1 --out", out, *few)
    assert result["units"] == 1
    assert result["computed"] == 0
    assert result["not_done"] == 0
    assert [stage["name"] for stage in result["stages"]][:2] == [
        "apr",
        "apr_one_failed",
    ]

    manifest = load_manifest(out / "manifest.json")
    assert [entry.folder for entry in manifest.junctions] == ["n1", "n3"]


def test_names_are_never_cut_and_no_line_is_wider_than_a_terminal():
    name = " / ".join(f"{letter}-Street of a very long name" for letter in "ABC")
    lines = table(
        ["junction", "units"],
        [
            [name, "2"],
            ["n1", "1"],
        ],
    )

    assert max(map(len, lines)) <= 80
    assert " ".join(line.removesuffix("2").strip() for line in lines[1:-1]) == name


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (),
            (
                "--budget: got nothing; expected a whole number of units, at least 0,"
                " or --budget-eur"
            ),
        ),
        (
            ("--budget", "-3"),
            "--budget: got '-3'; expected a whole number of units, at least 0",
        ),
        (("--budget-eur", "-1"), "--budget-eur: got '-1'; expected euros, at least 0"),
        # What no junction could take is told before any is cut out.
        (
            ("--budget", "1", "--along-arms", "0,-15"),
            "--along-arms: got '-15'; expected metres",
        ),
        (
            ("--budget", "1", "--cases", "FOO"),
            "--cases: got 'FOO'; expected one of default, ",
        ),
        (
            ("--budget", "1", "--sensors", "eye"),
            "--sensors: got 'eye'; expected one of ",
        ),
        (
            ("--budget", "1", "--weights", "no.csv"),
            "--weights: got 'no.csv'; expected run, case,",
        ),
        (
            ("--budget", "1", "--detector", "eye"),
            "--detector: got 'eye'; expected geometric, ",
        ),
        (
            ("--budget", "1", "--sites", "no.csv"),
            "no.csv: got No such file or directory; expect",
        ),
        (
            ("--budget", "1", "--max-units", "0"),
            "--max-units: got '0'; expected a number of units",
        ),
        (
            ("--budget", "1", "--worker-memory", "much"),
            "--worker-memory: got 'much'; expected an amount such as 1.5GiB",
        ),
    ],
)
def test_what_cannot_be_asked_is_one_line(run, tmp_path, arguments, message):
    assert refusal(
        run(
            "city", write_city(tmp_path), "--out", tmp_path / "c", "--quiet", *arguments
        )
    ).startswith(f"{message}")


def test_what_was_not_done_stands_in_the_text():
    from experiments.city.answer import CityJunctionRecord, CitySearchRecord

    failed = CityJunctionRecord(
        id="n1",
        name="A / B",
        map="m.osm",
        folder="junctions/n1",
        x=0.0,
        y=0.0,
        weight=1.0,
        reason="no lane leads in",
    )
    result = CityResult(
        command="",
        maps=(),
        budget_units=1,
        budget_eur=None,
        weights="equal",
        units=0,
        cost_eur=0.0,
        apr_before=0.0,
        stages=(),
        bound_of_fronts=0.0,
        solver="",
        is_proven=True,
        junctions=(failed,),
        not_done=1,
        computed=1,
        by="units",
        front=(),
        purchases=(),
        search=CitySearchRecord(
            poses="fine",
            max_units=1,
            max_junction_seconds=1.0,
            radius_m=80.0,
            sites="auto",
        ),
        sentences=("First.",),
        notes=("a note",),
        seconds={},
        versions={},
    )
    lines = city_text(result, "city").splitlines()

    assert lines[0] == "First."
    assert "  A / B: It could not be computed: no lane leads in." in lines

    known = city_text(
        replace_fields(result, junctions=(replace_fields(failed, cause="no site"),)),
        "city",
    )
    assert (
        "A / B: There is no pole or other place that could carry another sensor."
        in " ".join(known.split())
    )

    many = replace_fields(result, junctions=(failed,) * 20)
    assert "  and 8 more: junctions.csv" in city_text(many, "city")
