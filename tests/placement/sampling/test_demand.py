"""Files of demand, and the routes that are written from them."""

import re
from importlib.resources import files

import pytest

from geometry.errors import InputError
from placement.sampling.moving.demand import load_demand, write_routes

DEFAULT = (files("placement") / "data" / "demand.toml").read_text(encoding="utf-8")
WAYS = {
    "north": {"straight": {"south": "a b"}, "left": {"east": "a c"}},
    "east": {"right": {"north": "d e"}, "left": {"south": "d f", "south-west": "d g"}},
}
LANES = {"north": 2, "east": 1}


def rates(routes):
    """Vehicles an hour of each flow."""
    found = re.findall(r'<flow id="([^"]+)".*?period="exp\(([^)]*)\)"', routes)
    return {name: 3600.0 * float(rate) for name, rate in found}


def changed(folder, *changes):
    """The default demand with words changed, as a file; returns its path."""
    text = DEFAULT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)

    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_an_arms_vehicles_are_spread_over_the_turns_that_it_has():
    found = rates(write_routes(load_demand(), WAYS, LANES))

    # 300 on each of two lanes; straight and left have 0.6 and 0.2 of them, and nobody
    # turns right.
    assert found["north-south"] == pytest.approx(450.0)
    assert found["north-east"] == pytest.approx(150.0)
    # Two exits to the left share what turns left.
    assert found["east-north"] == pytest.approx(150.0)
    assert found["east-south"] == found["east-south-west"] == pytest.approx(75.0)


def test_an_arm_may_have_a_count_of_its_own(tmp_path):
    demand = load_demand(changed(tmp_path, ("[arms]", "[arms]\nnorth = 80.0")))

    found = rates(write_routes(demand, WAYS, LANES))

    assert found["north-south"] + found["north-east"] == pytest.approx(80.0)
    assert sum(
        rate for name, rate in found.items() if name.startswith("east")
    ) == pytest.approx(300.0)


def test_an_arm_without_traffic_has_no_flow(tmp_path):
    demand = load_demand(changed(tmp_path, ("[arms]", "[arms]\nnorth = 0.0")))
    for name in rates(write_routes(demand, WAYS, LANES)):
        assert not name.startswith("north")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("per_lane = 300.0", "per_lane = 0.0", "_per_lane: got 0.0; expected more"),
        (
            "left = 0.2",
            "left = 0.3",
            "turns: got a sum of 1.1; expected shares that sum to 1",
        ),
        (
            'sumo_class = "bus"',
            'sumo_class = "tram"',
            "sumo_class: got 'tram'; expected one of",
        ),
        (
            'actor = "parked-van"',
            'actor = "adult"',
            "got 'adult'; expected a parked vehicle",
        ),
        ("length_m = 12.0", "length_m = 0.0", "length_m: got 0.0; expected > 0 metres"),
        (
            "pause_s = [1.0, 7.0]",
            "pause_s = [9.0, 2.0]",
            "pause_s: got [9.0, 2.0]; expected",
        ),
        (
            'name = "bus"',
            'name = "truck"',
            "vehicles: got 'truck'; expected every body once",
        ),
        ("warm_up_s", "warmup_s", "warmup_s"),
    ],
)
def test_what_is_wrong_with_a_demand_is_one_clear_line(tmp_path, old, new, message):
    path = changed(tmp_path, (old, new))

    with pytest.raises(InputError) as caught:
        load_demand(path)

    refusal = str(caught.value)

    assert message in refusal
    assert refusal.startswith(str(path))


def test_an_arm_that_the_junction_does_not_have_is_told(tmp_path):
    demand = load_demand(changed(tmp_path, ("[arms]", "[arms]\nsouth-west = 80.0")))
    with pytest.raises(
        InputError, match="arms: got 'south-west'; expected an arm with lanes in"
    ):
        write_routes(demand, WAYS, LANES)
