"""``place-rsus render``: one frame of a run as a camera sees it."""

import os
from errno import ENOENT
from pathlib import Path
from typing import Any

import click

from placement.compute import Compute

from ..progress import StageProgress, tell
from .options import (
    SectionedCommand,
    compute_options,
    layout_option,
    option,
    quiet_option,
    scene_option,
)
from .running import load_one_layout, unwritable


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus render --layout carlancap-12 --run CPNC-50/east/40 \\
      --frame -13 --unit RSU3
  place-rsus render --layout carlancap-12 --run CBNA/east/60/rain \\
      --frame -1 --unit VUT
  place-rsus render --layout results/latest/layout.json \\
      --run CPNC-50/east/55/night --frame -20 --unit RSU1 --out night.jpg
  place-rsus render --layout carlancap-12 --run CBLA/west/50 \\
      --frame -11 --unit VUT-LIDAR""",
)
@layout_option
@option(
    "--run",
    "run_id",
    required=True,
    metavar="RUN",
    help="case/approach/speed or case/approach/speed/weather; away from the junction the position "
    "stands behind the approach: CPLA-50/east-15/40.",
)
@option(
    "--frame",
    required=True,
    type=click.IntRange(min=-(10**9), max=10**9),
    metavar="N",
    expected="a frame of the run, such as 40, or -1 for the last",
    help="Of the run, from 0; negative: from the end, -1 is at the impact.",
)
@option(
    "--unit",
    "unit_id",
    required=True,
    metavar="UNIT",
    help="One of the layout's, VUT or VUT-LIDAR.",
)
@option("--weather", metavar="WEATHER", help="day, night, rain or fog; default: that of the run.")
@option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write, .png or .jpg; -instances.png and -depth.png are written beside it; of a "
    "LiDAR .ply, or .bin with float32 x, y, z, intensity; default: in results/renders.",
)
@scene_option
@quiet_option
@compute_options()
@click.pass_obj
def render(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    run_id: str,
    frame: int,
    unit_id: str,
    weather: str | None,
    out: Path | None,
    scene: str,
    quiet: bool,
    compute: Compute,
) -> None:
    """Render what a camera sees in one frame (colours, instances, depths), or scan by LiDAR."""
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    progress("lay the run", 0, 0)
    from geometry.scene_files import load_scene
    from placement.layout import check_layout

    from ..jobs import render

    around = load_scene(scene)
    check_layout(layout, around)
    run = render.find_run(run_id, around, weather=weather)
    frame_index = render.find_frame(run, frame)
    viewpoint = render.find_viewpoint(layout, unit_id, run, frame_index)
    suffix = render.suffixes_of(viewpoint.sensor)[0]
    path = out or _default_path(run, unit_id, frame_index, suffix)
    render.check_path(path, viewpoint.sensor)
    if out is not None and not out.parent.is_dir():
        raise unwritable(path, FileNotFoundError(ENOENT, os.strerror(ENOENT)))
    progress("render", 0, 0)
    seen = render.render(around, run, frame_index, viewpoint, compute=compute)
    try:
        if out is None:
            path.parent.mkdir(parents=True, exist_ok=True)
        written = render.save(path, seen)
    except OSError as error:
        raise unwritable(path, error) from None
    progress.stop()
    for file in written:
        tell(f"Written to {file}.")
    tell(render.vru_sentence(seen))


def _default_path(run: Any, unit_id: str, frame_index: int, suffix: str) -> Path:
    from scenarios.positions import AT_ZERO

    place = run.approach if run.position == AT_ZERO.name else f"{run.approach}{run.position}"
    parts = [*run.case.name.split("/"), place, f"{run.vut_speed_kmh:g}", run.weather]
    name = "_".join([*parts, f"frame-{frame_index}", unit_id])
    return Path("results", "renders", name.replace(os.sep, "_") + suffix)
