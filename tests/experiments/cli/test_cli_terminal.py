"""What the terminal offers: help, sections, completion, how much is told."""

import logging
import re
import shutil
import subprocess

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner
from command_results import answer, output, refusal

from experiments.cli.options import PROGRAM, SECTIONS
from experiments.cli.terminal import sentences
from experiments.main import cli
from experiments.progress import StderrLog


def _commands(group=cli, path=()):
    """Path of words and command of each command, from the program down."""
    yield path, group
    for name, command in getattr(group, "commands", {}).items():
        yield from _commands(command, (*path, name))


def _help_of(path, command, option="--help"):
    """What a command says when it is asked for help."""
    return CliRunner().invoke(cli, [*path, option], prog_name="place-rsus").output


@pytest.mark.parametrize(
    ("path", "command"), list(_commands()), ids=lambda value: str(value)[:30]
)
def test_every_help_fits_80_columns_and_shows_examples(path, command):
    text = _help_of(path, command)
    assert max(map(len, text.splitlines())) <= 80
    if path and not isinstance(command, click.Group):
        assert "Examples:" in text
    assert command.help


def _shown(text):
    """Options that stand in a help's list."""
    return re.findall(r"^  (?:-\w, )?(--[-\w]+)", text, flags=re.M)


def test_sections_hold_every_option_once():
    text = _help_of((), cli, "--help-all")
    for param in cli.params:
        assert (
            len(
                re.findall(rf"^  {max(param.opts, key=len)}(?![-\w])", text, flags=re.M)
            )
            == 1
        )
    assert (
        text.index("Commands:")
        < text.index("What is asked:")
        < text.index("--budget N")
    )

    known = {
        getattr(param, "section", PROGRAM)
        for _, one in _commands()
        for param in one.params
    }
    assert known == {"", *SECTIONS, PROGRAM}
    assert all(f"\n{title}:\n" in text for title in (*SECTIONS, PROGRAM))


@pytest.mark.parametrize(
    ("path", "command"), list(_commands()), ids=lambda value: str(value)[:30]
)
def test_the_short_help_shows_at_most_25_options_and_all_of_them_elsewhere(
    path, command
):
    short = _shown(_help_of(path, command))
    assert len(short) <= 25
    if "--help-all" in short:
        every = _shown(_help_of(path, command, "--help-all"))
        assert set(short) < set(every)

        options = [param for param in command.params if isinstance(param, click.Option)]
        assert len(every) == len(options) + 1  # --help


def _completed(*words):
    """What a shell offers behind some words."""
    shell = ShellComplete(cli, {}, "place-rsus", "_PLACE_RSUS_COMPLETE")
    return [
        (item.value, item.type)
        for item in shell.get_completions(list(words[:-1]), words[-1])
    ]


def test_a_shell_completes_commands_options_words_and_files():
    assert ("evaluate", "plain") in _completed("e")
    assert ("--budget-cost", "plain") in _completed("--bud")
    assert _completed("export", "--format", "g") == [
        ("geojson", "plain"),
        ("gpkg", "plain"),
    ]
    assert _completed("--fusion", "") == [
        ("any", "plain"),
        ("single", "plain"),
    ]
    assert _completed("evaluate", "--layout", "carl") == [("carlancap-12", "plain")]
    assert _completed("evaluate", "--layout", "my/lay") == [("my/lay", "file")]
    assert _completed("--scene", "") == [("", "file")]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_are_what_their_shell_reads(run, shell):
    script = answer(run("completion", shell))
    assert "_PLACE_RSUS_COMPLETE" in script

    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here to read it")
    checked = subprocess.run(
        [shell, "-n"], input=script, capture_output=True, text=True
    )

    assert checked.returncode == 0
    assert checked.stderr == ""


@pytest.mark.long
@pytest.mark.usefixtures("without_figures", "own_cache")
def test_verbose_tells_sizes_bounds_and_seconds(run, small_study, caplog):
    out = output(run("--budget 1 --verbose --json --out found"))
    assert out.startswith("{")
    for line in (
        r"detection table: \d+ poses, \d+ frames",
        r"presolve: \d+ -> \d+ poses.*",
        r"apr: bound [\d.]+ after [\d.]+ s",
        r"evaluate: [\d.]+ s",
    ):
        assert any(re.fullmatch(line, told) for told in caplog.messages)

    caplog.clear()
    run("--budget 1 --json --out found")
    told = [record for record in caplog.records if record.levelno < logging.WARNING]

    assert not told  # the next call tells no more than it is asked to


def test_logs_go_to_what_is_stderr_at_the_moment(capsys):
    record = logging.LogRecord("placement", logging.INFO, "", 0, "%d poses", (7,), None)
    StderrLog().emit(record)
    assert capsys.readouterr() == ("", "7 poses\n")


def test_quiet_and_verbose_are_one_or_the_other(run):
    assert (
        refusal(run("--budget 1 --verbose --quiet"))
        == "--quiet, --verbose: got both; expected one of them"
    )
    # Whatever comes next.
    assert not logging.getLogger("placement").isEnabledFor(logging.INFO)


def test_a_number_is_not_split_from_its_unit():
    assert sentences("a" * 77 + " 12 % of 3 runs") == ["a" * 77, "12 % of 3 runs"]
    assert sentences("b" * 76 + " 1,250 EUR") == ["b" * 76, "1,250 EUR"]
