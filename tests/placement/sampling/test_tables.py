"""Tables of many worlds: side by side, cached, and what hides in them."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from hypothesis import given
from hypothesis import strategies as st
from sampled_worlds import table_of_world
from tiny_worlds import table_of

from geometry.lenses import BrownConrady, Fisheye
from geometry.sensors import CameraModel
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.sampling.tables import _append, build_sample_tables, sampled_table
from placement.sampling.uncertainty import (
    LatencyJitter,
    StandingTraffic,
    Uncertainty,
    VehicleKind,
)
from placement.sampling.worlds import draw_samples
from scenarios.runs import live_confirmation_times_s


def _plan(setting, candidates, seed=0):
    """The table of a plan in which nothing is uncertain."""
    return table_of(setting, candidates, compute=Compute(seed=seed))


@pytest.fixture(scope="module")
def planned(setting, candidates):
    """The plan's table."""
    return _plan(setting, candidates)


@pytest.fixture(scope="module")
def stacked(setting, candidates, default):
    """The table of three worlds."""
    return sampled_table(
        setting,
        candidates,
        default,
        n_samples=3,
        compute=Compute(seed=1),
    )


def _detected(table):
    """Detections of all poses, (n_poses, n_frames)."""
    return table.detected(slice(None))


# One table of many


def test_without_uncertainty_one_sample_is_the_plans_table(
    setting, candidates, planned
):
    sampled = sampled_table(
        setting,
        candidates,
        Uncertainty(),
        n_samples=1,
    )
    table = sampled.table
    axis = setting.axis

    assert np.array_equal(table.packed, planned.packed)
    assert table.packed.any()
    assert table.pose_ids == planned.pose_ids
    assert table.axis.run_ids == tuple(f"{run}#1" for run in axis.run_ids)

    for name in ("cases", "approaches", "weathers"):
        assert getattr(table.axis, name) == getattr(axis, name)

    for name in ("vut_speed_kmh", "weight", "last_brake_time_s", "run_start", "time_s"):
        assert np.array_equal(getattr(table.axis, name), getattr(axis, name))

    assert sampled.sample_index.tolist() == [0] * axis.n_runs


def test_worlds_stand_side_by_side_and_weigh_the_same(
    setting, candidates, default, stacked
):
    table, axis, n_runs = stacked.table, setting.axis, setting.axis.n_runs

    assert table.axis.weight.sum() == pytest.approx(1.0, abs=1e-12)

    expected = [0] * n_runs + [1] * n_runs + [2] * n_runs

    assert stacked.sample_index.tolist() == expected
    assert table.axis.run_ids[n_runs] == f"{axis.run_ids[0]}#2"
    assert table.axis.cases == axis.cases * 3

    samples = list(draw_samples(setting, candidates, default, n_samples=3, seed=1))
    parts = [table_of_world(sample, seed=1) for sample in samples]

    assert np.array_equal(
        _detected(table), np.hstack([_detected(part) for part in parts])
    )

    deadlines_s = [axis.last_brake_time_s - one.extra_latency_s for one in samples]
    expected_s = np.concatenate(deadlines_s).tolist()

    assert table.axis.last_brake_time_s.tolist() == expected_s

    for run in range(table.axis.n_runs):
        frames = table.axis.frames_of(run)
        assert np.array_equal(
            table.axis.time_s[frames], axis.time_s[axis.frames_of(run % n_runs)]
        )


def test_latency_moves_the_deadline_and_nothing_else(setting, candidates, planned):
    late = Uncertainty(latency=LatencyJitter(mean_s=0.3))

    sampled = sampled_table(setting, candidates, late, n_samples=1)

    assert np.array_equal(sampled.table.packed, planned.packed)

    before = setting.axis.last_brake_time_s
    after = sampled.table.axis.last_brake_time_s

    assert after == pytest.approx(before - 0.3)

    # As good as a rule with the longer latency.
    detected = _detected(planned).any(axis=0)

    # The age of a track is asked for at the moved moment, too.
    for memory_s in (0.2, 1.0, np.inf):
        rule = replace(setting.rule, track_memory_s=memory_s)
        slower = replace(rule, latency_s=rule.latency_s + 0.3)

        here_s = live_confirmation_times_s(detected, sampled.table.axis, rule=rule)
        expected = live_confirmation_times_s(detected, setting.axis, rule=slower)

        assert np.array_equal(here_s, expected)


@given(
    st.integers(1, 40).flatmap(
        lambda n: st.lists(
            st.lists(st.booleans(), min_size=n, max_size=n),
            min_size=1,
            max_size=4,
        )
    )
)
def test_bits_are_appended_where_they_belong(worlds):
    n_bits = len(worlds[0])
    n = len(worlds)
    packed = np.zeros((2, -(-n * n_bits // 8)), dtype=np.uint8)
    for index, bits in enumerate(worlds):
        rows = np.array([bits, [not bit for bit in bits]])
        part = np.packbits(rows, axis=1, bitorder="little")
        _append(packed, part, first_bit=index * n_bits, n_bits=n_bits)

    found = np.unpackbits(packed, axis=1, count=n * n_bits, bitorder="little").astype(
        bool
    )
    expected = [bit for bits in worlds for bit in bits]

    assert found[0].tolist() == expected
    assert np.array_equal(found[1], ~found[0])
    assert not np.unpackbits(packed, axis=1, bitorder="little")[:, n * n_bits :].any()


# Cache and progress


@pytest.mark.long
def test_each_world_has_a_cached_table_of_its_own(
    setting, candidates, default, stacked, tmp_path
):
    calls = []

    for n_samples in (2, 3, 3):
        found = sampled_table(
            setting,
            candidates,
            default,
            n_samples=n_samples,
            compute=Compute(
                seed=1,
                cache_folder=tmp_path,
                progress=lambda *call: calls.append(call),
            ),
        )
        assert len(list(tmp_path.glob("table-*.npz"))) == n_samples

    assert np.array_equal(found.table.packed, stacked.table.packed)

    stage = "sampled detection tables"
    built = (stage, 5, 6)
    cached = (stage, 3, 3)

    assert built in calls  # two mount positions in each of three worlds
    assert calls[0] == (stage, 0, 0)

    expected = [(stage, 1, 3), (stage, 2, 3), cached]

    assert calls[-3:] == expected


def test_drawn_tables_are_kept_apart(setting, candidates, tmp_path):
    chancy = replace(setting, table_detector=load_planning_detector("response"))
    drawn = Uncertainty(draws_detections=True)
    options = {"n_samples": 2, "compute": Compute(cache_folder=tmp_path)}

    first = sampled_table(chancy, candidates, drawn, **options)

    assert len(list(tmp_path.iterdir())) == 2

    again = sampled_table(chancy, candidates, drawn, **options)

    assert np.array_equal(again.table.packed, first.table.packed)

    sampled_table(chancy, candidates, Uncertainty(), **options)

    assert len(list(tmp_path.iterdir())) == 3  # both worlds are the plan

    linked = changed(chancy, "table_detector.frame_correlation", 0.1)

    other = sampled_table(linked, candidates, drawn, **options)

    assert len(list(tmp_path.iterdir())) == 5
    assert not np.array_equal(other.table.packed, first.table.packed)


# What worlds share


@pytest.mark.long
@pytest.mark.parametrize(
    ("planner", "lens"),
    [
        ("response", None),
        ("geometric", None),
        ("response", BrownConrady(k1=-0.1, p1=0.002)),
        ("geometric", Fisheye(k1=-0.02)),
    ],
)
def test_a_world_beside_others_is_as_it_is_alone(
    setting, candidates, default, planner, lens
):
    """What is kept of one world, for eyes that come up again, is what is found in
    another.
    """
    if lens is not None:
        candidates = [
            replace(
                one, sensor=replace(one.sensor, name="bent", lens=lens, roll_deg=3.0)
            )
            for one in candidates
            if isinstance(one.sensor, CameraModel)
        ]

    setting = replace(setting, table_detector=load_planning_detector(planner))

    worlds = list(draw_samples(setting, candidates, default, n_samples=4, seed=4))
    heights = [
        {pose.pose.position_m[2] for pose in world.candidates} for world in worlds
    ]

    assert len(set.union(*heights)) < sum(map(len, heights))  # they do come up again
    assert len({len(world.vehicles) for world in worlds}) > 1

    for at_once in (1, 2):
        together = list(build_sample_tables(worlds, n_samples=4, at_once=at_once))
        assert any(table.packed.any() for _, table in together)
        for world, table in together:
            assert np.array_equal(table.packed, table_of_world(world).packed)


# A queue hides a VRU


def _queue_of(actor, share):
    """One vehicle that waits as often as its share says."""
    kind = VehicleKind(actor=actor, parked_share=0.0, waiting_share=1.0)
    traffic = StandingTraffic(waiting_share=share, vehicles=(kind,))
    return Uncertainty(traffic=traffic)


@pytest.fixture(scope="module")
def truck(default):
    """The truck of the default traffic."""
    (found,) = [k.actor for k in default.traffic.vehicles if k.actor.name == "truck"]
    return found


def test_a_vehicle_that_waits_hides_a_vru_behind_it(
    junction_scene,
    standing_still,
    build_setting,
    look,
    keen,
    truck,
):
    """By hand: a box from 12.5 to 20.5 m east, 0.5 to 3.0 m north, 3.4 m high.

    The VRU stands 3 m north of it, the cameras 10.5 m south of it. A ray down to the
    road below the VRU passes the box's upper edge, 13 m away of 16 m, at 3/16 of the
    camera's height: from 20 m up all of the VRU is seen; from 9 m up the lowest ray
    over the edge is 2.11 m high there, above its 1.8 m.
    """
    assert truck.length_m == 8.0
    assert truck.width_m == 2.5
    assert truck.height_m == 3.4

    setting = build_setting(
        junction_scene, [standing_still([16.5, 6.0])], table_detector=keen
    )
    cameras = [
        look(f"{z:g}", [16.5, -10.0, z], yaw_deg=90.0, pitch_deg=pitch)
        for z, pitch in ((9.0, -25.0), (20.0, -50.0))
    ]

    rows = {
        share: _detected(
            sampled_table(setting, cameras, _queue_of(truck, share), n_samples=1).table
        )
        for share in (0.0, 1.0)
    }

    assert rows[0.0].all()

    low, high = rows[1.0]

    assert not low.any()
    assert high.all()


def test_what_waits_in_the_way_of_the_vut_hides_nothing(
    junction_scene,
    junction_runs,
    standing_still,
    build_setting,
    look,
    keen,
    truck,
):
    """The same box, but the VUT comes from the east, in whose lane it would stand."""
    runs = [
        standing_still([16.5, 6.0], run=junction_runs[way]) for way in ("west", "east")
    ]
    setting = build_setting(junction_scene, runs, table_detector=keen)
    camera = look(
        "low",
        [16.5, -10.0, 9.0],
        yaw_deg=90.0,
        pitch_deg=-25.0,
    )

    (row,) = _detected(
        sampled_table(setting, [camera], _queue_of(truck, 1.0), n_samples=1).table
    )
    hidden = row[setting.axis.frames_of(0)]
    seen = row[setting.axis.frames_of(1)]

    assert not hidden.any()
    assert seen.all()
