"""Every message of an answer has a German translation, with the same names in braces."""

import json
import re
import string
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import pytest
from babel.messages.extract import extract_from_file
from babel.messages.pofile import read_po
from matplotlib.text import Text
from partial_pages import blank_png

import experiments
from experiments import language as spoken
from experiments.figures.axes import root_figure
from experiments.language import (
    Messages,
    language,
    localized,
    mark,
    said,
    set_language,
    speaking,
    tr,
    trn,
)
from experiments.parts import section
from experiments.report.page import page_environment
from geometry.catalogue import load_cameras
from geometry.files import load_data
from geometry.junction import ARM_NAMES
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.detectors import ResponseDetector, load_detector
from placement.detectors.built_in import DETECTOR_NAMES, LIDAR_NAMES
from placement.detectors.evidence import VRU_CLASSES
from placement.optimiser.problem import Objective
from placement.wishes import assumed_prices, load_prices
from scenarios.cases import ROAD_USER_GROUPS, load_cases, load_unlaid_cases, worded_for

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


class Bracketed(Messages):
    """A language made up: English in brackets, but for what is put in."""

    def find(self, message):
        return re.sub(r"(\{[^}]*\})", r"⟧\1⟦", f"⟦{message}⟧").replace("⟦⟧", "")

    def find_plural(self, one, many, count):
        return self.find(one if count == 1 else many)


ALLOWED = {"APR", "AEB", "EUR", "Euro", "NCAP", "VUT", "RSU", "RSUs", "IoU", "HiGHS", "CarlaNCAP"}
ALLOWED |= {"m", "s", "ms", "px", "km", "h", "Hz", "N", "x", "prices.toml", "cost_eur"}
ALLOWED |= {"place-rsus", "python", "cvxpy", "highspy", "numpy", "scipy", "trimesh", "embree"}
ALLOWED |= {"rays", *DETECTOR_NAMES, *load_cases(), *load_cameras()}
ALLOWED |= {site.id for site in load_study_scene().sites}


def left_over(text):
    """Words of a text that no message said; ids, codes and numbers with units are none."""
    before = None
    while before != text:
        before, text = text, re.sub(r"⟦[^⟦⟧]*⟧", " ", text)
    tokens = [re.sub(r"^\W+|\W+$", "", token) for token in text.split()]
    return [
        token
        for token in tokens
        if re.search(r"[^\W\d_]", token)
        and not re.search(r"[\d/_\\@]", token)
        and token not in ALLOWED
    ]


class Said(HTMLParser):
    """What a page says to people: texts, names for those who do not see it, names of its runs."""

    def __init__(self, page):
        super().__init__()
        self.open, self.texts = [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br", "hr", "link", "input", "source"):
            self.open.append((tag, dict(attributes).get("id")))
        self.texts += [
            value for name, value in attributes if name in ("alt", "title", "aria-label")
        ]

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if ("script", "player-data") in self.open:
            data = json.loads(data)
            lists = (data[name] for name in ("runs", "parties", "units"))
            entries = [entry for entries in lists for entry in entries] + data["plan"]["arms"]
            keys = ("title", "case", "group", "name")
            self.texts += [entry[key] for entry in entries for key in keys if key in entry]
        elif not {"style", "script", "code"} & {tag for tag, _ in self.open}:
            self.texts.append(data)


def visible_words(page):
    """Words of a page that no message said."""
    return {text.strip(): left_over(text) for text in Said(page).texts if left_over(text)}


@pytest.fixture
def drawn(monkeypatch):
    """Texts of the figures that are made into pictures."""
    texts = []

    def blank(figure):
        texts.extend(text.get_text() for text in root_figure(figure).findobj(Text))
        return blank_png(figure)

    monkeypatch.setattr(section, "to_png", blank)
    return texts


@pytest.mark.usefixtures("few_runs")
def test_no_word_of_a_report_is_left_over(run, drawn, monkeypatch):
    monkeypatch.setattr(spoken, "_catalogue", lambda code: Bracketed())
    code, _, err = run("--budget", 2, "--out", "out", "--language", "de")
    assert code == 0, err
    page = Path("out/report.html").read_text()
    assert '<html lang="de">' in page
    assert not visible_words(page)
    assert len(drawn) > 50
    assert not {text: left_over(text) for text in drawn if left_over(text)}


def test_what_the_packages_below_say_is_known():
    scene = load_study_scene()
    texts = [case.title for case in (load_cases() | load_unlaid_cases()).values()]
    texts += [worded_for(case, keeps_left=True).title for case in load_cases().values()]
    names = [name for name in DETECTOR_NAMES if name != "cnn" or find_spec("onnxruntime")]
    detectors = [load_detector(name) for name in [*names, *(f"geometric+{x}" for x in LIDAR_NAMES)]]
    texts += [one.description for one in detectors]
    listed = re.compile(", ".join(["[a-z_]+"] * 2) + "[a-z_, ]*")  # keys of its file
    figures = [one.figures_words for one in detectors if isinstance(one, ResponseDetector)]
    texts += [listed.sub("key_of_file", words) for words in figures]
    kinds = [*load_prices().kinds, "sign"]
    sites = [replace(scene.sites[0], kind=kind, cost_eur=0.0) for kind in [*kinds, *kinds[1:]]]
    texts += assumed_prices(load_prices(), sites)
    texts += [*load_weathers(), *ARM_NAMES, *ROAD_USER_GROUPS, *VRU_CLASSES]
    texts += [objective.label for objective in Objective]
    with speaking("de", Bracketed()):
        left = {text: left_over(said(text)) for text in texts}
    assert len(texts) > 150
    assert not {text: words for text, words in left.items() if words}


def test_words_of_scripts_are_in_the_page():
    templates = ROOT / "report" / "templates"
    scripts = "".join(path.read_text() for path in sorted(templates.glob("*.js")))
    literal = r'"((?:[^"\\]|\\.)*)"'
    calls = re.findall(r'say\(((?:[^"()]|"(?:[^"\\]|\\.)*")*)', scripts)
    asked = [text for text in re.findall(literal, " ".join(calls)) if text != r"\0"]
    asked += [text for text in re.findall(literal, scripts) if re.search(r"\{\w+\}", text)]
    with speaking("de", Bracketed()):
        page = page_environment().get_template("words.html.j2").render()
    words = json.loads(re.search(r">(\{.*\})<", page)[1])
    assert len(asked) > 60
    assert set(asked) <= set(words)
    with speaking("en"):
        assert not page_environment().get_template("words.html.j2").render().strip()
