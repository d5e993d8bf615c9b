"""Every message of an answer has a German translation, with the same names in
braces.
"""

import ast
import copy
import json
import pickle
import re
import string
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from babel.messages.extract import extract_from_file
from babel.messages.pofile import read_po
from command_results import output
from json_files import UNIT, write_json
from made_up_language import Bracketed, left_over
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.text import Text
from messages_of_data import messages_of_data
from partial_pages import blank_png
from private_garden import write_garden
from small_results import lay_runs_of

import experiments
import geometry
import placement
import scenarios
from experiments import language as spoken
from experiments.figures.axes import root_figure
from experiments.language import (
    Messages,
    language,
    localized,
    mark,
    set_language,
    speaking,
    tr,
    tr_error,
    trn,
)
from experiments.parts import latency as latency_part
from experiments.parts import section, sheet
from experiments.parts.alternatives import doubt_sentences
from experiments.planner.page_files import page_html, page_messages
from experiments.report.page import page_environment
from geometry.errors import InputError
from geometry.junction import ARM_NAMES
from geometry.phrases import Phrase, join_phrases
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.detectors import load_detector
from placement.detectors.evidence import VRU_CLASSES
from placement.detectors.registry import DETECTOR_NAMES, LIDAR_NAMES
from placement.detectors.response import ResponseDetector
from placement.explain.alternatives import ByRuns
from placement.optimiser.problem import Objective
from placement.setting import Radio
from placement.wishes import assumed_prices, load_prices
from scenarios.cases import ROAD_USER_GROUPS, load_cases, load_unlaid_cases, worded_for

ROOT = Path(experiments.__file__).parent
CATALOGUES = sorted((ROOT / "languages/de").glob("*.po"))
PACKAGES = (experiments, placement, scenarios, geometry)
KEYWORDS = {
    "tr": None,
    "trn": (1, 2),
    "mark": None,
    "Phrase": None,
}


class Upside(Messages):
    """A language in capital letters."""

    def find(self, message):
        return message.upper().replace("{N", "{n")

    def find_plural(self, one, many, count):
        return self.find(one if count == 1 else many)


@cache
def messages_of_code():
    """Each message with the places where it stands; of plurals both forms."""
    found = {}
    folders = [Path(package.__file__).parent for package in PACKAGES]
    for path in sorted(path for folder in folders for path in folder.rglob("*")):
        method = {".py": "python", ".j2": "jinja2"}.get(path.suffix)
        if method and path.name not in ("language.py", "phrases.py"):
            options = {"extensions": "jinja2.ext.do", "silent": "false"}
            for line, message, *_ in extract_from_file(
                method, path, KEYWORDS, options=options
            ):
                found.setdefault(message, []).append(
                    f"{path.relative_to(ROOT.parent)}:{line}"
                )
    found.pop("", None)  # Phrase(""): nothing is said
    for one, many in page_messages():
        found.setdefault((one, many) if one else many, []).append("planner/page/*.js")
    for message, places in messages_of_data().items():
        found.setdefault(message, []).extend(places)
    return found


@cache
def translations():
    """Entries of all catalogues, by message and file."""
    found = {}
    for path in CATALOGUES:
        with path.open("rb") as file:
            for entry in read_po(file):
                if entry.id:
                    found.setdefault(entry.id, {})[path.name] = entry
    return found


def names_in_braces(text):
    """Names of the values that a message has."""
    return sorted(
        name for _, name, _, _ in string.Formatter().parse(text) if name is not None
    )


@pytest.mark.long
def test_every_message_has_a_translation():
    known = translations()
    messages = messages_of_code()
    missing = {one: where for one, where in messages.items() if one not in known}

    assert not missing

    empty = [
        one
        for one in messages
        if not all(e.string and not e.fuzzy for e in known[one].values())
    ]
    assert not empty


def test_translations_put_in_the_same_values_and_agree_between_files():
    for message, entries in translations().items():
        assert len({entry.string for entry in entries.values()}) == 1, message
        for entry in entries.values():
            if isinstance(entry.id, str):
                forms = (entry.id,)
            else:
                forms = entry.id
            if isinstance(entry.string, str):
                texts = (entry.string,)
            else:
                texts = entry.string
            wanted = set().union(*map(names_in_braces, forms))
            assert set().union(*map(names_in_braces, texts)) == wanted, message


@pytest.mark.long
def test_no_translation_is_left_over():
    assert not set(translations()) - set(messages_of_code())


@pytest.mark.long
def test_no_message_stands_within_an_f_string_where_extraction_misses_it():
    hidden = [
        f"{path.relative_to(ROOT.parent)}:{text.lineno}"
        for package in PACKAGES
        for path in sorted(Path(package.__file__).parent.rglob("*.py"))
        for text in ast.walk(ast.parse(path.read_text()))
        if isinstance(text, ast.JoinedStr)
        for call in ast.walk(text)
        if isinstance(call, ast.Call)
        and getattr(call.func, "id", "") in KEYWORDS
        and isinstance(call.args[0], ast.Constant)
    ]
    assert hidden == []


def test_numbers_among_the_values_are_written_as_the_language_does():
    assert tr("{a:.2f} of {b:,}", a=1.5, b=1200) == "1.50 of 1,200"
    assert localized("1,200.50") == "1,200.50"

    with speaking("de"):
        assert tr("{a:.2f} of {b:,}", a=1.5, b=1200) == "1,50 of 1.200"
        assert localized("1,200.50") == "1.200,50"
        assert tr("{text}", text="1.5") == "1.5"
    assert language() == "en"


def test_a_phrase_is_translated_with_the_phrases_and_numbers_within_it():
    thing = Phrase("lamp post")
    why = Phrase(
        "{thing} stands {far:.1f} m away, next to {name}",
        thing=thing,
        far=2.5,
        name="A",
    )
    assert (str(why), tr(why)) == ("lamp post stands 2.5 m away, next to A",) * 2

    with speaking("de"):
        assert tr(why) == "Laternenmast stands 2,5 m away, next to A"
        assert tr("{why}.", why=why) == "Laternenmast stands 2,5 m away, next to A."

        joined = join_phrases([thing, "A"], "; ")
        assert tr(joined) == "Laternenmast; A"


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))]
)
def test_copies_of_a_phrase_are_translated_too(copied):
    phrase = Phrase(
        "{arm} arm, {distance:.0f} m out", arm=Phrase("north"), distance=12.4
    )
    again = copied(phrase)
    assert again == phrase

    with speaking("de"):
        assert tr(again) == tr(phrase) != phrase


def test_each_message_stands_in_one_catalogue():
    assert {path.name for path in CATALOGUES} == {"answer.po", "page.po", "report.po"}
    assert not {
        one: entries for one, entries in translations().items() if len(entries) > 1
    }


def test_nothing_is_said_where_there_is_no_text():
    with speaking("de"):
        assert tr("") == ""


def test_another_catalogue_can_be_spoken_for_a_block():
    with speaking("en", Upside()):
        assert tr("three runs") == "THREE RUNS"
        assert trn("{n} run", "{n} runs", 2) == "2 RUNS"
        assert mark("a run") == "a run"
    assert tr("three runs") == "three runs"


def test_an_unknown_language_has_no_catalogue():
    with pytest.raises(FileNotFoundError):
        set_language("xx")


class Said(HTMLParser):
    """What a page says to people: texts, names for those who do not see it, names of
    its runs.
    """

    def __init__(self, page):
        super().__init__()
        self.open = []
        self.texts = []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br", "hr", "link", "input", "source"):
            self.open.append((tag, dict(attributes).get("id")))
        self.texts += [
            value
            for name, value in attributes
            if name in ("alt", "title", "aria-label", "placeholder")
        ]

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if ("script", "player-data") in self.open:
            data = json.loads(data)
            lists = (data[name] for name in ("runs", "parties", "units"))
            entries = [entry for entries in lists for entry in entries] + data["plan"][
                "arms"
            ]
            keys = ("title", "case", "group", "name")
            self.texts += [
                entry[key] for entry in entries for key in keys if key in entry
            ]
        elif not {"style", "script", "code"} & {tag for tag, _ in self.open}:
            self.texts.append(data)


def visible_words(page):
    """Words of a page that no message said."""
    return {
        text.strip(): left_over(text) for text in Said(page).texts if left_over(text)
    }


@pytest.fixture
def drawn(monkeypatch):
    """Texts of the figures that are made into pictures."""
    texts = []

    def blank(figure):
        texts.extend(text.get_text() for text in root_figure(figure).findobj(Text))
        return blank_png(figure)

    monkeypatch.setattr(section, "to_png", blank)
    return texts


@pytest.fixture
def bracketed(monkeypatch):
    """German is the language made up."""
    monkeypatch.setattr(spoken, "_catalogue", lambda code: Bracketed())


@pytest.fixture
def mine(tmp_path):
    """Files of a layout of a camera, of one with a LiDAR, too, and of a private
    area.
    """
    camera = UNIT | {"id": "U1", "latency_s": 0.5}
    lidar = UNIT | {"id": "U2", "x_m": -113.5, "lidar": "carla-ncap-lidar"}
    del lidar["camera"]
    for name, units in (
        ("mine-1", [camera]),
        ("mine-2", [camera, lidar]),
    ):
        write_json(tmp_path / f"{name}.json", {"name": name, "layout": units})
    garden = write_garden(tmp_path, (-130.0, -10.0, -100.0, 10.0), name="garden-1")
    return [tmp_path / "mine-1.json", tmp_path / "mine-2.json", garden]


@pytest.mark.long
@pytest.mark.usefixtures("bracketed", "small_study")
@pytest.mark.parametrize(
    "asked",
    [
        "--budget 2 --verbose",
        "--budget 2 --cars 0.5 --give-up 0.01 --vam-rate 0.5 --verbose",
        "--budget 2 --samples 4 --cars blind",
        "--budget 2 --cars see --fusion single --detector response --verbose",
        ("--target 0.5 --least cost --site-cost 100 --cars blind --verbose"),
        "evaluate --layout MINE-1 --cars blind --verbose",
        "evaluate --layout MINE-2 --no-look GARDEN-1 --verbose",
        "compare MINE-2 MINE-1 --samples 4 --verbose",
        "compare MINE-2 MINE-1 carlancap-12",
        "pareto --max 2",
        "pareto --max 2 --by cost --site-cost 500",
        "retrofit --layout MINE-2 --site-cost 500 --budget-cost 3000",
        "latency --layout MINE-2",
        "latency --layout MINE-1 --budget cpm-100ms",
    ],
)
def test_no_word_on_a_terminal_is_left_over(run, mine, few_runs, monkeypatch, asked):
    monkeypatch.setattr(
        latency_part, "build_setting", lambda question, scene, **options: few_runs
    )
    for path in mine:
        asked = asked.replace(path.stem.upper(), str(path))
    text = output(run(asked, "--language de --out out-1"))

    assert text.count("⟦") > 20
    assert not left_over(re.sub(r"--[a-z-]+", "", text))

    page = Path("out-1/report.html")
    assert page.exists() == (asked.startswith(("--", "evaluate", "compare")))
    assert not page.exists() or not visible_words(page.read_text())


@pytest.mark.long
@pytest.mark.usefixtures("bracketed", "with_blank_pictures")
def test_no_word_of_a_sheet_is_left_over(run, mine, small_setting, monkeypatch):
    monkeypatch.setattr(sheet, "build_setting", lambda *given, **options: small_setting)
    texts = []
    keep = PdfPages.savefig

    def savefig(pages, figure):
        texts.extend(text.get_text() for text in figure.findobj(Text))
        keep(pages, figure)

    monkeypatch.setattr(PdfPages, "savefig", savefig)
    text = output(run("sheet --layout", mine[1], "--out s-1.pdf --language de"))

    assert len(texts) > 40
    assert not {text: left_over(text) for text in [*texts, text] if left_over(text)}


@pytest.mark.long
@pytest.mark.usefixtures("small_study")
def test_the_language_is_that_of_the_option_else_of_the_environment(run, monkeypatch):
    asked = "pareto --max 1 --quiet"
    english = run(asked)
    german = run(asked, "--language de")

    assert "The best of" in english[1]
    assert "Die besten von" in german[1]

    monkeypatch.setenv("PLACE_RSUS_LANGUAGE", "de")
    assert run(asked) == german
    assert run(asked, "--language en") == english
    assert language() == "en"

    wrong = "place-rsus: --language: got 'fr'; expected one of en, de\n"
    assert run(asked, "--language fr") == (2, "", wrong)

    monkeypatch.setenv("PLACE_RSUS_LANGUAGE", "fr")
    assert run(asked) == (2, "", wrong)


@pytest.mark.long
@pytest.mark.usefixtures("few_runs", "bracketed")
@pytest.mark.parametrize(
    "asked",
    [
        "--budget 1 --refine --detector response",
        "--budget 2 --samples 2 --cars 0.3",
    ],
)
def test_no_word_of_a_report_is_left_over(
    run, drawn, monkeypatch, small_setting, asked
):
    # Some runs are missed and one does not count; radio is bad, and tracks die.
    axis = small_setting.axis
    rule = small_setting.rule
    odd = replace(
        small_setting,
        axis=replace(axis, weight=np.array([0.0, 0.3, 0.3, 0.2, 0.1, 0.1])),
        rule=replace(rule, latency_s=4.0, track_memory_s=0.5, build_up_s=0.2),
        radio=Radio(packet_loss=0.1, vam_rate=0.5),
    )
    lay_runs_of(monkeypatch, odd)
    output(run(asked, "--out out --language de"))
    page = Path("out/report.html").read_text()

    assert '<html lang="de">' in page
    assert not visible_words(page)
    assert len(drawn) > 50
    assert not {text: left_over(text) for text in drawn if left_over(text)}


def test_what_the_packages_below_say_is_known():
    scene = load_study_scene()
    texts = [case.title for case in (load_cases() | load_unlaid_cases()).values()]
    texts += [worded_for(case, keeps_left=True).title for case in load_cases().values()]
    names = [
        name for name in DETECTOR_NAMES if name != "cnn" or find_spec("onnxruntime")
    ]
    detectors = [
        load_detector(name)
        for name in [*names, *(f"geometric+{x}" for x in LIDAR_NAMES)]
    ]
    texts += [one.description for one in detectors]
    listed = re.compile(", ".join(["[a-z_]+"] * 2) + "[a-z_, ]*")  # keys of its file
    figures = [
        one.figures_words for one in detectors if isinstance(one, ResponseDetector)
    ]
    for words in figures:
        keys = listed.sub("key_of_file", words.fields.get("names", ""))
        texts.append(Phrase(words.template, **(words.fields | {"names": keys})))
    kinds = [*load_prices().kinds, "sign"]
    sites = [
        replace(scene.sites[0], kind=kind, cost_eur=0.0)
        for kind in [*kinds, *kinds[1:]]
    ]
    texts += assumed_prices(load_prices(), sites)
    texts += [*load_weathers(), *ARM_NAMES, *ROAD_USER_GROUPS, *VRU_CLASSES]
    texts += [objective.label for objective in Objective]
    with speaking("de", Bracketed()):
        left = {text: left_over(tr(text)) for text in texts}

    assert len(texts) > 150
    assert not {text: words for text, words in left.items() if words}


def test_words_of_scripts_are_in_the_page():
    templates = ROOT / "report/templates"
    scripts = "".join(path.read_text() for path in sorted(templates.glob("*.js")))
    literal = r'"((?:[^"\\]|\\.)*)"'
    calls = re.findall(r'say\(((?:[^"()]|"(?:[^"\\]|\\.)*")*)', scripts)
    asked = [text for text in re.findall(literal, " ".join(calls)) if text != r"\0"]
    asked += [
        text for text in re.findall(literal, scripts) if re.search(r"\{\w+\}", text)
    ]
    with speaking("de", Bracketed()):
        page = page_environment().get_template("words.html.j2").render()
    words = json.loads(re.search(r">(\{.*\})<", page)[1])

    assert len(asked) > 60
    assert set(asked) <= set(words)

    with speaking("en"):
        assert not page_environment().get_template("words.html.j2").render().strip()


def test_no_word_of_the_planners_page_is_left_over():
    with speaking("de", Bracketed()):
        page = page_html()
    assert '<html lang="de">' in page

    keys = {*"lnop"}
    assert not {
        text: words for text, words in visible_words(page).items() if set(words) - keys
    }


def test_scripts_of_the_planners_page_say_literals_and_nothing_else():
    """Each call of tr and trn is collected; no other literal has two words of a
    sentence.
    """
    scripts = [
        path.read_text() for path in sorted((ROOT / "planner/page").glob("*.js"))
    ]
    code = re.sub(
        r"^ *//.*|(?<=[;{},]) // .*", "", "\n".join(scripts), flags=re.MULTILINE
    )
    literal = r'"(?:[^"\\\n]|\\.)*"'
    left = re.sub(rf"\btr(n\({literal}, {literal}|\({literal})", "", code)

    assert not re.findall(r"\btrn?\(.*", left)
    assert len(page_messages()) > 200

    phrases = [
        one
        for one in re.findall(literal, left)
        if re.search(r"[A-Za-z]{2} [a-z]{2}", one)
    ]
    assert set(phrases) <= {'"unit aim"', '"out of view"'}


def words_of(node):
    """A text in code that no message says, with 1 in place of each value.

    None: it is none.
    """
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Unquoted":
        node = node.args[0]
    if isinstance(node, ast.JoinedStr):
        parts = (getattr(part, "value", None) for part in node.values)
        return "".join(part if isinstance(part, str) else "1" for part in parts)
    text = getattr(node, "value", None)
    if isinstance(text, str):
        return text
    return None


def test_what_the_planner_refuses_is_translated():
    """Literals in errors are marked, and texts with values are phrases."""
    texts = set()
    for path in sorted((ROOT / "planner").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                called = getattr(node.func, "id", "")
            else:
                called = ""
            if called in ("InputError", "refuse"):
                texts |= {*map(words_of, node.args)}
            elif isinstance(node, ast.Assign):
                named = getattr(node.targets[0], "id", "") in (
                    "expected",
                    "got",
                    "_EXPECTED",
                )
                if named:
                    texts |= {words_of(node.value)}
                else:
                    texts |= set()
    texts -= {None}
    options = {
        "--port",
        "--cars",
        "a free port",
        "blind or see: the page shows each run once",
    }
    options |= {"it on the command line: a network is a program"}
    options |= {"--tiles", "an address such as https://HOST/{z}/{x}/{y}.png"}

    # Of the command line, in English; and numbers of variants, which the page gives.
    assert texts == {*options, "1:1: 1", "0 to 1"}


def test_an_error_is_translated_with_all_that_it_names():
    error = InputError(
        mark("height"), 7.5, Phrase("{low:g} .. {high:g} m", low=1, high=2.5)
    )
    assert tr_error(error) == str(error) == "height: got 7.5; expected 1 .. 2.5 m"
    with speaking("de"):
        assert tr_error(error) == "Höhe: 7,5 gegeben; erwartet: 1 .. 2,5 m"
        assert tr_error(ValueError("no answer")) == "no answer"


def test_counted_runs_stand_in_german_where_the_nominative_does():
    both = ByRuns(
        units=("a",),
        runs_avoided=65,
        runs_avoided_here=64,
        is_proven=True,
    )
    for found in (both, replace(both, is_proven=False)):
        with speaking("de"):
            (text,) = doubt_sentences((), found, n_runs=107)
        assert "65, diese hier 64 (insgesamt 107 Läufe, nach" in text
