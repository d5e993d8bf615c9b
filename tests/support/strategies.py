"""Hypothesis strategies for the values that the packages pass on."""

import dataclasses

import numpy as np
from hypothesis import strategies as st

from geometry.actors import Actor, load_actors
from geometry.poses import Pose
from geometry.sensors import CameraModel
from placement.detection_table import DetectionTable, pack_table
from scenarios.encounters import Encounter
from scenarios.paths import Motion, StraightPath
from scenarios.runs import FrameAxis

KMH = 1.0 / 3.6


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Floats within a range."""
    return st.floats(low, high, allow_subnormal=False)


angles_deg = numbers(-720.0, 720.0)
pitches_deg = numbers(-90.0, 90.0)
coordinates_m = numbers(-300.0, 300.0)
points_m = st.tuples(coordinates_m, coordinates_m, coordinates_m).map(np.array)


@st.composite
def poses(draw) -> Pose:
    """Poses anywhere near the origin."""
    return Pose(
        position_m=draw(points_m), yaw_deg=draw(angles_deg), pitch_deg=draw(pitches_deg)
    )


@st.composite
def cameras(draw) -> CameraModel:
    """Cameras of any resolution and field of view."""
    return CameraModel(
        name="any",
        width_px=draw(st.integers(1, 4000)),
        height_px=draw(st.integers(1, 4000)),
        horizontal_fov_deg=draw(numbers(5.0, 170.0)),
        frame_rate_hz=10.0,
        near_m=0.1,
        price_eur=0.0,
    )


@st.composite
def boxes_px(draw, size_px: int = 40, margin_px: int = 0) -> np.ndarray:
    """A box with whole coordinates, within an image or a margin beyond it; it may be
    empty.
    """
    x = sorted(
        draw(
            st.lists(
                st.integers(-margin_px, size_px + margin_px), min_size=2, max_size=2
            )
        )
    )
    y = sorted(
        draw(
            st.lists(
                st.integers(-margin_px, size_px + margin_px), min_size=2, max_size=2
            )
        )
    )
    return np.array([x[0], y[0], x[1], y[1]], dtype=float)


@dataclasses.dataclass(frozen=True)
class Rectangle:
    """A rectangle on the ground."""

    centre_m: tuple[float, float]
    yaw_deg: float
    length_m: float
    width_m: float


@st.composite
def rectangles(draw, reach_m: float = 6.0) -> Rectangle:
    return Rectangle(
        centre_m=(draw(numbers(-reach_m, reach_m)), draw(numbers(-reach_m, reach_m))),
        yaw_deg=draw(angles_deg),
        length_m=draw(numbers(0.2, 6.0)),
        width_m=draw(numbers(0.2, 6.0)),
    )


def build_encounter(
    *,
    vru: Actor,
    vut_speed_mps: float,
    vru_speed_mps: float,
    angle_deg: float,
    touch: float,
    turn_deg: float = 0.0,
    origin_m: tuple[float, float] = (0.0, 0.0),
    vut_drive_s: float = 8.0,
) -> Encounter:
    """An encounter in which the VUT's front first touches the VRU at time 0, at any
    angle.

    In the VUT's frame (front at x = 0, left at +y) the VRU's rearmost corner is at x =
    0 at time 0 and at `touch` (-1 = right edge, +1 = left edge) of the VUT's half
    width. The VUT is the faster one, so before time 0 the whole VRU was ahead of the
    front. `angle_deg` is the VRU's heading against the VUT's; the whole encounter is
    turned and moved at the end.
    """
    vut = load_actors()["vut"]
    assert vut_speed_mps > vru_speed_mps * np.cos(np.radians(angle_deg))

    angle = np.radians(angle_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    corners = np.array(
        [
            0.5 * i * vru.length_m * along + 0.5 * j * vru.width_m * across
            for i in (-1, 1)
            for j in (-1, 1)
        ]
    )
    rear_x = corners[:, 0].min()
    rear_y = corners[np.isclose(corners[:, 0], rear_x, atol=1e-9), 1].mean()
    vru_middle = np.array([-rear_x, 0.5 * touch * vut.width_m - rear_y])
    vut_middle = np.array([-0.5 * vut.length_m, 0.0])

    turn = np.radians(turn_deg)
    rotation = np.array(
        [
            [np.cos(turn), -np.sin(turn)],
            [np.sin(turn), np.cos(turn)],
        ]
    )

    def motion(middle, direction, yaw_deg, speed_mps, drive_s):
        start = rotation @ (middle - direction * speed_mps * drive_s) + origin_m
        path = StraightPath(start_m=start, yaw_deg=yaw_deg)
        return Motion(path=path, speed_mps=speed_mps, start_time_s=-drive_s)

    return Encounter(
        vut=vut,
        vut_motion=motion(
            vut_middle, np.array([1.0, 0.0]), turn_deg, vut_speed_mps, vut_drive_s
        ),
        vru=vru,
        vru_motion=motion(vru_middle, along, turn_deg + angle_deg, vru_speed_mps, 12.0),
    )


@st.composite
def encounters(draw) -> Encounter:
    """Oblique, crossing and longitudinal encounters alike."""
    return build_encounter(
        vru=load_actors()[draw(st.sampled_from(["adult", "cyclist"]))],
        vut_speed_mps=draw(numbers(20.0, 60.0)) * KMH,
        vru_speed_mps=draw(numbers(3.0, 15.0)) * KMH,
        angle_deg=draw(numbers(-180.0, 180.0)),
        touch=draw(numbers(-0.95, 0.95)),
        turn_deg=draw(angles_deg),
        origin_m=(draw(coordinates_m), draw(coordinates_m)),
    )


@st.composite
def frame_axes(draw, max_runs: int = 4, max_frames: int = 12) -> FrameAxis:
    """Frames of a few runs with random weights and last brake times."""
    lengths = draw(st.lists(st.integers(1, max_frames), min_size=1, max_size=max_runs))
    n_runs = len(lengths)
    parts = draw(st.lists(st.integers(1, 9), min_size=n_runs, max_size=n_runs))
    last = draw(st.lists(numbers(-1.2, 0.0), min_size=n_runs, max_size=n_runs))
    return FrameAxis(
        run_ids=tuple(f"run{index}" for index in range(n_runs)),
        cases=tuple(draw(st.sampled_from(["A", "B"])) for _ in range(n_runs)),
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=np.array(parts) / sum(parts),
        last_brake_time_s=np.array(last),
        run_start=np.concatenate([[0], np.cumsum(lengths)]),
        time_s=np.concatenate([np.arange(1 - n, 1) / 10.0 for n in lengths]),
    )


@st.composite
def detection_tables(draw, max_poses: int = 5) -> tuple[DetectionTable, np.ndarray]:
    """A detection table, and the booleans that it was packed from."""
    axis = draw(frame_axes())
    n_poses = draw(st.integers(1, max_poses))
    bits = draw(
        st.lists(
            st.booleans(),
            min_size=n_poses * axis.n_frames,
            max_size=n_poses * axis.n_frames,
        )
    )
    detected = np.array(bits, dtype=bool).reshape(n_poses, axis.n_frames)
    return (
        pack_table(tuple(f"pose{c}" for c in range(n_poses)), axis, detected),
        detected,
    )
