"""MCAP recordings, read back by the reader of another package."""

import importlib
import json
import math
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from command_results import refusal
from export_layouts import awkward_layout, large_layout
from json_files import read_json
from numpy.testing import assert_allclose
from PIL import Image
from short_runs import cut_run

from experiments.export.mcap import to_mcap
from experiments.export.watched import WatchedRun, find_run, follow_watched
from geometry.errors import InputError
from geometry.sensors import CameraModel
from geometry.study_scene import load_study_scene
from geometry.weather import pick_weather
from placement.compute import Compute
from placement.imaging import build_backdrop, draw_picture
from placement.layout import load_carlancap_layout
from scenarios.aeb import load_aeb_rule

pytest.importorskip("foxglove", reason="the extra mcap is not installed")
reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")

SCENE = load_study_scene()
LAYOUT = load_carlancap_layout()


def read_mcap(content):
    """Times [s] and messages by topic, decoded by the schemas in the file.

    The packages `mcap` and `protobuf` read it, neither of which wrote it.
    """
    descriptors = importlib.import_module("google.protobuf.descriptor_pb2")
    pools = importlib.import_module("google.protobuf.descriptor_pool")
    factory = importlib.import_module("google.protobuf.message_factory")
    found = {}
    kinds = {}
    messages = reader.make_reader(BytesIO(content)).iter_messages()

    for schema, channel, message in messages:
        if channel.message_encoding == "json":
            value = json.loads(message.data)
        else:
            # A schema is a set of files; classes of messages are made of them once.
            if schema.id not in kinds:
                described = descriptors.FileDescriptorSet.FromString(schema.data)
                pool = pools.DescriptorPool()
                for file in described.file:
                    pool.Add(file)
                kind = pool.FindMessageTypeByName(schema.name)
                kinds[schema.id] = factory.GetMessageClass(kind)
            value = kinds[schema.id].FromString(message.data)

        time_s = message.log_time / 1.0e9
        topic = found.setdefault(channel.topic, [])
        topic.append((time_s, value))

    return found


@pytest.fixture(scope="module")
def watched():
    """A run behind parked cars; the first unit sees it from the tenth frame on, no
    other does.
    """
    run = find_run("CPNCO-50/east/40", SCENE)
    n_frames = len(run.time_s)
    first, *others = LAYOUT.units
    detected = {first.id: np.arange(n_frames) >= 10}
    for unit in others:
        detected[unit.id] = np.zeros(n_frames, dtype=bool)

    return WatchedRun(run=run, detected=detected, rule=load_aeb_rule())


@pytest.fixture(scope="module")
def topics(watched):
    """The run as it is read back."""
    content = to_mcap(LAYOUT, SCENE, watched)
    return read_mcap(content)


def test_bodies_are_where_the_run_has_them(topics, watched):
    """Boxes stand on the road: their middles are half their heights above it."""
    run = watched.run
    elapsed_s = run.time_s - run.time_s[0]
    bodies = topics["/bodies"]

    assert len(bodies) == len(run.time_s)

    for frame, (time_s, update) in enumerate(bodies):
        assert time_s == pytest.approx(elapsed_s[frame], abs=1e-6)

        # Both who meet, and all that is parked.
        boxes = {entity.id: entity.cubes[0] for entity in update.entities}
        assert len(boxes) == 2 + len(run.obstruction) > 2

        for name, body, at_m, yaw_deg in (
            ("vut", run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
            ("vru", run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
        ):
            pose = boxes[name].pose
            size = boxes[name].size
            place = pose.position
            east_m, north_m = at_m[frame]
            assert_allclose(
                [place.x, place.y, place.z],
                [east_m, north_m, 0.5 * body.height_m],
                atol=1e-9,
            )

            # A turn about the vertical axis: w and z are cosine and sine of its half.
            turn = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            off_deg = math.degrees(turn) - yaw_deg[frame]
            off_deg = (off_deg + 180.0) % 360.0 - 180.0

            assert off_deg == pytest.approx(0.0, abs=1e-9)
            assert size.x == body.length_m
            assert size.y == body.width_m
            assert size.z == body.height_m


def test_detections_confirmation_and_braking_follow_the_rule(topics, watched):
    """Three frames in a row confirm; 25 ms later the car knows."""
    states = [state for _, state in topics["/state"]]
    updates = [update for _, update in topics["/detections"]]
    first = LAYOUT.units[0]

    for frame, (state, update) in enumerate(zip(states, updates, strict=True)):
        if frame >= 10:
            detecting = [first.id]
        else:
            detecting = []
        assert state["detecting"] == detecting

        # A line from each unit that detects to the body.
        points = update.entities[0].lines[0].points
        assert len(points) == 2 * state["n_detecting"]
        # The third in a row.
        assert state["is_confirmed"] == (frame >= 12)
        # 25 ms later.
        assert state["would_brake"] == (frame >= 13)

    assert states[-1]["last_brake_time_s"] == watched.run.last_brake_time_s


def test_the_track_has_an_ellipse_and_turns_red_when_the_car_decides(topics, watched):
    """The ellipse holds 95 % of where the body may be."""
    followed = follow_watched(watched, LAYOUT.units)
    states = [state for _, state in topics["/state"]]
    decides = [state["decides_to_brake"] for state in states]

    assert decides == followed.brakes.tolist()
    # Nobody brakes before a track is confirmed, and this run is braked for.
    assert not decides[11]
    assert decides[-1]

    reds = []
    for frame, (_, update) in enumerate(topics["/decision"]):
        ellipse, prediction = update.entities
        ring = ellipse.lines
        ways = prediction.lines
        # From the frame on in which the track is confirmed.
        assert len(ring) == (frame >= 12)

        if not ring:
            continue

        colour = ring[0].color
        reds.append(colour.r > 0.8 and colour.g < 0.2)
        state = followed.tracks.state[0, frame]
        covariance = followed.tracks.covariance[frame]
        points_m = np.array([[point.x, point.y] for point in ring[0].points])
        off_m = points_m - state[:2]
        inverse = np.linalg.inv(covariance[:2, :2])
        # 95 % of a normal place in the plane: chi-square of two degrees, 5.991.
        squared = np.einsum(
            "ni,ij,nj->n",
            off_m,
            inverse,
            off_m,
        )
        assert_allclose(squared, 5.991, atol=0.01)

        # The way leads as far ahead as the body gets in a given time.
        first, *_, last = ways[0].points
        way_m = math.hypot(last.x - first.x, last.y - first.y)
        speed_mps = way_m / followed.ahead_s
        along_mps = np.linalg.norm(state[2:])
        assert speed_mps == pytest.approx(along_mps, abs=1e-9)

    assert reds == decides[12:]


def test_frusta_show_the_corners_of_the_image(topics):
    """A frustum's far corners are projected to the corners of the picture."""
    _, update = topics["/units"][0]
    by_id = {entity.id: entity for entity in update.entities}
    ids = [unit.id for unit in LAYOUT.units]

    assert list(by_id) == ids

    for unit_id in ids:
        line = by_id[unit_id].lines[0]
        ((_, calibration),) = topics[f"/calibration/{unit_id}"]
        matrix = np.reshape(list(calibration.K), (3, 3))
        points = np.array([[point.x, point.y, point.z] for point in line.points])
        # The first point is the camera itself.
        projected = points[1:] @ matrix.T
        pixels = projected[:, :2] / projected[:, 2:]
        width = calibration.width - 0.5
        height = calibration.height - 0.5
        assert_allclose(
            pixels,
            [
                [-0.5, -0.5],
                [width, -0.5],
                [width, height],
                [-0.5, height],
            ],
            atol=1e-6,
        )


def test_the_scenes_meshes_are_whole(topics):
    """Each triangle has three indices of vertices."""
    ((_, update),) = topics["/scene"]
    drawn = [entity.id for entity in update.entities]
    things = [thing.id for thing in SCENE.instances]

    assert drawn == things

    n_indices = sum(len(entity.triangles[0].indices) for entity in update.entities)
    assert n_indices == 3 * len(SCENE.triangles)


@pytest.mark.long
@pytest.mark.parametrize("build", [awkward_layout, large_layout])
def test_any_layout_is_written_without_a_run(build):
    """Then nothing moves: the scene, the units and their cameras."""
    layout = build()
    found = read_mcap(to_mcap(layout, SCENE))

    assert {"/scene", "/units", "/tf"} <= set(found)

    # Each unit has a frame of coordinates of its own.
    ((_, transforms),) = found["/tf"]
    frames = [one.child_frame_id for one in transforms.transforms]
    ids = [unit.id for unit in layout.units]

    assert frames == ids

    # Only cameras are calibrated.
    calibrations = [topic for topic in found if topic.startswith("/calibration/")]
    cameras = [unit for unit in layout.units if isinstance(unit.sensor, CameraModel)]

    assert len(calibrations) == len(cameras)


def test_a_recording_is_small(watched):
    """Meshes and frusta are written once, not in each frame."""
    content = to_mcap(LAYOUT, SCENE, watched)
    assert len(content) < 5_000_000


def test_foxgloves_layout_names_topics_that_exist(topics):
    """The file that the pages offer to users of Foxglove."""
    panels = read_json(Path("docs/files/foxglove.json"))["configById"]
    shown = set(panels["3D!scene"]["topics"])
    plotted = set()
    for path in panels["Plot!state"]["paths"]:
        topic, *_ = path["value"].split(".")
        plotted.add(topic)

    assert shown | plotted <= set(topics)


@pytest.mark.long
def test_pictures_are_what_a_reduced_camera_draws(watched):
    """But for what JPEG loses; they are 640 pixels wide."""
    unit = LAYOUT.units[0]
    one = replace(LAYOUT, units=(unit,))
    few = cut_run(watched.run, slice(2))
    unseen = {unit.id: np.zeros(2, dtype=bool)}
    short = replace(watched, run=few, detected=unseen)
    content = to_mcap(
        one,
        SCENE,
        short,
        pictures=Compute(),
    )
    found = read_mcap(content)
    ((_, calibration),) = found[f"/calibration/{unit.id}"]

    assert calibration.width == 640

    small = replace(unit.sensor, width_px=640, height_px=calibration.height)
    backdrop = build_backdrop(SCENE, few.obstruction)
    weather = pick_weather(few.weather, "weather")
    images = found[f"/image/{unit.id}"]
    times_s = [time_s for time_s, _ in images]

    assert times_s == pytest.approx([0.0, 0.1])

    for frame, (_, image) in enumerate(images):
        assert image.frame_id == unit.id
        assert image.format == "jpeg"

        picture = Image.open(BytesIO(image.data))
        shown = np.asarray(picture, dtype=float)
        drawn = draw_picture(
            backdrop,
            few,
            frame,
            unit.pose,
            small,
            weather=weather,
        ).rgb
        off = np.abs(shown - drawn)
        assert off.mean() < 3.0  # of 255

    with pytest.raises(InputError, match="--pictures: got no run; expected --run"):
        to_mcap(one, SCENE, pictures=Compute())


def test_pictures_of_other_formats_are_refused(run):
    """Only recordings hold pictures."""
    asked = "export --format cpm --layout carlancap-12 --run CPNC-50/east/40"
    result = run(asked, "--pictures")
    line = refusal(result)

    assert "--pictures: got it; expected none: cpm has no such option" in line
