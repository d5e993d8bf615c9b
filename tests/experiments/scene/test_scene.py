"""``place-rsus scene`` on small hand-made maps, and ``--scene`` with what it makes of
them.
"""

import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from browser_pages import open_page
from city_maps import write_city
from command_results import refusal
from json_files import read_json, write_json
from numpy.testing import assert_allclose
from opendrive_text import crossing, document
from osm_text import LAT_DEG, LON_DEG, OsmText
from osm_text import crossing as crossing_streets
from PIL import Image

from experiments.figures.axes import to_png
from experiments.scene.command import scene_text
from experiments.scene.pictures import plot_scene_plan
from experiments.scene.run import SceneResult
from geometry.errors import InputError
from geometry.junction import build_junction
from geometry.notes import assumed_sites
from geometry.scene_files import load_scene_folder
from geometry.study_scene import load_study_scene
from placement import candidates as poses
from placement.candidates import load_candidate_grid

FOUR = [
    (1.0, 0.0),
    (0.0, 1.0),
    (-1.0, 0.0),
    (0.0, -1.0),
]


class Result(NamedTuple):
    """Exit code and texts of a command."""

    code: int
    out: str
    err: str


@pytest.fixture
def command(run, monkeypatch):
    """Runs a command without spending time on pictures of scenes."""
    monkeypatch.setattr("experiments.scene.run.plot_scene_plan", lambda scene: None)
    monkeypatch.setattr("experiments.scene.run.to_png", lambda figure: b"picture")
    return lambda *arguments: Result(*run(*arguments))


@pytest.fixture
def scene_command(command):
    """Runs ``place-rsus scene``."""
    return lambda first, *others: command(f"scene {first}", *others, "--quiet")


@pytest.fixture
def scene_answer(ask, command):
    """What ``place-rsus scene`` answers as JSON."""
    return lambda first, *others: ask(f"scene {first}", *others)


@pytest.fixture
def city(tmp_path):
    """Two streets with lamps, a house, and a second junction."""
    osm = OsmText()
    crossing_streets(
        osm,
        bearings=FOUR,
        highway="residential",
        lanes="2",
    )
    osm.node(9.0, 9.0, highway="street_lamp")
    osm.node(-9.0, -9.0, highway="street_lamp")
    corners = [
        (14.0, 14.0),
        (30.0, 14.0),
        (30.0, 30.0),
        (14.0, 30.0),
    ]
    osm.way([*corners, corners[0]], {"building": "yes", "height": "12"})
    return osm.write(tmp_path, "city.osm")


@pytest.fixture
def roads(tmp_path):
    """A crossing in OpenDRIVE."""
    path = tmp_path / "roads.xodr"
    path.write_text(document(crossing()))
    return path


@pytest.mark.long
def test_a_map_becomes_a_scene_that_says_what_was_understood(
    scene_command, scene_answer, city, tmp_path
):
    """As a folder, or as an archive; showing either tells the same."""
    out = tmp_path / "scene"
    summary = scene_answer("import", city, "-o", out)
    (junction,) = summary["junctions"]

    assert junction["arms"] == 4
    assert junction["lanes"] == 8
    assert junction["name"] == "Street 0 / Street 1 / Street 2 / Street 3"
    assert summary["buildings"] == 1
    assert summary["sites"] == 2
    assert summary["crs"] == "EPSG:4326"
    assert sorted(path.name for path in out.iterdir()) == [
        "plan.png",
        "scene.toml",
        "things.glb",
    ]

    scene = load_scene_folder(out)
    triangles = scene.triangles[scene.triangle_instance == 1]
    house = scene.vertices_m[triangles]

    assert scene.instances[1].class_name == "building"
    assert house[..., 2].max() == pytest.approx(12.0, abs=1e-3)
    assert house[..., :2].min(axis=(0, 1)) == pytest.approx([14.0, 14.0], abs=1.0)

    again = scene_answer("show", out)
    (shown,) = again["junctions"]

    assert shown["arms"] == 4
    assert shown["x_m"] == pytest.approx(junction["x_m"])
    assert shown["y_m"] == pytest.approx(junction["y_m"])
    assert again["skipped"] == summary["skipped"]

    archive = tmp_path / "scene.zip"
    assert scene_command("import", city, "-o", archive).code == 0
    assert load_scene_folder(archive).instances == scene.instances


@pytest.mark.long
def test_a_map_is_listed_and_one_of_its_junctions_taken_by_point_or_name(
    scene_command, scene_answer, tmp_path
):
    """By default the one with most arms; a word must fit only one of them."""
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    far = osm.node(300.0, 0.0)

    for start, (east, north), name in (
        (middle, (-100.0, 0.0), "West Road"),
        (middle, (0.0, 100.0), "Church Lane"),
        (far, (400.0, 0.0), "East Road"),
        (far, (300.0, 100.0), "Mill Lane"),
        (far, (300.0, -100.0), "Mill Lane"),
    ):
        osm.road([start, (east, north)], name=name, highway="residential")

    osm.road([middle, far], name="High Street", highway="residential")
    path = osm.write(tmp_path)
    listed = scene_answer("show", path)

    assert [one["arms"] for one in listed["junctions"]] == [4, 3]

    text = scene_command("show", path).out
    assert max(map(len, text.splitlines())) <= 80
    assert "Church Lane" in text

    small = listed["junctions"][1]
    at = f"{small['x_m']:.6f},{small['y_m']:.6f}"

    for choice in (
        ["--at", at],
        ["--junction", small["id"]],
        ["--junction", "church"],
    ):
        out = tmp_path / "out"
        summary = scene_answer("import", path, *choice, "-o", out)
        assert summary["junctions"][0]["id"] == small["id"]

    summary = scene_answer("import", path, "-o", tmp_path / "out")

    assert summary["junctions"][0]["id"] == listed["junctions"][0]["id"]
    assert any("other junctions" in entry["what"] for entry in summary["skipped"])

    for wrong, message in (
        (["--junction", "lane"], "--junction: got 'lane'; expected one of"),
        (["--junction", "nowhere"], "--junction: got 'nowhere'; expected one of"),
        (["--at", "1,1"], "--at: got 1,1; expected a point within 100 m of a junction"),
        (["--at", "1"], "--at: got '1'; expected two numbers: X,Y"),
        (["--at", at, "--junction", "x"], "--at: got it beside --junction"),
    ):
        result = scene_command("import", path, *wrong, "-o", tmp_path / "x")
        assert result.code == 2
        assert message in result.err
        assert not (tmp_path / "x").exists()


@pytest.mark.long
def test_sites_are_poles_kerbs_or_a_list(scene_command, scene_answer, city, tmp_path):
    """A list has degrees, and says what each pole may carry and costs."""

    def sites(*options):
        return scene_answer("import", city, *options, "-o", tmp_path / "s")["site_list"]

    assert {site["kind"] for site in sites()} == {"lamp post"}

    kerbs = sites("--sites", "kerb:20")
    assert len(kerbs) > 8
    assert {site["kind"] for site in kerbs} == {"kerb"}

    nearest = min(np.hypot(site["x_m"], site["y_m"]) for site in kerbs)
    assert 3.0 < nearest < 12.0

    lamp = sites()[0]
    scene = load_scene_folder(tmp_path / "s")
    from geometry.frames import transform

    lon, lat = transform([lamp["x_m"], lamp["y_m"]], scene.crs, "EPSG:4326")
    listed = tmp_path / "poles.csv"
    listed.write_text(
        "id;lat;lon;min_height_m;max_height_m;cost_eur;capacity;forbidden\n"
        f"pole 1;{lat:.8f};{lon:.8f};5;6;900;3;no\n"
        f"pole 2;{lat + 0.0001:.8f};{lon:.8f};5;6;900;1;yes\n"
        f"far away;{lat + 0.1:.8f};{lon:.8f};5;6;900;1;no\n"
    )
    found = sites("--sites", listed)

    assert [site["id"] for site in found] == ["pole-1", "pole-2"]
    assert found[0]["height_range_m"] == [5.0, 6.0]
    assert found[0]["capacity_units"] == 3
    assert found[1]["use"] == "forbidden"
    assert found[0]["x_m"] == pytest.approx(lamp["x_m"], abs=0.05)

    for wrong, message in (
        ("kerb:x", "--sites: got 'kerb:x'; expected kerb:SPACING in metres"),
        ("somewhere", "--sites: got 'somewhere'; expected auto, map, kerb:SPACING"),
        ("gone.csv", "gone.csv: got No such file"),
    ):
        result = scene_command(
            "import",
            city,
            "--sites",
            wrong,
            "-o",
            tmp_path / "x",
        )
        assert result.code == 2
        assert message in result.err


@pytest.mark.long
def test_buildings_come_from_another_file(scene_command, scene_answer, roads, tmp_path):
    """A mesh does not say its unit, nor which way is up."""
    import trimesh

    box = trimesh.creation.box([10.0, 10.0, 8.0])
    box.apply_translation([25.0, 25.0, 4.0])
    (tmp_path / "house.stl").write_bytes(box.export(file_type="stl"))
    files = [roads, tmp_path / "house.stl"]
    out = tmp_path / "scene"
    refused = scene_command("import", *files, "-o", out)

    assert refused.code == 2
    assert "--unit" in refused.err

    result = scene_command(
        "import",
        *files,
        "--unit",
        "m",
        "--up",
        "z",
        "-o",
        str(out),
        "--json",
        "--quiet",
    )
    summary = json.loads(result.out)

    assert summary["buildings"] == 1
    assert any(entry["what"] == "poles of the map" for entry in summary["skipped"])

    scene = load_scene_folder(out)
    index = [thing.class_name for thing in scene.instances].index("building")
    triangles = scene.triangles[scene.triangle_instance == index]
    corners = scene.vertices_m[triangles]

    assert corners.min(axis=(0, 1)) == pytest.approx([20.0, 20.0, 0.0], abs=1e-4)

    checked = scene_command("check", out)
    assert checked.code == 0
    assert "crosswalks: none" in checked.out


@pytest.mark.long
def test_what_is_wrong_with_a_scene_is_found(scene_command, tmp_path):
    """A pole is moved into a building by hand."""
    out = tmp_path / "scene"
    assert scene_command("import town05 -o", out).code == 0
    assert "nothing found" in scene_command("check", out).out
    assert scene_command("check").code == 0

    text = (out / "scene.toml").read_text()
    inside = load_study_scene()
    house = next(thing for thing in inside.instances if thing.class_name == "building")
    index = inside.instances.index(house)
    triangles = inside.triangles[inside.triangle_instance == index]
    corners = inside.vertices_m[np.unique(triangles)]
    x, y = corners[:, :2].mean(axis=0)
    sites = text.index("[[sites]]")
    first = text.index("position_m = [", sites)
    end = text.index("]", first)
    moved = f"position_m = [{x:.2f}, {y:.2f}, 0.0"
    (out / "scene.toml").write_text(text[:first] + moved + text[end:])
    result = scene_command("check", out, "--json")

    assert result.code == 1

    summary = json.loads(result.out)
    assert not summary["is_sound"]

    (finding,) = summary["findings"]
    assert finding["level"] == "error"
    assert f"inside building {house.id}" in finding["why"]


def test_bad_maps_are_one_line(scene_command, roads, city, tmp_path):
    """And nothing is written."""
    (tmp_path / "a.txt").write_text("hello")
    for files, message in (
        (["a.txt"], "got another kind of file; expected .xodr"),
        (["gone.osm"], "gone.osm: got no such file; expected a map file"),
        ([""], "got a folder; expected a map file"),
        ([], "FILE: got nothing; expected a map"),
        ([roads, city], "expected roads in one of the files"),
    ):
        paths = [tmp_path / file for file in files]
        result = scene_command("import", *paths, "-o", tmp_path / "x")

        assert message in refusal(result)
        assert not (tmp_path / "x").exists()


def test_other_peoples_folders_stay(scene_command, city, tmp_path):
    """Only scenes are overwritten."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("dear")
    (tmp_path / "file").write_text("x")

    for out, message in (
        ("mine", "which holds other things; expected a new folder, or a scene's"),
        ("file", "a file; expected a folder, or a .zip file"),
    ):
        result = scene_command("import", city, "-o", str(tmp_path / out))
        assert result.code == 2
        assert message in result.err

    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["letter.txt"]


@pytest.mark.long
@pytest.mark.usefixtures("with_blank_pictures")
def test_a_placement_on_an_imported_scene_goes_through_to_the_report(
    command, city, tmp_path, monkeypatch
):
    """The study's layout is nowhere mentioned: it belongs to another junction."""
    out = tmp_path / "scene"
    for keeps in ("right", "left"):
        asked = ("scene import", city, "--driving-side", keeps, "-o", out, "--quiet")
        imported = command(*asked)

        assert imported.code == 0
        assert f"traffic keeps {keeps}" in " ".join(imported.out.split())

    grid = replace(
        load_candidate_grid(),
        heights_m=np.array([6.0]),
        yaw_step_deg=45.0,
        pitches_deg=np.array([-20.0]),
    )
    monkeypatch.setattr(poses, "load_candidate_grid", lambda **_: grid)
    results = tmp_path / "results"
    question = ["--cases CPNA-25,CBNA,CPTAfs-50 --speeds 20,40 --approaches north"]
    question += ["--along-arms", "0"]
    result = command(
        "--scene",
        out,
        "--budget 1",
        *question,
        "--json --quiet --out",
        results,
    )

    assert result.code == 0, result.err

    summary = json.loads(result.out)
    assert summary["baseline"] is None
    assert summary["apr"] > 0.0

    page = (results / "report.html").read_text()
    assert "carlancap" not in page
    assert read_json(results / "layout.json")["scene"].startswith("city/")

    table = (results / "layout.csv").read_text()
    (row,) = csv.DictReader(io.StringIO(table))
    (unit,) = read_json(results / "layout.geojson")["features"]
    longitude_deg = unit["geometry"]["coordinates"][0]

    assert float(row["map_x"]) == pytest.approx(longitude_deg, abs=1e-9)
    assert row["map_crs"] == "EPSG:4326"

    layout = str(results / "layout.json")
    elsewhere = command("evaluate --layout", layout, *question, "--quiet")

    assert elsewhere.code == 2
    assert "expected one of town05, the scene in use" in elsewhere.err

    here = command(
        "export --layout",
        layout,
        "--scene",
        out,
        "--format csv",
    )
    assert here.out == table


def test_a_scene_of_no_known_place_has_no_geojson(command, roads, tmp_path):
    """Other formats need no place on Earth."""
    out = tmp_path / "scene"
    assert command("scene import", roads, "-o", out, "--quiet").code == 0

    layout = {
        "schema": "place-rsus/layout/1",
        "name": "mine",
        "layout": [
            {
                "id": "a",
                "x_m": 9.0,
                "y_m": 9.0,
                "z_m": 6.0,
                "yaw_deg": 0.0,
                "pitch_deg": -20.0,
                "camera": "carla-ncap-rgb",
            }
        ],
    }
    path = tmp_path / "mine.json"
    write_json(path, layout)
    given = ["export --layout", path, "--scene", out, "--format"]
    result = command(*given, "geojson")

    assert result.code == 2
    assert "a scene without crs" in result.err
    assert command(*given, "csv").code == 0


@pytest.mark.long
def test_a_case_that_no_arm_carries_is_told_first_and_strict_makes_it_an_error(
    command, tmp_path
):
    osm = OsmText()
    crossing_streets(osm, bearings=[FOUR[0], FOUR[2], FOUR[3]], highway="residential")
    osm.node(9.0, -9.0, highway="street_lamp")
    out = tmp_path / "scene"
    path = str(osm.write(tmp_path))

    assert command("scene import", path, "-o", out, "--quiet").code == 0

    lamp = {
        "id": "a",
        "x_m": 9.0,
        "y_m": -9.0,
        "z_m": 6.0,
        "yaw_deg": 90.0,
        "pitch_deg": -30.0,
    }
    layout = tmp_path / "mine.json"
    write_json(layout, {"layout": [lamp | {"camera": "carla-ncap-rgb"}]})
    given = ["evaluate --layout", layout, "--scene", out, "--quiet --json"]
    # Where a street ends in another one, nobody can cross it beyond the junction: some
    # cases remain, and those that do not are told.
    few = "--approaches east --cases"
    summary = json.loads(command(*given, few, "study").out)
    refused = {entry["case"] for entry in summary["not_driven"]} - set(summary["cases"])

    assert summary["cases"]
    assert refused

    one = sorted(refused)[0]
    assert summary["possible_runs"] >= summary["runs"]
    assert one in " ".join(summary["driven"])

    result = command(*given, few, one)

    assert result.code == 2, result.err
    assert "which no approach carries" in result.err

    both = f"{summary['cases'][0]},{one}"
    told = json.loads(command(*given, few, both).out)

    assert told["cases"] == summary["cases"][:1]
    assert told["driven"][0].endswith(f"Not simulated: {one} anywhere.")


@pytest.mark.long
def test_the_plan_shows_something():
    scene = load_study_scene()
    figure = plot_scene_plan(scene)
    png = to_png(figure)
    image = Image.open(io.BytesIO(png))
    picture = np.asarray(image.convert("L"))

    assert picture.std() > 20.0


@pytest.mark.long
def test_a_junction_of_a_map_is_imported_once_and_told(command, tmp_path, monkeypatch):
    from experiments.cli import first_answer
    from experiments.jobs import placement, search

    asked = []

    def stop(question, **_):
        asked.append(question)
        raise InputError("here", "the question", "nothing more")

    monkeypatch.setattr(search, "search", lambda *given, **more: None)
    monkeypatch.setattr(first_answer, "first_answer", lambda found: [])
    monkeypatch.setattr(placement, "run_placement", stop)
    monkeypatch.setenv("PLACE_RSUS_CACHE", str(tmp_path / "cache"))
    osm = OsmText()
    crossing_streets(
        osm,
        bearings=[
            (1.0, 0.0),
            (0.0, 1.0),
            (-1.0, 0.0),
        ],
        lanes="2",
    )
    city = str(osm.write(tmp_path))

    for _ in range(2):
        result = command(
            "--scene",
            city,
            "--junction",
            "Street 2 / Street 0",
            "--budget 2",
        )
        assert result.code == 2
        assert "Imported Street 0 / Street 1 / Street 2: 3 arms, 24 sites" in result.err

    (imported,) = (tmp_path / "cache/scenes").iterdir()
    junction = build_junction(load_scene_folder(imported))

    assert {one.scene for one in asked} == {str(imported)}
    assert len(junction.arms) == 3

    options = ["--sites kerb:30 --driving-side left --at", f"{LON_DEG},{LAT_DEG}"]
    assert command("--scene", city, *options, "--budget 2 --quiet").code == 2

    other = load_scene_folder(Path(asked[-1].scene))
    assumed = set(assumed_sites(other.notes))

    assert other.keeps_left
    assert len(other.sites) < 24
    assert assumed == {site.id for site in other.sites}

    for wrong in (
        [],
        ["--scene", str(tmp_path)],
        ["--scene", asked[0].scene],
    ):
        result = command(
            *wrong,
            "--junction",
            "Street 0",
            "--budget 2 --quiet",
        )
        assert result.code == 2
        assert "expected --scene FILE, a map with roads" in result.err


def test_lists_that_are_long_are_cut(monkeypatch):
    """After 20 entries, and lines after 100 characters."""
    summary = {
        "name": "x" * 100,
        "junctions": [
            {
                "id": f"j{i}",
                "name": "n" * 50,
                "x_m": 1.0,
                "y_m": 2.0,
                "arms": 3,
                "lanes": 6,
            }
            for i in range(30)
        ],
        "buildings": 1,
        "things": 2,
        "sites": 0,
        "crosswalks": 0,
        "keeps_left": True,
        "skipped": [{"what": "w" * 70, "why": "y" * 30}] * 30,
        "crs": None,
    }
    text = scene_text(msgspec.convert(summary, SceneResult))

    assert text.count("and 10 more: --json") == 2
    assert max(map(len, text.splitlines())) <= 100


@pytest.fixture
def chooser(scene_command, tmp_path):
    """The page on which a junction of a street with three is chosen."""
    path = write_city(tmp_path)
    result = scene_command(
        "show",
        path,
        "--staggered 40 --out",
        tmp_path / "out",
    )
    assert result.code == 0
    return tmp_path / "out/junctions.html"


def test_the_junctions_of_a_map_stand_on_a_page_with_streets_and_names(chooser):
    page = chooser.read_text()
    assert re.findall(r'data-id="(.*?)"', page) == ["n3", "n1", "n2"]

    for street in ("Main Street", "A Lane", "B Lane", "C Lane"):
        assert re.search(rf"<text [^>]*>{street}</text>", page)

    circles = re.findall(r'<circle cx="(.*?)" cy="(.*?)"', page)
    third, first, second = np.array(circles, dtype=float)

    # Junctions are drawn 250 m and 500 m east of the first, the last 10 m north: up on
    # the page.
    assert_allclose(second - first, [250.0, 0.0], atol=6.0)
    assert_allclose(third - first, [500.0, -10.0], atol=6.0)
    assert "--staggered 40 --junction" in page


def view_box(page):
    """What of the map a page shows: left, top, width, height."""
    words = page.get_attribute(".street-map", "viewBox").split()
    return [float(word) for word in words]


# Quickly: what the map's page is made of, above
@pytest.mark.long
@pytest.mark.system
def test_a_junction_is_chosen_on_the_map_or_in_the_list(browser, chooser):
    with open_page(browser, chooser.as_uri()) as page:
        page.locator(".street-map circle").nth(1).click()
        assert page.inner_text("#chosen-name") == "A Lane / Main Street"
        assert page.inner_text("#command").startswith("place-rsus scene import ")
        assert "--junction n1 -o scene\n" in page.inner_text("#command")

        page.fill(".map-find", "lane b")
        assert page.inner_text(".map-count") == "1 / 3"

        page.locator("li button:visible").press("Enter")
        assert "--junction n2 " in page.inner_text("#command")

        box = view_box(page)
        circle = page.locator(".street-map circle").nth(2)
        x = float(circle.get_attribute("cx"))
        y = float(circle.get_attribute("cy"))

        assert box[0] + 0.5 * box[2] == pytest.approx(x)
        assert box[1] + 0.5 * box[3] == pytest.approx(y)

        page.click(".map-nearer")
        nearer = view_box(page)

        assert nearer[2] == pytest.approx(0.6 * box[2])
        assert nearer[0] + 0.5 * nearer[2] == pytest.approx(x)

        middle = page.locator(".street-map").bounding_box()
        at = (middle["x"] + 100.0, middle["y"] + 100.0)
        page.mouse.move(*at)
        page.mouse.wheel(0, 200)
        page.wait_for_function(
            f"document.querySelector('svg').viewBox.baseVal.width > {nearer[2] + 1.0}"
        )
        page.click(".map-all")
        page.mouse.move(*at)
        page.mouse.down()
        page.mouse.move(at[0] + 60.0, at[1])
        page.mouse.up()
        moved = view_box(page)

        assert moved[0] < 0.0
        assert moved[1] == pytest.approx(0.0, abs=1e-6)
