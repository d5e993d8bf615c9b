"""A whole city on a street with three junctions: choice, folder, resume, workers, bad
input.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from html import unescape
from io import BytesIO
from math import exp
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from babel.messages.pofile import read_po
from browser_pages import open_page, start_browser
from city_maps import FEW_RUNS, FEW_RUNS_OPTIONS, write_city
from json_files import read_json, write_json
from once import make_once
from osm_text import OsmText
from partial_pages import blank_png

from experiments.city import answer as city_answer
from experiments.city import pages as city_pages
from experiments.city import run as job
from experiments.city import tasks as city_tasks
from experiments.city.answer import fronts_table, load_front
from experiments.city.command import city_text
from experiments.city.inputs import CitySearch, CityWish, estimated_accidents
from experiments.engine.start import EngineWish, start_engine
from experiments.engine.tasks import Engine, WorkerDiedError, map_tasks
from experiments.language import speaking
from experiments.parts.section import build_picture
from experiments.progress import StageProgress
from experiments.results.folders import changed_files
from experiments.results.numbers import percent
from geometry.errors import InputError
from geometry.maps import importing
from geometry.maps.importing import read_map, survey_junctions
from placement.city.fronts import Options
from placement.layout import load_layout
from placement.question import Question, load_question_values

pytestmark = pytest.mark.long

SEARCH = CitySearch(is_coarse=True, max_units=2, max_junction_s=3600.0)
LEAST_S = 1.0e-6


def run(
    maps,
    out,
    *,
    question=FEW_RUNS,
    search=SEARCH,
    engine=EngineWish(),  # noqa: B008 - frozen
    tell=lambda sentence: None,
    told=None,
    **wish,
):
    """A city's answer: for two units unless another budget is wished for."""
    if not ("budget_units" in wish or "budget_eur" in wish):
        wish = {"budget_units": 2, **wish}
    return job.run_city(
        question,
        maps=[maps] if isinstance(maps, Path) else maps,
        wish=CityWish(**wish),
        search=search,
        engine=engine,
        out=out,
        seed=0,
        command="place-rsus city tiny.osm",
        progress=StageProgress(),
        tell=tell if told is None else told.append,
    )


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """The map, and the folder of a city for two units."""

    def make(folder):
        run(write_city(folder), folder / "city")

    return make_once(tmp_path_factory, "tiny-city", make)


@cache
def read_once(path, content, *reading):
    """A map as it was read before, if its content is still the same."""
    return read_map(path, *reading)


@pytest.fixture(autouse=True)
def quick(monkeypatch, with_blank_pictures):
    """Pictures are blank, and the same map is not read again: for `tiny` all of it is
    done.
    """
    monkeypatch.setattr(job, "to_png", blank_png)
    monkeypatch.setattr(
        importing,
        "read_map",
        lambda path, *reading: read_once(
            path, path.is_file() and path.read_bytes(), *reading
        ),
    )


@pytest.fixture
def no_pages(monkeypatch):
    """Draws nothing, and writes no tables."""
    monkeypatch.setattr(
        job, "write_city", lambda out, result, *args, **settings: result
    )
    monkeypatch.setattr(job.pages, "render_junction_page", lambda *args, **settings: "")


@pytest.fixture
def never(monkeypatch):
    """Fails where anything is solved."""

    def fail(task):
        pytest.fail(f"{task.options.name} is solved")

    monkeypatch.setattr(job, "run_junction", fail)


@pytest.fixture
def city(tiny, tmp_path):
    """A copy of the folder, to be written to."""
    shutil.copytree(tiny / "city", tmp_path / "city")
    return tmp_path / "city"


@pytest.fixture
def again(tiny, city):
    """Asks about the same city once more, with other wishes, into the copy."""
    return partial(run, tiny / "tiny.osm", city)


def fronts_of(folder):
    """Fronts of all junctions in a city's folder."""
    return [load_front(path) for path in sorted(folder.glob("junctions/*/front.json"))]


def test_a_front_whose_layouts_are_lost_is_still_in_the_table(city):
    front = fronts_of(city)[0]
    table = pd.read_parquet(BytesIO(fronts_table([front.without_layouts()])))

    assert len(table) == len(front.points) > 1
    assert set(table.layout) == {""}


def test_the_folder_has_all_of_it_and_nothing_is_done_twice(again, city, never):
    assert not changed_files(city)

    result = again()
    assert result.computed == 0
    assert not changed_files(city)

    written = read_json(city / "city.json")
    assert written["units"] == result.units == 2
    assert written["sentences"][0].startswith("2 sensors at 2 of 3 junctions for ")

    table = pd.read_parquet(city / "fronts.parquet")
    assert set(table.junction) == {one.id for one in result.junctions}
    assert len(table) == sum(len(front.points) for front in fronts_of(city))

    rows = pd.read_csv(city / "junctions.csv")
    assert (rows.runs > 0).all()
    assert (rows.cpu_s > 0.0).all()

    poles = pd.read_csv(city / "poles.csv")
    assert poles.units.sum() == 2
    assert {one.part for one in result.purchases} == {"sensor", "site"}
    assert sum(one.count for one in result.purchases if one.part == "site") == len(
        poles
    )

    page = (city / "report.html").read_text()
    served = [one for one in result.junctions if one.units]
    for one in served:
        assert f'href="{one.folder}/report.html"' in page
        assert one.label in (city / one.folder / "report.html").read_text()

        layout = load_layout(city / one.folder / "layout.json")
        assert len(layout.units) == one.units

        asked = load_question_values(city / one.folder / "question.toml")
        assert asked == {"cases": "CPNC-50", "along_arms": "0", "speeds": "50"}
    idle = next(one for one in result.junctions if not one.units)

    assert not (city / idle.folder / "layout.json").exists()

    import geopandas as gpd

    units = gpd.read_file(city / "city.gpkg", layer="units")

    assert len(units) == 2
    assert units.crs == "EPSG:4326"

    places = gpd.read_file(city / "city.gpkg", layer="junctions")
    assert places.units.sum() == 2

    carrying = gpd.read_file(city / "city.gpkg", layer="poles")
    assert carrying.units.sum() == 2
    assert carrying.crs == units.crs
    assert sorted(carrying.site) == sorted(units.site)
    assert {*carrying.geometry.x.round(9)} == {*units.geometry.x.round(9)}
    assert places.union_all().convex_hull.buffer(0.002).contains(units.union_all())


def test_only_what_is_missing_or_changed_is_computed(
    again, tiny, city, tmp_path, no_pages
):
    first, second, *_ = sorted(
        path.parent for path in city.glob("junctions/*/front.json")
    )
    (first / "front.json").unlink()
    (second / "front.json").write_text("{ half of")

    assert again().computed == 2
    assert again().computed == 0

    changed = tmp_path / "tiny.osm"
    text = (tiny / "tiny.osm").read_text()
    # One house: that at the first junction.
    changed.write_text(text.replace('v="9"', 'v="12"', 1))

    assert run(changed, city).computed == 1


def test_another_citys_folder_and_other_things_are_refused(
    tiny, city, never, tmp_path, no_pages
):
    other = write_city(tmp_path, "tiny.osm", east_m=5_000.0)
    with pytest.raises(
        InputError, match=r"city, the folder of another city \(tiny.osm\); expected"
    ):
        run(other, city)

    (tmp_path / "full").mkdir()
    (tmp_path / "full/notes.txt").write_text("mine")
    with pytest.raises(
        InputError, match=r"full, which holds other things; expected a new folder"
    ):
        run(tiny / "tiny.osm", tmp_path / "full")


def test_a_junction_that_cannot_be_done_is_a_row_with_its_reason(again, tiny, tmp_path):
    sites = tmp_path / "sites.csv"  # at the first junction alone
    sites.write_text("id,lat,lon\nlamp,52.50006,13.40009\n")
    result = run(
        tiny / "tiny.osm", tmp_path / "new", search=replace(SEARCH, sites=str(sites))
    )
    reasons = [one.reason for one in result.junctions]

    assert sum(map(bool, reasons)) == result.not_done == 2
    assert any("sites: got" in reason for reason in reasons)
    assert [one.cause for one in result.junctions if one.reason] == [
        "no site",
        "no site",
    ]

    part = percent(result.stages[0].objective)
    of_all = percent(result.stages[0].objective / 3.0)

    assert (
        f": {of_all} of the simulated collisions at all of them are prevented"
        in result.sentences[0]
    )
    assert result.sentences[0].endswith(" are prevented. 2 junctions are left out.")
    assert any(
        f"At the other junctions, {part} are prevented" in one
        for one in result.sentences
    )

    rows = pd.read_csv(tmp_path / "new/junctions.csv")
    assert rows.reason.notna().sum() == 2

    page = (tmp_path / "new/report.html").read_text()
    first, _, rest = page.partition("<nav")
    why = "There is no pole or other place that could carry another sensor."

    assert (
        f'<p class="lead">{result.sentences[0]}</p>'.replace(" %", "\u00a0%") in first
    )
    assert f"<li>2 junctions: {why}</li>" in first
    assert rest.count(why) == 2
    # More time is another question: what was in time stays in the folder, the rest is
    # told.
    with pytest.raises(
        InputError, match=r"no junction with a front.*; expected more time or memo"
    ):
        again(search=replace(SEARCH, max_junction_s=LEAST_S))


def test_the_headline_says_what_was_left_out_not_driven_and_not_proven(
    again, never, no_pages
):
    result = again()
    assert result.runs == result.possible_runs > 0
    assert city_answer.says("undone", result) == ()

    first, *others = result.junctions
    left = msgspec.structs.replace(
        result,
        junctions=(msgspec.structs.replace(first, reason="x", cause="time"), *others),
        not_done=1,
        runs=1_234,
        possible_runs=5_678,
        stages=(
            msgspec.structs.replace(result.stages[0], bound=0.9, gap=0.1),
            *result.stages[1:],
        ),
    )
    # A bound at two of three junctions of the same weight counts two thirds of all.
    gap = 100.0 * (0.9 - left.stages[0].objective) * 2.0 / 3.0

    assert city_answer.says("undone", left) == (
        "1 junction is left out.",
        "There was no room to simulate 4,444 of 5,678 collisions.",
        "This choice is not proven to be best: a better one could gain at most"
        f" {gap:.1f} points.",
    )


def cross_map(folder, **tags):
    """A map of four streets from a point."""
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    for way in (
        (90.0, 0.0),
        (0.0, 90.0),
        (-90.0, 0.0),
        (0.0, -90.0),
    ):
        osm.road([middle, osm.node(*way)], **tags)
    return osm.write(folder, "cross.osm")


def test_each_foreseen_error_has_its_cause(tmp_path):
    away = cross_map(tmp_path, oneway="yes")  # all lead away: no car drives in
    [task] = tasks_of(away)
    answer = city_tasks.run_junction(task)

    assert answer.record.cause == "no lane"
    assert answer.record.is_final

    [task, *_] = tasks_of(write_city(tmp_path))
    slow = replace(task, wishes=replace(task.wishes, time_limit_s=LEAST_S))
    answer = city_tasks.run_junction(slow)

    assert answer.record.cause == "time"
    assert not answer.record.is_final

    no_arm = replace(task, question=replace(FEW_RUNS, approaches="south-east"))
    assert city_tasks.run_junction(no_arm).record.cause == "no run"


def test_the_page_and_the_terminal_speak_german(again, city, never):
    with speaking("de"):
        result = again()
        text = city_text(result, city)
    pages = [(city / "report.html").read_text()]
    pages += [path.read_text() for path in city.glob("junctions/*/report.html")]

    assert text.startswith("2 Sensoren an 2 von 3 Knotenpunkten für 9")
    assert "Was zu bestellen ist" in pages[0]

    # Scripts look their German words up by the English ones; what they show is in other
    # data.
    words = re.compile(
        r'<script( type="application/json" id="script-words")?>.*?</script>', re.S
    )
    pages = [words.sub("", page) for page in pages]
    english = set()
    for entry in messages():
        if isinstance(entry, str) and "{" not in entry and len(entry.split()) > 2:
            english |= {entry for page in [text, *pages] if entry in unescape(page)}

    assert not english


def messages():
    """English texts that have another German one."""
    found = []
    for path in Path("experiments/languages/de").glob("*.po"):
        with path.open("rb") as file:
            found += [
                one.id for one in read_po(file) if one.id and one.id != one.string
            ]
    return found


@pytest.mark.parametrize(
    ("flows", "n_signals", "per_year"),
    # AASHTO, Highway Safety Manual (2010), table 12-10, at vehicles a day on major and
    # minor
    [
        ((20_000, 20_000, 4_800, 2_800), 2, exp(-10.99) * 20_000**1.07 * 4_800**0.23),
        ((20_000, 18_000, 4_800, 4_800), 0, exp(-8.90) * 20_000**0.82 * 4_800**0.25),
        ((12_000, 10_000, 4_000), 1, exp(-12.13) * 12_000**1.11 * 4_000**0.26),
        ((12_000, 12_000, 4_000), 0, exp(-13.36) * 12_000**1.11 * 4_000**0.41),
    ],
)
def test_the_estimate_of_accidents_is_that_of_the_manual(
    flows, n_signals, per_year, tmp_path
):
    [surveyed] = survey_junctions(read_map(cross_map(tmp_path)))
    assert surveyed.roads == (("residential", 2),) * 4

    roads = tuple(("living_street", flow // 400) for flow in flows)
    found = estimated_accidents(replace(surveyed, roads=roads, n_signals=n_signals))
    assert found == pytest.approx(per_year)


def test_where_no_accidents_are_known_a_wide_crossing_counts_most(
    again, tiny, city, never, tmp_path
):
    equal = again()
    assert "every junction counts the same" in equal.warnings[0]
    assert not equal.has_accidents

    page = unescape((city / "report.html").read_text())
    assert f'<p class="warning">{equal.warnings[0]}</p>' in page

    result = again(budget_units=1, weights_file=Path("proxy"))
    assert result.warnings[0] in unescape((city / "report.html").read_text())

    # All arms have two lanes of 1,000 vehicles: crossing, three arms, and crossing with
    # signals.
    wanted = {
        "n1": exp(-8.90) * 2_000**1.07,
        "n2": exp(-13.36) * 2_000**1.52,
        "n3": exp(-10.99) * 2_000**1.30,
    }
    total = sum(wanted.values())
    assert {one.id: one.weight for one in result.junctions} == pytest.approx(
        {name: value / total for name, value in wanted.items()}
    )

    text = (tiny / "tiny.osm").read_text()
    assert text.count('v="C Lane"') == 2

    street = 'k="highway" v="residential"'
    lane = 'v="C Lane"'
    ways = [
        (
            way.replace(
                street,
                f'{street.replace("residential", "primary")}/><tag k="lanes" v="6"',
            )
            if lane in way
            else way
        )
        for way in text.split("<way")
    ]
    wide = tmp_path / "tiny.osm"
    wide.write_text("<way".join(ways))
    there = job.inputs.load_city([wide], SEARCH.reading, CityWish(budget_units=1))
    values = job.inputs.load_values(there, CityWish(weights_file=Path("proxy")))
    share = dict(
        zip(
            [one.surveyed.junction.id for one in there.junctions],
            values.weight,
            strict=True,
        )
    )

    assert share["n3"] > 0.9 * sum(share.values())
    with pytest.raises(
        InputError, match="weight_column: got 'n'; expected a file of --junction"
    ):
        CityWish(weights_file=Path("proxy"), weight_column="n")


@pytest.mark.parametrize(
    ("given", "are_accidents"),
    [
        ({}, False),
        ({"weights_file": Path("proxy")}, False),
        ({"weights_file": Path("points.csv")}, True),
        ({"weights_file": Path("counts.gpkg"), "weight_column": "aadt"}, False),
        (
            {
                "weights_file": Path("points.csv"),
                "weight_column": "n",
                "counted_years": 5.0,
            },
            True,
        ),
    ],
)
def test_traffic_is_not_called_accidents(given, are_accidents):
    assert CityWish(**given).has_accidents == are_accidents


def test_weights_decide_and_what_is_not_used_is_told(again, never, tmp_path, no_pages):
    table = tmp_path / "accidents.csv"
    table.write_text("lat,lon,count\n52.5,13.4,1\n52.5,13.40741,8\n52.6,13.4,5\n")
    result = again(budget_units=1, weights_file=table)
    weights = sorted(one.weight for one in result.junctions)

    assert weights == pytest.approx([0.0, 1 / 9, 8 / 9])

    served = next(one for one in result.junctions if one.units)
    assert served.weight == pytest.approx(8 / 9)
    assert "C Lane" in served.name
    assert any(
        "1 of 3 places (5 of 14 by weight) are not used: they are more than 50 m" in n
        for n in result.notes
    )

    table.write_text("lat,lon\n10,20\n")
    with pytest.raises(
        InputError, match=r"nearest place is .* m from a junction; expected places"
    ):
        again(weights_file=table)

    table.write_text("junction,cars\nn1,3\nn99,4\n")
    result = again(weights_file=table)
    assert [one.weight for one in result.junctions if one.id == "n1"] == [1.0]

    lost = "accidents.csv: rows of junctions that do not count, such as n99: 1."
    assert lost in result.notes


# Quickly: test_weights_decide_and_what_is_not_used_is_told
def test_accidents_around_each_junction_make_its_front(tiny, tmp_path, no_pages):
    table = tmp_path / "atlas.csv"
    head = "UTYP1;UART;IstFuss;IstRad;IstKrad;IstPKW;ULICHTVERH;XGCSWGS84;YGCSWGS84\n"
    near_all = "4;6;1;0;0;1;0;13,40370;52,5\n3;5;0;1;0;1;2;13,40370;52,5\n"
    table.write_text(head + near_all)
    question = replace(
        FEW_RUNS, weights=f"unfallatlas:{table}", accidents_within_m=2000.0
    )
    out = tmp_path / "scored"
    result = run(tiny / "tiny.osm", out, question=question)

    assert result.computed == 3
    assert run(tiny / "tiny.osm", out, question=question).computed == 0

    # More accidents in the file make other fronts; none near one junction leaves that
    # out.
    only_first = "4;6;1;0;0;1;0;13,4;52,5\n"
    table.write_text(head + near_all + only_first)
    assert run(tiny / "tiny.osm", out, question=question).computed == 3

    near = replace(question, accidents_within_m=100.0)
    reasons = [
        one.reason
        for one in run(tiny / "tiny.osm", tmp_path / "near", question=near).junctions
    ]

    assert sorted(map(bool, reasons)) == [False, False, True]
    assert any(
        "expected a place with accidents within 100 m" in reason for reason in reasons
    )

    [left] = [front for front in fronts_of(tmp_path / "near") if front.reason]
    assert left.cause == "no accident"


def area(path, lon_deg, half_deg=0.0005, **values):
    """A square of GeoJSON around the street, at a longitude."""
    low = lon_deg - half_deg
    high = lon_deg + half_deg
    ring = [
        [low, 52.49],
        [high, 52.49],
        [high, 52.51],
        [low, 52.51],
        [low, 52.49],
    ]
    feature = {
        "type": "Feature",
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "properties": values,
    }
    write_json(path, {"type": "FeatureCollection", "features": [feature]})
    return path


def test_districts_areas_and_years(again, never, tmp_path, no_pages):
    middle = area(
        tmp_path / "middle.geojson", 13.40368, name="middle", min_apr=0.3, weight=3
    )
    heavy = again(areas=middle)
    at = next(one for one in heavy.junctions if "B Lane" in one.name)

    assert at.weight == pytest.approx(3 / 5)
    assert at.apr >= 0.3

    served = again(budget_units=1, districts=middle, min_district_apr=0.3)
    assert [one.units for one in served.junctions if one.district == "middle"] == [1]
    with pytest.raises(
        InputError, match=r"budget_eur: got 10.0; expected at least [\d,]+ EUR, to"
    ):
        again(
            budget_eur=10.0,
            districts=middle,
            min_district_apr=0.3,
        )

    years = again(budget_units=3, units_per_year=1)
    assert sorted(one.year for one in years.junctions if one.units)[-1] == years.units

    few = again(budget_units=3, units_per_year=1, years=2)
    assert few.units == 2


def test_accidents_and_money_are_told_by_the_year(again, never, tmp_path, no_pages):
    table = tmp_path / "accidents.csv"
    table.write_text("junction,count\nn1,10\nn2,20\nn3,30\n")
    heavy = area(tmp_path / "middle.geojson", 13.40368, name="middle", weight=3)
    given = {"weights_file": table, "counted_years": 5.0, "areas": heavy}
    counts = {"n1": 10, "n2": 20, "n3": 30}
    result = again(**given)
    by_hand = sum(
        counts[one.id] / 5.0 * (one.apr - one.apr_before) for one in result.junctions
    )

    assert result.accidents_per_year == pytest.approx(12.0)
    assert " of the accidents at all of them are prevented" in result.sentences[0]
    assert result.prevented_per_year == pytest.approx(by_hand)
    assert result.prevented_in_years is None

    said = (
        f"Of 12.0 accidents a year {by_hand:.1f} would be prevented, if as many happen"
        " as were"
    )
    assert any(one.startswith(said) for one in result.sentences)

    result = again(years=10, **given)
    assert result.prevented_in_years == pytest.approx(10.0 * by_hand)

    each = result.cost_eur / (10.0 * by_hand)
    assert any(
        f"({result.cost_eur / 10.0:,.0f} EUR a year), {each:,.0f} EUR each;" in one
        for one in result.sentences
    )

    # One sensor a year: what is mounted in the second year is there for nine.
    result = again(years=10, units_per_year=1, **given)
    assert sorted(one.year for one in result.junctions if one.units) == [1, 2]

    by_hand = sum(
        counts[one.id] / 5.0 * (one.apr - one.apr_before) * (11 - one.year)
        for one in result.junctions
        if one.units
    )
    assert result.prevented_in_years == pytest.approx(by_hand)


def test_a_budget_below_the_cheapest_unit_buys_nothing_and_says_what_it_would(
    again, never, no_pages
):
    result = again(budget_eur=10.0)
    assert result.units == 0
    assert result.cost_eur == 0.0
    assert result.sentences[0] == "No sensors at 3 junctions for at most 10 EUR."
    assert result.sentences[1].startswith("The cheapest useful choice is 1 sensor at ")

    for nothing in ({"budget_units": 0}, {"budget_eur": 0.0}):
        result = again(**nothing)
        assert result.units == 0
        assert result.stages[0].objective == 0.0
        assert result.stages[0].gap == 0.0
        assert result.sentences[1].startswith(
            "The cheapest useful choice is 1 sensor at "
        )


def test_the_cheapest_useful_choice_is_that_for_the_least_money(tiny):
    city = job.inputs.load_city(
        [tiny / "tiny.osm"], SEARCH.reading, CityWish(budget_units=1)
    )
    options = Options(
        junction=np.array([0, 0, 1, 1, 1]),
        units=np.array([0, 1, 0, 1, 1]),
        cost_eur=np.array([0.0, 8_560.0, 0.0, 4_040.0, 5_000.0]),
        apr=np.array([0.0, 0.9, 0.0, 0.2, 0.3]),
        **{
            name: np.zeros(5)
            for name in ("apr_one_failed", "smallest_margin_s", "mean_margin_s")
        },
    )
    share = np.array([0.5, 0.5])
    first = np.array([0, 2])
    of_what = "of the accidents"
    said = city_answer._cheapest(city, options, [0, 1], share, first, of_what=of_what)

    assert said.startswith("The cheapest useful choice is 1 sensor at ")
    assert said.endswith(
        "for 4,040 EUR: it would prevent 10.0 % of the accidents of the city."
    )


def test_pages_of_junctions_that_stay_as_they_were_are_not_drawn_again(
    again, city, never
):
    def pages():
        return {
            path: path.stat().st_mtime_ns
            for path in city.glob("junctions/*/report.html")
        }

    before = pages()
    assert len(before) == 2

    again()
    assert pages() == before

    again(budget_units=1)
    assert len(pages()) == 1

    again(budget_units=0)
    assert pages() == {}
    assert not changed_files(city)


def test_what_hangs_there_is_kept_and_paid(tiny, tmp_path, no_pages):
    before = read_json(tiny / "city/city.json")
    served = next(one for one in before["junctions"] if one["units"])
    folder = tiny / "city" / served["folder"]
    after = run(
        tiny / "tiny.osm",
        tmp_path / "next",
        budget_units=1,
        keep=(folder / "layout.json",),
        junctions=served["id"],
    )
    [kept] = after.junctions

    assert kept.kept == served["units"]
    assert kept.units == after.units
    assert kept.apr_before == pytest.approx(served["apr"])
    assert after.apr_before == pytest.approx(served["apr"])
    assert after.stages[0].objective >= after.apr_before
    assert (
        sum(one.count for one in after.purchases if one.part == "sensor") == after.units
    )
    assert any("Existing sensors prevent" in sentence for sentence in after.sentences)
    with pytest.raises(
        InputError, match=r"scene: got 'tiny/n\d'; expected a junction that counts"
    ):
        run(
            tiny / "tiny.osm",
            tmp_path / "other",
            keep=(tiny / "city",),
            junctions=next(
                one["id"] for one in before["junctions"] if not one["units"]
            ),
        )


def test_which_junctions_count(again, never, tmp_path, no_pages):
    assert len(again(min_arms=4).junctions) == 2
    assert [one.id for one in again(signals_only=True).junctions] == ["n3"]
    assert [one.id for one in again(junctions="n2").junctions] == ["n2"]

    names = tmp_path / "names.txt"
    names.write_text("n1\nMain Street / C Lane\n")
    assert {one.id for one in again(junctions=str(names)).junctions} == {
        "n1",
        "n3",
    }

    east = area(tmp_path / "east.geojson", 13.407, 0.001)
    assert [one.id for one in again(within=east).junctions] == ["n3"]
    for wish, message in (
        ({"junctions": "n77"}, r"--junctions: got 'n77'; expected one of n\d"),
        (
            {"min_arms": 9},
            r"no junction that counts: Junctions with fewer than 9 arms: 3.",
        ),
        (
            {"within": area(tmp_path / "far.geojson", 20.0)},
            r"--within: .* expected an area with",
        ),
        (
            {"keep": (tmp_path,)},
            r"--keep: .* expected a folder of place-rsus city with layouts",
        ),
        (
            {"years": 2},
            r"years: got 2; expected `units_per_year` or `counted_years` as well",
        ),
        (
            {"counted_years": 2},
            r"counted_years: got 2; expected `weights_file` as well",
        ),
        (
            {"min_district_apr": 0.5},
            r"min_district_apr: got 0.5; expected `districts` as well",
        ),
    ):
        with pytest.raises(InputError, match=message):
            again(**wish)


def test_maps_that_overlap_or_have_no_junction_are_refused(tiny, never, tmp_path):
    second = write_city(tmp_path, "second.osm", east_m=2.0)
    with pytest.raises(
        InputError, match=r"got maps that overlap: both have a junction at "
    ):
        run([tiny / "tiny.osm", second], tmp_path / "city")

    empty = tmp_path / "empty.osm"
    empty.write_text('<osm version="0.6"><node id="1" lat="52.5" lon="13.4"/></osm>')

    with pytest.raises(InputError):
        run(empty, tmp_path / "city")
    assert not (tmp_path / "city").exists()


# ---------- workers


def tasks_of(path):
    """The task of each junction of a map."""
    city = job.inputs.load_city([path], SEARCH.reading, CityWish(budget_units=1))
    grid = job.build_grid(Question(), is_coarse=True)
    task_of = job._task_maker(city, FEW_RUNS, SEARCH, grid, existing={}, seed=0)
    return [task_of(one) for one in city.junctions]


class Dying(Engine):
    """Workers of which each dies, and how often one was asked."""

    times = 0

    def submit(self, function, shared, task):
        self.times += 1
        future = Future()
        future.set_exception(WorkerDiedError("more than 1.5 GiB of memory"))
        return future


def test_a_junction_whose_worker_died_thrice_is_told(tmp_path):
    [task, *_] = tasks_of(write_city(tmp_path))
    workers = Dying()
    [(_, answer)] = map_tasks(
        city_tasks.run_junction, [task], engine=workers, failed=city_tasks.unsolved
    )

    assert workers.times == 3
    assert answer.record.id == task.chosen.junction.id
    assert (
        answer.record.reason
        == "its worker died of more than 1.5 GiB of memory, 3 times: more"
        " --worker-memory, or fewer poses"
    )
    assert answer.record.cause == "memory"
    assert not answer.record.is_final


def without_times(folder):
    """Contents of a city's files, less what says when and how long.

    And hashes of it.
    """
    found = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    timed = ("report.html", "city.json", "city.gpkg")
    for name in (*timed, "SHA256SUMS", "manifest.json"):
        del found[name]
    table = pd.read_csv(BytesIO(found["junctions.csv"]))
    found["junctions.csv"] = table.drop(columns=["cpu_s", "peak_memory_mib"]).to_csv()
    for name in [name for name in found if name.endswith("front.json")]:
        front = json.loads(found[name])
        del front["seconds"], front["peak_memory_mib"]
        found[name] = front
    return found


@pytest.mark.filterwarnings("ignore")  # those of dask
def test_the_answer_is_the_same_to_the_byte_wherever_it_is_found(tiny, tmp_path):
    pytest.importorskip("distributed")
    from dask_cluster import dask_processes

    path = tiny / "tiny.osm"
    run(path, tmp_path / "one")
    expected = without_times(tmp_path / "one")
    run(path, tmp_path / "two", engine=EngineWish(workers=2))

    assert without_times(tmp_path / "two") == expected

    out = tmp_path / "four"
    with dask_processes(tmp_path, n=4) as cluster:
        _, file, _, authority, _, own = cluster.options
        wish = EngineWish(scheduler=str(file), tls_ca=authority, tls_cert=own)

        def kill_two(sentence):
            # Workers are there: two of them die at work, and are started again.
            if sentence.startswith("Workers: 4"):
                for delay_s, index in ((3.0, 0), (6.0, 1)):
                    killer = threading.Timer(delay_s, cluster.kill_a_worker, [index])
                    killer.start()
                    killers.append(killer)

        killers = []
        told = []
        with start_engine(wish, n_tasks=4, tell=told.append) as started:
            while started._client.nthreads() == {} or started.capacity < 4:
                started._looked_s = 0.0
                started.watch()
        run(path, out, engine=wish, tell=kill_two)

        assert len(killers) == 2

        for killer in killers:
            killer.join()
    assert without_times(out) == expected


def start_command(path, out):
    """The same as `run`, on the command line, by two processes."""
    command = ("city", path, "--budget", "2", "--coarse", "--max-units", "2")
    seconds = ("--max-junction-seconds", "3600")
    seconds += ("--time-limit", f"{FEW_RUNS.time_limit_s:g}")
    limits = (*seconds, "--workers", "2", "--out", out)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [
            *(sys.executable, "-m", "experiments.main"),
            *(*command, *limits, *FEW_RUNS_OPTIONS),
        ],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def test_killed_at_ten_moments_it_goes_on_and_answers_the_same(tiny, tmp_path):
    path = tiny / "tiny.osm"
    run(path, tmp_path / "one")
    rng = np.random.default_rng(49)
    n_done = []
    for delay_s in rng.uniform(0.5, 15.0, 10):
        main = start_command(path, tmp_path / "killed")
        with suppress(subprocess.TimeoutExpired):
            main.wait(delay_s)
        main.kill()
        main.wait()
        n_done.append(len([*(tmp_path / "killed").glob("junctions/*/front.json")]))

    assert sorted(n_done) == n_done  # nothing is lost

    run(path, tmp_path / "killed")
    killed = without_times(tmp_path / "killed")
    expected = without_times(tmp_path / "one")

    assert killed.keys() == expected.keys()
    # Pages are not compared: one that the command had drawn before it was killed stays.
    for name in expected:
        if not name.endswith("report.html"):
            assert killed[name] == expected[name], name


@pytest.mark.skipif(not hasattr(os, "fork"), reason="signals and processes as on Linux")
def test_kill_9_loses_at_most_the_junctions_in_work_and_ends_the_workers(
    again, tiny, city, no_pages
):
    import psutil

    kept, *missing = sorted(path.parent for path in city.glob("junctions/*/front.json"))
    before = (kept / "front.json").read_bytes()
    for folder in missing:
        shutil.rmtree(folder)
    main = start_command(tiny / "tiny.osm", city)
    pause = threading.Event()
    children = []
    for _ in range(6000):
        if (
            any((folder / "front.json").exists() for folder in missing)
            or main.poll() is not None
        ):
            children = psutil.Process(main.pid).children(recursive=True)
            main.kill()
            break
        pause.wait(0.02)

    assert main.wait() == -signal.SIGKILL
    assert children  # a worker had been there

    _, alive = psutil.wait_procs(children, timeout=60)
    assert not alive

    done = {folder: (folder / "front.json").exists() for folder in missing}
    written = {
        folder: (folder / "front.json").read_bytes()
        for folder in missing
        if done[folder]
    }

    assert written
    assert (kept / "front.json").read_bytes() == before

    again = again()
    assert again.computed == list(done.values()).count(False)
    assert all(
        (folder / "front.json").read_bytes() == text for folder, text in written.items()
    )
    for mine, theirs in zip(fronts_of(tiny / "city"), fronts_of(city), strict=True):
        assert mine.key == theirs.key
        assert mine.front == theirs.front
        assert mine.layouts == theirs.layouts


def test_numbers_of_the_figure_are_those_of_the_result(again, city, never, no_pages):
    from experiments.city.pages import plot_city_front

    result = again(budget_eur=20_000.0)
    axes = plot_city_front(result)
    drawn = {line.get_gid(): line.get_xydata() for line in axes.lines if line.get_gid()}

    np.testing.assert_allclose(
        drawn["chosen"], [[result.cost_eur, 100 * result.stages[0].objective]]
    )
    assert len(drawn["steps"]) == len(result.front) + 1


def stops_of(city):
    """Stops of the slider, as the city's page has them."""
    page = (city / "report.html").read_text()
    return json.loads(page.split('id="sum-data">')[1].split("</script>")[0])


def test_the_slider_has_each_step_of_the_front_and_the_choice(again, city, never):
    for wish in ({"budget_units": 2}, {"budget_eur": 9_500.0}, {"budget_units": 0}):
        result = again(**wish)
        shown = stops_of(city)
        states = []
        got = {}
        for stop in shown["stops"]:
            got = got | {int(index): n for index, n in stop["sets"].items()}
            states.append({index: n for index, n in got.items() if n})
        chosen = {
            index: one.units for index, one in enumerate(result.junctions) if one.units
        }
        [at] = [
            number for number, stop in enumerate(shown["stops"]) if stop["is_chosen"]
        ]

        assert states[at] == chosen
        assert f" prevent {percent(result.stages[0].objective)} of the" in shown[
            "stops"
        ][at]["says"].replace("prevents", "prevent")
        assert sum(states[-1].values()) == 3

        says = [stop["says"] for stop in shown["stops"]]
        steps = [percent(step.apr) for step in result.front]
        assert all(any(share in one for one in says) for share in steps)

        if "budget_eur" in wish:
            costs = [f"{step.taken:,.0f} EUR: " for step in result.front]
            assert all(any(one.startswith(cost) for one in says) for cost in costs)
        assert {shown["names"][key] for key in shown["spots"]} == {
            one.label for one in result.junctions
        }


def test_a_step_that_takes_a_sensor_away_says_why(again, never, no_pages):
    result = again(budget_eur=20_000.0)
    first, *_ = result.front
    fewer = [
        msgspec.structs.replace(first, units=2),
        msgspec.structs.replace(first, units=1, taken=first.taken + 1.0),
    ]
    streets = {
        "size_m": [1, 1],
        "streets": "",
        "junctions": [],
        "names": [],
    }
    sums = {
        "stops": [],
        "shown": {},
        "chosen": 0,
        "streets": streets,
    }

    def page_of(steps):
        draw = partial(build_picture, city_pages.plot_city_front(result))
        return city_pages._templates().front(result, draw, steps, 1, sums)

    why = "fewer sensors on more expensive poles prevent more there."

    assert why not in page_of(fewer[:1])

    told = page_of(fewer)
    assert f"Step 2 removes a sensor from a junction: {why}" in told
    assert "1 (before: 2)" in told


# Quickly: test_the_slider_has_each_step_of_the_front_and_the_choice
@pytest.mark.system
def test_the_page_runs_by_itself_and_its_slider_says_who_gets_what(tiny):
    page_of = tiny / "city/report.html"
    with start_browser() as browser:
        check_who_gets_what(browser, page_of.as_uri())
        with open_page(browser, page_of.as_uri(), java_script_enabled=False) as page:
            assert not page.is_visible("#sums")
            assert page.is_visible(
                "text=The first 3 steps; 2 of them fit into the budget"
            )


def check_who_gets_what(browser, address):
    with open_page(browser, address) as page:
        assert page.is_visible("#sum-chosen")
        assert page.locator("#sum-map .mark:visible").count() == 2
        slider = page.locator("#sum")
        slider.press("End")
        assert page.inner_text("#sum-says").startswith(
            "3 sensors (junctions: 3) prevent 100.0 %"
        )
        assert page.locator("#sum-gets li").count() == 3
        assert page.locator("#sum-map .mark:visible").count() == 3
        assert not page.is_visible("#sum-chosen")
        slider.press("Home")
        assert page.locator("#sum-gets li").count() == 0
        page.click("#junctions ~ * a[href^='junctions/']")
        page.wait_for_url("**/junctions/*/report.html")
        assert page.is_visible("text=Look closer")
