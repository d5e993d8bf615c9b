"""``--traffic``: what drives by in sampled worlds, as a user asks for it and is told of it."""

import importlib.util
import json

import pytest

from experiments.jobs import placement

HEAD = "timestep_time,vehicle_id,vehicle_x,vehicle_y,vehicle_angle,vehicle_type\n"
MIDDLE_M = (-126.76, 1.89)  # of the study's junction


@pytest.fixture
def vans(tmp_path):
    """A minute of vans, one every 4 s, that drive west at 10 m/s beside the middle."""
    path = tmp_path / "vans.csv"
    rows = [
        f"{0.5 * k:.1f},van{n},{MIDDLE_M[0] + 95 - 5 * (k - 8 * n)},{MIDDLE_M[1] + 6.5},270,van\n"
        for k in range(121)
        for n in range(15)
        if 0 <= k - 8 * n <= 38
    ]
    path.write_text(HEAD + "".join(rows))
    return path


def test_a_file_of_traffic_drives_by_in_sampled_worlds(
    run, small_study, monkeypatch, vans, request
):
    monkeypatch.setattr(placement, "MIN_FRESH_WORLDS", 2)
    asked = ("--budget", 1, "--samples", 1, "--traffic", vans, "--quiet")
    code, out, _ = run(*asked, "--json", "--out", "with")
    assert code == 0
    summary = json.loads(out)
    moving = summary["sampled"]["moving"]
    assert summary["sampled"]["traffic_source"] == "vans.csv"
    assert moving["n_runs"] == 2 * summary["runs"]
    assert 0 <= moving["n_left_out"] < moving["n_vehicles"]
    with open("with/report.html", encoding="utf-8") as file:  # noqa: PTH123
        page = file.read()
    said = f"{moving['n_left_out']} of {moving['n_vehicles']}"
    assert page.count(said) >= 2  # in the answer and among the assumptions
    assert "vehicles that drive by (vans.csv)" in page
    request.getfixturevalue("without_figures")
    code, out, _ = run(*asked, "--json", "--out", "again")
    assert json.loads(out)["sampled"] == summary["sampled"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--traffic", "sumo"), "--traffic: got it without --samples; expected both"),
        (
            ("--traffic-offset", "1,2"),
            "--traffic-offset: got it without --traffic; expected both",
        ),
        (
            ("--traffic", "cars.avi", "--samples", 1),
            "got 'cars.avi'; expected sumo, a .toml file",
        ),
        (
            ("--traffic", "VANS", "--traffic-offset", "-900,0", "--samples", 1),
            "vans.csv: got no vehicle within 100 m of the junction, the nearest 8",
        ),
    ],
)
def test_what_cannot_be_asked_is_one_clear_line(run, small_study, vans, options, message):
    options = [vans if option == "VANS" else option for option in options]
    code, out, err = run("--budget", 1, *options, "--quiet")
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_without_sumo_one_line_says_what_is_missing(run, small_study, monkeypatch):
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "libsumo" else real(name)
    )
    code, out, err = run("--budget", 1, "--samples", 1, "--traffic", "sumo", "--quiet")
    assert (code, out) == (2, "")
    assert "pip install place-rsus[traffic]" in err
    assert err.count("\n") == 1
