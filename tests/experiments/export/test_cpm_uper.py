"""Collective perception messages as bytes."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from export_layouts import level_layout
from numpy.testing import assert_allclose
from pyproj import Transformer
from tiny_worlds import unit_at

from experiments.export.cpm import RELEASES, build_stations, fuse_m2, to_cpm
from experiments.export.uper import decode, encode, split, tell_load, to_cpm_uper
from experiments.export.watched import (
    WatchedRun,
    find_run,
    follow_watched,
    report_covariances_m2,
    watch_run,
)
from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.lidar import load_lidars
from geometry.study_scene import load_study_scene
from placement.candidates import is_ring
from placement.layout import Layout, load_carlancap_layout
from placement.sampling.uncertainty import BY_EYE, CALIBRATED
from scenarios.aeb import load_aeb_rule

pytest.importorskip("asn1tools", reason="the extra v2x is not installed")

SCENE = load_study_scene()
# Of test_a_message_by_hand. asn1tools 0.169.0 with ETSI's modules decodes them to the
# same.
GOLDEN = {
    "2.1.1": (
        "020e0000000000000000000296cdbc0380743007ffffff08eddd0f8880"
        "80109002001a7c0004000412c097df511361489040"
    ),
    "2.4.1": (
        "020e0000000000000000000296cdbc0380743007ffffff08eddd0f8880"
        "80109002001a7c0004000412c0978af2d561489040"
    ),
}


def containers(message):
    """The containers of a message, that of objects last if there is one."""
    return message["payload"]["cpmContainers"]


def objects_of(message):
    """What a message says is perceived; nothing in one about sensors alone."""
    last = containers(message)[-1]
    if last["containerId"] != 5:
        return []

    data = last["containerData"]
    return data["perceivedObjects"]


def all_objects(messages):
    """What several messages say is perceived, in their order."""
    found = []
    for message in messages:
        found.extend(objects_of(message))

    return found


def seen_in(run, seed, share=0.5):
    """A run in which a unit detects by lot."""
    rng = np.random.default_rng(seed)
    is_detected = rng.random(len(run.time_s)) < share
    return WatchedRun(
        run=run,
        detected={"one": is_detected},
        rule=load_aeb_rule(),
    )


def by_axis(fields, name, axes="xyz"):
    """Fields of a container by their axes."""
    return [fields[f"{axis}{name}"] for axis in axes]


def values_of(fields, name, axes="xyz"):
    """Values of fields by their axes, in hundredths of the unit."""
    return np.array([field["value"] for field in by_axis(fields, name, axes)])


@pytest.fixture(scope="module")
def runs():
    """A pedestrian, a cyclist, a motorcyclist, and a car."""
    ids = (
        "CPNC-50/east/40",
        "CBLA/east/25",
        "CMCscp-near/north/30x50",
        "CCFtap/north/10x30",
    )
    return [find_run(run_id, SCENE) for run_id in ids]


def test_objects_are_where_the_run_has_them(runs):
    """Position, velocity, age and times by hand, from the run's own frames."""
    layout = level_layout(0.0)
    mast_m = layout.units[0].pose.position_m[:2]

    for run in runs:
        watched = seen_in(run, 7)
        (station,) = build_stations(layout, SCENE, watched)
        by_time = {}
        for message in station.messages:
            management = message["payload"]["managementContainer"]
            by_time[management["referenceTime"]] = message

        frames = np.flatnonzero(watched.detected["one"])
        assert len(frames) > 3

        for frame in frames:
            elapsed_s = run.time_s[frame] - run.time_s[0]
            message = by_time[round(1000 * elapsed_s) + 25]
            (one,) = objects_of(message)
            assert one["measurementDeltaTime"] == -25

            told_cm = values_of(one["position"], "Coordinate")
            at_m = told_cm / 100.0
            expected_m = run.vru_position_m[frame] - mast_m
            assert_allclose(at_m[:2], expected_m, atol=0.012)

            # n stands for more than n - 1 and at most n centimetres.
            up_cm = np.ceil(50.0 * run.encounter.vru.height_m - 1e-6)
            assert at_m[2] == pytest.approx(up_cm / 100.0, abs=1e-9)

            if 0 < frame < len(run.time_s) - 1:
                around = [frame - 1, frame + 1]
                (step_m,) = np.diff(run.vru_position_m[around], axis=0)
                (over_s,) = np.diff(run.time_s[around])
                velocity = one["velocity"]["cartesianVelocity"]
                speeds_mps = values_of(velocity, "Velocity", "xy") / 100.0
                # Within what a turn or a start changes in a tenth of a second.
                assert_allclose(speeds_mps, step_m / over_s, atol=0.6)

        # What the sensors are is told once a second.
        told_ms = []
        for time_ms, message in by_time.items():
            kinds = [one["containerId"] for one in containers(message)]
            if 3 in kinds:
                told_ms.append(time_ms)
        assert np.diff(told_ms).min() >= 1000 - 1


def test_confidences_are_those_of_the_reports_and_of_the_track(runs):
    """95 % of a normal error lies within 1.96 standard deviations."""
    run = runs[0]
    layout = level_layout(0.0)
    told = {}

    for aimed in (CALIBRATED, BY_EYE):
        watched = replace(seen_in(run, 7, share=0.9), aimed=aimed)
        (station,) = build_stations(layout, SCENE, watched)
        frames = np.flatnonzero(watched.detected["one"])
        found = all_objects(station.messages)
        (errors_m2,) = report_covariances_m2(watched, layout.units)
        tracks = follow_watched(watched, layout.units).tracks

        for frame, one in zip(frames, found, strict=True):
            ee, en, nn = errors_m2[frame]
            velocities = one["velocity"]["cartesianVelocity"]

            for axis, variance, row in (
                ("x", ee, 2),
                ("y", nn, 3),
            ):
                place = one["position"][f"{axis}Coordinate"]
                expected = math.ceil(196.0 * math.sqrt(variance) - 1e-6)
                # Beyond 40.94 m: out of range.
                assert place["confidence"] == min(expected, 4095)

                # 126: more than can be told; 127: not known.
                velocity = velocities[f"{axis}Velocity"]
                sd_mps = math.sqrt(tracks.covariance[frame, row, row])
                expected = math.ceil(196.0 * sd_mps - 1e-6)
                expected = min(expected, 126)
                if not tracks.is_live[frame]:
                    expected = 127
                assert velocity["confidence"] == expected

            (matrix,) = one["lowerTriangularCorrelationMatrices"]
            correlation = en / math.sqrt(ee * nn)

            assert matrix["matrix"] == [[round(100.0 * correlation)]]
            assert one["position"]["zCoordinate"]["confidence"] == 4096
        assert tracks.is_live.any()

        # The run ends near the mast.
        last = found[-1]["position"]
        told[aimed] = last["xCoordinate"]["confidence"]

    assert told[CALIBRATED] < told[BY_EYE]


def test_reports_of_several_units_are_fused_by_their_inverses():
    """The inverses of errors add up: 1 + 1 + 2, and a fourth of it to the north."""
    errors_m2 = [
        [1.0, 0.0, 4.0],
        [1.0, 0.0, 4.0],
        [0.5, 0.0, 2.0],
    ]
    expected_m2 = [
        [0.25, 0.0],
        [0.0, 1.0],
    ]
    fused_m2 = fuse_m2(np.array(errors_m2))

    assert_allclose(fused_m2, expected_m2, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("release", RELEASES)
def test_a_message_by_hand(release):
    """Byte by byte as another library decodes and encodes it."""
    layout = level_layout(90.0, -10.0)
    (station,) = build_stations(layout, SCENE, release=release)
    content = encode(station.messages[0], release)

    assert content.hex() == GOLDEN[release]


def test_both_releases_open_to_the_same_side():
    """V2.1.1 counts clockwise from north, V2.4.1 counter-clockwise from east."""
    layout = level_layout(30.0)
    shapes = []
    for release in RELEASES:
        (station,) = build_stations(layout, SCENE, release=release)
        _, sensors, *_ = containers(station.messages[0])
        region = sensors["containerData"][0]["perceptionRegionShape"]
        shapes.append(region["radial"])

    old, new = shapes
    start = old["stationaryHorizontalOpeningAngleStart"]
    end = new["horizontalOpeningAngleEnd"]

    # In tenths of a degree: the unit looks 30 degrees north of east, 110 wide.
    assert start == 900 - end
    assert new["horizontalOpeningAngleStart"] == (300 - 550) % 3600


def test_the_load_of_the_channel_is_that_of_the_bytes(runs):
    """Without a run there is one message, about the sensors."""
    layout = level_layout(0.0)
    content = to_cpm_uper(layout, SCENE, seen_in(runs[0], 1))
    messages = split(content)
    first_ms, _ = messages[0]
    last_ms, _ = messages[-1]
    span_s = (last_ms - first_ms) / 1000.0
    n_bytes = sum(len(data) for _, data in messages)
    bytes_per_s = n_bytes / span_s
    share = 8.0 * bytes_per_s / 6.0e6
    words = tell_load(content)

    assert f"{bytes_per_s:.0f} to {bytes_per_s:.0f} bytes per second" in words
    assert f"together {100.0 * share:.2f} % of a channel of 6 Mbit/s" in words

    without_run = to_cpm_uper(layout, SCENE)
    assert "1 messages of" in tell_load(without_run)


def test_what_units_detect_in_a_run_is_the_evaluators():
    """As many objects as frames in which a unit detects."""
    study = load_carlancap_layout()
    layout = Layout(
        name="two",
        units=study.units[:2],
        scene_name=study.scene_name,
    )
    watched = watch_run(layout, SCENE, "CPNC-50/east/40")
    document = json.loads(to_cpm(layout, SCENE, watched))
    n_told = 0
    for station in document["stations"]:
        for one in all_objects(station["messages"]):
            n_told += len(one["sensorIdList"])

    n_detected = sum(int(frames.sum()) for frames in watched.detected.values())
    assert n_told == n_detected > 0


def test_an_unknown_release_is_refused():
    layout = level_layout(0.0)
    told = r"^release: got '3'; expected one of 2.1.1, 2.4.1$"

    with pytest.raises(InputError, match=told):
        to_cpm(layout, SCENE, release="3")


def random_layout(rng):
    """One to four units at a site, within some metres, of all kinds."""
    kinds = [*load_cameras().values(), *load_lidars().values()]
    middle_m = rng.uniform(-60.0, 60.0, 2)
    units = []
    for number in range(rng.integers(1, 5)):
        east_m, north_m = middle_m + rng.uniform(-3.0, 3.0, 2)
        up_m = rng.uniform(2.0, 12.0)
        yaw_deg = rng.uniform(-180.0, 180.0)
        pitch_deg = rng.uniform(-90.0, 45.0)
        sensor = kinds[rng.integers(len(kinds))]
        units.append(
            unit_at(
                f"unit {number}",
                [east_m, north_m, up_m],
                yaw_deg=float(yaw_deg),
                pitch_deg=float(pitch_deg),
                site_id="site",
                sensor=sensor,
            )
        )

    return Layout(
        name="random",
        units=tuple(units),
        scene_name=SCENE.name,
    )


def assert_within_a_unit(above):
    """n stands for more than n - 1 and at most n of a unit."""
    assert above.min() > -0.01
    assert above.max() < 1.01


def start_of_view(shape):
    """Name of the field that says where a view begins; releases name it differently."""
    ending = "zontalopeninganglestart"
    return next(key for key in shape if key.lower().endswith(ending))


@pytest.mark.long
def test_random_layouts_and_frames_are_read_back_to_the_resolution(runs):
    """Places in centimetres, velocities in centimetres a second, angles in tenths of a
    degree.
    """
    rng = np.random.default_rng(10_000)
    to_local = Transformer.from_crs("EPSG:4326", SCENE.crs, always_xy=True)
    moving = [(run, run.encounter.vru_motion) for run in runs]

    for _ in range(10_000):
        layout = random_layout(rng)
        release = RELEASES[rng.integers(2)]
        run, motion = moving[rng.integers(len(moving))]
        frame = rng.integers(len(run.time_s))

        # The last unit detects in this frame, nobody in any other.
        detected = {}
        for unit in layout.units:
            detected[unit.id] = np.zeros(len(run.time_s), dtype=bool)
        detected[layout.units[-1].id][frame] = True
        watched = WatchedRun(
            run=run,
            detected=detected,
            rule=load_aeb_rule(),
        )
        (station,) = build_stations(
            layout,
            SCENE,
            watched,
            release=release,
        )
        found = []
        for message in station.messages:
            content = encode(message, release)
            found.append(decode(content, release))
        assert found == list(station.messages)

        (first, *_) = found
        place = first["payload"]["managementContainer"]["referencePosition"]
        longitude_deg = place["longitude"] / 1e7
        latitude_deg = place["latitude"] / 1e7
        east_m, north_m = to_local.transform(longitude_deg, latitude_deg)
        origin_m = np.array([east_m, north_m, 0.0])
        sensors = containers(first)[1]["containerData"]

        for unit, sensor in zip(layout.units, sensors, strict=True):
            shape = sensor["perceptionRegionShape"]["radial"]
            point = shape["shapeReferencePoint"]
            told_cm = by_axis(point, "Coordinate")
            asked_m = unit.pose.position_m - origin_m
            assert_within_a_unit(told_cm - 100.0 * asked_m)

            if not is_ring(unit.sensor):
                half_deg = 0.5 * unit.sensor.horizontal_fov_deg
                name = start_of_view(shape)
                if "stat" in name:
                    begin_deg = 90.0 - unit.pose.yaw_deg
                else:
                    begin_deg = unit.pose.yaw_deg
                above = shape[name] - 10.0 * (begin_deg - half_deg)
                above = (above + 100.0) % 3600 - 100.0
                assert -1e-3 < above < 1.001

        (one,) = all_objects(found)
        assert one["sensorIdList"] == [len(layout.units) - 1]

        half_height_m = 0.5 * run.encounter.vru.height_m
        at_m = np.append(run.vru_position_m[frame], half_height_m)
        told_cm = values_of(one["position"], "Coordinate")
        assert_within_a_unit(told_cm - 100.0 * (at_m - origin_m))

        around_s = run.time_s[frame] + np.array([-5e-4, 5e-4])
        places_m, _ = motion.path.at(motion.distance_m(around_s))
        (way_m,) = np.diff(places_m, axis=0)
        velocity = one["velocity"]["cartesianVelocity"]
        told_cmps = values_of(velocity, "Velocity", "xy")
        speed_mps = way_m / 1e-3
        off = told_cmps - 100.0 * speed_mps - 0.5
        # Half a unit, and what a start changes in a moment.
        assert np.abs(off).max() < 0.6
