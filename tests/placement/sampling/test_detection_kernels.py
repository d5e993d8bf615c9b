"""Detections drawn frame by frame: noise, its links, and tables made of it."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_worlds import first_world, table_of_world
from scipy.signal import lfilter
from scipy.stats import kstest, norm

from geometry.catalogue import load_lidars
from geometry.kernels import kernel
from placement.compute import Compute
from placement.detection_table import pack_table
from placement.detectors import load_planning_detector
from placement.evaluator import build_surroundings, perceive_frames
from placement.sampling.detection_kernels import _linked, draw_frames, random_bits
from placement.sampling.tables import build_drawn_tables, silence
from placement.sampling.uncertainty import Uncertainty
from placement.sampling.worlds import draw_samples, link_frames

DRAWN = Uncertainty(draws_detections=True)


# RandomStreams from frame to frame


def _noise(frames, correlation, seed):
    """Noise of frames whose neighbours are linked."""
    links = link_frames(np.asarray(frames))
    return _noise_at(
        links.run_of_frame,
        links.place_of_frame,
        np.uint64(seed),
        correlation,
    )


@kernel
def _noise_at(run, place, key, correlation):
    """Noise at places of runs."""
    noise = np.empty(len(run))
    for index in range(len(run)):
        step = np.sqrt(1.0 - correlation**2)
        noise[index] = _linked(
            key,
            correlation,
            step,
            run[index],
            place[index],
            -1,
            0.0,
        )

    return noise


def test_random_bits_are_those_of_splitmix64():
    """Numbers of the reference implementation: Vigna, splitmix64.c, seed 1234567."""
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    found = [int(random_bits(np.uint64(1234567), n)) for n in range(3)]
    assert found == expected


@pytest.mark.long
def test_fresh_noise_is_standard_normal_also_in_its_tails():
    n = 2_000_000
    cells = np.arange(n)
    noise = _noise(2 * cells, 0.0, 3)

    assert kstest(noise, "norm").pvalue > 0.001

    for limit in (2.0, 3.0, 3.5, 4.0):  # the ziggurat's own tail begins at 3.44
        for tail in (noise > limit, noise < -limit):
            expected = n * norm.sf(limit)
            n_tail = tail.sum()
            deviation = np.sqrt(expected)

            assert n_tail == pytest.approx(expected, abs=4.5 * deviation)

    correlation_found = np.corrcoef(noise[:-1], noise[1:])

    assert abs(correlation_found[0, 1]) < 0.004


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.97, 1.0])
def test_linked_noise_is_what_a_recursive_filter_makes_of_fresh_noise(correlation):
    frames_of_runs = [start + np.arange(30) for start in range(0, 217, 31)]
    frames = np.concatenate(frames_of_runs)
    fresh_noise = _noise(frames, 0.0, 6)
    fresh = fresh_noise.reshape(7, 30)
    linked_noise = _noise(frames, correlation, 6)
    linked = linked_noise.reshape(7, 30)
    step = np.sqrt(1.0 - correlation**2)

    for run, noise in zip(fresh, linked, strict=True):
        assert noise[0] == run[0]

        start = [correlation * run[0]]
        expected, _ = lfilter(
            [step],
            [1.0, -correlation],
            run[1:],
            zi=start,
        )

        assert noise[1:] == pytest.approx(expected, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_frames_are_drawn_where_the_noise_of_their_cell_is_below_the_limit(seed):
    """Also where they are out of order, show nothing, or leave nothing to chance."""
    rng = np.random.default_rng(seed)
    links = link_frames(
        rng.permutation(np.tile(np.flatnonzero(rng.random(400) < 0.9), 2))
    )
    where = links.run_of_frame, links.place_of_frame
    n = len(links.run_of_frame)
    weather = rng.integers(0, 2, n)
    entry = rng.integers(-1, 30, n)
    limit = rng.normal(size=(2, 30))
    limit[rng.random((2, 30)) < 0.2] = np.inf
    limit[rng.random((2, 30)) < 0.2] = -np.inf
    key = np.uint64(seed)
    packed = np.zeros(-(-n // 8), dtype=np.uint8)
    nothing = np.zeros(n)
    own = np.array([0.0, 1.0])

    draw_frames(
        limit,
        weather,
        entry,
        *where,
        key,
        0.6,
        nothing,
        key,
        own,
        packed,
    )
    noise = _noise_at(*where, key, 0.6)
    is_below = noise < limit[weather, entry]
    expected = (entry >= 0) & is_below
    unpacked = np.unpackbits(packed, count=n, bitorder="little")
    drawn = unpacked.astype(bool)

    assert np.array_equal(drawn, expected)


def test_equal_frames_share_their_luck_and_their_order_does_not_matter():
    frames = np.array([0, 1, 2, 10, 11, 0, 1, 2])
    noise = _noise(frames, 0.5, 1)
    expected = noise[5:].tolist()
    values = noise.tolist()
    backwards = _noise(frames[::-1], 0.5, 1)
    forwards = backwards[::-1].tolist()

    assert noise[:3].tolist() == expected
    assert len(set(values)) == 5
    assert forwards == noise.tolist()


# Tables drawn frame by frame


@pytest.fixture(scope="module")
def response():
    """The detector whose detections are drawn."""
    return load_planning_detector("response")


@pytest.fixture(scope="module")
def watched(junction_scene, standing_still, build_setting, response, look):
    """A VRU that stands still in the open for two minutes, and who looks at it."""
    n_frames = 1200
    run = standing_still([2.0, -1.0])
    long = {
        "time_s": 0.1 * np.arange(1 - n_frames, 1),
        "vut_position_m": np.tile([-60.0, -1.75], (n_frames, 1)),
        "vut_yaw_deg": np.zeros(n_frames),
        "vru_position_m": np.tile([2.0, -1.0], (n_frames, 1)),
        "vru_yaw_deg": np.full(n_frames, 90.0),
        "vru_shape": np.zeros(n_frames, dtype=np.int64),
    }
    run = replace(run, **long)
    setting = build_setting(
        junction_scene,
        (run, replace(run, id="in fog", weather="fog")),
        table_detector=replace(response, frame_correlation=0.0),
    )
    lidars = iter(load_lidars().values())
    lidar = next(lidars)
    far = [
        look(f"{x}", [x, -1.0, 6.0], yaw_deg=0.0, pitch_deg=-5.0)
        for x in (-28.0, -38.0)
    ]
    return setting, (
        *far,
        look(
            "lidar",
            [-8.0, -1.0, 1.5],
            yaw_deg=0.0,
            sensor=lidar,
        ),
    )


def test_frames_are_detected_as_often_as_the_evaluators_pixels_make_likely(watched):
    setting, poses = watched
    sample = first_world(setting, poses, DRAWN)
    first, other = build_drawn_tables(
        sample,
        setting.table_detector,
        compute=Compute(workers=1),
        n_draws=2,
    )

    (alone,) = build_drawn_tables(
        sample, setting.table_detector, compute=Compute(workers=1)
    )
    drawn = first.detected(slice(None))

    assert np.array_equal(alone.packed, first.packed)

    detected = other.detected(slice(None))
    cameras = detected[:2]
    differs = (cameras != drawn[:2]).mean()

    assert 0.2 < differs < 0.6  # other coins

    # Of the same kind.
    expected = drawn[:2].mean()
    share = cameras.mean()

    assert share == pytest.approx(expected, abs=0.03)

    for row, pose in enumerate(poses[:2]):
        for index, run in enumerate(setting.runs):
            one_frame = {
                name: getattr(run, name)[:1]
                for name in (
                    "time_s",
                    "vut_position_m",
                    "vut_yaw_deg",
                    "vru_position_m",
                )
            } | {"vru_yaw_deg": run.vru_yaw_deg[:1], "vru_shape": run.vru_shape[:1]}
            surroundings = build_surroundings(
                setting.scene, [replace(run, **one_frame)]
            )

            mount = (pose.pose, pose.sensor)
            evidence = perceive_frames(surroundings, mount)
            (likely,) = setting.table_detector.probability(
                replace(
                    evidence,
                    contrast=surroundings.contrast(evidence_distance(pose, run)),
                )
            )
            frames = setting.axis.frames_of(index)
            often = drawn[row, frames].mean()

            # 1200 coins, and points instead of pixels.
            assert often == pytest.approx(likely, abs=0.05)
            assert 0.05 < likely < 0.97


def evidence_distance(pose, run):
    """Distance to the middle of the VRU. [m]"""
    return np.array(
        [np.linalg.norm([*run.vru_position_m[0], 0.9] - pose.pose.position_m)]
    )


def test_in_fog_less_is_detected_of_the_same_frames(watched):
    setting, poses = watched
    world = first_world(setting, poses, DRAWN)
    table = table_of_world(world)
    detected = table.detected(slice(None))
    by_day = setting.axis.frames_of(0)
    day = detected[:, by_day]
    in_fog = setting.axis.frames_of(1)
    fog = detected[:, in_fog]
    n_in_fog = fog[0].sum()
    n_by_day = day[0].sum()

    assert not (fog & ~day).any()
    assert n_in_fog < n_by_day


def test_poses_have_luck_of_their_own_that_seed_and_world_change(watched):
    setting, poses = watched
    twin = replace(poses[0], id="again")
    twins = (poses[0], twin, poses[1])

    def draw(seed, which=twins):
        return table_of_world(
            first_world(setting, which, DRAWN, seed), seed=0
        ).detected(slice(None))

    first = draw(0)
    is_same = np.array_equal(first[0], first[2])
    alone = draw(0, twins[2:])
    is_same_again = np.array_equal(draw(1)[0], first[0])

    assert np.array_equal(first[0], first[1])  # the same pose under another name
    assert not is_same
    assert np.array_equal(alone[0], first[2])
    assert not is_same_again

    worlds = [
        table_of_world(sample).detected(slice(None))[0]
        for sample in draw_samples(setting, twins[:1], DRAWN, n_samples=2, seed=0)
    ]
    is_same_world = np.array_equal(worlds[0], worlds[1])

    assert np.array_equal(worlds[0], first[0])
    assert not is_same_world


def test_a_lidar_counts_the_points_that_it_may_expect(watched):
    setting, poses = watched
    world = first_world(setting, poses, DRAWN)
    table = table_of_world(world)
    drawn = table.detected([2])
    planned = table_of_world(
        first_world(setting, poses, Uncertainty()), seed=0
    ).detected([2])

    assert np.array_equal(drawn, planned)
    assert drawn.any()


def test_nothing_is_drawn_of_a_detector_that_looks_at_boxes(setting, candidates):
    world = first_world(setting, candidates, DRAWN)
    table = table_of_world(world)
    drawn = table.packed
    planned = table_of_world(
        first_world(setting, candidates, Uncertainty()), seed=0
    ).packed

    assert np.array_equal(drawn, planned)
    assert planned.any()


def test_two_workers_draw_the_same_table_as_one(setting, candidates, response):
    chancy = replace(setting, table_detector=response)
    calls = []
    tables = [
        table_of_world(
            first_world(chancy, candidates, DRAWN),
            workers=workers,
            progress=lambda *call: calls.append(call),
        ).packed
        for workers in (1, 2)
    ]

    assert np.array_equal(*tables)
    assert tables[0].any()

    stage = "sampled detection tables"
    expected = [(stage, 1, 2), (stage, 2, 2)] * 2

    # Mount positions of the first world.
    assert calls == expected


# Messages


def test_the_same_messages_are_lost_in_all_weathers(watched):
    setting, poses = watched
    uncertainty = Uncertainty(packet_loss=0.5)
    sample = first_world(setting, poses, uncertainty)

    every = pack_table(
        tuple(p.id for p in poses),
        setting.axis,
        np.ones((3, setting.axis.n_frames), dtype=bool),
    )
    silent = silence(sample, every)
    heard = silent.detected(slice(None))
    by_day = setting.axis.frames_of(0)
    day = heard[:, by_day]

    in_fog = setting.axis.frames_of(1)
    fog = heard[:, in_fog]

    assert np.array_equal(day, fog)
