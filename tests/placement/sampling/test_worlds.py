"""Worlds that are sampled: mounts, streams of luck, and heavy runs."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from refusals import refused_with
from sampled_worlds import first_world

from placement.sampling.tables import build_sample_tables
from placement.sampling.uncertainty import LatencyJitter, MountingErrors, Uncertainty
from placement.sampling.worlds import (
    RandomStreams,
    draw_samples,
    mount_key,
    repeat_heavy_runs,
)
from scenarios.runs import build_frame_axis


def _offsets(sample):
    """How far off each pose is: yaw, pitch, height."""
    return np.array(
        [
            (
                real.pose.yaw_deg - planned.pose.yaw_deg,
                real.pose.pitch_deg - planned.pose.pitch_deg,
                real.pose.position_m[2] - planned.pose.position_m[2],
            )
            for planned, real in zip(sample.planned, sample.candidates, strict=True)
        ]
    )


def _mounting(*spread):
    """Errors of yaw, pitch and height with these spreads."""
    names = ("yaw_sd_deg", "pitch_sd_deg", "height_sd_m")
    return Uncertainty(mounting=MountingErrors(**dict(zip(names, spread, strict=True))))


def _record(sample):
    """All that is drawn, in a form that can be compared."""
    return (
        _offsets(sample).tolist(),
        sample.extra_latency_s.tolist(),
        [(v.actor.name, *v.key[1:]) for v in sample.vehicles],
        [len(run.obstruction) for run in sample.setting.runs],
    )


def test_without_uncertainty_a_sample_is_the_plan(setting, candidates):
    sample = first_world(setting, candidates, Uncertainty())

    assert sample.candidates == candidates
    assert all(a is b for a, b in zip(sample.candidates, candidates, strict=True))
    assert sample.setting.runs == setting.runs
    assert np.array_equal(
        sample.setting.axis.last_brake_time_s, setting.axis.last_brake_time_s
    )
    assert sample.vehicles == ()


@pytest.mark.long
def test_the_same_seed_draws_the_same_worlds_and_another_one_others(
    setting, candidates, default
):
    def draw(**options):
        options = {"n_samples": 2, "seed": 5, **options}
        return [
            _record(s) for s in draw_samples(setting, candidates, default, **options)
        ]

    first = draw()

    assert draw() == first
    assert draw(n_samples=3)[:2] == first

    for other in (draw(seed=6), draw(purpose="judge"), first[::-1]):
        for one, another in zip(first, other, strict=True):
            assert all(
                part != same for part, same in zip(one[:3], another[:3], strict=True)
            )


def test_worlds_are_drawn_when_they_are_asked_for_and_wishes_checked_at_once(
    setting, default
):
    worlds = draw_samples(setting, (), default, n_samples=10**9, seed=0)
    assert next(iter(worlds)).streams == RandomStreams(
        seed=0, purpose="choose", index=0
    )

    for field, value, message in (
        ("n_samples", 0, "samples: got 0; expected a whole number, at least 1"),
        ("n_samples", 2.0, "samples: got 2.0; expected a whole number, at least 1"),
    ):
        with refused_with(message):
            draw_samples(
                setting, (), default, **{"n_samples": 1, "seed": 0, field: value}
            )


# Mounts


def test_errors_have_their_spread_and_no_bias(setting, look):
    spread = (2.0, 0.5, 0.1)
    poses = [look(f"{i}", [float(i), 0.0, 6.0], yaw_deg=0.0) for i in range(400)]

    sample = first_world(setting, poses, _mounting(*spread), seed=1)
    off = _offsets(sample) / spread

    assert np.abs(off.mean(axis=0)).max() < 4.0 / np.sqrt(400)
    assert off.std(axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.15)
    assert np.abs(off).max() <= 3.0 + 1e-9
    assert np.abs(np.corrcoef(off.T)[np.triu_indices(3, 1)]).max() < 0.2

    for planned, real in zip(poses, sample.candidates, strict=True):
        assert real.pose.position_m[:2].tolist() == planned.pose.position_m[:2].tolist()
        assert real.id == planned.id
        assert real.site_id == planned.site_id
        assert real.sensor == planned.sensor


@pytest.mark.long
def test_few_heights_stand_for_the_normal_distribution(setting, look):
    """Three, whose mean, variance and fourth moment are those of the normal
    distribution.
    """
    poses = [look(f"{i}", [float(i), 0.0, 6.0], yaw_deg=0.0) for i in range(4000)]
    sample = first_world(setting, poses, _mounting(0.0, 0.0, 0.1), seed=1)
    steps, count = np.unique(
        (_offsets(sample)[:, 2] / 0.1).round(9), return_counts=True
    )

    assert steps == pytest.approx([-np.sqrt(3.0), 0.0, np.sqrt(3.0)])

    share = count / count.sum()

    assert share == pytest.approx([1 / 6, 2 / 3, 1 / 6], abs=4.0 * np.sqrt(0.25 / 4000))

    exact = np.array([1 / 6, 2 / 3, 1 / 6])

    assert [exact @ steps**power for power in (1, 2, 3, 4, 5)] == pytest.approx(
        [0, 1, 0, 3, 0]
    )


def test_poses_of_one_mount_are_off_by_the_same(setting, candidates, look):
    extra = [
        look(n, [0.0, 0.0, h], yaw_deg=y) for n, h, y in (("a", 6, 0), ("b", 7, 90))
    ]
    poses = (*candidates, *extra)
    sample = first_world(setting, poses, _mounting(1.0, 1.0, 0.1), seed=2)
    off = _offsets(sample).round(9)

    mounts = [mount_key(pose) for pose in poses]

    assert len(set(mounts)) == 3

    by_mount = {
        mount: {tuple(row) for row, m in zip(off, mounts, strict=True) if m == mount}
        for mount in mounts
    }

    assert all(len(rows) == 1 for rows in by_mount.values())
    assert len(set.union(*by_mount.values())) == 3


def test_errors_do_not_depend_on_what_else_is_tried(setting, candidates, default):
    all_of_them = first_world(setting, candidates, default, seed=3)
    last = first_world(setting, candidates[-1:], default, seed=3)

    assert _offsets(all_of_them)[-1].tolist() == _offsets(last)[0].tolist()
    assert [v.key for v in all_of_them.vehicles] == [v.key for v in last.vehicles]


def test_no_sensor_ends_up_underground_or_looks_over_its_shoulder(setting, look):
    low = [
        look(f"{i}", [float(i), 0.0, 0.2], yaw_deg=0.0, pitch_deg=-89.5)
        for i in range(50)
    ]
    low.append(look("lowest", [0.0, 9.0, 0.05], yaw_deg=0.0, pitch_deg=89.5))

    sample = first_world(setting, low, _mounting(0.0, 20.0, 0.5))

    assert min(pose.pose.position_m[2] for pose in sample.candidates[:-1]) == 0.1
    assert sample.candidates[-1].pose.position_m[2] >= 0.05
    assert max(abs(pose.pose.pitch_deg) for pose in sample.candidates) == 90.0


# Latency, messages, weather


def test_a_run_that_no_braking_avoids_stays_one(setting, candidates):
    hopeless = np.full(setting.axis.n_runs, -np.inf)
    never = changed(setting, "axis.last_brake_time_s", hopeless)
    late = Uncertainty(latency=LatencyJitter(mean_s=0.05))

    sample = first_world(never, candidates, late)

    assert (sample.setting.axis.last_brake_time_s == -np.inf).all()


def test_the_evaluator_is_told_how_many_messages_are_lost(setting, candidates):
    lossy = replace(
        setting, radio=replace(setting.radio, packet_loss=0.4, vam_rate=0.5)
    )
    sample = first_world(lossy, candidates, Uncertainty(packet_loss=0.2))

    assert sample.setting.radio.packet_loss == 0.2
    assert sample.setting.radio.vam_rate == 0.5


# RandomStreams


def test_every_thing_has_a_generator_of_its_own():
    lucks = [
        RandomStreams(seed=seed, purpose=purpose, index=index)
        for seed in (0, 1)
        for purpose in ("choose", "judge")
        for index in (0, 1)
    ]
    first = {
        luck.rng(*key).random() for luck in lucks for key in (("a",), ("b",), ("a", 1))
    }

    assert len(first) == 24
    assert lucks[0].rng("a").random() == lucks[0].rng("a").random()


# Runs of great weight


def test_heavy_runs_are_there_as_often_as_they_weigh_and_are_drawn_each_by_itself(
    setting, candidates
):
    weight = np.array([0.1, 0.8, 0.1])  # 2.4 times the mean: twice
    setting = changed(setting, "axis.weight", weight)

    often = repeat_heavy_runs(setting, most=10)
    names = list(setting.axis.run_ids)

    assert often.axis.run_ids == (names[0], names[1], f"{names[1]}+1", names[2])
    assert often.axis.weight == pytest.approx([0.1, 0.4, 0.4, 0.1])
    assert repeat_heavy_runs(setting, most=1) is setting

    uncertainty = Uncertainty(packet_loss=0.5)
    seen = []
    for drawn in (Uncertainty(), uncertainty):
        samples = draw_samples(often, candidates, drawn, n_samples=1, seed=0)
        ((_, table),) = build_sample_tables(samples)
        frames = table.detected(slice(None))
        seen += [frames[:, often.axis.frames_of(run)] for run in (1, 2)]

    one, copy, lossy_one, lossy_copy = seen

    assert np.array_equal(one, copy)
    assert one.any()
    assert not np.array_equal(lossy_one, lossy_copy)


def test_weathers_of_a_repeated_run_share_its_draws(setting):
    fog = tuple(
        replace(run, id=f"{run.id} in fog", weather="fog") for run in setting.runs
    )
    runs = (*setting.runs, *fog)
    axis = build_frame_axis(runs, np.tile([0.05, 0.4, 0.05], 2))

    often = repeat_heavy_runs(replace(setting, runs=runs, axis=axis), most=10)
    by_id = {run.id: run.encounter for run in often.runs}
    name = setting.runs[1].id

    assert by_id[f"{name}+1"] is by_id[f"{name} in fog+1"]
    assert by_id[f"{name}+1"] is not by_id[name]


def test_what_the_vut_sees_is_repeated_with_its_run(setting):
    axis = replace(setting.axis, weight=np.array([0.1, 0.8, 0.1]))
    seen = np.random.default_rng(0).random(axis.n_frames) < 0.5

    often = repeat_heavy_runs(replace(setting, axis=axis, seen_by_vut=seen), most=10)
    parts = [seen[axis.frames_of(run)] for run in (0, 1, 1, 2)]

    assert np.array_equal(often.seen_by_vut, np.concatenate(parts))
