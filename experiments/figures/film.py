"""A run from above: film strip or animation, with what the VUT has in sight of the VRU."""

from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.files import read_bytes, write_atomically
from geometry.footprints import footprint_corners
from geometry.poses import Pose, body_rotation, to_world
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Scene
from geometry.terrain import on_ground
from placement.compute import Progress, silent
from placement.evaluator import load_vut_camera
from placement.imaging.mesh import build_static_mesh
from scenarios.positions import AT_ZERO
from scenarios.runs import Run

from .axes import (
    BLUE,
    SKY,
    VERMILION,
    Style,
    drawing_any_name,
    literal,
    new_figure,
    root_figure,
    show_square,
)
from .plan import PARKED_STYLE, draw_parked, draw_scene

STILLS = (".png", ".svg", ".pdf")
ANIMATION = ".gif"
_DPI = 130
_PANEL_IN = 3.4
_ROWS, _COLUMNS = 2, 3
_SHOWN_S = 4.0  # a strip begins so long before the last moment to brake, or when the VRU sets off
_MARGIN_M = 6.0
_LEAST_SIZE_M = 24.0
_LOOKS_UP = np.linspace(0.08, 0.97, 10)  # parts of the VRU that are looked for, of its height
_LOOKS_ASIDE = (-0.35, 0.0, 0.35)  # of its width and length
_END_M = 0.02
_FAR_M = 500.0


def plot_film(scene: Scene, run: Run) -> list[Axes]:
    """Film strip of a run in which nobody brakes: six plan views from its begin to the impact.

    In metres, north up. The fourth shows the last frame in which braking still helps, the last one
    the impact.
    """
    figure = new_figure(_COLUMNS * _PANEL_IN, _ROWS * (_PANEL_IN + 0.3) + 1.0, dpi=_DPI)
    figure.suptitle(_title(run), fontsize=11)
    instants = _instants(run)
    stage = _Stage(scene, run, instants)
    panels = [figure.add_subplot(_ROWS, _COLUMNS, number + 1) for number in range(len(instants))]
    for axes, frame in zip(panels, instants, strict=True):
        stage.draw(axes, frame)
    figure.legend(
        handles=_legend(run), loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    return panels


def save_film(path: Path, scene: Scene, run: Run, *, progress: Progress = silent) -> None:
    """Write a run as a film strip or, to a ``.gif``, as an animation in real time.

    `progress` gets the frames of an animation. Raises InputError if the suffix is unknown, OSError
    if the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix == ANIMATION:
        data = _animate(scene, run, progress)
    elif suffix in STILLS:
        buffer = BytesIO()
        metadata = {"Software": None} if suffix == ".png" else {}
        with drawing_any_name():
            figure = root_figure(plot_film(scene, run)[0])
            figure.savefig(buffer, format=suffix[1:], metadata=metadata)
        data = buffer.getvalue()
    else:
        raise InputError(
            "--out", str(path), "a name that ends in " + ", ".join((*STILLS, ANIMATION))
        )
    write_atomically(path, data)


def _animate(scene: Scene, run: Run, progress: Progress) -> bytes:
    frames = [frame for frame in range(len(run.time_s)) if run.time_s[frame] >= _first_s(run)]
    figure = new_figure(5.6, 6.6, dpi=100)
    figure.suptitle(_title(run), fontsize=9)
    figure.legend(
        handles=_legend(run), loc="outside lower center", ncols=2, fontsize=7, frameon=False
    )
    axes = figure.add_subplot()
    stage = _Stage(scene, run, frames)

    def draw(frame: int) -> list[Any]:
        axes.clear()
        stage.draw(axes, frame)
        return []

    animation = FuncAnimation(figure, draw, frames=frames, init_func=list)
    with TemporaryDirectory() as folder, drawing_any_name():  # the library writes to names only
        name = Path(folder) / "film.gif"
        rate_hz = round(1.0 / float(np.diff(run.time_s[-2:])[0]))
        animation.save(
            name,
            writer=PillowWriter(fps=rate_hz),
            progress_callback=lambda done, total: progress("draw", done, total),
        )
        return read_bytes(name)


def _title(run: Run) -> str:
    where = run.approach if run.position == AT_ZERO.name else f"{run.approach} ({run.position} m)"
    speeds = f"{run.vut_speed_kmh:g}"
    if run.case.pairs_kmh:
        speeds += f" and {run.case.vru_speed_kmh:g}"
    return (
        f"{literal(run.case.name)}: {run.case.title}\n"
        f"from the {where} at {speeds} km/h, {run.weather}; nobody brakes"
    )


def _first_s(run: Run) -> float:
    last_s = run.last_brake_time_s
    moves_s = max(run.encounter.vru_motion.start_time_s, float(run.time_s[0]))
    return max(moves_s, last_s - _SHOWN_S) if np.isfinite(last_s) else moves_s


def _instants(run: Run) -> list[int]:
    """Frames of a strip: three, the last one that still helps, one after it, the impact."""
    final = len(run.time_s) - 1
    first = int(np.searchsorted(run.time_s, _first_s(run) - 1e-9))
    usable = np.flatnonzero(run.time_s <= run.last_brake_time_s)
    last = int(usable[-1]) if len(usable) else final - 2
    before = np.linspace(min(first, last), last, 4).round().astype(int)
    after = (last + final + 1) // 2
    return [*before.tolist(), after, final]


class _Sightlines:
    """Lines from the VUT's camera to points of the VRU, and what stands in between."""

    def __init__(self, scene: Scene, run: Run) -> None:
        self.run = run
        self.origin = np.append(scene.outline_m.mean(axis=0), 0.0)
        still = build_static_mesh(scene, run.obstruction)
        vertices = still.vertices_m - self.origin
        self.caster: RayCaster = build_caster(vertices, still.triangles, library="embree")
        self.vut_camera = load_vut_camera()
        self.lens = self.vut_camera.pose_on(run.encounter.vut).position_m

    def eye(self, frame: int) -> FloatArray:
        pose = _pose(self.run, self.run.vut_position_m[frame], self.run.vut_yaw_deg[frame])
        (eye,) = to_world(self.lens[None], pose)
        return np.asarray(eye)

    def free(self, frame: int) -> BoolArray:
        """Mask of the points that are in the image with a free line to them."""
        vru = self.run.encounter.vru
        points = np.array(
            [
                [aside * vru.length_m, across * vru.width_m, up * vru.height_m]
                for up in _LOOKS_UP
                for aside in _LOOKS_ASIDE
                for across in _LOOKS_ASIDE
            ]
        )
        pose = _pose(self.run, self.run.vru_position_m[frame], self.run.vru_yaw_deg[frame])
        targets = to_world(points, pose) - self.origin
        eye = self.eye(frame) - self.origin
        vectors = targets - eye
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
        vectors *= 1.0 - _END_M / length
        origins = np.repeat(eye[None], len(vectors), axis=0).astype(np.float32)
        is_free = ~self.caster.is_blocked(origins, vectors.astype(np.float32))
        return is_free & self._is_in_image(vectors, float(self.run.vut_yaw_deg[frame]))

    def _is_in_image(self, vectors_m: FloatArray, vut_yaw_deg: float) -> BoolArray:
        """Mask of the points that lie inside the image of the level camera."""
        camera = self.vut_camera.camera
        ahead, left, up = (vectors_m @ body_rotation(vut_yaw_deg)).T
        is_inside: BoolArray = ahead > 0.0
        is_inside &= np.abs(left) * camera.focal_length_px <= 0.5 * camera.width_px * ahead
        is_inside &= np.abs(up) * camera.focal_length_px <= 0.5 * camera.height_px * ahead
        return is_inside


@dataclass(frozen=True, slots=True)
class _Window:
    """A square part of the plan."""

    middle_m: FloatArray
    half_size_m: float


class _Stage:
    """Draws one instant of a run after the other, all in the same window."""

    def __init__(self, scene: Scene, run: Run, frames: list[int]) -> None:
        self.scene, self.run = scene, run
        self.sightlines = _Sightlines(scene, run)
        self.window = _window(run, frames)
        last_s = run.last_brake_time_s
        motion = run.encounter.vut_motion
        self.brake_m = motion.path.at(motion.distance_m(last_s))[0] if np.isfinite(last_s) else None

    def draw(self, axes: Axes, frame: int) -> None:
        """Everything at one instant."""
        run, window = self.run, self.window
        draw_scene(axes, self.scene)
        draw_parked(axes, run.obstruction)
        for positions, style in ((run.vut_position_m, "-"), (run.vru_position_m, (0, (3, 1.5)))):
            axes.plot(*positions.T, color="#777777", linewidth=0.8, linestyle=style, zorder=3)
            axes.plot(
                *positions[: frame + 1].T, color="black", linewidth=1.8, linestyle=style, zorder=3.1
            )
        if self.brake_m is not None:
            axes.plot(*self.brake_m, zorder=6.8, **_BRAKE_STYLE)
        share = self._draw_sight(axes, frame)
        _draw_body(
            axes, run.encounter.vut, run.vut_position_m[frame], run.vut_yaw_deg[frame], BLUE, ""
        )
        _draw_body(
            axes,
            run.encounter.vru,
            run.vru_position_m[frame],
            run.vru_yaw_deg[frame],
            VERMILION,
            "xxxx",
        )
        show_square(axes, window.middle_m, window.half_size_m)
        axes.tick_params(labelsize=7)
        axes.set_title(self._caption(frame, share), fontsize=9)
        self._point_at_vut(axes, frame)

    def _caption(self, frame: int, share: float) -> str:
        time_s = self.run.time_s[frame]
        when = f"{time_s:.1f} s".replace("-", "\N{MINUS SIGN}") if time_s < 0.0 else "impact"
        return f"{when}: {100.0 * share:.0f} % of the VRU in the VUT's sight"

    def _draw_sight(self, axes: Axes, frame: int) -> float:
        free = self.sightlines.free(frame)
        eye = self.sightlines.eye(frame)[:2]
        target = self.run.vru_position_m[frame]
        camera = self.sightlines.vut_camera.camera
        yaw = np.radians(self.run.vut_yaw_deg[frame])
        half = np.radians(0.5 * camera.horizontal_fov_deg)
        edges = eye + _FAR_M * np.array(
            [[np.cos(yaw + side), np.sin(yaw + side)] for side in (half, -half)]
        )
        axes.add_patch(Polygon([eye, *edges], facecolor=SKY, alpha=0.18, zorder=2.4))
        is_free = bool(free.any())
        axes.plot(
            *np.stack([eye, target]).T,
            zorder=6.9,
            **(_FREE_STYLE if is_free else _BLOCKED_STYLE),
        )
        return float(free.mean())

    def _point_at_vut(self, axes: Axes, frame: int) -> None:
        """An arrow at the edge where the VUT is outside of the window."""
        offset = self.run.vut_position_m[frame] - self.window.middle_m
        reach = np.abs(offset).max() / self.window.half_size_m
        if reach <= 1.0:
            return
        edge = self.window.middle_m + 0.97 * offset / reach
        inside = self.window.middle_m + 0.80 * offset / reach
        distance_m = np.hypot(*(self.run.vut_position_m[frame] - self.run.vru_position_m[frame]))
        axes.annotate(
            f"VUT, {distance_m:.0f} m",
            xy=tuple(edge),
            xytext=tuple(inside),
            ha="center",
            va="center",
            fontsize=8,
            arrowprops={"arrowstyle": "-|>", "facecolor": "black"},
            zorder=9,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )


def _draw_body(
    axes: Axes, actor: Actor, position_m: FloatArray, yaw_deg: float, colour: str, hatch: str
) -> None:
    corners = footprint_corners(position_m, yaw_deg, length_m=actor.length_m, width_m=actor.width_m)
    axes.add_patch(
        Polygon(
            corners, facecolor=colour, edgecolor="black", linewidth=0.9, hatch=hatch, zorder=7.5
        )
    )
    # A white wedge from the middle of the flanks to the nose says where it is heading.
    front_left, rear_left, rear_right, front_right = corners
    wedge = [
        0.5 * (front_left + front_right),
        0.5 * (front_left + rear_left),
        0.5 * (front_right + rear_right),
    ]
    axes.add_patch(Polygon(wedge, facecolor="white", edgecolor="black", linewidth=0.6, zorder=7.6))


def _pose(run: Run, position_m: FloatArray, yaw_deg: float) -> Pose:
    return Pose(position_m=on_ground(position_m, run.terrain), yaw_deg=float(yaw_deg))


def _window(run: Run, frames: list[int]) -> _Window:
    """Around the VRU's way and the impact, and the VUT where it must brake."""
    shown = [run.vru_position_m[frames], run.vut_position_m[-1:]]
    shown += [body.pose.position_m[None, :2] for body in run.obstruction[:2]]
    if np.isfinite(run.last_brake_time_s):
        motion = run.encounter.vut_motion
        shown.append(motion.path.at(motion.distance_m([run.last_brake_time_s]))[0])
    points = np.concatenate(shown)
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    return _Window(0.5 * (low + high), max(0.5 * float((high - low).max()), 0.5 * _LEAST_SIZE_M))


_BRAKE_STYLE: Style = {
    "marker": "|",
    "markersize": 11.0,
    "markeredgewidth": 2.4,
    "color": "#CC0000",
    "linestyle": "none",
}
_FREE_STYLE: Style = {"color": "black", "linewidth": 1.0, "linestyle": "-"}
_BLOCKED_STYLE: Style = {"color": "black", "linewidth": 1.0, "linestyle": (0, (1, 2))}


def _legend(run: Run) -> list[Any]:
    line = partial(Line2D, [], [])
    handles = [
        Patch(facecolor=BLUE, edgecolor="black", label="car under test (VUT)"),
        Patch(facecolor=VERMILION, edgecolor="black", hatch="xxxx", label=run.case.vru.class_name),
        line(color="black", linewidth=1.8, label="way so far, thin: to come"),
        line(label="middle of the VUT where it must brake", **_BRAKE_STYLE),
        Patch(facecolor=SKY, alpha=0.3, label="what the VUT's camera looks at"),
        line(label="in sight", **_FREE_STYLE),
        line(label="nothing of it in sight", **_BLOCKED_STYLE),
    ]
    if run.obstruction:
        handles.append(Patch(label="parked body or wall of this case", **PARKED_STYLE))
    return handles
