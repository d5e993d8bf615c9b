"""Files of uncertainties: what they say, leave out, and say wrongly."""

import numpy as np
import pytest
import trimesh
from refusals import refused_with

from geometry.errors import InputError
from placement.sampling.uncertainty import load_uncertainty

WHOLE = """
[mounting]
yaw_sd_deg = 1
pitch_sd_deg = 0.5
height_sd_m = 0.1
[latency]
distribution = "uniform"
mean_s = 0.02
sd_s = 0.01
drawn_per = "sample"
[messages]
packet_loss = 0.1
[detector]
is_drawn = false
[traffic]
taken_share = 0.2
free_place_m = 5
parked_gap_m = 1
clear_of_mouth_m = 5
waiting_share = 0.4
following_share = 0
waiting_gap_m = 2
crosswalk_gap_m = 3
along_arm_m = 40
clearance_m = 0.5
[[vehicles]]
actor = "parked-van"
parked_share = 1
waiting_share = 0.25
[[vehicles]]
name = "tram"
length_m = 30
width_m = 2.65
height_m = 3.6
parked_share = 0
waiting_share = 0.75
"""


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes mine.toml; returns its name."""
    monkeypatch.chdir(tmp_path)

    def write_text(text):
        (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
        return "mine.toml"

    return write_text


def test_a_file_says_it_all(write):
    read = load_uncertainty(write(WHOLE))

    assert read.name == "mine.toml"
    assert read.mounting.yaw_sd_deg == 1.0
    assert read.mounting.pitch_sd_deg == 0.5
    assert read.latency.distribution == "uniform"
    assert read.latency.drawn_per == "sample"
    assert read.packet_loss == 0.1
    assert not read.draws_detections
    assert read.traffic.taken_share == 0.2
    assert read.traffic.along_arm_m == 40.0

    van, tram = read.traffic.vehicles

    assert van.actor.name == "parked-van"
    assert tram.actor.length_m == 30.0
    assert tram.waiting_share == 0.75


def test_what_a_file_leaves_out_is_certain(write):
    read = load_uncertainty(write("[messages]\npacket_loss = 0.3\n"))

    assert read.packet_loss == 0.3
    assert read.traffic.is_empty
    assert read.mounting.yaw_sd_deg == 0.0


def test_a_box_is_closed_faces_outwards_and_stands_on_the_road():
    for kind in load_uncertainty().traffic.vehicles[-2:]:
        (shape,) = kind.actor.shapes
        mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
        size = [kind.actor.length_m, kind.actor.width_m, kind.actor.height_m]
        expected = np.prod(size)

        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(expected)
        assert np.ptp(shape.vertices_m, axis=0) == pytest.approx(size)
        assert shape.vertices_m[:, 2].min() == 0.0
        assert shape.vertices_m[:, :2].mean(axis=0) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("yaw_sd_deg = 1", "yaw_deg = 1"),
            "mine.toml: mounting: got 'yaw_deg'; expected one of ",
        ),
        (
            ("yaw_sd_deg = 1\n", ""),
            "mine.toml: mounting.yaw_sd_deg: got nothing; expected a value",
        ),
        (
            ("is_drawn = false", "is_drawn = 0"),
            "mine.toml: detector.is_drawn: got 0; expected true or false",
        ),
        (
            ('"uniform"', '"normal"'),
            (
                "mine.toml: latency.distribution: got 'normal'; expected one of gamma,"
                " uniform"
            ),
        ),
        (
            ('"parked-van"', '"adult"'),
            "mine.toml: vehicles[0].actor: got 'adult'; expected a parked vehicle",
        ),
        (
            ("waiting_share = 0.25", "waiting_share = 0.5"),
            (
                "mine.toml: traffic.vehicles: waiting_share: got a sum of 1.25; "
                "expected shares that sum to 1"
            ),
        ),
        (
            ("[messages]", "[massages]"),
            "mine.toml: got 'massages'; expected one of mounting, ",
        ),
        (
            ('distribution = "uniform"', 'budget = "study"'),
            "mine.toml: latency: got 'mean_s'; expected one of budget, drawn_per",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_place(write, change, message):
    assert change[0] in WHOLE

    path = write(WHOLE.replace(*change))

    with pytest.raises(InputError) as caught:
        load_uncertainty(path)

    assert str(caught.value).startswith(message)


def test_sections_must_be_sections(write):
    with refused_with("mine.toml: mounting: got 3; expected a section [mounting]"):
        load_uncertainty(write("mounting = 3\n"))

    vehicles = WHOLE[WHOLE.index("[[vehicles]]") :]

    with refused_with(
        "mine.toml: vehicles: got no section traffic; expected where they stand"
    ):
        load_uncertainty(write(vehicles))


def test_a_budget_may_stand_in_for_a_distribution(write):
    read = load_uncertainty(
        write('[latency]\nbudget = "cpm-50ms"\ndrawn_per = "run"\n')
    )
    assert read.latency.budget is not None
    assert read.latency.budget.name == "cpm-50ms"


def test_a_name_that_nobody_knows_is_refused():
    with refused_with(
        "--uncertainty: got 'much'; expected default, robustness, as-measured, none,"
        " or a .toml file with uncertainties"
    ):
        load_uncertainty("much", where="--uncertainty")
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_uncertainty("nowhere.toml")
