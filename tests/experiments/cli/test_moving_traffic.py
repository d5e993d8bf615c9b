"""``--traffic``: what drives by in sampled worlds, as a user asks for it and is told of
it.
"""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from command_results import refusal

from experiments.jobs import placement
from geometry.actors import load_actors
from placement.sampling.moving import sumo
from placement.sampling.moving.sumo import SimulatedWindows
from placement.sampling.moving.trajectories import Trajectories

MIDDLE_M = np.array([-126.76, 1.89])  # of the study's junction


@pytest.fixture
def vans(monkeypatch):
    """In place of SUMO: two minutes of vans, one every 4 s, west at 10 m/s beside the
    middle.
    """
    van = load_actors()["parked-van"]
    n_vans = 30
    step_s = 0.1
    along_m = np.arange(95.0, -96.0, -10.0 * step_s)
    starts_s = 4.0 * np.arange(n_vans)
    driven = Trajectories(
        bodies=(van,) * n_vans,
        row_start=len(along_m) * np.arange(n_vans + 1),
        time_s=(starts_s[:, None] + step_s * np.arange(len(along_m))).ravel(),
        position_m=np.tile(
            MIDDLE_M + np.column_stack([along_m, 0.0 * along_m + 6.5]), (n_vans, 1)
        ),
        yaw_deg=np.full(n_vans * len(along_m), 180.0),
        step_s=step_s,
        first_s=0.0,
        last_s=float(starts_s[-1] + step_s * len(along_m)),
    )

    def simulate(network, demand, groups, *, reach_m, step_s, rng):
        impact_s = rng.integers(200, 1000, size=len(groups)) * 0.1
        return SimulatedWindows(
            trajectories=driven,
            impact_s=dict(zip(groups, impact_s.tolist(), strict=True)),
            n_departed=n_vans,
            n_waiting=0,
        )

    monkeypatch.setattr(sumo, "simulate_windows", simulate)
    monkeypatch.setattr(sumo, "build_network", lambda scene, **options: None)
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name: name if name == "libsumo" else real(name),
    )


# Quickly: tests/placement/sampling/test_traffic.py
@pytest.mark.long
@pytest.mark.usefixtures("vans")
def test_traffic_drives_by_in_sampled_worlds(
    run, ask, small_study, monkeypatch, request
):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 2)
    asked = "--budget 1 --samples 1 --traffic sumo --quiet --workers 1"
    summary = ask(asked, "--out with")
    moving = summary["sampled"]["moving"]

    assert summary["sampled"]["traffic_source"] == "SUMO, demand default"
    assert moving["n_runs"] == 2 * summary["runs"]
    assert 0 <= moving["n_left_out"] < moving["n_vehicles"]

    page = Path("with/report.html").read_text()
    said = f"{moving['n_left_out']} of {moving['n_vehicles']}"

    assert page.count(said) >= 2  # in the answer and among the assumptions
    assert "vehicles that drive by (SUMO, demand default)" in page

    request.getfixturevalue("without_figures")
    _, out, _ = run(asked, "--json --out again")
    assert json.loads(out)["sampled"] == summary["sampled"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--traffic", "sumo"), "--traffic: got it without --samples; expected both"),
        (
            ("--traffic", "cars.avi", "--samples", 1),
            "got 'cars.avi'; expected sumo, or a .toml file",
        ),
    ],
)
def test_what_cannot_be_asked_is_one_clear_line(run, small_study, options, message):
    assert message in refusal(run("--budget 1", *options, "--quiet"))


def test_without_sumo_one_line_says_what_is_missing(run, small_study, monkeypatch):
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name: None if name == "libsumo" else real(name),
    )
    assert "pip install place-rsus[traffic]" in refusal(
        run("--budget 1 --samples 1 --traffic sumo --quiet")
    )
