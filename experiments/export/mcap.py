"""Layouts and runs as MCAP recordings in Foxglove's schemas."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.calibrations import CalibratedCamera
from geometry.errors import refuse
from geometry.scene import Scene
from geometry.sensors import CameraModel, with_width
from geometry.terrain import on_ground
from geometry.weather import pick_weather
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.evaluation import earliest_arrival_s
from placement.evaluator.picture_sources import to_jpeg
from placement.imaging import build_backdrop, draw_picture
from placement.layout import Layout
from scenarios.runs import Run, build_frame_axis, find_onsets

from ..language import mark
from . import ExportFormat, load_extra
from .calibration import calibrations, lens_coefficients, plain, sensor_quaternion
from .watched import Followed, WatchedRun, ellipse_points_m, follow_watched

# Frame, as REP 105 calls it.
WORLD = "map"
_COLOURS = {
    "ground": (0.45, 0.45, 0.45, 1.0),
    "building": (0.75, 0.7, 0.62, 1.0),
    "wall": (0.7, 0.7, 0.7, 1.0),
    "vegetation": (0.3, 0.55, 0.3, 1.0),
    "pole": (0.3, 0.3, 0.3, 1.0),
    "unit": (0.1, 0.4, 0.9, 1.0),
    "vut": (0.2, 0.3, 0.8, 0.9),
    "vru": (0.9, 0.5, 0.1, 0.9),
    "seen": (0.1, 0.8, 0.2, 1.0),
    "foreseen": (0.95, 0.8, 0.1, 1.0),
    "braking": (0.9, 0.1, 0.1, 1.0),
    "other": (0.6, 0.6, 0.65, 1.0),
}
# How far ahead its far side is drawn.
_FRUSTUM_M = 4.0
# of what is drawn: the sides of wider ones would be kilometres away
_WIDEST_DEG = 150.0
# Of pictures.
_WIDEST_PX = 640
_NANO = 1_000_000_000
# Above the ground, so that lines on it are seen.
_LINE_M = 0.05
_WAY_POINTS = 36


def to_mcap(
    layout: Layout,
    scene: Scene,
    watched: WatchedRun | None = None,
    *,
    pictures: Compute | None = None,
) -> bytes:
    """Layout as an MCAP file; with a run its frames, from time 0 on.

    Topics: /scene (meshes), /units (a frustum per camera, a ball per LiDAR), /tf and
    /calibration/UNIT (cameras); of a run /bodies (boxes), /detections (a line from each
    unit that detects) and /state (JSON: time to the impact, units that detect, whether
    a track is confirmed and braking would have begun, and whether the car would brake
    by the decision) and /decision (the track's ellipse of 95 %, and the ways of both
    for as long as the car looks ahead; red once it brakes). Frame "map": x east, y
    north, z up. Nobody brakes in it. With `pictures`, what to draw with, /image/UNIT
    has what
    each camera sees of a run, reduced, and /calibration/UNIT is of these pictures. Not
    in it: point clouds. Raises InputError for pictures without a run, MissingExtraError
    if foxglove-sdk is not installed.
    """
    if pictures is not None:
        if watched is None:
            refuse("--pictures", "no run", "--run RUN, whose frames are drawn")
        layout = replace(layout, units=tuple(_reduced(unit) for unit in layout.units))
    foxglove, m, kinds = (
        load_extra(f"foxglove{part}", "mcap needs foxglove-sdk", "mcap")
        for part in ("", ".messages", ".channels")
    )
    units = layout.units
    context = foxglove.Context()
    file = io.BytesIO()
    with foxglove.open_mcap(file, context=context):
        channels: dict[str, Any] = {}

        def log(topic: str, message: Any, time_s: float) -> None:
            if topic not in channels:
                maker = getattr(kinds, f"{type(message).__name__}Channel", None)
                if maker is None:
                    channels[topic] = foxglove.Channel(
                        topic, message_encoding="json", context=context
                    )
                else:
                    channels[topic] = maker(topic, context=context)
            channels[topic].log(message, log_time=round(time_s * _NANO))

        log("/scene", m.SceneUpdate(entities=list(_meshes(m, scene))), 0.0)
        log("/units", m.SceneUpdate(entities=list(_units(m, units))), 0.0)
        transforms = [
            m.FrameTransform(
                timestamp=m.Timestamp(0),
                parent_frame_id=WORLD,
                child_frame_id=unit.id,
                translation=_vector(m, unit.pose.position_m),
                rotation=_turn(m, sensor_quaternion(unit.pose, unit.sensor)),
            )
            for unit in units
        ]
        log("/tf", m.FrameTransforms(transforms=transforms), 0.0)
        if any(isinstance(unit.sensor, CameraModel) for unit in units):
            for name, camera in calibrations(layout, "mcap").items():
                log(f"/calibration/{name}", _calibration(m, name, camera), 0.0)
        for topic, message, time_s in (
            [] if watched is None else _frames(m, units, watched)
        ):
            log(topic, message, time_s)
        if pictures is not None and watched is not None:
            for topic, message, time_s in _pictures(
                m, units, scene, watched.run, pictures
            ):
                log(topic, message, time_s)
    return file.getvalue()


def _entity(m: Any, name: str, **parts: Any) -> Any:
    return m.SceneEntity(frame_id=WORLD, id=name, timestamp=m.Timestamp(0), **parts)


def _colour(m: Any, name: str) -> Any:
    red, green, blue, alpha = _COLOURS.get(name, _COLOURS["other"])
    return m.Color(r=red, g=green, b=blue, a=alpha)


def _points(m: Any, points_m: Any) -> list[Any]:
    return [m.Point3(x=x, y=y, z=z) for x, y, z in np.asarray(points_m).tolist()]


def _meshes(m: Any, scene: Scene) -> Iterator[Any]:
    for index, thing in enumerate(scene.instances):
        triangles = scene.triangles[scene.triangle_instance == index]
        used, indices = np.unique(triangles, return_inverse=True)
        mesh = m.TriangleListPrimitive(
            points=_points(m, scene.vertices_m[used]),
            indices=indices.ravel().tolist(),
            color=_colour(m, thing.class_name),
        )
        kind = m.KeyValuePair(key="class", value=thing.class_name)
        yield _entity(m, thing.id, triangles=[mesh], metadata=[kind])


def _units(m: Any, units: Sequence[CandidatePose]) -> Iterator[Any]:
    for unit in units:
        position_m = np.asarray(unit.pose.position_m)
        above = _pose(m, position_m + [0.0, 0.0, 0.5])
        label = m.TextPrimitive(pose=above, text=unit.id, font_size=0.5, billboard=True)
        if not isinstance(unit.sensor, CameraModel):
            size = _vector(m, [0.3, 0.3, 0.3])
            ball = m.SpherePrimitive(
                pose=_pose(m, position_m), size=size, color=_colour(m, "unit")
            )
            yield _entity(m, unit.id, spheres=[ball], texts=[label])
            continue
        corners = _corners(unit.sensor)
        frustum = m.LinePrimitive(
            type=m.LinePrimitiveLineType.LineList,
            pose=_pose(m, position_m, sensor_quaternion(unit.pose, unit.sensor)),
            points=_points(m, [[0.0, 0.0, 0.0], *corners]),
            indices=[0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1],
            thickness=0.05,
            color=_colour(m, "unit"),
        )
        yield _entity(m, unit.id, lines=[frustum], texts=[label])


def _corners(camera: CameraModel) -> list[list[float]]:
    """Corners of a pinhole's picture.

    Of the angles that a lens shows across and up.
    """
    half = 0.5 * np.array([camera.width_px, camera.height_px])
    x_m, y_m = _FRUSTUM_M * half / camera.focal_length_px
    if not camera.is_pinhole:
        fovs_deg = np.minimum(
            [camera.horizontal_fov_deg, camera.vertical_fov_deg], _WIDEST_DEG
        )
        x_m, y_m = _FRUSTUM_M * np.tan(np.radians(0.5 * fovs_deg))
    return [
        [x * x_m, y * y_m, _FRUSTUM_M] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]


def _vector(m: Any, values: Any) -> Any:
    x, y, z = np.asarray(values).tolist()
    return m.Vector3(x=x, y=y, z=z)


def _turn(m: Any, quaternion: Sequence[float]) -> Any:
    x, y, z, w = quaternion
    return m.Quaternion(x=x, y=y, z=z, w=w)


def _pose(
    m: Any, position_m: Any, quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
) -> Any:
    return m.Pose(position=_vector(m, position_m), orientation=_turn(m, quaternion))


def _calibration(m: Any, name: str, camera: CalibratedCamera) -> Any:
    is_fisheye, terms = lens_coefficients(name, camera)
    return m.CameraCalibration(
        timestamp=m.Timestamp(0),
        frame_id=name,
        width=camera.width_px,
        height=camera.height_px,
        distortion_model="kannala_brandt" if is_fisheye else "plumb_bob",
        D=plain(terms),
        K=plain(camera.K),
        R=plain(np.eye(3)),
        P=plain(np.column_stack([camera.K, np.zeros(3)])),
    )


def _frames(
    m: Any, units: Sequence[CandidatePose], watched: WatchedRun
) -> Iterator[tuple[str, Any, float]]:
    run = watched.run
    axis = build_frame_axis((run,), np.ones(1))
    parties = [
        (watched.detected[unit.id], unit.latency(watched.rule)) for unit in units
    ]
    onsets = find_onsets(earliest_arrival_s(parties, axis), axis, rule=watched.rule)
    confirmed_s = float(onsets.confirmation_s[0])
    onset_s = float(onsets.onset_s[0])
    met = run.encounter.vru
    last_s = run.last_brake_time_s
    followed = follow_watched(watched, units)
    for frame, to_impact_s in enumerate(run.time_s.tolist()):
        time_s = to_impact_s - float(run.time_s[0])
        bodies: list[tuple[str, Actor, Any, float]] = [
            (
                "vut",
                run.encounter.vut,
                run.vut_position_m[frame],
                run.vut_yaw_deg[frame],
            ),
            ("vru", met, run.vru_position_m[frame], run.vru_yaw_deg[frame]),
            *(
                (
                    f"obstruction-{n}",
                    one.actor,
                    one.pose.position_m[:2],
                    one.pose.yaw_deg,
                )
                for n, one in enumerate(run.obstruction, 1)
            ),
            *(
                (f"traffic-{n}", one.actor, one.position_m[frame], one.yaw_deg[frame])
                for n, one in enumerate(run.traffic, 1)
                if one.is_there[frame]
            ),
        ]
        boxes = [_box(m, run, *body) for body in bodies]
        yield "/bodies", m.SceneUpdate(entities=boxes), time_s
        seeing = [unit for unit in units if watched.detected[unit.id][frame]]
        ground_m = on_ground(run.vru_position_m[frame], run.terrain)
        at_m = ground_m + [0.0, 0.0, 0.5 * met.height_m]
        rays = m.LinePrimitive(
            type=m.LinePrimitiveLineType.LineList,
            points=_points(
                m, [p for unit in seeing for p in (unit.pose.position_m, at_m)]
            ),
            thickness=0.05,
            color=_colour(m, "seen"),
        )
        seen = _entity(m, "detections", lines=[rays])
        yield "/detections", m.SceneUpdate(entities=[seen]), time_s
        decided = list(_decision(m, run, followed, frame))
        yield "/decision", m.SceneUpdate(entities=decided), time_s
        state = {
            "to_impact_s": to_impact_s,
            "n_detecting": len(seeing),
            "detecting": [unit.id for unit in seeing],
            "is_confirmed": to_impact_s >= confirmed_s,
            "would_brake": to_impact_s >= onset_s,
            "overlap_probability": float(followed.probability[frame]),
            "decides_to_brake": bool(followed.brakes[frame]),
            "last_brake_time_s": last_s if np.isfinite(last_s) else None,
        }
        yield "/state", state, time_s


def _decision(m: Any, run: Run, followed: Followed, frame: int) -> Iterator[Any]:
    """What the car knows and foresees in a frame; empty where no track is confirmed."""
    if not followed.tracks.is_live[frame]:
        # An entity without parts takes the place of that of the frame before.
        yield _entity(m, "ellipse")
        yield _entity(m, "ways")
        return
    name = "foreseen"
    if followed.brakes[frame]:
        name = "braking"
    state = followed.tracks.state[0, frame]
    covariance_m2 = followed.tracks.covariance[frame, :2, :2]
    ellipse_m = ellipse_points_m(state[:2], covariance_m2)
    ring = m.LinePrimitive(
        type=m.LinePrimitiveLineType.LineLoop,
        points=_points(m, _on_road_m(ellipse_m, run)),
        thickness=0.05,
        color=_colour(m, name),
    )
    yield _entity(m, "ellipse", lines=[ring])
    ahead_s = np.linspace(0.0, followed.ahead_s, _WAY_POINTS)
    vru_m = state[:2] + ahead_s[:, None] * state[2:]
    vut_motion = run.encounter.vut_motion
    vut_m, _ = vut_motion.path.at(vut_motion.distance_m(run.time_s[frame] + ahead_s))
    ways = [
        m.LinePrimitive(
            type=m.LinePrimitiveLineType.LineStrip,
            points=_points(m, _on_road_m(way_m, run)),
            thickness=0.1,
            color=_colour(m, name),
        )
        for way_m in (vru_m, vut_m)
    ]
    yield _entity(m, "ways", lines=ways)


def _on_road_m(places_m: FloatArray, run: Run) -> FloatArray:
    """Places (n, 2) just above the ground, (n, 3), in m."""
    above: FloatArray = on_ground(places_m, run.terrain) + [0.0, 0.0, _LINE_M]
    return above


def _reduced(unit: CandidatePose) -> CandidatePose:
    """A unit with a camera of fewer pixels that sees the same."""
    if not isinstance(unit.sensor, CameraModel) or unit.sensor.width_px <= _WIDEST_PX:
        return unit
    return replace(unit, sensor=with_width(unit.sensor, _WIDEST_PX))


def _pictures(
    m: Any, units: Sequence[CandidatePose], scene: Scene, run: Run, compute: Compute
) -> Iterator[tuple[str, Any, float]]:
    backdrop = build_backdrop(scene, run.obstruction)
    weather = pick_weather(run.weather, "weather")
    cameras = [
        (unit, unit.sensor) for unit in units if isinstance(unit.sensor, CameraModel)
    ]
    for frame, to_impact_s in enumerate(run.time_s.tolist()):
        compute.progress(mark("draw pictures"), frame, len(run.time_s))
        time_s = to_impact_s - float(run.time_s[0])
        for unit, camera in cameras:
            picture = draw_picture(
                backdrop,
                run,
                frame,
                unit.pose,
                camera,
                weather=weather,
                compute=compute,
            )
            image = m.CompressedImage(
                timestamp=m.Timestamp.from_epoch_secs(time_s),
                frame_id=unit.id,
                data=to_jpeg(picture.rgb),
                format="jpeg",
            )
            yield f"/image/{unit.id}", image, time_s


def _box(
    m: Any, run: Run, name: str, actor: Actor, position_m: Any, yaw_deg: float
) -> Any:
    half_rad = 0.5 * np.radians(yaw_deg)
    turn = (0.0, 0.0, float(np.sin(half_rad)), float(np.cos(half_rad)))
    middle_m = on_ground(position_m, run.terrain) + [0.0, 0.0, 0.5 * actor.height_m]
    size = _vector(m, [actor.length_m, actor.width_m, actor.height_m])
    cube = m.CubePrimitive(
        pose=_pose(m, middle_m, turn), size=size, color=_colour(m, name)
    )
    return _entity(
        m, name, cubes=[cube], metadata=[m.KeyValuePair(key="body", value=actor.name)]
    )


FORMAT = ExportFormat(
    write=to_mcap,
    shows_runs=True,
    options=("pictures",),
)
