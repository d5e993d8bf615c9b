"""Names of options."""

import click
import pytest

from experiments.cli.options import with_option_names
from experiments.main import cli


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("budget: got 0; expected 1", "--budget: got 0; expected 1"),
        ("yaw_step_deg: got 7; expected 5", "--yaw-step: got 7; expected 5"),
        (
            "site x: got 1; expected `budget_cost`",
            "site x: got 1; expected --budget-cost",
        ),
        ("nothing: got `unheard_of`", "nothing: got `unheard_of`"),
        ("a.toml: budget: got 0", "a.toml: budget: got 0"),
    ],
)
def test_fields_become_options(message, expected):
    assert with_option_names(message, cli) == expected


def test_the_main_command_wins_over_others_with_the_same_parameter():
    @click.group()
    @click.option("--out")
    def group(out):
        pass

    @group.command()
    @click.option("--to", "out")
    def inner(out):
        pass

    assert with_option_names("out: got nothing", group) == "--out: got nothing"
