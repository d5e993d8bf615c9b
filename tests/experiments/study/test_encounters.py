"""The crosswalk of DUT, with made-up clips; and people as measured, with made-up people."""

import math

import numpy as np
import pytest
from click.testing import CliRunner

from experiments.study import encounters, people
from geometry.junction import build_junction
from placement.compute import Compute
from scenarios.paths import rotated

RATE_HZ = encounters.RATE_HZ
N_FRAMES = 120


def put_clip(folder, number, *, turn_deg=0.0, shift_m=(0.0, 0.0)):
    """Two parked cars, one that drives east at 5 m/s, a walker who would be hit at 4.5 s.

    In pictures north is down; all of it is turned and shifted.
    """
    cars, walkers = [], []

    def row(name, frame, word, x, y, yaw_deg=None):
        east, north = rotated([x, y], turn_deg) + shift_m
        last = () if yaw_deg is None else (-math.radians(yaw_deg + turn_deg), 0.0)
        return ",".join(map(str, (name, frame, word, east, -north, *last)))

    for frame in range(N_FRAMES):
        time_s = frame / RATE_HZ
        cars.append(row(0, frame, "veh", 12.0, -6.0, 0.0))
        cars.append(row(1, frame, "veh", 12.0, -9.0, 180.0))
        if time_s < 4.0:
            cars.append(row(2, frame, "veh", 5.0 * (time_s - 4.5) - 2.446, 0.0, 0.0))
        walkers.append(row(0, frame, "ped", 0.3, 1.4 * (time_s - 4.5)))
        walkers.append(row(1, frame, "ped", -8.0, -0.7 + 1.4 * time_s))
        walkers.append(row(2, frame, "ped", -6.0, -0.2 + 1.4 * time_s))
    name = f"intersection_{number}_traj"
    head = "id,frame,label,x_est,y_est"
    (folder / f"{name}_veh_filtered.csv").write_text("\n".join([f"{head},psi_est,v", *cars]))
    (folder / f"{name}_ped_filtered.csv").write_text("\n".join([head, *walkers]))


@pytest.fixture
def folder(tmp_path):
    put_clip(tmp_path, "01")
    put_clip(tmp_path, "02", turn_deg=8.0, shift_m=(3.0, -2.0))
    return tmp_path


def test_clips_are_laid_upon_one_another(folder):
    one, other = encounters.lay_clips(folder).values()
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.position_m, b.position_m, atol=1.0e-6)
        off_deg = (a.yaw_deg - b.yaw_deg + 180.0) % 360.0 - 180.0
        np.testing.assert_allclose(off_deg[np.isfinite(a.yaw_deg)], 0.0, atol=1.0e-6)


def test_the_street_is_made_of_what_the_tracks_tell(folder):
    scene = encounters.build_street(encounters.lay_clips(folder))
    arms = build_junction(scene).arms
    assert {name: len(arm.entry_lanes) for name, arm in arms.items()} == {"west": 1, "east": 0}
    assert [thing.id for thing in scene.instances] == ["ground", "parked-0", "parked-1"]
    feet_m = np.array([site.position_m[:2] for site in scene.sites])
    assert len(feet_m) >= 6
    assert (np.abs(feet_m[:, 1]) <= 2.5 + 1.0e-6).all()
    assert abs(scene.crosswalks_m[0, :, 1]).max() < 1.0e-6


def test_the_table_says_who_was_seen_in_time(folder):
    text, _ = encounters.study(folder, ttc_s=2.0, compute=Compute(workers=2, cache_folder=folder))
    assert text.startswith(
        "2 pairs of a moving car and a pedestrian come to a time to collision below 2 s in 2 clips"
    )
    front = "| the car's front, time to collision below 1 s | 2 | 2 | 2 | 2 | 2 |"
    assert front in text.splitlines()
    assert "| the car's side, time to collision below 3 s | 0 | 0 | 0 | 0 | 0 |" in text
    (row, _) = (line for line in text.splitlines() if line.startswith(("| 01-2-0", "| 02-2-0")))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1] == "front"
    # The car is last seen at frame 95; the walker's flank is 0.05 m beyond where its front is at
    # 4.5 s. Braking takes v / (2 a) more than the way that is left.
    assert float(cells[2]) == pytest.approx(4.51 - 95 / RATE_HZ, abs=0.006)
    assert (cells[3], cells[4]) == ("18", "5")
    assert float(cells[6]) == pytest.approx(5.0 / (2.0 * 7.72), abs=0.01)


def test_a_folder_without_clips_is_told(tmp_path):
    for command in (encounters.main, people.main):
        result = CliRunner().invoke(command, [str(tmp_path)])
        assert result.exit_code == 2
        assert len(result.output.splitlines()) == 1


def put_person(path, at):
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"{n},{0.02 * n:.2f},{at(0.02 * n):.6f},0" for n in range(500)]
    path.write_text("\n".join([",timestamp,x,y", *rows]) + "\n")


def test_people_are_measured_as_they_were_made(tmp_path):
    def start(time_s, acceleration, kept_mps):
        """Stands for 3 s, then gains its speed evenly."""
        gaining_s = min(max(time_s - 3.0, 0.0), kept_mps / acceleration)
        rest_s = max(time_s - 3.0 - kept_mps / acceleration, 0.0)
        return 0.5 * acceleration * gaining_s**2 + kept_mps * rest_s

    for place, kept in (("pedestrians", 1.5), ("cyclists", 4.0)):
        for n in range(11):
            speed_mps = kept * (0.5 + 0.1 * n)
            put_person(tmp_path / place / "moving" / f"{n}.csv", lambda t, v=speed_mps: v * t)
            put_person(
                tmp_path / place / "starting" / f"{n}.csv", lambda t, v=kept: start(t, 1.0, v)
            )
    import tomllib

    section = tomllib.loads(people.measure(tmp_path))
    for name, kept in (("pedestrian", 1.5), ("cyclist", 4.0)):
        speeds = section[name]["speed_kmh"]
        assert speeds[5] == pytest.approx(kept * 3.6, rel=0.01)
        assert speeds[1] == pytest.approx(kept * 3.6 * 0.6, rel=0.01)
        # Over a second the ends of a start are blurred: a short one seems gentler.
        assert section[name]["start_mps2"][5] == pytest.approx(1.0, abs=0.2)
