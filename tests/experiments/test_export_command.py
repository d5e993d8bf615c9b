"""``place-rsus export``: every format from the command line."""

import itertools
import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from export_layouts import awkward_layout, large_layout, map_scene, placeless_scene
from export_speeds import measure_exports

import experiments.export
from experiments.cli.export import export as command
from experiments.export import FORMAT_NAMES, FORMATS, load_format
from experiments.export.calibration import lidar_ids
from experiments.export.json import to_json
from experiments.progress import StageProgress
from geometry.errors import InputError

BINARY = ["gpkg", "cpm-uper", "mcap"]
TOLD = {"cpm-uper": "10 messages of "}  # what is said of a file that was written


@pytest.fixture
def layout_path(tmp_path):
    """File of a layout at no site."""
    path = tmp_path / "layout.json"
    layout = awkward_layout()
    text = to_json(layout)
    for unit in layout.units:  # the study's junction has other sites
        text = text.replace(f'"site": "{unit.site_id}"', '"site": ""')
    path.write_text(text)
    return path


def call(*arguments):
    """Result of the command by itself."""
    return CliRunner().invoke(
        command, [str(one) for one in arguments], obj=StageProgress()
    )


def test_every_format_is_described():
    modules = Path(experiments.export.__file__).parent.glob("*.py")
    written = [module for module in modules if " = ExportFormat(" in module.read_text()]
    several = {"uper": ["cpm-uper"]}
    names = [several.get(one.stem, [one.stem]) for one in written]

    assert sorted(FORMAT_NAMES) == sorted(itertools.chain(*names))

    help_text = call("--help").output
    assert all(f"\n    {name} " in help_text for name in FORMAT_NAMES)
    assert [name for name in FORMAT_NAMES if FORMATS[name].is_binary] == BINARY


@pytest.mark.long
@pytest.mark.parametrize("name", FORMAT_NAMES)
@pytest.mark.parametrize("build", [awkward_layout, large_layout])
def test_notes_tell_the_truth(name, build):
    layout = build()
    note = load_format(name)
    content = note.write(layout, map_scene())

    assert isinstance(content, bytes) == FORMATS[name].is_binary
    # Bear a date.
    assert content == note.write(layout, map_scene()) or name in (
        "gpkg",
        "dxf",
    )

    if note.has_lidars:
        gone = []
    else:
        gone = lidar_ids(layout)
    assert bool(gone) == (not note.has_lidars and build is awkward_layout)
    if isinstance(content, str):
        assert content.endswith("\n")

    if name in ("geojson", "gpkg", "kml", "cpm", "cpm-uper"):  # need a place on earth
        with pytest.raises(InputError, match="a scene without crs"):
            note.write(layout, placeless_scene())
    else:
        assert note.write(layout, placeless_scene())


@pytest.mark.long
@pytest.mark.parametrize("name", FORMAT_NAMES)
def test_every_format_is_written_to_a_file_whole(name, layout_path, tmp_path):
    out = tmp_path / f"out.{name}"
    given = ["--layout", layout_path, "--format", name]
    result = call(*given, "--out", out)

    assert result.exit_code == 0, result.output
    assert result.stdout == ""

    said = "left out, for they are no cameras: lidar ä, lidar b\n"
    said = TOLD.get(name, "" if load_format(name).has_lidars else said)

    assert result.stderr.startswith(said)
    assert bool(result.stderr) == bool(said)
    assert out.stat().st_size > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [layout_path.name, out.name]
    )
    if name not in (*BINARY, "dxf"):  # it bears a date
        assert call(*given).stdout.encode() == out.read_bytes()


@pytest.mark.parametrize("name", BINARY)
def test_what_is_no_text_needs_a_file(name, layout_path):
    result = call("--layout", layout_path, "--format", name)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert f"--out: got nothing; expected a file: {name} is no text" in result.stderr


@pytest.mark.parametrize("name", BINARY)
def test_an_old_file_survives_a_failure(name, layout_path, tmp_path, monkeypatch):
    out = tmp_path / "old"
    out.write_text("old")

    def fail(*_given):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Path, "replace", fail)
    result = call("--layout", layout_path, "--format", name, "--out", out)

    assert result.exit_code == 2
    assert "No space left on device" in result.stderr
    assert out.read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"old", "layout.json"}


@pytest.mark.parametrize("name", ["csv", "ros"])
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            ["--run", "CPNC-50/east/40"],
            "--run: got 'CPNC-50/east/40'; expected none: {} shows no",
        ),
        (
            ["--release", "2.1.1"],
            "--release: got '2.1.1'; expected none: {} has no such option",
        ),
    ],
)
def test_a_format_says_what_it_does_not_show(name, given, message, layout_path):
    result = call("--layout", layout_path, "--format", name, *given)
    assert str(result.exception).startswith(message.format(name))


@pytest.mark.long
def test_five_hundred_units_and_runs_take_less_than_five_megabytes():
    measured = measure_exports()
    assert {name for name, *_ in measured} == set(FORMAT_NAMES)
    for name, *_, megabytes in measured:
        assert 0.0 < float(megabytes) < 5.0 or name == "cpm-uper", name
