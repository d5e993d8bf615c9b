"""Every field of a question is an option of the command line, with help that names options."""

import re

import pytest

from experiments.cli.options import OPTIONS, SECTIONS, help_of, option_of
from placement.question import question_fields


def test_each_field_has_exactly_one_entry_in_the_same_order():
    assert list(OPTIONS) == list(question_fields())
    for shown in OPTIONS.values():
        assert shown["section"] in SECTIONS
        assert {shown.get("needs"), shown.get("excludes")} - {None} <= set(OPTIONS)


@pytest.mark.parametrize("name", OPTIONS)
def test_help_names_options_in_place_of_fields(name):
    known = question_fields()
    text = help_of(known[name])
    assert not {*re.findall("`([a-z_0-9]+)`", text)} & set(known)
    assert set(re.findall(r"--[a-z][a-z-]*", text)) <= set(map(option_of, known.values()))


def test_an_option_is_called_by_the_key_of_the_question_file():
    known = question_fields()
    assert option_of(known["site_cost_eur"]) == "--site-cost"
    assert help_of(known["least"]) == "What --target is reached with the least of."
