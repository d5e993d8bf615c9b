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
    short = cut_run(run, slice(-N_FRAMES, None))
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
    lidar = next(iter(load_lidars().values()))
    return (
        east,
        replace(west, id="west"),
        replace(away, id="far", site_id="b"),
        replace(east, id="lidar", sensor=lidar),
        replace(steep, id="steep", site_id="c"),
    )


def told(setting, poses, uncertainty, *, draw=0):
    """Frames that reach the VUT of all, (n_poses, n_runs, n_frames)."""
    sample = changed(first_world(setting, poses, uncertainty), "streams.draw", draw)
    every = np.ones((len(poses), setting.axis.n_frames), dtype=bool)
    table = pack_table(tuple(pose.id for pose in poses), setting.axis, every)
    shape = (len(poses), len(setting.runs), -1)
    return silence(sample, table).detected(slice(None)).reshape(shape)


def near(share, n):
    """A share to 4.5 standard errors of n coins."""
    return pytest.approx(share, abs=4.5 * np.sqrt(share * (1.0 - share) / n))


# Units out of order


def test_a_unit_out_of_order_tells_nothing_for_a_run_and_a_pole_silences_all_its_units(
    many, poses
):
    outages = Outages(unit_share=0.1, pole_share=0.2)
    drawn = told(many, poses, Uncertainty(outages=outages))

    assert np.array_equal(drawn.all(axis=2), drawn.any(axis=2))  # whole runs

    out = ~drawn[:, :, 0]
    beside_share = (out[0] & out[1]).mean()
    apart_share = (out[0] & out[2]).mean()

    expected = [near(0.28, N_RUNS)] * len(poses)

    assert out.mean(axis=1).tolist() == expected
    # Independent but for the pole: neither, or the pole, or by chance both.
    assert beside_share == near(0.2 + 0.8 * 0.1**2, N_RUNS)
    assert apart_share == near(0.28**2, N_RUNS)


def test_outages_are_drawn_anew_each_time_that_a_world_is_looked_at(many, poses):
    uncertainty = Uncertainty(outages=Outages(unit_share=0.5))
    first = told(many, poses, uncertainty, draw=0)
    again = told(many, poses, uncertainty, draw=0)
    other = told(many, poses, uncertainty, draw=1)

    assert np.array_equal(first, again)
    assert (first[0, :, 0] == other[0, :, 0]).mean() == near(0.5, N_RUNS)
    assert uncertainty.draws_anew


def test_poses_that_are_tried_for_one_unit_are_out_of_order_together(many, poses):
    turned = replace(changed(poses[0], "pose.yaw_deg", 30.0), id="b")
    uncertainty = Uncertainty(outages=Outages(unit_share=0.5))

    one, twin = told(many, (poses[0], turned), uncertainty)

    assert np.array_equal(one, twin)


# Cameras that are blinded


def test_a_dirty_camera_sees_nothing_for_a_run_and_a_lidar_does_not_mind(many, poses):
    dirty = Uncertainty(blinding=Blinding(dirty_share=0.3))

    assert told(many, poses, Uncertainty()).all()

    drawn = told(many, poses, dirty)

    assert np.array_equal(drawn.all(axis=2), drawn.any(axis=2))

    seeing = drawn[:, :, 0].mean(axis=1).tolist()
    by_lidar = seeing.pop(3)

    assert by_lidar == 1.0
    assert seeing == [near(0.7, N_RUNS)] * len(seeing)
    assert not np.array_equal(told(many, poses, dirty, draw=1), drawn)


def test_low_sun_dazzles_those_who_look_towards_it(many, poses):
    """Level sun: a share of the circle that follows from the angle between axis and
    sun.
    """
    sun = Blinding(low_sun_share=0.5, sun_below_deg=0.0, dazzled_within_deg=40.0)
    dazzled = ~told(many, poses, Uncertainty(blinding=sun))[:, :, 0]
    reach = np.degrees(np.arccos(np.cos(np.radians(40.0)) / np.cos(np.radians(15.0))))

    assert dazzled[0].mean() == near(0.5 * reach / 180.0, N_RUNS)
    assert not (dazzled[0] & dazzled[1]).any()  # they look in opposite ways
    assert np.array_equal(dazzled[0], dazzled[2])  # one sun for all
    assert not dazzled[3:].any()  # a LiDAR, and who looks down


def test_the_sun_shines_by_day_alone(many, poses):
    sun = Blinding(low_sun_share=1.0, sun_below_deg=1.0, dazzled_within_deg=180.0)
    nights = replace(
        many, runs=tuple(replace(run, weather="night") for run in many.runs)
    )

    by_day = told(many, poses[:1], Uncertainty(blinding=sun))
    by_night = told(nights, poses[:1], Uncertainty(blinding=sun))

    assert not by_day.any()
    assert by_night.all()


def test_the_vut_is_dazzled_by_the_same_sun_and_each_is_another_car(many, poses):
    dirt = Blinding(dirty_share=0.3)
    sun = Blinding(low_sun_share=1.0, sun_below_deg=0.0, dazzled_within_deg=60.0)

    def blinded(blinding, setting=many):
        sample = first_world(setting, poses[:1], Uncertainty(blinding=blinding))
        return blinded_frames(sample).reshape(N_RUNS, N_FRAMES)

    assert blinded(dirt)[:, 0].mean() == near(0.3, N_RUNS)

    (yaw_deg,) = {run.vut_yaw_deg[0] for run in many.runs}
    ahead = replace(poses[0].pose, yaw_deg=yaw_deg, pitch_deg=0.0)
    as_the_vut = replace(poses[0], pose=ahead)
    dazzled = ~told(many, [as_the_vut], Uncertainty(blinding=sun))[0]

    assert np.array_equal(blinded(sun), dazzled)
    assert dazzled.mean() == near(1.0 / 3.0, N_RUNS)
    assert not blinded(sun, replace(many, vut_sensors=("camera", "lidar"))).any()


# Lost messages


def test_single_losses_are_a_coin_per_frame_as_without_bursts():
    run = np.repeat(10 * np.arange(500), 8)
    place = np.tile(np.arange(8), 500)
    key = np.uint64(7)
    packed = np.full(500, 255, dtype=np.uint8)
    lose_frames(run, place, key, 0.3, np.uint64(8), 1.0, packed)

    coins = np.array([int(random_bits(key, int(n))) >> 12 for n in run + place])
    arrived = np.unpackbits(packed, bitorder="little").astype(bool)

    assert np.array_equal(arrived, (coins + 0.5) / 2.0**52 >= 0.3)


def test_bursts_leave_the_share_of_losses_and_link_consecutive_frames(many, poses):
    """The chain's correlation is (1 - 1 / length)^distance."""
    lost = ~told(many, poses, Uncertainty(packet_loss=0.3, burst_frames=3.0))

    assert lost.mean() == pytest.approx(0.3, abs=0.02)

    columns = np.corrcoef(lost[0].T)
    apart = np.abs(np.subtract.outer(np.arange(N_FRAMES), np.arange(N_FRAMES)))

    assert columns == pytest.approx((2.0 / 3.0) ** apart, abs=0.1)


def test_units_of_one_pole_lose_the_same_messages_if_asked_for(many, poses):
    shared = Uncertainty(packet_loss=0.3, burst_frames=2.0, loss_shared_by="pole")
    lost = ~told(many, poses, shared)

    assert np.array_equal(lost[0], lost[1])
    assert (lost[0] & lost[2]).mean() == pytest.approx(0.09, abs=0.02)

    alone = ~told(many, poses, replace(shared, loss_shared_by="unit"))

    assert (alone[0] & alone[1]).mean() == pytest.approx(0.09, abs=0.02)


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
        packed = np.zeros(-(-len(numbers) // 8), dtype=np.uint8)
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

    return (limits[-1] + 0.05 - 0.1 * below).reshape(runs, length)


def _lasting(person, unit_person, n=20_000):
    """Noise with these shares that lasts five frames of one person."""
    drawn = np.repeat(default_rng(0).standard_normal(n // 5), 5)
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

    assert np.corrcoef(one.T)[0] == pytest.approx(expected, abs=0.04)

    both = np.corrcoef(one[:, 0], other[:, 3])[0, 1]

    assert both == pytest.approx(0.2, abs=0.05)  # the person alone


def test_where_all_lasts_a_run_is_one_draw_and_more_than_the_table_is_no_error():
    lasting = _lasting(0.4, 0.6)
    noise = _noise(lasting, unit=1, runs=500)

    assert np.ptp(noise, axis=1).max() < 0.11  # one step of the limits
    assert _lasting(0.5, 0.4).frame_correlation(0.7) == 0.0
    assert _lasting(0.0, 0.0).frame_correlation(0.7) == 0.7


def test_the_vut_and_units_find_the_same_people_hard_to_see(setting, poses):
    """Whatever else is drawn: with all noise of the person, what decides is the same
    number.
    """
    response = load_planning_detector("response")
    chancy = replace(setting, detector=response, table_detector=response)
    uncertainty = Uncertainty(draws_detections=True, person_share=1.0)
    sample = first_world(chancy, poses, uncertainty)
    numbers = np.unique(draw_index(setting.runs))

    noise = sample.setting.detector._noise(numbers, np.random.default_rng(1))

    assert noise.tolist() == sample.drawn_detector.lasting.person[numbers].tolist()

    starts = np.flatnonzero(np.diff(numbers, prepend=-9) != 1)

    assert len(set(noise.tolist())) == len(starts) == len(setting.runs)
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
