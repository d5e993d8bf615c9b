"""Frames that never reach the VUT: outages, dirt, low sun, lost messages."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from numpy.random import default_rng
from sampled_worlds import first_world
from short_runs import cut_run

from geometry.catalogue import load_lidars
from geometry.errors import InputError
from placement.detection_table import pack_table
from placement.detectors import load_planning_detector
from placement.detectors.response import LastingNoise
from placement.evaluator.surroundings import draw_index
from placement.sampling.detection_kernels import draw_frames, lose_frames, random_bits
from placement.sampling.tables import blinded_frames, silence
from placement.sampling.uncertainty import (
    Blinding,
    Outages,
    Uncertainty,
    load_uncertainty,
)
from placement.sampling.worlds import link_frames

N_RUNS = 2000
N_FRAMES = 6


@pytest.fixture(scope="module")
def many(setting, build_setting):
    """So many short runs, by day."""
    (run, *_) = setting.runs
    last_frames = slice(-N_FRAMES, None)
    short = cut_run(run, last_frames)
    runs = [
        replace(short, id=f"{number}", encounter=replace(run.encounter))
        for number in range(N_RUNS)
    ]
    return build_setting(setting.scene, runs)


@pytest.fixture(scope="module")
def poses(look):
    """Two cameras and a LiDAR at one pole, and a camera at each of two others."""
    east = look(
        "east",
        [-130.0, 8.85, 6.8],
        yaw_deg=0.0,
        pitch_deg=-15.0,
        site_id="a",
    )
    away = changed(east, "pose.position_m", [0.0, 0.0, 6.0])
    west = changed(east, "pose.yaw_deg", 180.0)
    steep = changed(away, "pose.pitch_deg", -60.0)
    lidars = iter(load_lidars().values())
    lidar = next(lidars)
    return (
        east,
        replace(west, id="west"),
        replace(away, id="far", site_id="b"),
        replace(east, id="lidar", sensor=lidar),
        replace(steep, id="steep", site_id="c"),
    )


def told(setting, poses, uncertainty, *, draw=0):
    """Frames that reach the VUT of all, (n_poses, n_runs, n_frames)."""
    world = first_world(setting, poses, uncertainty)
    sample = changed(world, "streams.draw", draw)
    every = np.ones((len(poses), setting.axis.n_frames), dtype=bool)
    pose_ids = tuple(pose.id for pose in poses)
    table = pack_table(pose_ids, setting.axis, every)
    n_runs = len(setting.runs)
    shape = (len(poses), n_runs, -1)
    silent = silence(sample, table)
    heard = silent.detected(slice(None))
    return heard.reshape(shape)


def near(share, n):
    """A share to 4.5 standard errors of n coins."""
    variance = share * (1.0 - share) / n
    deviation = np.sqrt(variance)
    return pytest.approx(share, abs=4.5 * deviation)


# Units out of order


def test_a_unit_out_of_order_tells_nothing_for_a_run_and_a_pole_silences_all_its_units(
    many, poses
):
    outages = Outages(unit_share=0.1, pole_share=0.2)
    uncertainty = Uncertainty(outages=outages)
    drawn = told(many, poses, uncertainty)
    whole_runs = drawn.all(axis=2)
    some_frames = drawn.any(axis=2)

    assert np.array_equal(whole_runs, some_frames)  # whole runs

    out = ~drawn[:, :, 0]
    is_out_beside = out[0] & out[1]
    beside_share = is_out_beside.mean()
    is_out_apart = out[0] & out[2]
    apart_share = is_out_apart.mean()

    expected = [near(0.28, N_RUNS)] * len(poses)
    shares = out.mean(axis=1).tolist()

    assert shares == expected
    # Independent but for the pole: neither, or the pole, or by chance both.
    assert beside_share == near(0.2 + 0.8 * 0.1**2, N_RUNS)
    assert apart_share == near(0.28**2, N_RUNS)


def test_outages_are_drawn_anew_each_time_that_a_world_is_looked_at(many, poses):
    outages = Outages(unit_share=0.5)
    uncertainty = Uncertainty(outages=outages)
    first = told(many, poses, uncertainty, draw=0)
    again = told(many, poses, uncertainty, draw=0)
    other = told(many, poses, uncertainty, draw=1)
    is_same = first[0, :, 0] == other[0, :, 0]

    assert np.array_equal(first, again)
    assert is_same.mean() == near(0.5, N_RUNS)
    assert uncertainty.draws_anew


def test_poses_that_are_tried_for_one_unit_are_out_of_order_together(many, poses):
    turned_pose = changed(poses[0], "pose.yaw_deg", 30.0)
    turned = replace(turned_pose, id="b")
    outages = Outages(unit_share=0.5)
    uncertainty = Uncertainty(outages=outages)

    one, twin = told(many, (poses[0], turned), uncertainty)

    assert np.array_equal(one, twin)


# Cameras that are blinded


def test_a_dirty_camera_sees_nothing_for_a_run_and_a_lidar_does_not_mind(many, poses):
    blinding = Blinding(dirty_share=0.3)
    dirty = Uncertainty(blinding=blinding)
    clean = told(many, poses, Uncertainty())

    assert clean.all()

    drawn = told(many, poses, dirty)
    whole_runs = drawn.all(axis=2)
    some_frames = drawn.any(axis=2)

    assert np.array_equal(whole_runs, some_frames)

    share_seeing = drawn[:, :, 0].mean(axis=1)
    seeing = share_seeing.tolist()
    by_lidar = seeing.pop(3)
    again = told(many, poses, dirty, draw=1)

    assert by_lidar == 1.0
    assert seeing == [near(0.7, N_RUNS)] * len(seeing)
    assert not np.array_equal(again, drawn)


def test_low_sun_dazzles_those_who_look_towards_it(many, poses):
    """Level sun: a share of the circle that follows from the angle between axis and
    sun.
    """
    sun = Blinding(low_sun_share=0.5, sun_below_deg=0.0, dazzled_within_deg=40.0)
    blinded = Uncertainty(blinding=sun)
    seen = told(many, poses, blinded)
    dazzled = ~seen[:, :, 0]
    angle = np.radians(40.0)
    height = np.radians(15.0)
    ratio = np.cos(angle) / np.cos(height)
    reach = np.degrees(np.arccos(ratio))
    expected = near(0.5 * reach / 180.0, N_RUNS)
    is_both = dazzled[0] & dazzled[1]

    assert dazzled[0].mean() == expected
    assert not is_both.any()  # they look in opposite ways
    assert np.array_equal(dazzled[0], dazzled[2])  # one sun for all
    assert not dazzled[3:].any()  # a LiDAR, and who looks down


def test_the_sun_shines_by_day_alone(many, poses):
    sun = Blinding(low_sun_share=1.0, sun_below_deg=1.0, dazzled_within_deg=180.0)
    runs = tuple(replace(run, weather="night") for run in many.runs)
    nights = replace(many, runs=runs)

    dazzling = Uncertainty(blinding=sun)
    by_day = told(many, poses[:1], dazzling)
    by_night = told(nights, poses[:1], dazzling)

    assert not by_day.any()
    assert by_night.all()


def test_the_vut_is_dazzled_by_the_same_sun_and_each_is_another_car(many, poses):
    dirt = Blinding(dirty_share=0.3)
    sun = Blinding(low_sun_share=1.0, sun_below_deg=0.0, dazzled_within_deg=60.0)

    def blinded(blinding, setting=many):
        uncertainty = Uncertainty(blinding=blinding)
        sample = first_world(setting, poses[:1], uncertainty)
        return blinded_frames(sample).reshape(N_RUNS, N_FRAMES)

    dirty_share = blinded(dirt)[:, 0].mean()

    assert dirty_share == near(0.3, N_RUNS)

    (yaw_deg,) = {run.vut_yaw_deg[0] for run in many.runs}
    ahead = replace(poses[0].pose, yaw_deg=yaw_deg, pitch_deg=0.0)
    as_the_vut = replace(poses[0], pose=ahead)
    dazzling = Uncertainty(blinding=sun)
    seen = told(many, [as_the_vut], dazzling)
    dazzled = ~seen[0]
    expected = near(1.0 / 3.0, N_RUNS)
    other_sensors = replace(many, vut_sensors=("camera", "lidar"))
    is_blinded = blinded(sun, other_sensors)

    assert np.array_equal(blinded(sun), dazzled)
    assert dazzled.mean() == expected
    assert not is_blinded.any()


# Lost messages


def test_single_losses_are_a_coin_per_frame_as_without_bursts():
    rounds = np.arange(500)
    run = np.repeat(10 * rounds, 8)
    places = np.arange(8)
    place = np.tile(places, 500)
    key = np.uint64(7)
    packed = np.full(500, 255, dtype=np.uint8)
    lose_frames(run, place, key, 0.3, np.uint64(8), 1.0, packed)

    bits = [int(random_bits(key, int(n))) >> 12 for n in run + place]
    coins = np.array(bits)
    unpacked = np.unpackbits(packed, bitorder="little")
    arrived = unpacked.astype(bool)
    uniform = (coins + 0.5) / 2.0**52

    assert np.array_equal(arrived, uniform >= 0.3)


def test_bursts_leave_the_share_of_losses_and_link_consecutive_frames(many, poses):
    """The chain's correlation is (1 - 1 / length)^distance."""
    bursts = Uncertainty(packet_loss=0.3, burst_frames=3.0)
    arrived = told(many, poses, bursts)
    lost = ~arrived

    assert lost.mean() == pytest.approx(0.3, abs=0.02)

    columns = np.corrcoef(lost[0].T)
    frames = np.arange(N_FRAMES)
    apart = np.abs(np.subtract.outer(frames, frames))

    assert columns == pytest.approx((2.0 / 3.0) ** apart, abs=0.1)


def test_units_of_one_pole_lose_the_same_messages_if_asked_for(many, poses):
    shared = Uncertainty(packet_loss=0.3, burst_frames=2.0, loss_shared_by="pole")
    lost = ~told(many, poses, shared)
    both_lost = lost[0] & lost[2]

    assert np.array_equal(lost[0], lost[1])
    assert both_lost.mean() == pytest.approx(0.09, abs=0.02)

    by_unit = replace(shared, loss_shared_by="unit")
    arrived = told(many, poses, by_unit)
    alone = ~arrived
    both_alone = alone[0] & alone[1]

    assert both_alone.mean() == pytest.approx(0.09, abs=0.02)


# What is the same in all frames of a run


def _noise(lasting, *, unit, runs=4000, length=4, correlation=0.7):
    """Noise of a unit in frames (n_runs, length), found by asking for every limit."""
    numbers = np.concatenate(
        [start + np.arange(length) for start in range(0, 5 * runs, 5)]
    )
    links = link_frames(numbers)
    limits = np.linspace(-4.0, 4.0, 81)
    below = np.zeros(len(numbers))

    for limit in limits:
        n_bytes = -(-len(numbers) // 8)
        packed = np.zeros(n_bytes, dtype=np.uint8)
        draw_frames(
            np.array([[limit]]),
            *(np.zeros(len(numbers), dtype=np.int64),) * 2,
            links.run_of_frame,
            links.place_of_frame,
            np.uint64(unit),
            lasting.frame_correlation(correlation),
            lasting.person[numbers],
            np.uint64(unit + 100),
            np.sqrt([lasting.unit_person_share, lasting.frame_share]),
            packed,
        )
        below += np.unpackbits(packed, count=len(numbers), bitorder="little")

    noise = limits[-1] + 0.05 - 0.1 * below
    return noise.reshape(runs, length)


def _lasting(person, unit_person, n=20_000):
    """Noise with these shares that lasts five frames of one person."""
    runs_drawn = default_rng(0).standard_normal(n // 5)
    drawn = np.repeat(runs_drawn, 5)
    return LastingNoise(
        person=np.sqrt(person) * drawn,
        person_share=person,
        unit_person_share=unit_person,
    )


def test_noise_has_the_shares_and_consecutive_frames_the_correlation_of_the_table():
    lasting = _lasting(0.2, 0.3)
    one = _noise(lasting, unit=1)
    other = _noise(lasting, unit=2)

    assert one.std() == pytest.approx(1.0, abs=0.03)

    changing = 0.2 / 0.5  # of the half that changes, so that all have 0.7
    expected = [1.0, 0.7, 0.5 + 0.5 * changing**2, 0.5 + 0.5 * changing**3]
    correlation = np.corrcoef(one.T)

    assert correlation[0] == pytest.approx(expected, abs=0.04)

    correlations = np.corrcoef(one[:, 0], other[:, 3])
    both = correlations[0, 1]

    assert both == pytest.approx(0.2, abs=0.05)  # the person alone


def test_where_all_lasts_a_run_is_one_draw_and_more_than_the_table_is_no_error():
    lasting = _lasting(0.4, 0.6)
    noise = _noise(lasting, unit=1, runs=500)
    spread = np.ptp(noise, axis=1)
    half_lasts = _lasting(0.5, 0.4)
    none_lasts = _lasting(0.0, 0.0)

    assert spread.max() < 0.11  # one step of the limits
    assert half_lasts.frame_correlation(0.7) == 0.0
    assert none_lasts.frame_correlation(0.7) == 0.7


def test_the_vut_and_units_find_the_same_people_hard_to_see(setting, poses):
    """Whatever else is drawn: with all noise of the person, what decides is the same
    number.
    """
    response = load_planning_detector("response")
    chancy = replace(setting, detector=response, table_detector=response)
    uncertainty = Uncertainty(draws_detections=True, person_share=1.0)
    sample = first_world(chancy, poses, uncertainty)
    every_draw = draw_index(setting.runs)
    numbers = np.unique(every_draw)

    seeded = np.random.default_rng(1)
    noise = sample.setting.detector._noise(numbers, seeded)
    person = sample.drawn_detector.lasting.person[numbers]
    expected = person.tolist()

    assert noise.tolist() == expected

    steps = np.diff(numbers, prepend=-9)
    starts = np.flatnonzero(steps != 1)
    values = noise.tolist()

    assert len(set(values)) == len(starts) == len(setting.runs)
    assert chancy.detector.lasting is None


# The file


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[outages]\nunit_share = 2\npole_share = 0",
            "outages.unit_share: got 2.0; expected 0 to 1",
        ),
        (
            "[messages]\npacket_loss = 0\nburst_frames = 0.5",
            "messages.burst_frames: got 0.5; ",
        ),
        (
            "[messages]\npacket_loss = 0\nshared_by = 'all'",
            "messages.shared_by: got 'all'; expec",
        ),
        (
            "[detector]\nis_drawn = true\nperson_share = 0.6\nunit_person_share = 0.5",
            "detector.unit_person_share: got 0.5; expected 0 to 0.4",
        ),
        ("mounting = 'by ear'", "mounting: got 'by ear'; expected "),
        ("[blinding]\ndirty_share = 0.1", "blinding.low_sun_share: "),
    ],
)
def test_what_cannot_be_names_file_and_field(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)

    with pytest.raises(InputError) as caught:
        load_uncertainty(str(path))

    assert str(caught.value).startswith(f"{path}: {message}")
