"""The command `plan` without a browser: what it opens, and what it begins with."""

import json
import stat
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname, urlopen

import pytest
from command_results import output, refusal
from json_files import read_json, write_json

pytest.importorskip("starlette", reason="place-rsus[plan] is not installed")

from experiments.export.json import to_json
from experiments.planner import command
from experiments.planner.plan import PlanState, Variant
from experiments.planner.plan_files import layout_text, plan_text
from experiments.planner.server import RunningServer
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout

FEW = ("--cases", "CPNC-50", "--along-arms", "0", "--speeds", "50")
SCENE = load_study_scene()
STUDY = load_carlancap_layout()


def save_plan(path, *variants, scene=SCENE):
    """File of a plan with some variants."""
    path.write_text(plan_text(PlanState(variants=variants), scene))
    return path


def save_layout(path, units, **fields):
    """File of a layout of some units."""
    path.write_text(
        to_json(replace(STUDY, name="layout", units=tuple(units), **fields))
    )
    return str(path)


def test_no_command_line_has_the_token_of_the_page(run, monkeypatch):
    opened = []

    def look(address):
        path = Path(url2pathname(urlsplit(address).path))
        opened.append(
            (address, path.read_text(), path.stat().st_mode, path.parent.stat().st_mode)
        )

    monkeypatch.setattr(command.webbrowser, "open", look)
    monkeypatch.setattr(RunningServer, "wait", lambda self: None)
    code, out, err = run("plan", *FEW)

    assert code == 0
    assert err.count("problem") == 0

    ((address, text, mode, folder_mode),) = opened
    (page,) = [word for word in out.split() if word.startswith("http://127.0.0.1:")]
    token = page.split("/")[3]

    assert address.startswith("file:")
    assert token not in address
    assert f'content="0; url={page}"' in text
    assert stat.S_IMODE(mode) == 0o600
    assert stat.S_IMODE(folder_mode) == 0o700
    with pytest.raises(OSError, match="refused"):
        urlopen(page)


def test_a_saved_plan_is_opened_again_and_layouts_are_further_variants(tmp_path):
    saved = save_plan(
        tmp_path / "plan.json",
        Variant(name="layout", units=STUDY.units[:1]),
        Variant(name="empty"),
    )
    # The first is there already.
    names = [save_layout(tmp_path / f"{n}.json", STUDY.units[:n]) for n in (1, 2)]
    begun = command._begun_plan(tuple(names), saved, SCENE)

    assert [len(variant.units) for variant in begun.variants] == [1, 2]
    assert command._begun_plan((), tmp_path / "none.json", SCENE).variants == ()


def test_own_poles_of_a_layout_are_there_again(tmp_path):
    lamp = next(site for site in SCENE.sites if site.id == "lamp-n1")
    pole = replace(lamp, id="own-1", position_m=lamp.position_m + [0.0, 2.0, 0.0])
    unit = replace(STUDY.units[0], site_id="own-1")
    state = PlanState(variants=(Variant(name="mine", units=(unit,)),), poles=(pole,))
    path = tmp_path / "layout.json"
    path.write_text(layout_text(state, SCENE))
    begun = command._begun_plan((str(path),), None, SCENE)

    assert [place.id for place in begun.poles] == ["own-1"]


def test_what_cannot_be_begun_with_is_refused_and_stays_as_it_is(run, tmp_path):
    other = save_plan(
        tmp_path / "plan.json",
        Variant(name="mine", units=STUDY.units[:1]),
        scene=replace(SCENE, name="elsewhere"),
    )
    before = other.read_text()
    code, _, err = run("plan", *FEW, "--no-open --save", str(other))

    assert code == 2
    assert other.read_text() == before
    assert err.endswith(
        "got one made for elsewhere; expected one of town05, the scene in use\n"
    )

    line = refusal(run("plan --no-open --save /dev/zero"))
    assert (
        "/dev/zero: got a device; expected a regular file's name, or one that is free"
        in line
    )

    many = [replace(STUDY.units[0], id=f"U{index}") for index in range(1001)]
    layout = save_layout(tmp_path / "many.json", many)
    line = refusal(run("plan --no-open --layout", layout))

    assert line.endswith("many.json: units: got 1,001; expected at most 1,000")


def test_the_last_change_is_saved_when_it_ends(run, tmp_path, monkeypatch):
    path = tmp_path / "plan.json"

    def change(server):
        """As a browser does just before Ctrl-C."""
        message = {"do": "add", "site": "corner-ne", "sensor": "carla-ncap-rgb"}
        server.session.handle(json.dumps(message).encode())

    monkeypatch.setattr(RunningServer, "wait", change)
    out = output(run("plan", *FEW, "--no-open --save", str(path)))

    assert out.endswith(f"; the plan is in {path}.\n")
    assert read_json(path)["variants"][0]["layout"][0]["site"] == "corner-ne"


def test_tiles_of_no_server_are_refused_before_anything_is_read(run, tmp_path):
    gone = str(tmp_path / "gone.osm")
    line = refusal(run("plan --no-open --scene", gone, "--tiles https://tiles.example"))
    assert line.startswith("--tiles: got 'https://tiles.example'; expected an address")


@pytest.fixture
def found(tmp_path):
    """A folder of results that was found for cars that see."""
    folder = tmp_path / "found"
    folder.mkdir()
    save_layout(folder / "layout.json", STUDY.units[:1])
    question = {
        "cars": "see",
        "cases": "study",
        "site_cost": 500.0,
        "budget": 3,
    }
    summary = {"asked": {"question": question}}
    write_json((folder / "summary.json"), summary)
    return folder


def test_a_layout_of_a_folder_of_results_opens_with_its_own_question(
    run, found, monkeypatch
):
    asked = []

    def begun(progress, question, *, quiet):
        asked.append(question)
        raise InputError("seen", 1, "no more")

    monkeypatch.setattr(command, "begin", begun)
    _, _, err = run("plan --no-open --layout", found / "layout.json")
    words = " ".join(err.split())

    assert f"The page uses the question of {found}: " in words
    assert "--cars see" in words
    assert asked[0].cars == "see"
    assert asked[0].cases == "study"
    assert asked[0].site_cost_eur == 500.0
    assert asked[0].budget is None  # the page asks for no number of units

    run("plan --no-open --cars blind --layout", found / "layout.json")
    assert asked[1].cars == "blind"
    assert asked[1].cases == "study"


def test_a_layout_of_a_folder_of_results_brings_what_exists(found):
    (unit,) = STUDY.units[:1]
    summary = {"asked": {"question": {"keep": "gone.json"}}, "existing": [unit.id]}
    write_json((found / "summary.json"), summary)
    begun = command._begun_plan((str(found / "layout.json"),), None, SCENE)

    assert [each.id for each in begun.existing] == [unit.id]


def test_a_network_is_not_taken_from_a_folder_of_results(run, found):
    summary = {"asked": {"question": {"detector": "mine.onnx"}}}
    write_json((found / "summary.json"), summary)
    line = refusal(run("plan --no-open --layout", found / "layout.json"))

    assert "summary.json: detector: got 'mine.onnx'; expected it on the" in line
