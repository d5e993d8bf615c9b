"""Pictures of exports as the readers of others find them, for ``results/judges.md``.

``uv run python tests/export_pictures.py --lanelet2 FILE``, FILE a map in Lanelet2's format.
"""

import importlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from experiments.export.dxf import to_dxf
from experiments.export.mcap import to_mcap
from experiments.export.watched import watch_run
from experiments.figures.axes import new_axes, root_figure, show_square
from experiments.figures.plan import draw_scene
from geometry.scene_files import load_scene
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout

_RUN, _BEFORE_S = "CPNCO-50/east/40", 1.2  # how long before the impact MCAP's bodies are drawn
_WIDTH_IN, _HALF_M, _DPI = 7.0, 45.0, 100


def draw_dxf(axes: Axes) -> None:
    """The study's layout as DXF, by ezdxf's own drawing of what it read."""
    ezdxf, drawing = (importlib.import_module(f"ezdxf{part}") for part in ("", ".addons.drawing"))
    backend = importlib.import_module("ezdxf.addons.drawing.matplotlib").MatplotlibBackend(axes)
    scene = load_study_scene()
    document = ezdxf.read(io.StringIO(to_dxf(load_carlancap_layout(), scene)))
    config = importlib.import_module("ezdxf.addons.drawing.config")
    white = config.Configuration(background_policy=config.BackgroundPolicy.WHITE)
    front = drawing.Frontend(drawing.RenderContext(document), backend, config=white)
    front.draw_layout(document.modelspace())
    root_figure(axes).set_size_inches(_WIDTH_IN, _WIDTH_IN)
    show_square(axes, scene.outline_m.mean(axis=0), _HALF_M)


def read_mcap(content: bytes) -> dict[str, list[tuple[float, Any]]]:
    """By topic: times [s] and messages, decoded by the schemas in the file, by the package mcap."""
    reader = importlib.import_module("mcap.reader").make_reader(io.BytesIO(content))
    sets, pools, factory = (
        importlib.import_module(f"google.protobuf.{name}")
        for name in ("descriptor_pb2", "descriptor_pool", "message_factory")
    )
    found: dict[str, list[tuple[float, Any]]] = {}
    kinds: dict[int, Any] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            value = json.loads(message.data)
        else:
            if schema.id not in kinds:
                pool = pools.DescriptorPool()
                for file in sets.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                kinds[schema.id] = factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            value = kinds[schema.id].FromString(message.data)
        found.setdefault(channel.topic, []).append((message.log_time / 1.0e9, value))
    return found


def draw_mcap(axes: Axes) -> None:
    """A run as MCAP, from above: meshes, views, and at an instant bodies and who detects."""
    layout, scene = load_carlancap_layout(), load_study_scene()
    watched = watch_run(layout, scene, _RUN)
    topics = read_mcap(to_mcap(layout, scene, watched))
    for entity in topics["/scene"][0][1].entities:
        for mesh in entity.triangles:
            points = np.array([[point.x, point.y] for point in mesh.points])
            colour = (mesh.color.r, mesh.color.g, mesh.color.b)
            for triangle in np.reshape(mesh.indices, (-1, 3)):
                axes.add_patch(Polygon(points[triangle], color=colour))
    at_s = -float(watched.run.time_s[0]) - _BEFORE_S
    for entity in _last(topics["/bodies"], at_s).entities:
        for cube in entity.cubes:
            turn = 2.0 * np.arctan2(cube.pose.orientation.z, cube.pose.orientation.w)
            ahead = np.array([np.cos(turn), np.sin(turn)]) * 0.5 * cube.size.x
            left = np.array([-np.sin(turn), np.cos(turn)]) * 0.5 * cube.size.y
            middle = np.array([cube.pose.position.x, cube.pose.position.y])
            corners = [middle + ahead + left, middle + ahead - left]
            corners += [middle - ahead - left, middle - ahead + left]
            colour = (cube.color.r, cube.color.g, cube.color.b)
            axes.add_patch(Polygon(corners, facecolor=colour, edgecolor="black", zorder=3))
    for entity in _last(topics["/detections"], at_s).entities:
        for line in entity.lines:
            ends = np.array([[point.x, point.y] for point in line.points]).reshape(-1, 2, 2)
            for end in ends:
                axes.plot(*end.T, color=(line.color.r, line.color.g, line.color.b), zorder=4)
    for entity in topics["/units"][0][1].entities:
        place = entity.texts[0].pose.position
        axes.plot(place.x, place.y, "o", color="tab:blue", zorder=5)
        axes.annotate(entity.texts[0].text, (place.x, place.y), fontsize=8, zorder=6)
    axes.set_title(f"{_RUN}, {_BEFORE_S:g} s before the impact; green: a unit detects")
    show_square(axes, scene.outline_m.mean(axis=0), _HALF_M)


def _last(messages: list[tuple[float, Any]], at_s: float) -> Any:
    return [message for time_s, message in messages if time_s <= at_s + 1.0e-6][-1]


def draw_lanelet2(axes: Axes, path: Path) -> None:
    """A map in Lanelet2's format, as the scene that is made of it."""
    scene = load_scene(str(path))
    draw_scene(axes, scene)
    show_square(axes, scene.outline_m.mean(axis=0), _HALF_M)


@click.command()
@click.option("--lanelet2", type=click.Path(path_type=Path, exists=True), help="A map to draw.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
def main(lanelet2: Path | None, out: Path) -> None:
    """Draw each, as judges_FORMAT.png."""
    wanted: dict[str, Callable[[Axes], None]] = {"dxf": draw_dxf, "mcap": draw_mcap}
    if lanelet2 is not None:
        wanted["lanelet2"] = lambda axes: draw_lanelet2(axes, lanelet2)
    for name, draw in wanted.items():
        axes = new_axes(_WIDTH_IN, _WIDTH_IN)
        draw(axes)
        root_figure(axes).savefig(out / f"judges_{name}.png", dpi=_DPI)


if __name__ == "__main__":
    main()
