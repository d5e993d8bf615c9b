"""Worlds that are sampled: mounts, streams of luck, and heavy runs."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from changes import changed
from refusals import refused_with
from sampled_worlds import first_world, table_of_world

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


def _mounting(yaw_sd_deg, pitch_sd_deg, height_sd_m):
    """Errors of mounting with these spreads."""
    errors = MountingErrors(
        yaw_sd_deg=yaw_sd_deg,
        pitch_sd_deg=pitch_sd_deg,
        height_sd_m=height_sd_m,
    )
    return Uncertainty(mounting=errors)


def _row_of(look, n_poses):
    """Poses every metre, 6 m high."""
    return [look(f"{n}", [float(n), 0.0, 6.0], yaw_deg=0.0) for n in range(n_poses)]


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
    for a, b in zip(sample.candidates, candidates, strict=True):
        assert a is b

    assert sample.setting.runs == setting.runs
    assert np.array_equal(
        sample.setting.axis.last_brake_time_s, setting.axis.last_brake_time_s
    )
    assert sample.vehicles == ()


@pytest.mark.long
def test_the_same_seed_draws_the_same_worlds_and_another_one_others(
    setting, candidates, default
):
    def draw(*, n_samples=2, seed=5, **options):
        samples = draw_samples(
            setting,
            candidates,
            default,
            n_samples=n_samples,
            seed=seed,
            **options,
        )
        return [_record(sample) for sample in samples]

    first = draw()
    drawn = draw(n_samples=3)

    assert draw() == first
    assert drawn[:2] == first

    other_seed = draw(seed=6)
    other_purpose = draw(purpose="judge")

    for others in (other_seed, other_purpose, first[::-1]):
        for one, other in zip(first, others, strict=True):
            for part in range(3):
                assert one[part] != other[part]


def test_worlds_are_drawn_when_they_are_asked_for(setting, default):
    worlds = draw_samples(
        setting,
        (),
        default,
        n_samples=10**9,
        seed=0,
    )
    first = RandomStreams(seed=0, purpose="choose", index=0)

    assert next(iter(worlds)).streams == first


@pytest.mark.parametrize("n_samples", [0, 2.0])
def test_a_number_of_worlds_that_cannot_be_is_refused_at_once(
    setting, default, n_samples
):
    message = f"samples: got {n_samples}; expected a whole number, at least 1"

    with refused_with(message):
        draw_samples(setting, (), default, n_samples=n_samples, seed=0)


# Mounts


def test_errors_have_their_spread_and_no_bias(setting, look):
    spread = (2.0, 0.5, 0.1)
    poses = _row_of(look, 400)

    mounting = _mounting(*spread)
    sample = first_world(setting, poses, mounting, seed=1)
    off = _offsets(sample) / spread
    bias = off.mean(axis=0)
    root = np.sqrt(400)
    sizes = np.abs(off)
    correlation = np.corrcoef(off.T)
    above = np.triu_indices(3, 1)
    between = correlation[above]

    assert np.abs(bias).max() < 4.0 / root
    assert off.std(axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.15)
    assert sizes.max() <= 3.0 + 1e-9
    assert np.abs(between).max() < 0.2

    for planned, real in zip(poses, sample.candidates, strict=True):
        planned_m = planned.pose.position_m[:2]
        expected = planned_m.tolist()
        real_m = real.pose.position_m[:2]

        assert real_m.tolist() == expected
        assert real.id == planned.id
        assert real.site_id == planned.site_id
        assert real.sensor == planned.sensor


@pytest.mark.long
def test_few_heights_stand_for_the_normal_distribution(setting, look):
    """Three, whose mean, variance and fourth moment are those of the normal
    distribution.
    """
    poses = _row_of(look, 4000)
    exact = np.array([1 / 6, 2 / 3, 1 / 6])

    sample = first_world(
        setting,
        poses,
        _mounting(0.0, 0.0, 0.1),
        seed=1,
    )
    height_errors_m = _offsets(sample)[:, 2]
    steps_off = height_errors_m / 0.1
    off = steps_off.round(9)
    steps, count = np.unique(off, return_counts=True)
    moments = [exact @ steps**power for power in (1, 2, 3, 4, 5)]
    root = np.sqrt(3.0)
    deviation = np.sqrt(0.25 / 4000)

    assert steps == pytest.approx([-root, 0.0, root])
    assert count / 4000 == pytest.approx(exact, abs=4.0 * deviation)
    assert moments == pytest.approx([0, 1, 0, 3, 0])


def test_poses_of_one_mount_are_off_by_the_same(setting, candidates, look):
    low = look("a", [0.0, 0.0, 6], yaw_deg=0)
    high = look("b", [0.0, 0.0, 7], yaw_deg=90)
    poses = (*candidates, low, high)

    sample = first_world(
        setting,
        poses,
        _mounting(1.0, 1.0, 0.1),
        seed=2,
    )
    by_mount = {}
    offsets = _offsets(sample).round(9)
    for pose, off in zip(poses, offsets, strict=True):
        of_mount = by_mount.setdefault(mount_key(pose), set())
        of_mount.add(tuple(off))

    assert len(by_mount) == 3
    for rows in by_mount.values():
        assert len(rows) == 1

    all_offsets = set.union(*by_mount.values())

    assert len(all_offsets) == 3


def test_errors_do_not_depend_on_what_else_is_tried(setting, candidates, default):
    every = first_world(setting, candidates, default, seed=3)
    last = first_world(setting, candidates[-1:], default, seed=3)
    own_offset = _offsets(every)[-1].tolist()
    same_offset = _offsets(last)[0].tolist()
    keys_of_every = [v.key for v in every.vehicles]
    keys_of_last = [v.key for v in last.vehicles]

    assert own_offset == same_offset
    assert keys_of_every == keys_of_last


def test_no_sensor_ends_up_underground_or_looks_over_its_shoulder(setting, look):
    low = [
        look(f"{n}", [float(n), 0.0, 0.2], yaw_deg=0.0, pitch_deg=-89.5)
        for n in range(50)
    ]
    lowest = look(
        "lowest",
        [0.0, 9.0, 0.05],
        yaw_deg=0.0,
        pitch_deg=89.5,
    )

    mounting = _mounting(0.0, 20.0, 0.5)
    sample = first_world(setting, [*low, lowest], mounting)
    poses = [candidate.pose for candidate in sample.candidates]
    lowest_m = min(pose.position_m[2] for pose in poses[:-1])
    steepest_deg = max(abs(pose.pitch_deg) for pose in poses)

    assert lowest_m == 0.1
    assert poses[-1].position_m[2] >= 0.05
    assert steepest_deg == 90.0


# Latency, messages, weather


def test_a_run_that_no_braking_avoids_stays_one(setting, candidates):
    hopeless = np.full(setting.axis.n_runs, -np.inf)
    never = changed(setting, "axis.last_brake_time_s", hopeless)
    latency = LatencyJitter(mean_s=0.05)
    late = Uncertainty(latency=latency)
    sample = first_world(never, candidates, late)
    is_never = sample.setting.axis.last_brake_time_s == -np.inf

    assert is_never.all()


def test_the_evaluator_is_told_how_many_messages_are_lost(setting, candidates):
    radio = replace(setting.radio, packet_loss=0.4, vam_rate=0.5)
    lossy = replace(setting, radio=radio)
    uncertainty = Uncertainty(packet_loss=0.2)
    sample = first_world(lossy, candidates, uncertainty)

    assert sample.setting.radio.packet_loss == 0.2
    assert sample.setting.radio.vam_rate == 0.5


# RandomStreams


def test_every_thing_has_a_generator_of_its_own():
    firsts = []
    for seed, purpose, index in product((0, 1), ("choose", "judge"), (0, 1)):
        streams = RandomStreams(seed=seed, purpose=purpose, index=index)
        for key in (("a",), ("b",), ("a", 1)):
            generator = streams.rng(*key)
            first = generator.random()
            firsts.append(first)
            again = streams.rng(*key)

            assert again.random() == firsts[-1]

    assert len(set(firsts)) == 24


# Runs of great weight


def test_heavy_runs_are_there_as_often_as_they_weigh_and_are_drawn_each_by_itself(
    setting, candidates
):
    weight = np.array([0.1, 0.8, 0.1])  # 2.4 times the mean: twice
    setting = changed(setting, "axis.weight", weight)
    first, second, third = setting.axis.run_ids

    often = repeat_heavy_runs(setting, most=10)

    assert often.axis.run_ids == (first, second, f"{second}+1", third)
    assert often.axis.weight == pytest.approx([0.1, 0.4, 0.4, 0.1])
    assert repeat_heavy_runs(setting, most=1) is setting

    def of_the_heavy_run(uncertainty):
        world = first_world(often, candidates, uncertainty)
        table = table_of_world(world)
        frames = table.detected(slice(None))
        return [frames[:, often.axis.frames_of(run)] for run in (1, 2)]

    one, copy = of_the_heavy_run(Uncertainty())
    losses = Uncertainty(packet_loss=0.5)
    lossy_one, lossy_copy = of_the_heavy_run(losses)

    assert np.array_equal(one, copy)
    assert one.any()
    assert not np.array_equal(lossy_one, lossy_copy)


def test_weathers_of_a_repeated_run_share_its_draws(setting):
    fog = tuple(
        replace(run, id=f"{run.id} in fog", weather="fog") for run in setting.runs
    )
    runs = (*setting.runs, *fog)
    weight = np.tile([0.05, 0.4, 0.05], 2)
    axis = build_frame_axis(runs, weight)

    repeated = replace(setting, runs=runs, axis=axis)
    often = repeat_heavy_runs(repeated, most=10)
    by_id = {run.id: run.encounter for run in often.runs}
    name = setting.runs[1].id

    assert by_id[f"{name}+1"] is by_id[f"{name} in fog+1"]
    assert by_id[f"{name}+1"] is not by_id[name]


def test_what_the_vut_sees_is_repeated_with_its_run(setting):
    axis = replace(setting.axis, weight=[0.1, 0.8, 0.1])
    rng = np.random.default_rng(0)
    seen = rng.random(axis.n_frames) < 0.5

    repeated = replace(setting, axis=axis, seen_by_vut=seen)
    often = repeat_heavy_runs(repeated, most=10)
    parts = [seen[axis.frames_of(run)] for run in (0, 1, 1, 2)]
    expected = np.concatenate(parts)

    assert np.array_equal(often.seen_by_vut, expected)
