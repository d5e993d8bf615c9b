import json

import pytest

from experiments.cli import doctor
from experiments.cli.doctor import doctor_text, examine


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


@pytest.mark.parametrize("folder", ["file/below", "gone/deep"])
def test_a_cache_that_cannot_be_is_told(tmp_path, folder):
    (tmp_path / "file").write_text("")
    summary = examine(tmp_path / folder)
    assert summary["cache"]["is_writable"] == folder.startswith("gone")
