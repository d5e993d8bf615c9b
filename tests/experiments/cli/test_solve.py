"""``place-rsus solve``: instances from files."""

import json
from pathlib import Path

import pytest

from placement.covering import load_instance

GOLDEN = Path(__file__).parents[2] / "golden" / "cover"
SCP41 = GOLDEN / "scp41.txt"
SMALL = """\
3 4
0 2 0 1
1 3 1 2 3
2 1 3
"""


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.txt"
    path.write_text(SMALL)
    return path


def solved(result):
    """What a call printed as JSON."""
    code, out, err = result
    assert (code, err) == (0, "")
    return json.loads(out, parse_constant=pytest.fail)


def refusal(result):
    """The one line of a refused call."""
    code, out, err = result
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("place-rsus: ")
    return line.removeprefix("place-rsus: ")


def covered_rows(instance, summary):
    columns = [column - summary["numbered_from"] for column in summary["chosen"]]
    return int(instance.covers[columns].toarray().any(axis=0).sum())


def test_an_or_library_file_is_solved_to_its_published_optimum(run):
    summary = solved(run("solve", SCP41, "--json", "--quiet"))
    assert (summary["objective"], summary["bound"], summary["gap"]) == (429.0, 429.0, 0.0)
    assert summary["is_proven"] is True
    assert summary["seconds"] > 0.0
    assert summary["numbered_from"] == 1
    instance = load_instance(SCP41)
    assert covered_rows(instance, summary) == instance.n_rows
    assert instance.cost[[column - 1 for column in summary["chosen"]]].sum() == 429.0


def test_with_a_budget_it_is_a_maximal_covering_problem(run):
    summary = solved(run("solve", SCP41, "--budget", 3, "--json", "--quiet"))
    assert summary["problem"] == "maximal covering"
    assert len(summary["chosen"]) == 3
    assert summary["objective"] == covered_rows(load_instance(SCP41), summary) == 30
    assert summary["gap"] == 0.0


def test_the_question_is_all_there_is_by_default(run, small):
    by_default = solved(run("solve", small, "--json", "--quiet"))
    asked = solved(run("solve", small, "--target", "max", "--json", "--quiet"))
    assert by_default["objective"] == asked["objective"] == 2.0
    assert 3 in by_default["chosen"]  # the only one that sees sample 2
    assert solved(run("solve", small, "--target", 0.6, "--json", "--quiet"))["objective"] == 1.0
    money = solved(run("solve", small, "--budget-cost", 1.5, "--json", "--quiet"))
    assert (money["objective"], money["cost"]) == (2.0, 1.0)


def test_the_answer_fits_a_terminal(run, small):
    code, out, err = run("solve", small, "--quiet")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == (
        "small.txt: the least cost that covers all that can be covered (set covering)"
    )
    assert lines[1].split() == ["cost", "2"]
    assert lines[2].split() == ["bound", "2,", "proven"]
    assert max(map(len, lines)) <= 80
    code, out, err = run("solve", SCP41, "--budget-cost", 100, "--gap", 0.5, "--quiet")
    assert max(map(len, out.splitlines())) <= 80
    assert "the most that 100 buys" in out


def test_an_instance_is_written_as_or_library_has_it(run, small, tmp_path):
    out = tmp_path / "small.scp"
    before = solved(run("solve", small, "--out", out, "--json", "--quiet"))
    again = solved(run("solve", out, "--json", "--quiet"))
    assert again["numbered_from"] == before["numbered_from"] + 1
    assert again["chosen"] == [column + 1 for column in before["chosen"]]
    assert refusal(run("solve", small, "--out", tmp_path / "no" / "a.scp", "--quiet")) == (
        f"--out: got {tmp_path / 'no' / 'a.scp'}: No such file or directory; expected a file that "
        "can be written"
    )


def test_progress_is_told_on_stderr_only(run, small):
    code, out, err = run("solve", small, "--json")
    assert code == 0
    assert json.loads(out)["objective"] == 2.0
    assert err.splitlines() == ["read ...", "solve ..."]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--budget", 3, "--target", "max"),
            "--target: got it beside --budget; expected one of --budget, --budget-cost, --target",
        ),
        (("--budget", 0), "--budget: got '0'; expected a whole number of columns, at least 1"),
        (
            ("--budget-cost", 0.5),
            "--budget-cost: got 0.5; expected at least 1, the least cost of a column that covers "
            "anything",
        ),
        (
            ("--target", "most"),
            "--target: got 'most'; expected max, or a share of the rows, 0 to 1",
        ),
        (("--gap", 2), "--gap: got 2.0; expected a share, 0 <= gap < 1"),
        (("--time-limit", 0), "--time-limit: got '0'; expected seconds, more than 0"),
        (
            ("--format", "mps"),
            "--format: got 'mps'; expected one of auto, orlib, gecco, rail, sts",
        ),
    ],
)
def test_wrong_options_are_told_in_one_line(run, small, arguments, message):
    assert refusal(run("solve", small, *arguments, "--quiet")) == message


def test_a_file_that_is_wrong_is_told_in_one_line(run, tmp_path):
    assert refusal(run("solve", tmp_path / "none", "--quiet")) == (
        f"{tmp_path / 'none'}: got No such file or directory; expected a readable file"
    )
    assert refusal(run("solve", SCP41, "--format", "gecco", "--quiet")).startswith(f"{SCP41}: line")
    message = refusal(run("solve", SCP41, "--solver", "nonesuch", "--quiet"))
    assert message.startswith(
        "--solver: got 'nonesuch'; expected auto or HIGHS for covering problems"
    )
