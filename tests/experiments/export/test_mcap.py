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


def read_mcap(content):
    """Times [s] and messages by topic, decoded by the schemas in the file.

    The packages `mcap` and `protobuf` read it, neither of which wrote it.
    """
    descriptors = importlib.import_module("google.protobuf.descriptor_pb2")
    pools = importlib.import_module("google.protobuf.descriptor_pool")
    factory = importlib.import_module("google.protobuf.message_factory")
    found = {}
    kinds = {}
    for schema, channel, message in reader.make_reader(
        BytesIO(content)
    ).iter_messages():
        if channel.message_encoding == "json":
            value = json.loads(message.data)
        else:
            if schema.id not in kinds:
                pool = pools.DescriptorPool()
                files = descriptors.FileDescriptorSet.FromString(schema.data).file
                for file in files:
                    pool.Add(file)
                kind = pool.FindMessageTypeByName(schema.name)
                kinds[schema.id] = factory.GetMessageClass(kind)
            value = kinds[schema.id].FromString(message.data)
        topic = found.setdefault(channel.topic, [])
        topic.append((message.log_time / 1.0e9, value))

    return found


@pytest.fixture(scope="module")
def watched():
    """A run behind parked cars; the first unit sees it from the tenth frame on, no
    other does.
    """
    run = find_run("CPNCO-50/east/40", SCENE)
    units = load_carlancap_layout().units
    detected = {unit.id: np.zeros(len(run.time_s), dtype=bool) for unit in units}
    detected[units[0].id][10:] = True
    return WatchedRun(run=run, detected=detected, rule=load_aeb_rule())


@pytest.fixture(scope="module")
def topics(watched):
    """The run as it is read back."""
    return read_mcap(to_mcap(load_carlancap_layout(), SCENE, watched))


def test_bodies_are_where_the_run_has_them(topics, watched):
    run = watched.run
    assert len(topics["/bodies"]) == len(run.time_s)
    for frame, (time_s, update) in enumerate(topics["/bodies"]):
        assert time_s == pytest.approx(run.time_s[frame] - run.time_s[0], abs=1e-6)

        boxes = {entity.id: entity.cubes[0] for entity in update.entities}
        assert len(boxes) == 2 + len(run.obstruction) > 2

        for name, body, at_m, yaw_deg in (
            ("vut", run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
            ("vru", run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
        ):
            pose = boxes[name].pose
            size = boxes[name].size
            assert_allclose(
                [pose.position.x, pose.position.y, pose.position.z],
                [*at_m[frame], 0.5 * body.height_m],
                atol=1e-9,
            )

            turn = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            off_deg = math.degrees(turn) - yaw_deg[frame]

            assert (off_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
            assert size.x == body.length_m
            assert size.y == body.width_m
            assert size.z == body.height_m


def test_detections_confirmation_and_braking_follow_the_rule(topics, watched):
    states = [state for _, state in topics["/state"]]
    first = load_carlancap_layout().units[0]

    for frame, (state, (_, update)) in enumerate(
        zip(states, topics["/detections"], strict=True)
    ):
        assert state["detecting"] == ([first.id] if frame >= 10 else [])

        points = update.entities[0].lines[0].points
        assert len(points) == 2 * state["n_detecting"]
        assert state["is_confirmed"] == (frame >= 12)  # the third in a row
        assert state["would_brake"] == (frame >= 13)  # 25 ms later

    assert states[-1]["last_brake_time_s"] == watched.run.last_brake_time_s


def test_the_track_has_an_ellipse_and_turns_red_when_the_car_decides(topics, watched):
    followed = follow_watched(watched, load_carlancap_layout().units)
    states = [state for _, state in topics["/state"]]
    decides = [state["decides_to_brake"] for state in states]

    assert decides == followed.brakes.tolist()
    # Nobody brakes before a track is confirmed, and this run is braked for.
    assert not decides[11]
    assert decides[-1]

    reds = []
    for frame, (_, update) in enumerate(topics["/decision"]):
        ring, ways = (entity.lines for entity in update.entities)
        assert len(ring) == (frame >= 12)

        if not ring:
            continue
        reds.append(ring[0].color.r > 0.8 and ring[0].color.g < 0.2)
        points_m = np.array([[p.x, p.y] for p in ring[0].points])
        off_m = points_m - followed.tracks.state[0, frame, :2]
        inverse = np.linalg.inv(followed.tracks.covariance[frame, :2, :2])
        # 95 % of a normal place in the plane: chi-square of two degrees, 5.991.
        squared = np.einsum(
            "ni,ij,nj->n",
            off_m,
            inverse,
            off_m,
        )
        assert_allclose(squared, 5.991, atol=0.01)

        first, *_, last = ways[0].points
        speed_mps = math.hypot(last.x - first.x, last.y - first.y) / followed.ahead_s
        along_mps = np.hypot(*followed.tracks.state[0, frame, 2:])
        assert speed_mps == pytest.approx(along_mps, abs=1e-9)

    assert reds == decides[12:]


def test_frusta_show_the_corners_of_the_image(topics):
    """A frustum's far corners are projected to the corners of the picture."""
    (_, update), units = topics["/units"][0], load_carlancap_layout().units
    by_id = {entity.id: entity for entity in update.entities}

    assert list(by_id) == [unit.id for unit in units]

    for unit in units:
        line = by_id[unit.id].lines[0]
        ((_, calibration),) = topics[f"/calibration/{unit.id}"]
        matrix = np.reshape(list(calibration.K), (3, 3))
        ends = np.array([[point.x, point.y, point.z] for point in line.points])[1:]
        pixels = ends @ matrix.T
        pixels = pixels[:, :2] / pixels[:, 2:]
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
    ((_, update),) = topics["/scene"]
    assert [entity.id for entity in update.entities] == [
        thing.id for thing in SCENE.instances
    ]

    triangles = sum(len(entity.triangles[0].indices) // 3 for entity in update.entities)
    assert triangles == len(SCENE.triangles)


@pytest.mark.long
@pytest.mark.parametrize("build", [awkward_layout, large_layout])
def test_any_layout_is_written_without_a_run(build):
    layout = build()
    found = read_mcap(to_mcap(layout, SCENE))

    assert {"/scene", "/units", "/tf"} <= set(found)

    ((_, transforms),) = found["/tf"]
    assert [one.child_frame_id for one in transforms.transforms] == [
        u.id for u in layout.units
    ]

    cameras = [unit for unit in layout.units if isinstance(unit.sensor, CameraModel)]
    assert sum(topic.startswith("/calibration/") for topic in found) == len(cameras)


def test_a_recording_is_small(watched):
    assert len(to_mcap(load_carlancap_layout(), SCENE, watched)) < 5_000_000


def test_foxgloves_layout_names_topics_that_exist(topics):

    layout = read_json(Path("docs/files/foxglove.json"))
    shown = set(layout["configById"]["3D!scene"]["topics"])
    plotted = {
        path["value"].split(".")[0]
        for path in layout["configById"]["Plot!state"]["paths"]
    }

    assert shown | plotted <= set(topics)


@pytest.mark.long
def test_pictures_are_what_a_reduced_camera_draws(watched):
    layout = load_carlancap_layout()
    one = replace(layout, units=layout.units[:1])
    few = cut_run(watched.run, slice(2))
    short = replace(
        watched, run=few, detected={one.units[0].id: np.zeros(2, dtype=bool)}
    )
    found = read_mcap(
        to_mcap(
            one,
            SCENE,
            short,
            pictures=Compute(),
        )
    )
    (unit,) = one.units
    ((_, calibration),) = found[f"/calibration/{unit.id}"]

    assert calibration.width == 640

    small = replace(unit.sensor, width_px=640, height_px=calibration.height)
    backdrop = build_backdrop(SCENE, few.obstruction)
    images = found[f"/image/{unit.id}"]

    assert [time_s for time_s, _ in images] == pytest.approx([0.0, 0.1])

    for frame, (_, image) in enumerate(images):
        assert image.frame_id == unit.id
        assert image.format == "jpeg"

        shown = np.asarray(Image.open(BytesIO(image.data)), dtype=float)
        weather = pick_weather(few.weather, "weather")
        drawn = draw_picture(
            backdrop,
            few,
            frame,
            unit.pose,
            small,
            weather=weather,
        ).rgb
        assert np.abs(shown - drawn).mean() < 3.0  # of 255: JPEG

    with pytest.raises(InputError, match="--pictures: got no run; expected --run"):
        to_mcap(one, SCENE, pictures=Compute())


def test_pictures_of_other_formats_are_refused(run):
    asked = "export --format cpm --layout carlancap-12 --run CPNC-50/east/40"
    line = refusal(run(asked, "--pictures"))
    assert "--pictures: got it; expected none: cpm has no such option" in line
