"""The package as a library: names, what objects print, all in a few lines."""

import subprocess
import sys

import pytest
from numpy.testing import assert_array_equal

import placement


def test_every_public_name_is_there_and_nothing_else_is_listed():
    assert dir(placement) == placement.__all__ == sorted(placement.__all__)

    for name in placement.__all__:
        assert getattr(placement, name).__name__ == name


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="attribute plcae"):
        placement.plcae  # noqa: B018


def test_solvers_and_rays_are_loaded_when_first_used():
    code = "import sys, placement; placement.Question; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()

    assert "placement.question" in loaded
    assert not {"cvxpy", "open3d", "matplotlib", "numpy"} & set(loaded)


@pytest.fixture(scope="module")
def found():
    """What the library finds for a small question."""
    setting = placement.build_setting(
        placement.Question(cases="CPNC-50", approaches="north")
    )
    few = placement.build_candidates(setting.scene)[::97]
    found = placement.place(
        placement.Assembly(
            setting=setting,
            candidates=few,
            wishes=placement.Wishes(budget_units=2),
        )
    )
    return setting, found, placement.evaluate_layout(found.layout, setting)


def test_a_placement_prints_its_units_and_its_proof(found):
    _, best, _ = found
    text = str(best)

    for unit in best.layout.units:
        assert f"{unit.pose.position_m[0]:.1f}" in text
        assert unit.site_id in text

    assert "apr_one_failed" in text
    assert best.certificate.solver in text
    assert "<table" in best._repr_html_()
    assert "<table" in best.certificate._repr_html_()


def test_a_layout_is_a_table(found):
    frame = found[1].layout.to_frame()
    expected = [unit.pose.position_m for unit in found[1].layout.units]
    assert_array_equal(
        frame[["x_m", "y_m", "z_m"]],
        expected,
    )


def test_an_evaluation_prints_the_apr_of_every_party(found):
    _, best, judged = found
    frame = judged.to_frame()

    assert list(frame.index) == ["all runs", "CPNC-50"]

    expected = [
        "rsu_all",
        "vut",
        "vut_and_rsus",
        *(unit.id for unit in best.layout.units),
    ]

    assert list(frame.columns) == expected
    assert frame.loc["all runs", "vut"] == placement.apr(judged.vut, judged.axis)

    title = str(judged).splitlines()[0]

    assert title == f"{best.layout.name}: accident prevention ratio"
    assert "<table" in judged._repr_html_()
