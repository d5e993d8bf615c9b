"""``place-rsus doctor``: what it finds of the machine."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from experiments.cli import doctor
from experiments.cli.doctor import doctor_text, examine
from geometry.text_formats import load_data

PROJECT = Path(__file__).parents[3] / "pyproject.toml"


@pytest.mark.long
def test_what_is_installed_is_told(run, tmp_path):
    code, out, _ = run("doctor --json")
    summary = json.loads(out)

    assert code == 0
    assert summary["is_well"]
    assert summary["libraries"]["numpy"]
    assert "HIGHS" in summary["milp_solvers"]
    assert summary["rays"]["by"] in ("open3d", "embree")

    code, text, _ = run("doctor")
    assert "mixed-integer solvers: HIGHS" in text
    assert max(map(len, text.splitlines())) <= 80


def test_every_extra_is_looked_for_by_the_name_of_its_package():
    project = tomllib.loads(PROJECT.read_text())["project"]
    wanted = {}
    for extra, requirements in project["optional-dependencies"].items():
        names = [re.split(r"[<>=;~! ]", one, maxsplit=1)[0] for one in requirements]
        wanted[extra] = names
    listed = load_data("experiments", "installed.toml")["extras"]

    assert {one["extra"] for one in listed} == wanted.keys()
    for one in listed:
        assert one["package"] in wanted[one["extra"]]


def test_what_is_missing_is_told_with_what_it_costs(tmp_path, monkeypatch):
    real = doctor._version
    gone = ("requests", "cvxpy")
    monkeypatch.setattr(
        doctor, "_version", lambda name: None if name in gone else real(name)
    )
    monkeypatch.setattr(
        "geometry.raycast.open3d_problem", lambda: "Open3D cannot load: libusb " * 4
    )
    (tmp_path / "table-1.npz").write_bytes(b"x" * 2**20)
    summary = examine(tmp_path)

    assert not summary["is_well"]
    assert summary["cache"]["files"] == 1

    text = doctor_text(summary)
    assert "requests               not installed (place-rsus[online])" in text
    assert "MISSING: place-rsus does not work without it" in text
    assert "embreex casts the same rays" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    "folder", ["file/below", pytest.param("gone/deep", marks=pytest.mark.long)]
)
def test_a_cache_that_cannot_be_is_told(tmp_path, folder):
    (tmp_path / "file").write_text("")
    summary = examine(tmp_path / folder)
    assert summary["cache"]["is_writable"] == folder.startswith("gone")
