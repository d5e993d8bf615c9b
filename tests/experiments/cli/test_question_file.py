"""``--question`` and ``--save-question``: the options of a command, from and to a
file.
"""

from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from command_results import refusal

from experiments.cli.options import JUDGED, PLANNED, SectionedCommand, question_options
from geometry.errors import InputError
from placement.question import Question, load_question


@click.command(cls=SectionedCommand)
@question_options(*PLANNED, *JUDGED, defaults={"time_limit_s": 60.0})
def _plan(*, question):
    """A command that plans, and says its question."""
    click.echo(repr(question))


@click.command(cls=SectionedCommand)
@question_options(*JUDGED)
def _judge(*, question):
    """A command that judges, and says its question."""
    click.echo(repr(question))


def asked(command, *arguments):
    """Question that a command was given."""
    done = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output.strip()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "question.toml"


def test_a_file_gives_what_the_command_line_does_not(path):
    path.write_text("budget = 3\ncases = 'CBNA'\nrefine = true\nsite_cost = 10\n")
    plain = Question(
        budget=3,
        cases="CBNA",
        refine=True,
        site_cost_eur=10.0,
        time_limit_s=60.0,
    )
    assert asked(_plan, "--question", str(path)) == repr(plain)

    given = asked(
        _plan,
        "--cases",
        "CBLA",
        "--question",
        str(path),
        "--no-refine",
        "--budget",
        "2",
        "--time-limit",
        "1",
    )
    assert given == repr(
        Question(
            budget=2,
            cases="CBLA",
            refine=False,
            site_cost_eur=10.0,
            time_limit_s=1.0,
        )
    )


def test_what_a_command_has_no_option_for_is_not_used(path):
    path.write_text("budget = 3\ncases = 'CBNA'\n")
    assert asked(_judge, "--question", str(path)) == repr(Question(cases="CBNA"))


def test_the_question_in_use_is_saved_and_asks_the_same_again(path):
    arguments = (
        "--budget",
        "2",
        "--latency",
        "0.05",
        "--weather",
        "night,fog",
        "--refine",
    )
    said = asked(_plan, *arguments, "--save-question", str(path))

    assert repr(load_question(path)) == said
    assert asked(_plan, "--question", str(path)) == said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "budget = 0",
            "question.toml: budget: got 0; expected a whole number of units, at least",
        ),
        (
            "budgte = 1",
            "question.toml: got 'budgte'; expected one of budget, budget_cost, target",
        ),
    ],
)
@pytest.mark.parametrize("command", [[], ["scenarios", "list"]])
def test_a_wrong_file_is_one_line_before_anything_is_done(run, command, text, message):
    Path("question.toml").write_text(text)
    assert refusal(run(*command, "--question question.toml")).startswith(f"{message}")


@pytest.mark.parametrize("command", [_plan, _judge])
def test_a_network_that_only_the_file_names_is_refused(path, command):
    path.write_text('detector = "mail/net.onnx"\n')
    said = (
        r"--question: detector: got 'mail/net.onnx'; expected no network, which is a"
        r" program, or "
        r"--detector mail/net.onnx as well if you trust it"
    )
    with pytest.raises(InputError, match=said):
        asked(command, "--question", str(path))

    trusted = asked(command, "--question", str(path), "--detector", "mail/net.onnx")
    assert "detector='mail/net.onnx'" in trusted

    path.write_text('detector = "mail/net.onnx+pointrcnn-2019"\n')
    with pytest.raises(InputError, match="expected no network, which is a program"):
        asked(command, "--question", str(path))

    path.write_text('detector = "response.toml"\n')
    assert "detector='response.toml'" in asked(command, "--question", str(path))
