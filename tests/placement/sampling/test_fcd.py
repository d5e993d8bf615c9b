"""Floating car data: SUMO's own, hand-made ones in every format, and files that are damaged."""

import csv
import gzip
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from junctions import protocol_scene

from geometry.errors import InputError
from placement.sampling.moving.demand import load_demand
from placement.sampling.moving.fcd import load_fcd
from placement.sampling.moving.source import load_traffic

CROSS = Path(__file__).parent / "sumo_cross"


@pytest.fixture(scope="module")
def scene():
    """A junction around the origin of its world."""
    return protocol_scene()


def load(path, scene, offset_m=None):
    return load_fcd(path, scene, load_demand(), offset_m=offset_m, reach_m=100.0)


def xml_of(samples, ending="</fcd-export>"):
    """FCD of (time, id, x, y, angle, type), times ascending."""
    lines = ["<fcd-export>"]
    for time in dict.fromkeys(sample[0] for sample in samples):
        lines.append(f'<timestep time="{time}">')
        lines += [
            f'<vehicle id="{name}" x="{x}" y="{y}" angle="{angle}" type="{kind}"/>'
            for at, name, x, y, angle, kind in samples
            if at == time and name
        ]
        lines.append("</timestep>")
    return "\n".join([*lines, ending])


COLUMNS = [
    *("timestep_time", "vehicle_id", "vehicle_x", "vehicle_y", "vehicle_angle"),
    "vehicle_type",
]
# One car drives east along y = -1.75 at 10 m/s; the middle of its footprint is at -20 m at 0 s.
HALF_M = 0.5 * load_demand().vehicles[0].actor.length_m
EAST = [(0.5 * k, "a", -20.0 + 5.0 * k + HALF_M, -1.75, 90.0, "passenger") for k in range(9)]


def write(folder, ending, samples):
    path = folder / f"traffic{ending}"
    if ending in (".xml", ".xml.gz"):
        data = xml_of(samples).encode()
        path.write_bytes(gzip.compress(data) if ending.endswith("gz") else data)
    elif ending == ".parquet":
        pq.write_table(pa.table(dict(zip(COLUMNS, zip(*samples, strict=True), strict=True))), path)
    else:
        with gzip.open(path, "wt") if ending.endswith("gz") else path.open("w") as file:
            csv.writer(file, delimiter=";").writerows([COLUMNS, *samples])
    return path


@pytest.mark.parametrize("ending", [".xml", ".xml.gz", ".csv", ".csv.gz", ".parquet"])
def test_every_format_says_the_same(tmp_path, scene, ending):
    found = load(write(tmp_path, ending, EAST), scene)
    assert len(found.bodies) == 1
    assert (found.step_s, found.first_s, found.last_s) == (0.5, 0.0, 4.0)
    # Between samples it is where a car of steady speed is; outside of them it is nowhere.
    position, yaw = found.at(0, np.array([-0.1, 0.0, 0.3, 2.75, 4.0, 4.1]))
    expected = [np.nan, -20.0, -17.0, 7.5, 20.0, np.nan]
    assert position[:, 0] == pytest.approx(expected, abs=1e-9, nan_ok=True)
    assert yaw[1:-1] == pytest.approx(0.0, abs=1e-9)


def test_sumos_own_junction_is_placed_by_the_network_beside_it(scene):
    """Its network has its origin 200 m south-west of the junction's middle."""
    found = load(CROSS / "cross.fcd.xml.gz", scene)
    names = {body.name for body in found.bodies}
    assert names == {"parked-car-large", "truck", "bus"}
    assert found.step_s == 0.5
    assert np.abs(found.position_m).max() < 140.0
    near = np.hypot(*found.position_m.T)
    assert near.min() < 10.0  # somebody drives over the middle


def test_an_offset_that_is_given_stands_in_for_the_networks(scene, tmp_path):
    by_network = load(CROSS / "cross.fcd.xml.gz", scene)
    shutil.copy(CROSS / "cross.fcd.xml.gz", tmp_path)  # no network beside it
    by_offset = load_traffic(
        str(tmp_path / "cross.fcd.xml.gz"), scene, offset="-200,-200"
    ).trajectories
    assert samples_within(by_offset, 90.0) == samples_within(by_network, 90.0)
    moved = load(CROSS / "cross.fcd.xml.gz", scene, offset_m=np.array([-195.0, -200.0]))
    assert samples_within(moved, 80.0, east_m=5.0) == samples_within(by_network, 80.0)


def samples_within(found, reach_m, *, east_m=0.0):
    """Time and place of all samples near a point east of the middle, relative to it."""
    offset = found.position_m - [east_m, 0.0]
    near = np.hypot(*offset.T) <= reach_m
    samples = np.column_stack([found.time_s, offset])[near].round(6) + 0.0
    return sorted(map(tuple, samples.tolist()))


def test_a_projected_network_is_turned_into_the_scenes_own_frame(tmp_path, scene):
    """A point 5 km east of the meridian of UTM's zone, where grid north is not the scene's."""
    from dataclasses import replace

    import pyproj

    crs = "+proj=tmerc +lat_0=49 +lon_0=8 +datum=WGS84 +units=m"
    utm = "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
    to_utm = pyproj.Transformer.from_crs(crs, utm, always_xy=True)
    net_offset = np.array([-450_000.0, -5_400_000.0])
    samples = []
    for time, name, x, y, angle, kind in EAST:
        ahead = np.array(to_utm.transform(x + 1.0, y)) - to_utm.transform(x, y)
        grid = angle - np.degrees(np.arctan2(ahead[1], ahead[0]))
        samples.append((time, name, *(to_utm.transform(x, y) + net_offset).tolist(), grid, kind))
    path = write(tmp_path, ".xml", samples)
    (tmp_path / "city.net.xml").write_text(
        f'<net><location netOffset="{net_offset[0]},{net_offset[1]}" projParameter="{utm}"/></net>'
    )
    found = load(path, replace(scene, crs=crs))
    assert found.position_m[:, 0] == pytest.approx(-20.0 + 5.0 * np.arange(9), abs=0.02)
    assert found.position_m[:, 1] == pytest.approx(-1.75, abs=0.02)
    assert found.yaw_deg == pytest.approx(0.0, abs=0.01)


def test_a_vehicle_that_comes_back_is_away_in_between(tmp_path, scene):
    samples = [sample for sample in EAST if sample[0] not in (1.5, 2.0)]
    samples.insert(3, (1.5, "b", 0.0, 1.75, 270.0, "bus"))
    samples.insert(4, (2.0, "b", -5.0, 1.75, 270.0, "bus"))
    found = load(write(tmp_path, ".csv", samples), scene)
    a = [body.name for body in found.bodies].index("parked-car-large")
    position, _ = found.at(a, np.array([1.0, 1.25, 1.75, 2.25, 2.5]))
    assert np.isnan(position[:, 0]).tolist() == [False, True, True, True, False]


def test_headings_take_the_short_way_round(tmp_path, scene):
    samples = [(0.5 * k, "a", 0.0, 2.0 * k, (350 + 10 * k) % 360, "car") for k in range(4)]
    found = load(write(tmp_path, ".csv", samples), scene)
    _, yaw = found.at(0, np.array([0.25]))
    assert yaw % 360.0 == pytest.approx([95.0])


def test_cyclists_and_people_are_no_bodies_to_hide_behind(tmp_path, scene):
    bicycle = [(t, "b", x, 5.0, 90.0, "bicycle") for t, _, x, *_ in EAST]
    found = load(write(tmp_path, ".csv", sorted([*EAST, *bicycle])), scene)
    assert [body.name for body in found.bodies] == ["parked-car-large"]


def test_types_that_nobody_knows_drive_as_cars_and_are_told(tmp_path, scene, caplog):
    found = load(write(tmp_path, ".csv", [(*sample[:5], "DEFAULT") for sample in EAST]), scene)
    assert [body.name for body in found.bodies] == ["parked-car-large"]
    assert "types of vehicles not known by name (DEFAULT)" in caplog.text


def shifted(samples, metres):
    return [(t, name, x + metres, *rest) for t, name, x, *rest in samples]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got an empty file; expected SUMO's fcd-export"),
        ("<fcd-export>\n</fcd-export>", "got no vehicle at any time; expected vehicles that drive"),
        ("<routes/>", "got XML with routes; expected SUMO's fcd-export"),
        (xml_of(EAST, ending=""), "got a file that is cut off or damaged after 9 steps"),
        (
            xml_of(shifted(EAST, 5000.0)),
            "got no vehicle within 100 m of the junction, the nearest 4982 m away; expected "
            "traffic of this place, or `traffic_offset` EAST,NORTH",
        ),
        (
            xml_of([(4.0 * sample[0], *sample[1:]) for sample in EAST]),
            "got a step of 2 s; expected steady steps of at most 1 s",
        ),
        (
            xml_of([*EAST, (4.7, "a", 0.0, 0.0, 90.0, "car")]),
            "got 0.7 s after 4 s, elsewhere 0.5 s; expected steady steps of at most 1 s",
        ),
        (xml_of(EAST[:1]), "got one point in time; expected traffic over some time"),
        (
            xml_of([*EAST[:3], (1.5, "a", "nan", 0.0, 90.0, "car")]),
            "vehicle a at 1.5 s: x: got nan; expected a finite number",
        ),
        (
            xml_of([*EAST[:3], (1.5, "a", 1.0, "here", 90.0, "car")]),
            "vehicle a at 1.5 s: y: got 'here'; expected a finite number",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_one_clear_line(tmp_path, scene, text, message):
    path = tmp_path / "traffic.xml"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        load(path, scene)
    assert message in str(raised.value)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("ending", [".xml.gz", ".csv.gz"])
def test_a_packed_file_that_is_cut_off_is_told(tmp_path, scene, ending):
    path = write(tmp_path, ending, EAST)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="got a file that is cut off; expected a whole file"):
        load(path, scene)


def test_a_table_that_is_cut_off_is_told(tmp_path, scene):
    path = write(tmp_path, ".csv", EAST)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="of 6 columns; expected a whole file"):
        load(path, scene)
    path = write(tmp_path, ".parquet", EAST)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="expected a whole Parquet file"):
        load(path, scene)


def test_a_table_of_something_else_is_told(tmp_path, scene):
    path = tmp_path / "people.csv"
    path.write_text("name,age\nx,3\n")
    with pytest.raises(InputError, match="got columns name, age; expected SUMO's: timestep_time"):
        load(path, scene)


@pytest.mark.parametrize(
    ("source", "offset", "message"),
    [
        ("sumoo", "", "traffic: got 'sumoo'; expected sumo, a .toml file of demand, or a file"),
        ("x.csv", "12", "traffic_offset: got '12'; expected EAST,NORTH in metres"),
        ("x.csv", "1,nan", "traffic_offset: got '1,nan'; expected EAST,NORTH in metres"),
        ("sumo", "1,2", "traffic_offset: got '1,2'; expected nothing"),
        ("missing.csv", "", "missing.csv: got No such file or directory; expected a readable"),
    ],
)
def test_words_that_name_no_traffic_are_told(scene, source, offset, message):
    with pytest.raises(InputError) as raised:
        load_traffic(source, scene, offset=offset)
    assert message in str(raised.value)
