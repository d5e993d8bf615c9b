"""``place-rsus render``: one frame of a run as a camera sees it."""

import os
from pathlib import Path
from typing import Any

import click

from placement.compute import Compute

from ..progress import StageProgress
from .options import (
    SectionedCommand,
    WholeNumber,
    input_error,
    layout_option,
    option_name,
    quiet_option,
    scene_option,
    workers_option,
)

_MAX_DIGITS = 9


class FrameNumber(click.ParamType[int]):
    """A whole number, negative from the end."""

    name = "number"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """What the help shows for a value."""
        return "N"

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        """The value, checked."""
        text = str(value)
        digits = text.removeprefix("-")
        if not (digits.isascii() and digits.isdigit() and len(digits) <= _MAX_DIGITS):
            raise input_error(
                option_name(param), value, "a frame of the run, such as 40, or -1 for the last"
            )
        return int(text)


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
@click.option(
    "--run",
    "run_id",
    required=True,
    metavar="RUN",
    help="case/approach/speed or case/approach/speed/weather.",
)
@click.option(
    "--frame",
    required=True,
    type=FrameNumber(),
    help="Of the run, from 0; negative: from the end, -1 is at the impact.",
)
@click.option(
    "--unit",
    "unit_id",
    required=True,
    metavar="UNIT",
    help="One of the layout's, VUT or VUT-LIDAR.",
)
@click.option(
    "--weather", metavar="WEATHER", help="day, night, rain or fog; default: that of the run."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write, .png or .jpg; -instances.png and -depth.png are written beside it; of a "
    "LiDAR .ply, or .bin with float32 x, y, z, intensity; default: in results/renders.",
)
@click.option(
    "--seed",
    type=WholeNumber(0, "a whole number"),
    default=0,
    show_default=True,
    help="Of sensor noise and rain.",
)
@scene_option
@quiet_option
@workers_option
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
    seed: int,
    scene: str,
    quiet: bool,
    workers: int,
) -> None:
    """Render what a camera sees in one frame (colours, instances, depths), or scan by LiDAR."""
    if len(layout_names) != 1:
        got = f"{len(layout_names)} layouts" if layout_names else "nothing"
        raise click.UsageError(f"--layout: got {got}; expected it once")
    progress.start(quiet=quiet)
    progress("lay the run", 0, 0)
    from geometry.scene_folders import find_scene
    from placement.layout import check_layout

    from ..jobs import render
    from ..study.layout import find_layout

    around = find_scene(scene)
    layout = find_layout(layout_names[0], "--layout")
    check_layout(layout, around)
    run = render.find_run(run_id, around, weather=weather)
    frame_index = render.find_frame(run, frame)
    viewpoint = render.find_viewpoint(layout, unit_id, run, frame_index)
    suffix = render.suffixes_of(viewpoint.sensor)[0]
    path = out or _default_path(run, unit_id, frame_index, suffix)
    render.check_path(path, viewpoint.sensor)
    progress("render", 0, 0)
    compute = Compute(seed=seed, workers=workers)
    seen = render.render(around, run, frame_index, viewpoint, compute=compute)
    try:
        if out is None:
            path.parent.mkdir(parents=True, exist_ok=True)
        written = render.save(path, seen)
    except OSError as error:
        raise click.UsageError(
            f"--out: got {path}: {error.strerror or error}; expected a file that can be written"
        ) from None
    progress.stop()
    for file in written:
        click.echo(f"Written to {file}.")
    click.echo(render.vru_sentence(seen))


def _default_path(run: Any, unit_id: str, frame_index: int, suffix: str) -> Path:
    parts = [*run.case.name.split("/"), run.approach, f"{run.vut_speed_kmh:g}", run.weather]
    name = "_".join([*parts, f"frame-{frame_index}", unit_id])
    return Path("results", "renders", name.replace(os.sep, "_") + suffix)
