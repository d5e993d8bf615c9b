"""A run from above, as a film strip or an animation.

It shows what the VUT has in sight of the VRU.
"""

from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.footprints import footprint_corners
from geometry.opening import read_bytes
from geometry.poses import Pose, to_world
from geometry.scene import Scene
from geometry.terrain import on_ground
from geometry.writing import write_atomically
from placement.compute import Progress, silent
from placement.evaluator import build_surroundings, load_vut_camera, perceive_frames
from scenarios.positions import AT_ZERO
from scenarios.runs import Run

from ..language import localized, mark, tr
from .axes import (
    BLUE,
    SKY,
    VERMILION,
    Style,
    drawing_any_name,
    literal,
    new_figure,
    show_square,
)
from .plan import PARKED_STYLE, draw_parked, draw_scene

STILL = ".png"
ANIMATION = ".gif"
_DPI = 130
_PANEL_IN = 3.4
_ROWS = 2
_COLUMNS = 3
# a strip begins so long before the last moment to brake, or when the VRU sets off
_SHOWN_S = 4.0
_MARGIN_M = 6.0
_LEAST_SIZE_M = 24.0
_FAR_M = 500.0
_VUT: Style = {"facecolor": BLUE, "edgecolor": "black"}
_VRU: Style = {"facecolor": VERMILION, "edgecolor": "black", "hatch": "xxxx"}
_BAR: Style = {"marker": "|", "markersize": 11.0, "markeredgewidth": 2.4}
_BRAKE_STYLE: Style = _BAR | {"color": "#CC0000", "linestyle": "none"}
_FREE_STYLE: Style = {"color": "black", "linewidth": 1.0, "linestyle": "-"}
_BLOCKED_STYLE: Style = {"color": "black", "linewidth": 1.0, "linestyle": (0, (1, 2))}


def plot_film(scene: Scene, run: Run) -> list[Axes]:
    """Film strip of a run: six plan views from its begin to the impact.

    Parameters
    ----------
    scene : Scene
        What stands still.
    run : Run
        What moves. Nobody brakes.

    Returns
    -------
    axes : list of Axes
        One pair per instant, in metres, north up. The fourth shows the last frame in
        which braking still helps, the last one the impact.
    """
    figure = new_figure(_COLUMNS * _PANEL_IN, _ROWS * (_PANEL_IN + 0.3) + 1.0, dpi=_DPI)
    figure.suptitle(_title(run), fontsize=11)
    instants = _instants(run)
    stage = _Stage(scene, run, instants)
    panels = [
        figure.add_subplot(_ROWS, _COLUMNS, number + 1)
        for number in range(len(instants))
    ]
    for axes, frame in zip(panels, instants, strict=True):
        stage.draw(axes, frame)
    _draw_legend(figure, run, ncols=4, fontsize=8)
    return panels


def save_film(
    path: Path, scene: Scene, run: Run, *, progress: Progress = silent
) -> None:
    """Write a run as a film strip, or as an animation to a ``.gif``.

    The animation runs in real time.

    Parameters
    ----------
    path : Path
        Its suffix says what is written.
    scene, run
        As for :func:`plot_film`.
    progress : Progress
        Is told the frames of an animation.

    Raises
    ------
    InputError
        The suffix is unknown.
    OSError
        The file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix == ANIMATION:
        data = _animate(scene, run, progress)
    elif suffix == STILL:
        buffer = BytesIO()
        with drawing_any_name():
            figure = plot_film(scene, run)[0].get_figure(root=True)
            # It was made for these axes.
            assert figure is not None
            figure.savefig(buffer, format="png", metadata={"Software": None})
        data = buffer.getvalue()
    else:
        expected = f"a name that ends in {STILL} or {ANIMATION}"
        raise InputError("--out", str(path), expected)
    write_atomically(path, data)


def _animate(scene: Scene, run: Run, progress: Progress) -> bytes:
    frames = [
        frame for frame in range(len(run.time_s)) if run.time_s[frame] >= _first_s(run)
    ]
    figure = new_figure(5.6, 6.6, dpi=100)
    figure.suptitle(_title(run), fontsize=9)
    _draw_legend(figure, run, ncols=2, fontsize=7)
    axes = figure.add_subplot()
    stage = _Stage(scene, run, frames)

    def draw(frame: int) -> list[Any]:
        axes.clear()
        stage.draw(axes, frame)
        return []

    animation = FuncAnimation(figure, draw, frames=frames, init_func=list)
    # The library writes to names only.
    with (
        TemporaryDirectory() as folder,
        drawing_any_name(),
    ):
        name = Path(folder) / "film.gif"
        rate_hz = round(1.0 / float(np.diff(run.time_s[-2:])[0]))
        tell = partial(progress, mark("draw"))
        animation.save(name, writer=PillowWriter(fps=rate_hz), progress_callback=tell)
        return read_bytes(name)


def _title(run: Run) -> str:
    approach = tr(run.approach)
    if run.position != AT_ZERO.name:
        approach = f"{approach} ({run.position} m)"
    speeds = [localized(f"{run.vut_speed_kmh:g}")]
    if run.case.pairs_kmh:
        speeds.append(localized(f"{run.case.vru_speed_kmh:g}"))
    return tr(
        "{case}: {title}\nfrom the {approach} at {speeds} km/h, {weather}; nobody"
        " brakes",
        case=literal(run.case.name),
        title=tr(run.case.title),
        approach=approach,
        speeds=tr(" and ").join(speeds),
        weather=tr(run.weather),
    )


def _first_s(run: Run) -> float:
    last_s = run.last_brake_time_s
    moves_s = max(run.encounter.vru_motion.start_time_s, float(run.time_s[0]))
    if np.isfinite(last_s):
        return max(moves_s, last_s - _SHOWN_S)
    return moves_s


def _instants(run: Run) -> list[int]:
    """Frames of a strip, from the first to the impact.

    Three frames, the last one that still helps, one after it, and the impact.
    """
    final = len(run.time_s) - 1
    first = int(np.searchsorted(run.time_s, _first_s(run) - 1e-9))
    usable = np.flatnonzero(run.time_s <= run.last_brake_time_s)
    if len(usable):
        last = int(usable[-1])
    else:
        last = final - 2
    before = np.linspace(min(first, last), last, 4).round().astype(int)
    after = (last + final + 1) // 2
    return [*before.tolist(), after, final]


class _Stage:
    """Draws one instant of a run after the other, all in the same window."""

    def __init__(self, scene: Scene, run: Run, frames: list[int]) -> None:
        self.scene = scene
        self.run = run
        self.middle_m, self.half_size_m = _window(run, frames)
        last_s = run.last_brake_time_s
        motion = run.encounter.vut_motion
        self.brake_m = (
            motion.path.at(motion.distance_m(last_s))[0]
            if np.isfinite(last_s)
            else None
        )
        vut_camera = load_vut_camera()
        self.camera = vut_camera.camera
        self.lens = vut_camera.pose_on(run.encounter.vut).position_m
        seen = perceive_frames(build_surroundings(scene, (run,)), vut_camera)
        self.share = np.broadcast_to(
            seen.visible_share * seen.inside_share, len(run.time_s)
        )

    def draw(self, axes: Axes, frame: int) -> None:
        """Everything at one instant."""
        run = self.run
        draw_scene(axes, self.scene)
        draw_parked(axes, run.obstruction)
        for positions, dashes in (
            (run.vut_position_m, "-"),
            (run.vru_position_m, (0, (3, 1.5))),
        ):
            way: Style = {"linestyle": dashes}
            axes.plot(*positions.T, color="#777777", linewidth=0.8, zorder=3, **way)
            axes.plot(
                *positions[: frame + 1].T,
                color="black",
                linewidth=1.8,
                zorder=3.1,
                **way,
            )
        if self.brake_m is not None:
            axes.plot(*self.brake_m, zorder=6.8, **_BRAKE_STYLE)
        share = self._draw_sight(axes, frame)
        vut = run.encounter.vut
        vru = run.encounter.vru
        _draw_body(axes, vut, run.vut_position_m[frame], run.vut_yaw_deg[frame], **_VUT)
        _draw_body(axes, vru, run.vru_position_m[frame], run.vru_yaw_deg[frame], **_VRU)
        show_square(axes, self.middle_m, self.half_size_m)
        axes.tick_params(labelsize=7)
        time_s = run.time_s[frame]
        when = localized(f"{time_s:.1f} s".replace("-", "\N{MINUS SIGN}"))
        seen = tr(
            "{when}: {percent:.0f} % of the VRU in the VUT's sight",
            when=when if time_s < 0.0 else tr("impact"),
            percent=100.0 * share,
        )
        axes.set_title(seen, fontsize=9)
        self._point_at_vut(axes, frame)

    def _draw_sight(self, axes: Axes, frame: int) -> float:
        """Draw what the VUT looks at.

        Returns the share of the VRU that it has in sight.
        """
        run, yaw_deg = self.run, float(self.run.vut_yaw_deg[frame])
        where = on_ground(run.vut_position_m[frame], run.terrain)
        pose = Pose(position_m=where, yaw_deg=yaw_deg)
        (eye,) = np.asarray(to_world(self.lens[None], pose))
        share = float(self.share[frame])
        half_deg = 0.5 * self.camera.horizontal_fov_deg
        sides = np.radians([yaw_deg + half_deg, yaw_deg - half_deg])
        edges = eye[:2] + _FAR_M * np.stack([np.cos(sides), np.sin(sides)], axis=1)
        axes.add_patch(
            Polygon([eye[:2], *edges], facecolor=SKY, alpha=0.18, zorder=2.4)
        )
        if share > 0.0:
            style = _FREE_STYLE
        else:
            style = _BLOCKED_STYLE
        axes.plot(
            *np.stack([eye[:2], run.vru_position_m[frame]]).T, zorder=6.9, **style
        )
        return share

    def _point_at_vut(self, axes: Axes, frame: int) -> None:
        """An arrow at the edge where the VUT is outside of the window."""
        vut_m = self.run.vut_position_m[frame]
        offset = vut_m - self.middle_m
        reach = np.abs(offset).max() / self.half_size_m
        if reach <= 1.0:
            return
        east_m, north_m = self.middle_m + 0.97 * offset / reach
        inside = self.middle_m + 0.80 * offset / reach
        distance_m = np.hypot(*(vut_m - self.run.vru_position_m[frame]))
        style: Style = {"ha": "center", "va": "center", "fontsize": 8, "zorder": 9}
        style["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        style["arrowprops"] = {"arrowstyle": "-|>", "facecolor": "black"}
        words = f"VUT, {distance_m:.0f} m"
        axes.annotate(words, xy=(east_m, north_m), xytext=tuple(inside), **style)


def _draw_body(
    axes: Axes, actor: Actor, position_m: FloatArray, yaw_deg: float, **colours: Any
) -> None:
    corners = footprint_corners(
        position_m, yaw_deg, length_m=actor.length_m, width_m=actor.width_m
    )
    axes.add_patch(Polygon(corners, linewidth=0.9, zorder=7.5, **colours))
    # A white wedge from the middle of the flanks to the nose says where it is heading.
    front_left, rear_left, rear_right, front_right = corners
    flanks = (front_left + rear_left, front_right + rear_right)
    wedge = [0.5 * ends for ends in (front_left + front_right, *flanks)]
    axes.add_patch(
        Polygon(wedge, facecolor="white", edgecolor="black", linewidth=0.6, zorder=7.6)
    )


def _window(run: Run, frames: list[int]) -> tuple[FloatArray, float]:
    """Middle and half size of the square that a film shows.

    It holds the VRU's way, the impact and the braking VUT.
    """
    shown = [run.vru_position_m[frames], run.vut_position_m[-1:]]
    shown += [body.pose.position_m[None, :2] for body in run.obstruction[:2]]
    if np.isfinite(run.last_brake_time_s):
        motion = run.encounter.vut_motion
        shown.append(motion.path.at(motion.distance_m([run.last_brake_time_s]))[0])
    points = np.concatenate(shown)
    low = points.min(axis=0) - _MARGIN_M
    high = points.max(axis=0) + _MARGIN_M
    return 0.5 * (low + high), max(0.5 * float((high - low).max()), 0.5 * _LEAST_SIZE_M)


def _draw_legend(figure: Figure, run: Run, **options: Any) -> None:
    line = partial(Line2D, [], [])
    handles: list[Any] = [
        Patch(label=tr("car under test (VUT)"), **_VUT),
        Patch(label=tr(run.case.vru.class_name), **_VRU),
        line(color="black", linewidth=1.8, label=tr("path so far (thin: path ahead)")),
        line(label=tr("centre of the VUT at the last moment to brake"), **_BRAKE_STYLE),
        Patch(facecolor=SKY, alpha=0.3, label=tr("field of view of the VUT's camera")),
        line(label=tr("in sight"), **_FREE_STYLE),
        line(label=tr("completely hidden"), **_BLOCKED_STYLE),
    ]
    if run.obstruction:
        handles.append(
            Patch(label=tr("parked vehicle or wall of this case"), **PARKED_STYLE)
        )
    figure.legend(handles=handles, loc="outside lower center", frameon=False, **options)
