"""Rows of the live table are those of the detection table, whatever is turned, zoomed
or raised.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_results import build_small_setting
from tiny_worlds import table_of, unit_at

from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from placement import live
from placement.live import LiveTable, table_verdict
from placement.optimiser import Limits, PlacementProblem, run_margins_s
from scenarios.aeb import AebRule


@pytest.fixture(scope="module")
def setting():
    """A few runs."""
    return build_small_setting()


@pytest.fixture(scope="module")
def table(setting):
    """Shared by all examples: what is kept must not change what is found."""
    return LiveTable(setting)


def unit(
    setting,
    *,
    site=0,
    height_m=6.0,
    yaw_deg=0.0,
    pitch_deg=-15.0,
    sensor=None,
    name="U1",
):
    """A unit at a site of the scene."""
    mount = setting.scene.sites[site]
    return unit_at(
        name,
        mount.position_m + [0.0, 0.0, height_m],
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        site_id=mount.id,
        sensor=sensor,
    )


def built(setting, units):
    """Detections by the builder of tables."""
    return table_of(setting, units).detected(slice(None))


def zoomed(fov_deg):
    """The camera at a field of view."""
    camera = load_cameras()["carla-ncap-rgb"]
    return replace(camera, horizontal_fov_deg=fov_deg, fov_range_deg=(20.0, 100.0))


@pytest.mark.long
@settings(max_examples=15)
@given(
    site=st.integers(0, 3),
    height_m=st.sampled_from([4.0, 6.0]),
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-60.0, 10.0),
    fov_deg=st.sampled_from([None, 20.0, 47.0, 100.0]),
)
def test_rows_are_those_of_the_detection_table(
    setting,
    table,
    site,
    height_m,
    yaw_deg,
    pitch_deg,
    fov_deg,
):
    if fov_deg is None:
        sensor = None
    else:
        sensor = zoomed(fov_deg)

    where = {
        "site": site,
        "height_m": height_m,
        "yaw_deg": yaw_deg,
        "pitch_deg": pitch_deg,
    }
    units = [unit(setting, **where, sensor=sensor)]

    assert (table.detected(units) == built(setting, units)).all()


def test_a_lidar_and_cameras_at_one_mount_see_what_each_sees_alone(setting):
    lidar = next(iter(load_lidars().values()))
    units = [
        unit(setting, sensor=lidar, name="L", pitch_deg=0.0),
        unit(setting, yaw_deg=200.0, name="C"),
        unit(setting, yaw_deg=200.0, sensor=zoomed(47.0), name="Z"),
    ]

    found = LiveTable(setting).detected(units)

    assert found.any(axis=1).sum() >= 2
    assert (found == built(setting, units)).all()


def test_a_turn_casts_no_ray_and_a_lift_does(setting):
    fresh = LiveTable(setting)
    fresh.detected([unit(setting)])
    fresh.detected(
        [unit(setting, yaw_deg=33.0, pitch_deg=-20.0), unit(setting, yaw_deg=34.0)]
    )

    assert fresh.n_casts == 1

    fresh.detected([unit(setting, height_m=6.5)])

    assert fresh.n_casts == 2


def test_what_is_given_up_is_found_again_the_same(setting, monkeypatch):
    monkeypatch.setattr(live, "MAX_ROWS", 1)
    few = LiveTable(setting, max_mounts=1)
    units = [
        unit(setting, site=site, yaw_deg=210.0, name=f"U{site}") for site in range(3)
    ]
    first = few.detected(units)
    again = few.detected(units)

    assert few.n_casts == 5  # one row is still known
    assert (first == again).all()
    assert (first == built(setting, units)).all()


def test_a_verdict_by_the_table_is_what_the_optimiser_reads(setting, table):
    units = [
        unit(setting, site=site, yaw_deg=210.0, name=f"U{site}") for site in range(2)
    ]
    detected = table.detected(units)

    verdict = table_verdict(units, detected, setting)
    rows = table_of(setting, units)

    limits = Limits(
        site_index=np.arange(2),
        site_capacity=np.ones(2, dtype=int),
        budget_units=2,
    )
    problem = PlacementProblem(
        table=rows,
        limits=limits,
        fusion="any",
        rule=setting.rule,
    )

    assert (verdict.is_avoided == (run_margins_s(problem, [0, 1]) > -np.inf)).all()
    assert verdict.is_avoided.any()


def test_a_slow_unit_brakes_later(setting, table):
    one = unit(setting, yaw_deg=210.0)
    quick = table_verdict([one], table.detected([one]), setting)
    slow_one = replace(one, latency_s=0.4)

    slow = table_verdict([slow_one], table.detected([slow_one]), setting)

    assert isinstance(setting.rule, AebRule)

    known = np.isfinite(slow.onset_time_s) & np.isfinite(quick.onset_time_s)

    assert known.any()
    assert (slow.onset_time_s[known] > quick.onset_time_s[known]).all()
