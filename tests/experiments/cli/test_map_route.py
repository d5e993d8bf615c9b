"""A map in place of a scene, in every command that has ``--scene``."""

import json
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from command_results import refusal
from export_layouts import awkward_layout
from osm_text import LAT_DEG, LON_DEG, OsmText, crossing

from experiments.cli.commands import COMMANDS
from experiments.cli.options import OF_SCENE
from experiments.export.json import to_json
from geometry.registry import load_entry

FOUR = (
    (1.0, 0.0),
    (0.0, 1.0),
    (-1.0, 0.0),
    (0.0, -1.0),
)


def all_commands() -> Iterator[tuple[str, click.Command]]:
    """Commands and their subcommands, by the words that call them."""
    waiting = [(name, load_entry(entry.place)) for name, entry in COMMANDS.items()]
    while waiting:
        name, command = waiting.pop()
        yield name, command
        if isinstance(command, click.Group):
            waiting += [
                (f"{name} {word}", one) for word, one in command.commands.items()
            ]


@pytest.fixture
def map_path(tmp_path: Path) -> Path:
    """A crossing in OpenStreetMap."""
    osm = OsmText()
    crossing(osm, bearings=FOUR)
    return osm.write(tmp_path)


@pytest.fixture
def layout_path(tmp_path: Path) -> Path:
    """A layout for the map whose units hang on nothing."""
    layout = awkward_layout()
    text = to_json(layout)
    for unit in layout.units:
        text = text.replace(f'"site": "{unit.site_id}"', '"site": ""')
    text = text.replace('"town05"', '"map/n1"')
    path = tmp_path / "layout.json"
    path.write_text(text)
    return path


def test_every_command_with_a_scene_has_the_options_of_a_map():
    lacking = {}
    with_scene = set()
    for name, command in all_commands():
        asked = {parameter.name for parameter in command.params}
        if "scene" in asked:
            with_scene.add(name)
            lacking[name] = set(OF_SCENE) - asked

    assert {"export", "render", "verify", "evaluate", "sheet", "plan"} <= with_scene
    assert {name: missing for name, missing in lacking.items() if missing} == {}


@pytest.mark.long
def test_export_takes_a_map(run, map_path, layout_path):
    code, out, err = run(
        "export --format geojson --sites kerb:20 --driving-side left",
        "--junction",
        "Street 0 / Street 1 / Street 2 / Street 3",
        "--scene",
        map_path,
        "--layout",
        layout_path,
    )
    assert code == 0, err
    assert "traffic keeps" in err

    for feature in json.loads(out)["features"]:
        place = feature["geometry"]["coordinates"][:2]
        assert place == pytest.approx([LON_DEG, LAT_DEG], abs=0.01)


@pytest.mark.parametrize(
    "command",
    [
        "export --format geojson",
        "render --run CPNA-25/west/40 --frame 0 --unit U1",
        "verify .",
    ],
)
def test_a_junction_that_a_map_lacks_is_refused(command, run, map_path, layout_path):
    words = ["--junction", "nowhere", "--scene", map_path]
    if not command.startswith("verify"):
        words += ["--layout", layout_path]
    line = refusal(run(f"{command} --quiet", *words))

    assert "--junction: got 'nowhere'; expected one of n1 (Street 0" in line


@pytest.mark.parametrize(
    "command",
    ["export --format geojson", "render --run CPNA-25/west/40 --frame 0 --unit RSU3"],
)
def test_options_of_a_map_need_one(command, run):
    message = refusal(run(f"{command} --layout carlancap-12 --junction n1 --quiet"))
    assert message.startswith("--junction: got it with the study's junction")


@pytest.mark.long
def test_a_result_made_with_a_map_is_verified_with_it(run, map_path):
    """Also without the options of the map: the result says what was asked."""
    asked = ("--scene", map_path, "--sites", "kerb:20")
    code, _, err = run(
        "--budget 1 --cases CPNA --approaches west --along-arms 0 --out out --quiet",
        *asked,
    )
    assert code == 0, err

    for words in (asked, asked[:2]):
        code, out, err = run("verify out --quiet", *words)
        assert code == 0, out + err
        assert "checks: all OK" in out
    code, out, _ = run("verify out --quiet", *asked[:2], "--sites", "kerb:10")

    assert code == 1
    assert "FAILED" in out
