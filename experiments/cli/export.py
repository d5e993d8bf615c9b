"""``place-rsus export``: a layout for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..export import FORMAT_NAMES, FORMATS
from ..language import localized, tr
from ..progress import StageProgress, tell
from . import options
from .running import QuestionCall, begin, load_one_layout, write_result
from .terminal import sentences, table

if TYPE_CHECKING:
    from placement.question import Question

    from ..parts.sheet import SheetResult


_NOTE = """opencv and ros leave LiDARs out; geojson, gpkg, kml and cpm need a scene
that lies somewhere on earth.

"""


_EXPORT_EXAMPLES = """\b
Examples:
  place-rsus export --layout carlancap-12 --format carla
  place-rsus export --layout carlancap-12 --format geojson --out rsus.geojson
  place-rsus export --layout a.json --scene city.osm --junction "A St / B Ave" \\
      --format gpkg --out a.gpkg
  place-rsus export --calibration tsai.xml --format ros
  place-rsus export --run CPNC-50/east/40 --layout a.json \\
      --format cpm-uper --out cpm.bin"""


class _ExportCommand(click.Command):
    """Adds the formats to its help."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        lines = [
            f"  {name:<10} {item.content}{'; needs --out' if item.is_binary else ''}"
            for name, item in FORMATS.items()
        ]
        head = "\b\nFormats, and who reads them:\n" + "\n".join(lines) + "\n"
        self.epilog, rest = head + (self.epilog or ""), self.epilog
        super().format_epilog(ctx, formatter)
        self.epilog = rest


@click.command(
    cls=_ExportCommand,
    epilog=_NOTE + _EXPORT_EXAMPLES,
)
@options.layout_option
@options.option(
    "--calibration",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=(
        "Real cameras with their lenses, in place of a layout: of OpenCV, ROS, KITTI or"
        " Tsai."
    ),
)
@options.option(
    "--size",
    type=click.IntRange(min=1),
    nargs=2,
    metavar="WIDTH HEIGHT",
    needs="calibration",
    expected="two numbers of pixels, at least 1",
    help="With --calibration: of pictures, where the file does not tell.",
)
@options.option(
    "--format",
    "format_name",
    type=click.Choice(FORMAT_NAMES),
    required=True,
    metavar="FORMAT",
    help="One of those below.",
)
@options.question_options(*options.OF_SCENE, has_file=False)
@options.option(
    "--run",
    "run_id",
    default="",
    metavar="RUN",
    help=(
        "cpm, cpm-uper, mcap: what the units detect in a run, such as CPNC-50/east/40."
    ),
)
@options.option(
    "--aimed",
    type=click.Choice(("calibrated", "by-eye")),
    default="calibrated",
    show_default=True,
    metavar="HOW",
    help=(
        "With --run: how well the units' aims are known, calibrated or by-eye; it"
        " decides what is told of the errors of positions."
    ),
)
@options.option(
    "--release",
    metavar="V",
    help="cpm, cpm-uper: of the dictionary, 2.1.1 or 2.4.1.",
)
@options.option(
    "--crs",
    metavar="CRS",
    help=(
        "dxf: coordinates in metres, EPSG:25832 or another that pyproj knows; default:"
        " those of the map, or UTM for a map in degrees."
    ),
)
@options.option(
    "--views",
    is_flag=True,
    help="geojson, gpkg, kml: what each camera sees, as polygons.",
)
@options.option(
    "--pictures",
    is_flag=True,
    needs="run_id",
    help="mcap: what each camera sees, frame by frame.",
)
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; else stdout.",
)
@options.quiet_option
@click.pass_obj
def export(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    calibration: Path | None,
    size: tuple[int, int] | None,
    format_name: str,
    question: "Question",
    run_id: str,
    aimed: str,
    release: str | None,
    crs: str | None,
    views: bool,
    pictures: bool,
    out: Path | None,
    quiet: bool,
) -> None:
    """Write a layout in a format that other programs read."""
    progress.start(quiet=quiet)
    from placement.compute import Compute

    from ..export import load_format
    from ..export.calibration import lidar_ids
    from ..export.views import find_views
    from ..export.watched import export_layout

    chosen = load_format(format_name)
    if out is None and FORMATS[format_name].is_binary:
        raise click.UsageError(
            f"--out: got nothing; expected a file: {format_name} is no text"
        )
    missing: list[str] = []
    if calibration is not None and layout_names:
        raise click.UsageError(
            "--calibration: got it with --layout; expected one of them"
        )
    content: str | bytes
    if calibration is not None:
        content = _convert(calibration, format_name, size)
    else:
        question = begin(progress, question, quiet=quiet)
        layout = load_one_layout(layout_names)
        compute = Compute(progress=progress)
        if pictures:
            drawn = compute
        else:
            drawn = None
        asked = {
            "release": release,
            "crs": crs,
            "views": find_views if views else None,
        }
        content = export_layout(
            layout,
            format_name,
            scene_path=question.scene,
            run_id=run_id,
            aimed=aimed.replace("-", " "),
            compute=compute,
            options={
                k: v for k, v in {**asked, "pictures": drawn}.items() if v is not None
            },
        )
        if chosen.has_lidars:
            missing = []
        else:
            missing = lidar_ids(layout)
    if missing and not quiet:
        tell(f"left out, for they are no cameras: {', '.join(missing)}", err=True)
    write_result(out, content)
    if (
        out is not None
        and chosen.told is not None
        and isinstance(content, bytes)
        and not quiet
    ):
        tell(chosen.told(content), err=True)


def _convert(path: Path, format_name: str, size_px: tuple[int, int] | None) -> str:
    """Cameras of a calibration in another format."""
    from geometry.calibrations import read_cameras

    from ..export.opencv import opencv_text
    from ..export.ros import ros_text

    if format_name not in ("opencv", "ros"):
        got = f"got {format_name} beside --calibration; expected opencv or ros"
        raise click.UsageError(f"--format: {got}")
    found = read_cameras(path, size_px=size_px or None)
    if format_name == "opencv":
        return opencv_text(found, path.stem)
    return ros_text(found)


# ---------- for whoever mounts the units


_SHEET_EXAMPLES = """\b
Examples:
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus sheet --layout mine.json --scene scene --out mounting.pdf --json"""


@click.command(cls=options.SectionedCommand, epilog=_SHEET_EXAMPLES)
@options.layout_option
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="PDF file to write.",
)
@options.asking(*options.JUDGED, "keep", has_cache=False)
def sheet(job: QuestionCall, *, layout_names: tuple[str, ...], out: Path) -> None:
    """Write a PDF for whoever mounts the units: a page each.

    Where, how high, where it looks in words and degrees, what it will see (rendered), a
    plan, the nearest landmarks, and how many degrees and centimetres it may be off
    before a run is lost.
    """
    job = job.begin()
    layout = job.layout(layout_names)
    from ..parts.sheet import run_sheet

    summary = run_sheet(job.question, layout=layout, out=out, **job.means)
    job.print(summary, lambda: sheet_text(summary))


def sheet_text(summary: "SheetResult") -> str:
    """Tolerances of each unit before a run is lost."""
    rows = []
    for unit in summary.units:
        (right, left), (down, up) = unit.yaw_deg, unit.pitch_deg
        lower_m, higher_m = unit.height_m
        degrees = [
            localized(f"{value:g}\N{DEGREE SIGN}") for value in (left, right, up, down)
        ]
        rows.append(
            [
                unit.unit_id,
                *degrees,
                f"{100 * higher_m:.0f} cm",
                f"{100 * lower_m:.0f} cm",
            ]
        )
    lines = [
        *sentences(
            tr(
                "How far the units of {name} may be off before a run is lost:",
                name=summary.layout,
            )
        ),
        *table(
            [
                tr("unit"),
                tr("left"),
                tr("right"),
                tr("up"),
                tr("down"),
                tr("higher"),
                tr("lower"),
            ],
            rows,
        ),
        *sentences(
            tr("One change at a time; the largest of the steps tried."), indent=2
        ),
        "",
        tr("Written to {file}.", file=summary.written),
    ]
    return "\n".join(lines)
