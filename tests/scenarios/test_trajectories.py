"""Recorded trajectories: what is read, and the line for everything that cannot be."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from geometry.actors import pick_actor
from geometry.errors import InputError
from scenarios.trajectories import read_tracks

HEADER = "id,time,x,y,heading,class"


def csv_of(rows, header=HEADER):
    """The text of a table with commas."""
    lines = [header]
    for row in rows:
        lines.append(",".join(map(str, row)))
    return "\n".join(lines) + "\n"


def walk(name="a", word="pedestrian", *, steps=range(10), step_s=0.1, speed_mps=1.0):
    """Rows of somebody who walks east from (0, 2)."""
    rows = []
    for n in steps:
        time_s = n * step_s
        rows.append((name, time_s, time_s * speed_mps, 2.0, 90.0, word))
    return rows


def read(tmp_path, text, name="a.csv", **options):
    """What is read of a text."""
    path = tmp_path / name
    path.write_text(text)
    return read_tracks(path, **options)


def refusal(tmp_path, text, name="a.csv", **options):
    """What is told of a text behind the name of its file."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, name, **options)

    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{tmp_path / name}: ")


def test_a_csv_file_gives_tracks_by_id_whatever_the_order_of_rows(tmp_path):
    rows = sorted(walk("a") + walk("b", "CAR"), key=lambda row: row[1])
    (a, b), n_left_out = read(tmp_path, csv_of(rows))

    assert a.id == "a"
    assert a.class_name == "pedestrian"
    assert b.class_name == "vehicle"
    assert n_left_out == 0
    assert_allclose(a.position_m, [[0.1 * n, 2.0] for n in range(10)])
    np.testing.assert_array_equal(a.yaw_deg, 90.0)
    assert_allclose(a.velocity_mps(np.array([0.0, 0.45, 0.9])), [[1.0, 0.0]] * 3)


@pytest.mark.parametrize("scale", [1.0, 1.0e3, 1.0e6, 1.0e9])
@pytest.mark.parametrize("start_s", [0.0, 23.0, 1_626_155_123.0])
def test_times_are_of_any_clock_and_unit(tmp_path, caplog, scale, start_s):
    rows = []
    for name, time_s, *others in walk():
        rows.append((name, f"{(start_s + time_s) * scale:.0f}", *others))
        if scale == 1.0:
            rows[-1] = (name, f"{start_s + time_s:.1f}", *others)

    ((track,), n_left_out) = read(tmp_path, csv_of(rows))

    assert n_left_out == 0
    assert_allclose(track.time_s - start_s, 0.1 * np.arange(10), atol=1e-6)
    assert_allclose(track.velocity_mps(track.time_s[5:6]), [[1.0, 0.0]], atol=1e-4)

    word = {
        1.0: "s",
        1.0e3: "ms",
        1.0e6: "us",
        1.0e9: "ns",
    }[scale]
    told = f"{tmp_path / 'a.csv'}: times read as {word}, in steps of 0.1 s"
    expected = [told]
    if scale == 1.0:
        expected = []

    assert caplog.messages == expected

    # A column that says its unit needs no guess.
    caplog.clear()
    head = HEADER.replace("time", f"Timestamp [{word}]")
    ((named,), _) = read(tmp_path, csv_of(rows, head))

    assert_allclose(named.time_s, track.time_s)
    assert not caplog.messages


def test_a_unit_that_is_named_is_believed(tmp_path):
    rows = [(name, round(10.0 * time_s), *others) for name, time_s, *others in walk()]
    ((track,), _) = read(tmp_path, csv_of(rows, HEADER.replace("time", "time_s")))

    assert_allclose(track.time_s, range(10))

    rows = [(name, 100 * one, *others) for name, one, *others in rows]
    _, n_left_out = read(tmp_path, csv_of(rows, HEADER.replace("time", "time_s")))

    assert n_left_out == 10


def test_columns_frames_and_radians_of_dut_are_recognised(tmp_path):
    rows = [(7, 24 * n, "veh", 3.0 * n, 0.0, math.pi / 2, 3.0) for n in range(4)]
    text = csv_of(rows, "id,frame,label,x_est,y_est,psi_est,vel_est")
    ((track,), _) = read(tmp_path, text, frame_rate_hz=24.0)

    assert_allclose(track.time_s, range(4))
    assert_allclose(track.yaw_deg, 90.0)
    assert refusal(tmp_path, text).startswith("line 1: got id, frame, label, x_est")


def test_columns_may_have_other_names_and_one_class(tmp_path):
    rows = [("p", n, 0.5 * n, 0.0) for n in range(4)]
    text = csv_of(rows, "who,time,east,north")
    names = {"id": "who", "x": "east", "y": "north"}
    ((track,), _) = read(
        tmp_path,
        text,
        columns=names,
        class_name="cyclist",
    )

    assert track.id == "p"
    assert track.class_name == "cyclist"
    assert np.isnan(track.yaw_deg).all()


def test_who_is_away_for_a_while_comes_back_as_somebody_else(tmp_path):
    rows = walk(steps=[*range(5), *range(30, 36)])
    (first, second), _ = read(tmp_path, csv_of(rows))

    assert first.id == "a.1"
    assert second.id == "a.2"
    assert len(first.time_s) == 5
    assert len(second.time_s) == 6


def test_who_has_another_class_or_is_seen_briefly_is_counted(tmp_path):
    rows = [*walk("a", steps=range(2)), *walk("b", "horse"), *walk("c")]
    (track,), n_left_out = read(tmp_path, csv_of(rows))

    assert track.id == "c"
    assert n_left_out == 2


@pytest.mark.parametrize(
    ("message", "steps", "more"),
    [
        (
            "line 4: time: got 0.1 s after 0.1 s; expected times of a that",
            [0, 1, 1, 2],
            "",
        ),
        (
            "line 4: time: got 0.1 s after 0.2 s; expected times of a that",
            [0, 2, 1],
            "",
        ),
        (
            (
                "line 10: time: got 0.05 s after the one before; expected steps "
                "of 0.1 s, as in most"
            ),
            range(8),
            "a,0.75,0.75,2,90,pedestrian",
        ),
        (
            (
                "line 6: got 9.0 m in 0.1 s; expected a track of a without "
                "jumps, at most 12 m/s"
            ),
            range(4),
            "a,0.4,9.3,2,90,pedestrian",
        ),
        ("line 6: x: got 'nan'; expected a fini", range(4), "a,1.0,nan,2,90,ped"),
        ("line 6: time: got '1e999'; expected", range(4), "a,1e999,1.0,2,0,ped"),
        ("line 6: got 3 columns; expected 6", range(4), "a,1.0,1.0"),
        ("got nobody; expected trajectories of road users", [], ""),
    ],
)
def test_what_cannot_be_is_told_with_its_line(tmp_path, message, steps, more):
    text = csv_of(walk(steps=steps))
    assert refusal(tmp_path, text + more).startswith(message)


@pytest.mark.parametrize(
    ("header", "message", "options"),
    [
        ("id,time,x,class", "expected a column y, one of y, y_m, y_est", {}),
        ("id,x,y,class", "expected a column time in seconds, or frame with `rate`", {}),
        ("id,time,x,y", "expected a column with the class, or `class`", {}),
        (
            "id,time,x,y",
            "got 'east'; expected a column: id, time",
            {"columns": {"x": "east"}},
        ),
        (
            "id,time,x,y",
            "columns: got 'up'; expected one of id, time",
            {"columns": {"up": "x"}},
        ),
        (
            "id,time,x,y",
            "class: got 'dog'; expected one of pedestrian",
            {"class_name": "dog"},
        ),
    ],
)
def test_missing_columns_are_named(tmp_path, header, message, options):
    assert message in refusal(tmp_path, csv_of([], header), **options)


def test_floating_car_data_of_sumo(tmp_path):
    steps = ""
    for n in range(4):
        steps += (
            f'<timestep time="{n}">'
            f'<vehicle id="v" x="{10 * n}" y="5" angle="90" type="t"/>'
            f'<vehicle id="b" x="0" y="{n}" angle="0" type="DEFAULT_BIKETYPE"/>'
            f'<person id="p" x="1" y="{n}" angle="0"/></timestep>'
        )

    tracks, _ = read(tmp_path, f"<fcd-export>{steps}</fcd-export>", "a.xml")

    classes = [track.class_name for track in tracks]

    assert classes == ["vehicle", "cyclist", "pedestrian"]

    # The front bumper stands where SUMO's does.
    front_m = tracks[0].position_m[:, 0] + 0.5 * pick_actor("vut", "vut").length_m
    assert_allclose(front_m, [0.0, 10.0, 20.0, 30.0])
    assert_allclose(tracks[1].yaw_deg, 90.0)

    lost = (
        '<fcd-export><timestep time="0"><person id="p" x="1"'
        ' angle="0"/></timestep></fcd-export>'
    )
    message = "timestep 0, person p: y: got nothing; expected a finite number"

    assert refusal(tmp_path, lost, "a.xml") == message


def test_other_files_are_refused(tmp_path):
    text = refusal(tmp_path, "", "a.txt")
    other = refusal(tmp_path, "<a/>", "a.xml")

    assert text == "got '.txt'; expected .csv, or .xml of SUMO"
    assert other == "got 'a'; expected an element <fcd-export>"
