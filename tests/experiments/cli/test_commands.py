"""Commands that the program has."""

import subprocess
import sys

import click
import pytest

from experiments.cli.commands import COMMANDS, RECORDED
from experiments.main import cli
from geometry.registry import load_entry

HELD = "print('loaded:', *(name for name in sys.modules if name in places))"


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_loads_and_its_line_is_the_first_sentence_of_its_help(name):
    entry = COMMANDS[name]
    command = load_entry(entry.place)

    assert isinstance(command, click.Command)
    assert command.get_short_help_str(limit=1_000) == entry.line
    assert cli.get_command(click.Context(cli), name) is command


def test_the_answer_for_recordings_loads():
    assert callable(load_entry(RECORDED))


def test_an_unknown_command_is_none():
    assert cli.get_command(click.Context(cli), "levitate") is None


def test_the_help_of_the_program_loads_no_command():
    places = {entry.place.partition(":")[0] for entry in COMMANDS.values()}
    script = (
        "import sys; from experiments.main import cli; places = "
        f"{places!r}; cli.main(['--help'], standalone_mode=False); {HELD}"
    )
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    shown, _, loaded = run.stdout.partition("loaded:")

    assert loaded.split() == []
    assert all(f"  {name} " in shown for name in COMMANDS)
