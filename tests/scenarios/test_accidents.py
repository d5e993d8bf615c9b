import csv
import io
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refused_with

from geometry.errors import InputError
from scenarios.accidents import AccidentWeights, load_accident_rules, read_accidents
from scenarios.cases import load_cases
from scenarios.weights import check_weights, needs_place, weigh

HERE = (52.5200, 13.4050)
METRES_PER_DEGREE = 6_371_008.8 * math.pi / 180.0

ATLAS = (
    *(
        "OID_",
        "UIDENTSTLAE",
        "ULAND",
        "UREGBEZ",
        "UKREIS",
        "UGEMEINDE",
        "UJAHR",
        "UMONAT",
    ),
    *(
        "USTUNDE",
        "UWOCHENTAG",
        "UKATEGORIE",
        "UART",
        "UTYP1",
        "ULICHTVERH",
        "IstStrassenzustand",
    ),
    *(
        "IstRad",
        "IstPKW",
        "IstFuss",
        "IstKrad",
        "IstGkfz",
        "IstSonstige",
        "LINREFX",
        "LINREFY",
    ),
    *("XGCSWGS84", "YGCSWGS84", "PLST"),
)


def atlas_row(*, north_m=0.0, **cells) -> dict[str, str]:
    row = dict.fromkeys(ATLAS, "0") | {
        "UJAHR": "2023",
        "UART": "5",
        "UTYP1": "3",
        "IstPKW": "1",
    }
    latitude = HERE[0] + north_m / METRES_PER_DEGREE
    row |= {"YGCSWGS84": f"{latitude:.9f}", "XGCSWGS84": f"{HERE[1]:.9f}"}
    row = {name: text.replace(".", ",") for name, text in row.items()}
    return row | {name: str(value) for name, value in cells.items()}


def table(rows, separator=",") -> str:
    text = io.StringIO()
    writer = csv.DictWriter(
        text, list(rows[0]), delimiter=separator, lineterminator="\r\n"
    )
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def run(case, weather="day", approach="north"):
    return SimpleNamespace(
        id=f"{case}/{approach}/30/{weather}",
        case=SimpleNamespace(name=case),
        approach=approach,
        position="0",
        weather=weather,
    )


@pytest.fixture
def atlas(tmp_path):
    def write(rows, encoding="utf-8-sig"):
        path = tmp_path / "Unfallorte2023_LinRef.csv"
        path.write_bytes(table(rows, ";").encode(encoding))
        return path

    return write


DRIVEN = (run("CPNA-25"), run("CPNCO-50"), run("CBNA"), run("CBLA"), run("CMCscp-far"))


def weights_of(path, runs=DRIVEN, **options):
    return weigh(runs, f"unfallatlas:{path}", near=HERE, **options)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_accidents_of_a_type_are_shared_by_its_cases_that_are_driven(
    atlas, encoding, caplog
):
    rows = [
        atlas_row(IstFuss=1, UTYP1=4),  # crosses: CPNA, CPNCO
        atlas_row(IstFuss=1, UTYP1=4, north_m=400.0, PLST="M\xfchlenstra\xdfe"),
        atlas_row(IstRad=1, UTYP1=3),  # crosses: CBNA
        atlas_row(IstRad=1, UTYP1=6),  # along: CBLA
        atlas_row(IstRad=1, UTYP1=6, UART=4),  # oncoming: no case
        atlas_row(IstKrad=1, UTYP1=3),  # CMCscp
        atlas_row(IstRad=1, UTYP1=2),  # turns: not driven
        atlas_row(IstRad=1, IstPKW=0),
        atlas_row(IstRad=1, IstFuss=1),
        atlas_row(IstFuss=1, UTYP1=1),
        atlas_row(IstFuss=1, UTYP1=4, north_m=501.0),
        atlas_row(IstFuss=1, UTYP1=4, XGCSWGS84="", YGCSWGS84=""),
    ]
    path = atlas(rows, encoding)
    assert weights_of(path) == pytest.approx(np.array([1.0, 1.0, 1.0, 1.0, 1.0]) / 5.0)
    assert caplog.messages == [
        "weights: 5 of 10 accidents of Unfallorte2023_LinRef.csv within 500 m count;"
        " not used: 1 driving accident (UTYP1 1), 1 of which no case is driven"
        " (bicycle, VUT turns), 1 of which no case is driven (bicycle, oncoming), 1"
        " with several kinds of road users, 1 without a car"
    ]
    near_only = weights_of(path, within_m=100.0)
    assert near_only == pytest.approx(np.array([0.5, 0.5, 1.0, 1.0, 1.0]) / 4.0)


def test_day_and_night_weigh_what_happened_in_their_light(atlas):
    rows = [
        atlas_row(IstFuss=1, UTYP1=4),
        atlas_row(IstFuss=1, UTYP1=4, ULICHTVERH=2),
        atlas_row(IstFuss=1, UTYP1=4, ULICHTVERH=2),
        atlas_row(IstFuss=1, UTYP1=4, ULICHTVERH=1),  # twilight: half each
    ]
    path = atlas(rows)
    both = (run("CPNA-25"), run("CPNA-25", "night"), run("CPNA-25", "rain"))
    assert weights_of(path, both) == pytest.approx([1.5 / 4.0, 2.5 / 4.0, 0.0])
    # Where one of them is driven alone, light does not matter.
    assert weights_of(path, both[1:]) == pytest.approx([1.0, 0.0])
    assert weights_of(path, both[2:]) == pytest.approx([1.0])


def test_older_files_call_the_light_otherwise(atlas):
    rows = [
        {
            ("LICHT" if name == "ULICHTVERH" else name): cell
            for name, cell in row.items()
        }
        for row in [atlas_row(IstFuss=1, UTYP1=4, ULICHTVERH=2)]
    ]
    night = (run("CPNA-25"), run("CPNA-25", "night"))
    assert weights_of(atlas(rows), night) == pytest.approx([0.0, 1.0])


def test_what_cannot_be_read_or_is_elsewhere_is_one_line(atlas, tmp_path):
    row = atlas_row(IstFuss=1, UTYP1=4)

    def message(text, near=HERE, runs=DRIVEN) -> str:
        path = tmp_path / "a.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(InputError) as error:
            weigh(runs, f"unfallatlas:{path}", near=near)
        assert "\n" not in str(error.value)
        return str(error.value).replace(str(path), "a.csv")

    whole = table([row], ";")
    columns = (
        "utyp1, istfuss, istrad, istkrad, istpkw, ulichtverh, xgcswgs84, ygcswgs84"
    )
    assert (
        message(whole.replace("UTYP1", "TYP"))
        == f"a.csv: got no column utyp1; expected columns {columns}"
    )
    assert message("") == f"a.csv: got no column utyp1; expected columns {columns}"
    assert (
        message(b"\x00\xff" * 99)
        == f"a.csv: got no column utyp1; expected columns {columns}"
    )
    head = whole.partition("\n")[0]
    assert message(head) == "a.csv: got no rows; expected a row for each accident"
    assert message(whole + "1;2\r\n") == "a.csv: line 3: got 2 fields; expected 26"
    assert (
        message(whole + '"x')
        == "a.csv: line 3: got unexpected end of data; expected a CSV file"
    )
    at_sea = message(whole, near=(54.5, 3.0))
    assert (
        at_sea
        == "near: got 54.5,3; expected a place with accidents within 500 m (the nearest"
        " one of a.csv is 721.6 km away)"
    )
    nowhere = table(
        [atlas_row(XGCSWGS84="0", YGCSWGS84="0"), atlas_row(YGCSWGS84="5820000")], ";"
    )
    assert (
        message(nowhere)
        == "a.csv: got 2 accidents, none with a place; expected latitudes and"
        " longitudes in degrees"
    )
    assert (
        message(whole, runs=(run("CBLA"),))
        == "weights: got 0 of 1 accidents of a.csv within 500 m count; not used: 1 of"
        " which no case is driven (on foot, crosses); expected accidents as these"
        " cases: CBLA"
    )
    with pytest.raises(
        InputError, match=r"^near: got nothing; expected LATITUDE,LONGITUDE"
    ):
        weigh(DRIVEN, f"unfallatlas:{atlas([row])}")
    with pytest.raises(InputError, match="No such file"):
        check_weights("unfallatlas:nowhere.csv")
    with pytest.raises(
        InputError, match=r"unfallatlas:FILE, stats19:FILE, or a CSV file that"
    ):
        check_weights("unfallatlas")


# ---------- STATS19


def stats19(
    tmp_path, collisions, name="dft-road-casualty-statistics-collision-2023.csv"
):
    """Files of collisions, each (cells, its vehicles, its casualties)."""
    if "collision" in name:
        index = "collision_index"
    else:
        index = "accident_index"
    rows = {"collision": [], "vehicle": [], "casualty": []}
    for number, (cells, vehicles, casualties) in enumerate(collisions):
        key = {index: f"2023{number:06d}"}
        place = {"longitude": HERE[1], "latitude": HERE[0], "light_conditions": 1}
        rows["collision"].append(key | place | cells)
        for reference, (kind, manoeuvre, to) in enumerate(vehicles, 1):
            rows["vehicle"].append(
                key
                | {
                    "vehicle_reference": reference,
                    "vehicle_type": kind,
                    "vehicle_manoeuvre": manoeuvre,
                    "vehicle_direction_to": to,
                }
            )
        for reference, kind, movement in casualties:
            rows["casualty"].append(
                key
                | {
                    "vehicle_reference": reference,
                    "casualty_class": kind,
                    "pedestrian_movement": movement,
                }
            )
    for word, lines in rows.items():
        own = name.replace("collision", word).replace("accident", word)
        (tmp_path / (name if word == "collision" else own)).write_text(table(lines))
    return tmp_path / name


CAR = 9
BICYCLE = 1
MOTORCYCLE = 5
LORRY = 21
AHEAD = 18
LEFT = 7
RIGHT = 9
OVERTAKES = 13
PARKED = 2
NORTH = 1
EAST = 3
SOUTH = 5
WEST = 7


@pytest.mark.parametrize(
    ("vehicles", "casualties", "road_user", "event"),
    [
        ([(CAR, AHEAD, NORTH)], [(1, 3, 1)], "on foot", "crosses near"),
        ([(CAR, 19, NORTH)], [(1, 3, 2)], "on foot", "crosses near, hidden"),
        ([(CAR, AHEAD, NORTH)], [(1, 3, 4)], "on foot", "crosses far"),
        ([(CAR, AHEAD, NORTH)], [(1, 3, 8)], "on foot", "along"),
        ([(CAR, LEFT, WEST)], [(1, 3, 1)], "on foot", "VUT turns near"),
        (
            [(CAR, RIGHT, EAST), (CAR, AHEAD, 1)],
            [(1, 3, 9)],
            "on foot",
            "VUT turns far",
        ),
        # Traffic keeps left: who goes to the right comes from the near side.
        (
            [(CAR, AHEAD, NORTH), (BICYCLE, AHEAD, EAST)],
            [(2, 1, 0)],
            "bicycle",
            "crosses near",
        ),
        (
            [(BICYCLE, AHEAD, WEST), (CAR, AHEAD, NORTH)],
            [(1, 1, 0)],
            "bicycle",
            "crosses far",
        ),
        ([(CAR, AHEAD, 8), (BICYCLE, AHEAD, 8)], [(2, 1, 0)], "bicycle", "along"),
        (
            [(CAR, RIGHT, EAST), (MOTORCYCLE, AHEAD, SOUTH)],
            [],
            "motorcycle",
            "VUT turns far",
        ),
        ([(CAR, AHEAD, WEST), (CAR, AHEAD, EAST)], [(1, 1, 0)], "car", "oncoming"),
        (
            [(CAR, AHEAD, SOUTH), (CAR, RIGHT, EAST)],
            [(1, 1, 0)],
            "car",
            "VUT turns far",
        ),
    ],
)
def test_collisions_are_read_as_events(
    tmp_path, vehicles, casualties, road_user, event
):
    files = [({}, vehicles, casualties), ({}, [(CAR, AHEAD, NORTH)], [(1, 3, 1)])]
    first = read_accidents("stats19", stats19(tmp_path, files)).what[0]
    assert first.road_user == road_user
    assert first.event == event
    assert first.unused == ""
    assert first.light == "day"


@pytest.mark.parametrize(
    ("vehicles", "casualties", "unused"),
    [
        ([(LORRY, AHEAD, NORTH)], [(1, 3, 1)], "without a car"),
        ([(CAR, PARKED, 0)], [(1, 3, 1)], "of an unknown or unusual manoeuvre"),
        ([(CAR, AHEAD, NORTH)], [(1, 3, 5)], "of an unknown or unusual manoeuvre"),
        (
            [(CAR, AHEAD, NORTH)],
            [(1, 1, 0)],
            "with one vehicle alone, or more than two",
        ),
        (
            [(CAR, AHEAD, 1), (LORRY, AHEAD, 1)],
            [(1, 1, 0)],
            "with another kind of vehicle",
        ),
        (
            [(CAR, OVERTAKES, 1), (BICYCLE, AHEAD, 1)],
            [],
            "of an unknown or unusual manoeuvre",
        ),
        (
            [(CAR, AHEAD, 9), (BICYCLE, AHEAD, 1)],
            [],
            "of an unknown or unusual manoeuvre",
        ),
        (
            [(CAR, AHEAD, -1), (BICYCLE, AHEAD, 1)],
            [],
            "of an unknown or unusual manoeuvre",
        ),
    ],
)
def test_collisions_that_are_nothing_we_drive_say_why(
    tmp_path, vehicles, casualties, unused
):
    files = [({}, vehicles, casualties), ({}, [(CAR, AHEAD, NORTH)], [(1, 3, 1)])]
    path = stats19(tmp_path, files, "dftRoadSafety_accident_2015.csv")
    assert read_accidents("stats19", path).what[0].unused == unused


def test_collisions_become_weights_by_day_and_night(tmp_path):
    crossing = [(CAR, AHEAD, NORTH)], [(1, 3, 1)]
    path = stats19(
        tmp_path,
        [
            ({}, *crossing),
            ({"light_conditions": 4}, *crossing),
            ({"light_conditions": 6}, *crossing),
            ({"light_conditions": -1}, *crossing),
            ({"latitude": "NULL", "longitude": "NULL"}, *crossing),
        ],
    )
    runs = (run("CPNA-25"), run("CPNA-25", "night"))
    weight = weigh(runs, f"stats19:{path}", near=HERE)
    assert weight == pytest.approx([1.5 / 4.0, 2.5 / 4.0])


def test_files_of_vehicles_and_casualties_are_asked_for_by_name(tmp_path):
    path = stats19(tmp_path, [({}, [(CAR, AHEAD, NORTH)], [(1, 3, 1)])])
    (tmp_path / "dft-road-casualty-statistics-vehicle-2023.csv").unlink()
    with pytest.raises(InputError, match=r"vehicle-2023\.csv: got No such file"):
        read_accidents("stats19", path)
    other = path.rename(tmp_path / "a.csv")
    with refused_with(
        f'{other}: got the name a.csv; expected one with "collision" in it'
    ):
        read_accidents("stats19", other)


# ---------- the table


def test_the_table_names_cases_that_there_are_and_every_event_that_is_read():
    rules = load_accident_rules()
    known = set(load_cases())
    for kind in rules.types:
        for cases in kind.cases.values():
            for case in cases:
                # Those with cars and motorcyclists may not have come yet.
                assert case[:2] in ("CC", "CM") or any(
                    f"{name}-".startswith(f"{case}-") for name in known
                ), case
    events = {event for kind in rules.types for event in kind.cases}
    assert (
        set(rules.unfallatlas.events.values()) | set(rules.stats19.on_foot.values())
        <= events
    )


def test_words_are_split_at_the_first_colon():
    assert needs_place("stats19:C:/x.csv")
    assert not needs_place("C:/x.csv")
    assert not needs_place("unfallatlas")
    assert AccidentWeights("unfallatlas:C:/x.csv").files() == (Path("C:/x.csv"),)
