"""The runs that others have published, and placements told in files."""

import copy
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from oracles import separation_m
from refusals import refused_with

from geometry.actors import PlacedActor
from geometry.errors import InputError
from geometry.frames import to_carla_points, to_carla_yaw
from geometry.tables import read_table
from scenarios import published
from scenarios.published import stage_published

GOLDEN_FILE = Path(__file__).parents[1] / "golden" / "carla_ncap_runs.toml"
GOLDEN = tomllib.loads(GOLDEN_FILE.read_text(encoding="utf-8"))["runs"]
VRU_NAMES = {"bicycle": "cyclist", "pedestrian": "adult"}


def _placement(placements, golden):
    """The placement that a published run has."""
    meant = (golden["case"], golden["approach_from"])
    (found,) = [one for one in placements if (one.case.name, one.approach) == meant]
    return found


def _runs_of(runs, placement):
    """Runs of all speeds of a placement."""
    meant = (placement.case.name, placement.approach)
    return [run for run in runs if (run.case.name, run.approach) == meant]


def test_all_ten_published_placements_are_there():
    assert [golden["index"] for golden in GOLDEN] == list(range(10))


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: str(golden["index"]))
def test_published_starts_and_directions_are_the_generators(placements, golden):
    placement = _placement(placements, golden)
    assert placement.case.vru.name == VRU_NAMES[golden["vru"]]
    assert placement.case.vru_speed_kmh == golden["vru_speed_kmh"]
    for path, body in ((placement.vut_path, "vut"), (placement.vru_path, "vru")):
        assert to_carla_points(path.start_m).tolist() == golden[f"{body}_start"]
        assert to_carla_yaw(path.yaw_deg) % 360.0 == golden[f"{body}_yaw_deg"]


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: str(golden["index"]))
def test_published_vrus_are_at_the_collision_point_at_the_impact(
    placements, runs, golden
):
    collision = np.array(golden["collision_point"])
    if golden["index"] == 5:
        # The generator's point lies 3 m beside the line on which its own cyclist rides,
        # so that the cyclist never reaches it. Ours meet where the two paths cross.
        assert collision[1] == pytest.approx(golden["vru_start"][1] - 3.0)
        collision[1] = golden["vru_start"][1]

    drives = _runs_of(runs, _placement(placements, golden))
    speed_mps = golden["vru_speed_kmh"] / 3.6
    travel_s = math.dist(collision, golden["vru_start"]) / speed_mps

    assert len(drives) >= 8
    for run in drives:
        met_m = to_carla_points(run.vru_position_m[-1])
        start_s = run.encounter.vru_motion.start_time_s

        assert met_m == pytest.approx(collision, abs=1e-6)
        assert start_s == pytest.approx(-travel_s, abs=1e-6)


# Placements from TOML

CROSSING = {
    "case": "CPNC-50",
    "approach": "east",
    "vut_start_m": [-50.0, -4.0],
    "vut_yaw_deg": 180.0,
    "vru_start_m": [-110.0, -15.0],
    "vru_yaw_deg": 90.0,
    "collision_point_m": [-110.0, -4.0],
}


def _load(monkeypatch, *entries, **table):
    """What ``load_placements`` makes of a file; nothing is remembered."""
    table |= {"scene": "town05", "placements": list(entries)}
    monkeypatch.setattr(published, "load_data", lambda package, name: table)
    return published.load_placements.__wrapped__()


def _changed(**changes):
    """The entry of a crossing with other values; without those that are None."""
    entry = copy.deepcopy(CROSSING)
    for key, value in changes.items():
        if value is None:
            del entry[key]
        else:
            entry[key] = value
    return entry


def test_a_placement_carries_its_parked_bodies_into_every_run(monkeypatch, actors):
    length_m = actors["parked-car-large"].length_m
    row = {
        "first_m": [-100.0, -7.0 + 0.5 * length_m],
        "yaw_deg": 90.0,
        "gap_m": 1.0,
        "actors": ["parked-car-large"] * 2,
    }
    (placement,) = _load(monkeypatch, CROSSING, parked_rows=[row])
    first, second = placement.obstruction

    assert isinstance(first, PlacedActor)
    assert first.actor is second.actor is actors["parked-car-large"]
    assert first.pose.position_m == pytest.approx([-100.0, 7.0, 0.0])
    assert second.pose.position_m == pytest.approx([-100.0, 8.0 + length_m, 0.0])
    assert first.pose.yaw_deg == -90.0
    assert first.pose.pitch_deg == 0.0

    staging = stage_published(placement, vut_speed_kmh=40.0, vut=actors["vut"])
    assert staging.obstruction == (first, second)


@pytest.mark.parametrize("vru_yaw_deg", [89.1, 90.9])
def test_a_crossing_may_be_a_degree_out_of_square(monkeypatch, actors, vru_yaw_deg):
    (placement,) = _load(monkeypatch, _changed(vru_yaw_deg=vru_yaw_deg))
    for speed_kmh in placement.case.vut_speeds_kmh:
        staging = stage_published(
            placement,
            vut_speed_kmh=speed_kmh,
            vut=actors["vut"],
        )
        apart_m = separation_m(staging.encounter, np.array([0.0]))
        assert apart_m == pytest.approx(0.0, abs=0.01)


def test_a_placement_without_parked_bodies_has_none(monkeypatch):
    (placement,) = _load(monkeypatch, CROSSING)
    assert placement.obstruction == ()
    assert placement.vut_meeting_m == pytest.approx(60.0)
    assert placement.vru_meeting_m == pytest.approx(11.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"approach": ""}, "{0}.approach: got ''; expected text"),
        ({"vut_start_m": None}, "{0}.vut_start_m: got nothing; expected a value"),
        (
            {"vru_start_m": [1.0]},
            "{0}.vru_start_m: got shape (1,); expected shape (2,)",
        ),
        (
            {"vut_yaw_deg": "left"},
            "{0}.vut_yaw_deg: got 'left'; expected a finite number",
        ),
        (
            {"collision_point_m": [1.0, 2.0, 3.0]},
            "{0}.collision_point_m: got shape (3,); expected shape (2,)",
        ),
        (
            {"vru_yaw_deg": 180.0},
            "{0}: got paths at 0.0 degrees; expected perpendicular paths",
        ),
        (
            {"vru_yaw_deg": 30.0},
            "{0}: got paths at 30.0 degrees; expected perpendicular paths",
        ),
        (
            {"vru_yaw_deg": 91.5},
            "{0}: got paths at 88.5 degrees; expected perpendicular paths",
        ),
        (
            {"collision_point_m": [-110.0, -3.0]},
            (
                "{0}.collision_point_m: got [-110.0, -3.0]; expected a point on "
                "the VUT's path"
            ),
        ),
        (
            {"vru_yaw_deg": 270.0},
            (
                "{0}: got paths that meet behind a start; expected starts before "
                "the meeting point"
            ),
        ),
    ],
)
def test_placements_say_what_is_wrong(monkeypatch, changes, message):
    with refused_with(message.format("town05_runs.toml: placements[0]")):
        _load(monkeypatch, _changed(**changes))


def test_a_longitudinal_case_needs_one_heading():
    entry = {
        "case": "CBLA",
        "approach": "east",
        "vut_start_m": [0.0, 0.0],
        "vut_yaw_deg": 180.0,
        "vru_start_m": [-20.0, 0.0],
        "vru_yaw_deg": 90.0,
        "collision_point_m": [-40.0, 0.0],
    }
    with pytest.raises(InputError, match="expected one heading for VUT and VRU"):
        published._build_placement(
            read_table(entry, published._Entry, "runs.toml"),
            "runs.toml: placements[0]",
            "town05",
            (),
        )
