"""Weights by registers of accidents: the atlas of Germany, and STATS19."""

import csv
import io
import math
from pathlib import Path
from types import SimpleNamespace

import pytest
from refusals import refused_with

from geometry.errors import InputError
from scenarios.accidents import AccidentWeights, load_accident_rules, read_accidents
from scenarios.cases import load_cases
from scenarios.weights import check_weights, needs_place, weigh

HERE = (52.5200, 13.4050)
METRES_PER_DEGREE = 6_371_008.8 * math.pi / 180.0

ATLAS = """
    OID_ UIDENTSTLAE ULAND UREGBEZ UKREIS UGEMEINDE UJAHR UMONAT USTUNDE UWOCHENTAG
    UKATEGORIE UART UTYP1 ULICHTVERH IstStrassenzustand IstRad IstPKW IstFuss IstKrad
    IstGkfz IstSonstige LINREFX LINREFY XGCSWGS84 YGCSWGS84 PLST
"""
CRASH = {"UJAHR": "2023", "UART": "5", "UTYP1": "3", "IstPKW": "1"}


def atlas_row(*, north_m=0.0, **cells):
    """An accident as the atlas has it, so far north of here."""
    latitude = HERE[0] + north_m / METRES_PER_DEGREE
    place = {"YGCSWGS84": f"{latitude:.9f}", "XGCSWGS84": f"{HERE[1]:.9f}"}
    row = dict.fromkeys(ATLAS.split(), "0") | CRASH | place
    row = {name: text.replace(".", ",") for name, text in row.items()}
    return row | {name: str(value) for name, value in cells.items()}


def on_foot(**cells):
    """An accident with somebody who crosses on foot."""
    return atlas_row(IstFuss=1, UTYP1=4, **cells)


def table(rows, separator=","):
    """A file of rows as text."""
    text = io.StringIO()
    writer = csv.DictWriter(
        text,
        list(rows[0]),
        delimiter=separator,
        lineterminator="\r\n",
    )
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def run(case, weather="day"):
    """What weights look at of a run."""
    return SimpleNamespace(
        id=f"{case}/north/30/{weather}",
        case=SimpleNamespace(name=case),
        approach="north",
        position="0",
        weather=weather,
    )


@pytest.fixture
def atlas(tmp_path):
    """A function that writes a file of the atlas."""

    def write(rows, encoding="utf-8-sig"):
        path = tmp_path / "Unfallorte2023_LinRef.csv"
        path.write_bytes(table(rows, ";").encode(encoding))
        return path

    return write


DRIVEN = (run("CPNA-25"), run("CPNCO-50"), run("CBNA"), run("CBLA"), run("CMCscp-far"))


def weights_of(path, runs=DRIVEN, **options):
    """Weights of runs by the accidents of a file of the atlas, near here."""
    return weigh(runs, f"unfallatlas:{path}", near=HERE, **options)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_accidents_of_a_type_are_shared_by_its_cases_that_are_driven(
    atlas, encoding, caplog
):
    rows = [
        on_foot(),  # crosses: CPNA, CPNCO
        on_foot(north_m=400.0, PLST="M\xfchlenstra\xdfe"),
        atlas_row(IstRad=1, UTYP1=3),  # crosses: CBNA
        atlas_row(IstRad=1, UTYP1=6),  # along: CBLA
        atlas_row(IstRad=1, UTYP1=6, UART=4),  # oncoming: no case
        atlas_row(IstKrad=1, UTYP1=3),  # CMCscp
        atlas_row(IstRad=1, UTYP1=2),  # turns: not driven
        atlas_row(IstRad=1, IstPKW=0),
        atlas_row(IstRad=1, IstFuss=1),
        atlas_row(IstFuss=1, UTYP1=1),
        on_foot(north_m=501.0),
        on_foot(XGCSWGS84="", YGCSWGS84=""),
    ]
    path = atlas(rows, encoding)

    assert weights_of(path) == pytest.approx([0.2] * 5)
    assert caplog.messages == [
        "weights: 5 of 10 accidents of Unfallorte2023_LinRef.csv within 500 m count;"
        " not used: 1 driving accident (UTYP1 1), 1 of which no case is driven"
        " (bicycle, VUT turns), 1 of which no case is driven (bicycle, oncoming), 1"
        " with several kinds of road users, 1 without a car"
    ]

    near_only = weights_of(path, within_m=100.0)
    assert near_only == pytest.approx([0.125, 0.125, 0.25, 0.25, 0.25])


def test_day_and_night_weigh_what_happened_in_their_light(atlas):
    rows = [
        on_foot(),
        on_foot(ULICHTVERH=2),
        on_foot(ULICHTVERH=2),
        on_foot(ULICHTVERH=1),  # twilight: half each
    ]
    path = atlas(rows)
    both = (run("CPNA-25"), run("CPNA-25", "night"), run("CPNA-25", "rain"))

    assert weights_of(path, both) == pytest.approx([1.5 / 4.0, 2.5 / 4.0, 0.0])
    # Where one of them is driven alone, light does not matter.
    assert weights_of(path, both[1:]) == pytest.approx([1.0, 0.0])
    assert weights_of(path, both[2:]) == pytest.approx([1.0])


def test_older_files_call_the_light_otherwise(atlas):
    row = on_foot(ULICHTVERH=2)
    row["LICHT"] = row.pop("ULICHTVERH")
    night = (run("CPNA-25"), run("CPNA-25", "night"))

    assert weights_of(atlas([row]), night) == pytest.approx([0.0, 1.0])


WHOLE = table([on_foot()], ";")
HEAD = WHOLE.partition("\n")[0]
NOWHERE = table(
    [atlas_row(XGCSWGS84="0", YGCSWGS84="0"), atlas_row(YGCSWGS84="5820000")], ";"
)
COLUMNS = (
    "a.csv: got no column utyp1; expected columns utyp1, istfuss, istrad, istkrad,"
    " istpkw, ulichtverh, xgcswgs84, ygcswgs84"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (WHOLE.replace("UTYP1", "TYP"), COLUMNS),
        ("", COLUMNS),
        (b"\x00\xff" * 99, COLUMNS),
        (HEAD, "a.csv: got no rows; expected a row for each accident"),
        (WHOLE + "1;2\r\n", "a.csv: line 3: got 2 fields; expected 26"),
        (
            WHOLE + '"x',
            "a.csv: line 3: got unexpected end of data; expected a CSV file",
        ),
        (
            NOWHERE,
            "a.csv: got 2 accidents, none with a place; expected latitudes and"
            " longitudes in degrees",
        ),
    ],
)
def test_what_cannot_be_read_is_one_line(text, message, tmp_path):
    assert refusal(text, tmp_path) == message


def refusal(text, folder, runs=DRIVEN, near=HERE):
    """In which line a file is refused."""
    if isinstance(text, str):
        text = text.encode()
    path = folder / "a.csv"
    path.write_bytes(text)

    with pytest.raises(InputError) as caught:
        weigh(runs, f"unfallatlas:{path}", near=near)
    return str(caught.value).replace(str(path), "a.csv")


def test_accidents_elsewhere_and_of_no_case_are_one_line(tmp_path):
    assert refusal(WHOLE, tmp_path, near=(54.5, 3.0)) == (
        "near: got 54.5,3; expected a place with accidents within 500 m (the nearest"
        " one of a.csv is 721.6 km away)"
    )
    assert refusal(WHOLE, tmp_path, runs=(run("CBLA"),)) == (
        "weights: got 0 of 1 accidents of a.csv within 500 m count; not used: 1 of"
        " which no case is driven (on foot, crosses); expected accidents as these"
        " cases: CBLA"
    )


def test_a_register_needs_a_place_and_a_file(atlas):
    told = r"^near: got nothing; expected LATITUDE,LONGITUDE"
    with pytest.raises(InputError, match=told):
        weigh(DRIVEN, f"unfallatlas:{atlas([on_foot()])}")
    with pytest.raises(InputError, match="No such file"):
        check_weights("unfallatlas:nowhere.csv")

    told = "unfallatlas:FILE, stats19:FILE, or a CSV file that"
    with pytest.raises(InputError, match=told):
        check_weights("unfallatlas")


# ---------- STATS19


def stats19(
    tmp_path, collisions, name="dft-road-casualty-statistics-collision-2023.csv"
):
    """Files of collisions, each (cells, its vehicles, its casualties)."""
    index = "accident_index"
    if "collision" in name:
        index = "collision_index"
    place = {"longitude": HERE[1], "latitude": HERE[0], "light_conditions": 1}
    of_vehicle = ("vehicle_type", "vehicle_manoeuvre", "vehicle_direction_to")
    of_casualty = ("vehicle_reference", "casualty_class", "pedestrian_movement")
    rows = {"collision": [], "vehicle": [], "casualty": []}

    for number, (cells, vehicles, casualties) in enumerate(collisions):
        key = {index: f"2023{number:06d}"}
        rows["collision"].append(key | place | cells)
        for reference, vehicle in enumerate(vehicles, 1):
            told = dict(zip(of_vehicle, vehicle, strict=True))
            rows["vehicle"].append(key | {"vehicle_reference": reference} | told)
        for casualty in casualties:
            rows["casualty"].append(key | dict(zip(of_casualty, casualty, strict=True)))

    for word, lines in rows.items():
        own = name
        if word != "collision":
            own = name.replace("collision", word).replace("accident", word)
        (tmp_path / own).write_text(table(lines))
    return tmp_path / name


CODES = {
    "car": 9,
    "bicycle": 1,
    "motorcycle": 5,
    "lorry": 21,
    "ahead": 18,
    "left": 7,
    "right": 9,
    "bends": 19,
    "overtakes": 13,
    "parked": 2,
    "north": 1,
    "east": 3,
    "south": 5,
    "west": 7,
    "north-west": 8,
}


def codes_of(vehicles):
    """Rows of codes of vehicles such as ("car", "ahead", "north")."""
    rows = []
    for words in vehicles:
        rows.append([CODES.get(word, word) for word in words])
    return rows


# On foot, from the near side.
CROSSES = (codes_of([("car", "ahead", "north")]), [(1, 3, 1)])


# Vehicles are kind, manoeuvre and direction; casualties are the number of a vehicle,
# their class and how they walked.
@pytest.mark.parametrize(
    ("vehicles", "casualties", "road_user", "event"),
    [
        ([("car", "ahead", "north")], [(1, 3, 1)], "on foot", "crosses near"),
        ([("car", "bends", "north")], [(1, 3, 2)], "on foot", "crosses near, hidden"),
        ([("car", "ahead", "north")], [(1, 3, 4)], "on foot", "crosses far"),
        ([("car", "ahead", "north")], [(1, 3, 8)], "on foot", "along"),
        ([("car", "left", "west")], [(1, 3, 1)], "on foot", "VUT turns near"),
        (
            [("car", "right", "east"), ("car", "ahead", "north")],
            [(1, 3, 9)],
            "on foot",
            "VUT turns far",
        ),
        (
            [("car", "ahead", "north"), ("bicycle", "ahead", "east")],
            [(2, 1, 0)],
            "bicycle",
            "crosses near",
        ),
        (
            [("bicycle", "ahead", "west"), ("car", "ahead", "north")],
            [(1, 1, 0)],
            "bicycle",
            "crosses far",
        ),
        (
            [("car", "ahead", "north-west"), ("bicycle", "ahead", "north-west")],
            [(2, 1, 0)],
            "bicycle",
            "along",
        ),
        (
            [("car", "right", "east"), ("motorcycle", "ahead", "south")],
            [],
            "motorcycle",
            "VUT turns far",
        ),
        (
            [("car", "ahead", "west"), ("car", "ahead", "east")],
            [(1, 1, 0)],
            "car",
            "oncoming",
        ),
        (
            [("car", "ahead", "south"), ("car", "right", "east")],
            [(1, 1, 0)],
            "car",
            "VUT turns far",
        ),
    ],
)
def test_collisions_are_read_as_events(
    tmp_path, vehicles, casualties, road_user, event
):
    files = [({}, codes_of(vehicles), casualties), ({}, *CROSSES)]
    first = read_accidents("stats19", stats19(tmp_path, files)).what[0]

    assert first.road_user == road_user
    assert first.event == event
    assert first.unused == ""
    assert first.light == "day"


@pytest.mark.parametrize(
    ("vehicles", "casualties", "unused"),
    [
        ([("lorry", "ahead", "north")], [(1, 3, 1)], "without a car"),
        ([("car", "parked", 0)], [(1, 3, 1)], "of an unknown or unusual manoeuvre"),
        (
            [("car", "ahead", "north")],
            [(1, 3, 5)],
            "of an unknown or unusual manoeuvre",
        ),
        (
            [("car", "ahead", "north")],
            [(1, 1, 0)],
            "with one vehicle alone, or more than two",
        ),
        (
            [("car", "ahead", "north"), ("lorry", "ahead", "north")],
            [(1, 1, 0)],
            "with another kind of vehicle",
        ),
        (
            [("car", "overtakes", "north"), ("bicycle", "ahead", "north")],
            [],
            "of an unknown or unusual manoeuvre",
        ),
        (
            [("car", "ahead", 9), ("bicycle", "ahead", "north")],
            [],
            "of an unknown or unusual manoeuvre",
        ),
        (
            [("car", "ahead", -1), ("bicycle", "ahead", "north")],
            [],
            "of an unknown or unusual manoeuvre",
        ),
    ],
)
def test_collisions_that_are_nothing_we_drive_say_why(
    tmp_path, vehicles, casualties, unused
):
    files = [({}, codes_of(vehicles), casualties), ({}, *CROSSES)]
    path = stats19(tmp_path, files, "dftRoadSafety_accident_2015.csv")
    assert read_accidents("stats19", path).what[0].unused == unused


def test_collisions_become_weights_by_day_and_night(tmp_path):
    cells = [
        {},
        {"light_conditions": 4},
        {"light_conditions": 6},
        {"light_conditions": -1},
        {"latitude": "NULL", "longitude": "NULL"},
    ]
    path = stats19(tmp_path, [(told, *CROSSES) for told in cells])
    runs = (run("CPNA-25"), run("CPNA-25", "night"))
    weight = weigh(runs, f"stats19:{path}", near=HERE)

    assert weight == pytest.approx([1.5 / 4.0, 2.5 / 4.0])


def test_files_of_vehicles_and_casualties_are_asked_for_by_name(tmp_path):
    path = stats19(tmp_path, [({}, *CROSSES)])
    (tmp_path / "dft-road-casualty-statistics-vehicle-2023.csv").unlink()

    with pytest.raises(InputError, match=r"vehicle-2023\.csv: got No such file"):
        read_accidents("stats19", path)

    other = path.rename(tmp_path / "a.csv")
    told = f'{other}: got the name a.csv; expected one with "collision" in it'

    with refused_with(told):
        read_accidents("stats19", other)


# ---------- the table


def test_the_table_names_cases_that_there_are_and_every_event_that_is_read():
    rules = load_accident_rules()
    events = set()
    named = set()

    for kind in rules.types:
        events |= set(kind.cases)
        named |= {case for cases in kind.cases.values() for case in cases}

    for case in named:
        # Those with cars and motorcyclists may not have come yet.
        is_known = any(f"{name}-".startswith(f"{case}-") for name in load_cases())
        assert is_known or case[:2] in ("CC", "CM"), case

    read = {*rules.unfallatlas.events.values(), *rules.stats19.on_foot.values()}
    assert read <= events


def test_words_are_split_at_the_first_colon():
    assert needs_place("stats19:C:/x.csv")
    assert not needs_place("C:/x.csv")
    assert not needs_place("unfallatlas")
    assert AccidentWeights("unfallatlas:C:/x.csv").files() == (Path("C:/x.csv"),)
