"""What refinement has changed, in words and as a record."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from tiny_worlds import unit_at

from experiments.parts.explanation import build_refinement_record, refinement_sentences
from experiments.results.record import to_plain
from geometry.catalogue import pick_sensor
from placement.layout import Certificate, Layout, Stage
from placement.refinement import Refinement, rename

MINUS = "\N{MINUS SIGN}"
NAMES = ("apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s", "cost_eur")


def _unit(name, *, east=0.0, height=5.0, yaw=0.0, pitch=-15.0, camera="carla-ncap-rgb"):
    """A unit on a pole. [m, deg]"""
    return unit_at(
        name,
        [east, 0.0, height],
        yaw_deg=yaw,
        pitch_deg=pitch,
        site_id="pole",
        sensor=pick_sensor(camera, "test"),
    )


def _values(*numbers):
    """Values of the objectives, by their names."""
    return dict(zip(NAMES, numbers, strict=True))


BEFORE = _values(1.0, 0.0, 0.333, 3.81, 1500.0)


def _refinement(old, new, after, *, gap=0.0, old_values=BEFORE):
    """A refinement of some units into others."""
    before = Layout(name="best", units=tuple(old))
    layout, moves = rename(before, new, named=["RSU1"], name="refined")
    stage = Stage(
        name="apr",
        objective=1.0,
        bound=1.0,
        gap=gap,
        seconds=0.1,
    )
    unrefined = SimpleNamespace(
        layout=before,
        problem=SimpleNamespace(table=SimpleNamespace(n_poses=5772)),
        certificate=Certificate(stages=(stage,), solver="any"),
    )
    return Refinement(
        unrefined=unrefined,
        placement=SimpleNamespace(layout=layout),
        candidates=(),
        before=old_values,
        after=after,
        moves=moves,
        n_tried=760,
        seconds=12.5,
    )


def _sentences(refinement):
    """What is said of a refinement."""
    return refinement_sentences(build_refinement_record(refinement))


def test_a_turned_unit_is_told_with_all_objectives_that_changed():
    found = _refinement(
        [_unit("U1", yaw=-135.0)],
        [_unit("x", yaw=-141.94, pitch=-14.5, height=5.22)],
        _values(1.0, 0.0, 0.433, 3.74, 1500.0),
    )
    changed, proof = _sentences(found)

    assert (
        changed == f"Refinement turned U1 by {MINUS}6.94\N{DEGREE SIGN}, tilted it by"
        f" 0.50\N{DEGREE SIGN} and raised it by 0.22 m: smallest time to spare 0.33"
        " s to 0.43 s, mean time to spare 3.81 s to 3.74 s."
    )
    assert (
        proof == "Proven: no choice among the 5772 grid candidates is as good."
        " The bounds of the refined layout hold for these and the 760 poses tried"
        " between them, but not for every possible pose."
    )


def test_a_grid_that_is_not_proven_is_not_said_to_be():
    found = _refinement(
        [_unit("U1")],
        [_unit("x", yaw=1.0)],
        BEFORE | {"smallest_margin_s": 0.5},
        gap=0.1,
    )
    assert "proven" not in _sentences(found)[1]
    assert _sentences(found)[1].startswith(
        "It is better than the best choice found in time among the 5772 grid"
        " candidates."
    )


def test_units_that_are_new_gone_lowered_zoomed_or_renamed_are_told():
    zoom = _unit("U1", camera="varifocal-1080p")
    closer = replace(zoom.sensor, horizontal_fov_deg=60.0)
    found = _refinement(
        [zoom, _unit("RSU1", east=5.0), _unit("U3", east=9.0)],
        [
            replace(zoom, id="a", sensor=closer),
            _unit("b", east=5.0, height=4.5),
            _unit("c", east=20.0),
        ],
        _values(1.0, 0.25, 0.333, 3.8104, 1450.0),
    )

    assert (
        _sentences(found)[0]
        == f"Refinement zoomed U1 by {MINUS}29.60\N{DEGREE SIGN}, lowered RSU1 (now U2)"
        " by 0.50 m, removed U3 and added U4: APR if the most needed unit fails 0.0"
        " % to 25.0 %, mean time to spare 3.8100 s to 3.8104 s, cost 1500 EUR to"
        " 1450 EUR."
    )


def test_shares_that_print_alike_get_more_digits():
    found = _refinement(
        [_unit("U1")],
        [_unit("x", yaw=1.0)],
        BEFORE | {"apr": 0.99991},
        old_values=BEFORE | {"apr": 0.9999},
    )
    assert "APR 99.990 % to 99.991 %." in _sentences(found)[0]


def test_nothing_better_is_said_as_it_is():
    found = _refinement([_unit("U1")], [_unit("x")], BEFORE)
    assert not found.is_improved
    assert _sentences(found) == [
        "Refinement tried 760 poses between the 5772 candidates of the grid and found"
        " nothing better."
    ]


def test_the_summary_holds_all_numbers():
    after = _values(1.0, 0.0, 0.5, 3.0, 1500.0)
    summary = to_plain(
        build_refinement_record(
            _refinement([_unit("U1")], [_unit("x", yaw=1.0)], after)
        )
    )
    assert summary == {
        "is_improved": True,
        "before": dict(BEFORE),
        "after": dict(after),
        "moves": [
            {
                "was": "U1",
                "is": "U1",
                "is_same_place": True,
                "turn_deg": pytest.approx(1.0),
                "tilt_deg": 0.0,
                "lift_m": 0.0,
                "zoom_deg": 0.0,
            }
        ],
        "grid_candidates": 5772,
        "grid_is_proven": True,
        "poses_tried": 760,
        "seconds": 12.5,
    }
