"""Every field of a question is an option of the command line, with help that names
options.
"""

import re

import click
import pytest

from experiments.cli.options import (
    QUESTION_OPTIONS,
    SECTIONS,
    help_of,
    option_name,
    option_of,
    question_options,
)
from placement.question import question_fields


@pytest.fixture(scope="module")
def options():
    """Options of a command made from a question."""

    @click.command()
    @question_options(*QUESTION_OPTIONS, has_file=False)
    def ask(*, question):
        pass

    return {param.name: param for param in ask.params}


def test_each_field_has_exactly_one_entry_in_the_same_order(options):
    assert list(QUESTION_OPTIONS) == list(options) == list(question_fields())
    for shown in options.values():
        assert shown.section in SECTIONS
        assert {shown.needs, shown.excludes} - {""} <= set(options)


def test_each_option_has_the_name_default_and_words_of_its_field(options):
    for name, field in question_fields().items():
        shown = options[name]
        assert option_name(shown) == option_of(field)
        assert shown.default == field.default
        assert shown.help == help_of(field)


@pytest.mark.parametrize("name", QUESTION_OPTIONS)
def test_help_names_options_in_place_of_fields(name):
    known = question_fields()
    text = help_of(known[name])

    assert not {*re.findall("`([a-z_0-9]+)`", text)} & set(known)
    assert set(re.findall(r"--[a-z][a-z-]*", text)) <= set(
        map(option_of, known.values())
    )


def test_an_option_is_called_by_the_key_of_the_question_file():
    known = question_fields()
    assert option_of(known["site_cost_eur"]) == "--site-cost"
    assert help_of(known["least"]) == "What --target is reached with the least of."
