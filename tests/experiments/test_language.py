"""Every message of an answer has a German translation, with the same names in braces."""

import string
from pathlib import Path

import pytest
from babel.messages.extract import extract_from_file
from babel.messages.pofile import read_po

import experiments
from experiments.language import (
    Messages,
    language,
    localized,
    mark,
    set_language,
    speaking,
    tr,
    trn,
)
from geometry.files import load_data

ROOT = Path(experiments.__file__).parent
CATALOGUES = sorted((ROOT / "languages" / "de").glob("*.po"))
KEYWORDS = {"tr": None, "trn": (1, 2), "mark": None}


class Upside(Messages):
    def find(self, message):
        return message.upper().replace("{N", "{n")

    def find_plural(self, one, many, count):
        return self.find(one if count == 1 else many)


def messages_of_code():
    """Each message with the places where it stands; of plurals both forms."""
    found = {}
    for path in sorted(ROOT.rglob("*")):
        method = {".py": "python", ".j2": "jinja2"}.get(path.suffix)
        if method and path.name != "language.py":
            options = {"extensions": "jinja2.ext.do", "silent": "false"}
            for line, message, *_ in extract_from_file(method, path, KEYWORDS, options=options):
                found.setdefault(message, []).append(f"{path.relative_to(ROOT)}:{line}")
    for message in load_data("experiments", "said_below.toml")["messages"]:
        found.setdefault(message, []).append("data/said_below.toml")
    for of_part in load_data("experiments", "texts.toml").values():
        for message in of_part.values():
            key = message if isinstance(message, str) else tuple(message)
            found.setdefault(key, []).append("data/texts.toml")
    return found


def translations():
    found = {}
    for path in CATALOGUES:
        with path.open("rb") as file:
            for entry in read_po(file):
                if entry.id:
                    found.setdefault(entry.id, {})[path.name] = entry
    return found


def names_in_braces(text):
    return sorted(name for _, name, _, _ in string.Formatter().parse(text) if name is not None)


def test_every_message_has_a_translation():
    known, messages = translations(), messages_of_code()
    missing = {one: where for one, where in messages.items() if one not in known}
    assert not missing
    empty = [
        one for one in messages if not all(e.string and not e.fuzzy for e in known[one].values())
    ]
    assert not empty


def test_translations_put_in_the_same_values_and_agree_between_files():
    for message, entries in translations().items():
        assert len({entry.string for entry in entries.values()}) == 1, message
        for entry in entries.values():
            forms = (entry.id,) if isinstance(entry.id, str) else entry.id
            texts = (entry.string,) if isinstance(entry.string, str) else entry.string
            wanted = set().union(*map(names_in_braces, forms))
            assert set().union(*map(names_in_braces, texts)) == wanted, message


def test_no_translation_is_left_over():
    assert not set(translations()) - set(messages_of_code())


def test_numbers_among_the_values_are_written_as_the_language_does():
    assert tr("{a:.2f} of {b:,}", a=1.5, b=1200) == "1.50 of 1,200"
    assert localized("1,200.50") == "1,200.50"
    with speaking("de"):
        assert tr("{a:.2f} of {b:,}", a=1.5, b=1200) == "1,50 of 1.200"
        assert localized("1,200.50") == "1.200,50"
        assert tr("{text}", text="1.5") == "1.5"
    assert language() == "en"


def test_another_catalogue_can_be_spoken_for_a_block():
    with speaking("en", Upside()):
        assert tr("three runs") == "THREE RUNS"
        assert trn("{n} run", "{n} runs", 2) == "2 RUNS"
        assert mark("a run") == "a run"
    assert tr("three runs") == "three runs"


def test_an_unknown_language_has_no_catalogue():
    with pytest.raises(FileNotFoundError):
        set_language("xx")
