"""How far units may be off before something is lost."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_worlds import setting_of, table_of, unit_at

from geometry.catalogue import load_cameras
from geometry.poses import Pose, wrap_deg
from geometry.study_scene import load_study_scene
from placement.explain.tolerances import (
    LIFTS_M,
    TURNS_DEG,
    find_standing,
    find_tolerances,
)
from placement.optimiser import run_margins_s
from placement.wishes import Wishes, build_problem

CAMERA = load_cameras()["carla-ncap-rgb-90"]


@pytest.fixture(scope="module")
def setting(runs, rule):
    """Runs that come three ways."""
    ways = ("CBNA/east/60", "CPNC-50/east/55", "CPNC-50/west/60", "CBNA/south/60")
    few = [run for run in runs if run.id in ways]
    return setting_of(load_study_scene(), few, rule=rule)


def unit(name, yaw_deg):
    """A camera at the corner's pole, 8 m high."""
    return unit_at(
        name,
        [-115.4, 8.85, 8.0],
        yaw_deg=yaw_deg,
        pitch_deg=-40.0,
        sensor=CAMERA,
    )


def avoided(setting, units):
    """Weight of the runs that units avoid."""
    table = table_of(setting, units)
    existing = tuple(one.id for one in units[1:])
    wishes = Wishes(budget_units=len(units), existing=existing)
    problem = build_problem(setting, units, table, wishes=wishes)
    rows = range(len(units))
    margins_s = run_margins_s(problem, rows)
    return np.isfinite(margins_s)


def moved(one, *, yaw_deg=0.0, pitch_deg=0.0, height_m=0.0):
    """A unit off by these errors."""
    pose = one.pose
    return replace(
        one,
        pose=Pose(
            position_m=pose.position_m + [0.0, 0.0, height_m],
            yaw_deg=float(wrap_deg(pose.yaw_deg + yaw_deg)),
            pitch_deg=pose.pitch_deg + pitch_deg,
        ),
    )


@pytest.mark.long
def test_within_its_tolerances_nothing_is_lost_and_a_step_beyond_something_is(setting):
    one = unit("a", -135.0)
    planned = avoided(setting, [one])

    assert planned.any()

    (found,) = find_tolerances(setting, [one])
    limited = 0
    for axis, steps, (low, high) in (
        ("yaw_deg", TURNS_DEG, found.yaw_deg),
        ("pitch_deg", TURNS_DEG, found.pitch_deg),
        ("height_m", LIFTS_M, found.height_m),
    ):
        for sign, good in (
            (-1.0, low),
            (1.0, high),
        ):
            within = [step for step in steps if step <= good]

            assert good == (within[-1] if within else 0.0)

            if within:
                turned = moved(one, **{axis: sign * good})
                kept = avoided(setting, [turned])
                assert not (planned & ~kept).any()

            too_far = [step for step in steps if step > good]
            beyond = too_far[:1]

            for step in beyond:
                limited += 1
                turned_further = moved(one, **{axis: sign * step})
                kept = avoided(setting, [turned_further])

                assert (planned & ~kept).any()

    assert limited


def test_a_twin_lets_a_unit_be_off_by_all_that_is_tried(setting):
    twins = [
        unit("a", -135.0),
        unit("b", -135.0),
    ]
    for found in find_tolerances(setting, twins):
        widest = (TURNS_DEG[-1], TURNS_DEG[-1])
        highest = (LIFTS_M[-1], LIFTS_M[-1])

        assert found.yaw_deg == found.pitch_deg == widest
        assert found.height_m == highest


@pytest.mark.long
def test_usual_errors_cost_what_a_layout_built_so_has(setting):
    one = unit("a", -135.0)
    found = find_standing(setting, [one])
    planned = avoided(setting, [one])
    cost = {}
    for kind, name, size in (
        ("yaw", "yaw_deg", 1.0),
        ("pitch", "pitch_deg", 1.0),
        ("height", "height_m", 0.05),
    ):
        for step in (-size, size):
            off = moved(one, **{name: step})
            left = avoided(setting, [off])
            left_share = left.mean()
            n_lost = (planned & ~left).sum()
            cost[kind, step] = (left_share, int(n_lost))

    worst = found.worst

    expected = min(apr for apr, _ in cost.values())
    is_tolerant = found.aim_deg >= 1.0 and found.height_m >= 0.05

    assert worst.apr == pytest.approx(expected)
    assert (worst.apr, len(worst.lost_run_ids)) == pytest.approx(
        cost[worst.kind, worst.step]
    )
    assert is_tolerant == (not worst.lost_run_ids)

    (tolerance,) = find_tolerances(setting, [one])
    expected_aim_deg = min(2.0, *tolerance.yaw_deg, *tolerance.pitch_deg)
    expected_height_m = min(0.05, *tolerance.height_m)

    assert found.aim_deg == expected_aim_deg
    assert found.height_m == expected_height_m
