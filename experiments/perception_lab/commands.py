"""Commands of the perception lab.

``place-rsus dataset``, ``detector`` and ``render``.
"""

import os
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geometry.errors import check_one_of
from geometry.writing import is_about
from placement.compute import Compute
from placement.question import Question, question_fields, split_names

from ..cli import options
from ..cli.running import (
    QuestionCall,
    begin,
    command_line,
    load_one_layout,
    unwritable,
)
from ..cli.terminal import sentences, table
from ..progress import StageProgress, tell
from ..results.numbers import percent

if TYPE_CHECKING:
    from placement.detectors.evidence import Interval
    from placement.detectors.fitting import FalseAlarms

    from .dataset import DatasetSummary
    from .fit import FitResult


_DATASET_EXAMPLES = """\b
Examples:
  place-rsus dataset --layout carlancap-12 --cases CPNC-50,CBNA \\
      --out ncap_data
  place-rsus dataset --layout results/latest/layout.json --every 10 \\
      --weather day,night,rain --lidar none --format coco --out training
  place-rsus evaluate --recording ncap_data      reads it back"""


@click.command(cls=options.SectionedCommand, epilog=_DATASET_EXAMPLES)
@options.layout_option
@options.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="FOLDER",
    help="New folder, or one of the same dataset: what is there is not drawn again.",
)
@options.option(
    "--format",
    type=click.Choice(["carlancap", "coco"]),
    default="carlancap",
    help="carlancap: the study's folders; coco: pictures and coco.json.",
)
@options.option(
    "--units",
    default="",
    metavar="NAMES",
    help="Cameras of the layout, with commas between; VUT is the car's. Default: all.",
)
@options.option(
    "--every",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    expected="a number of frames, at least 1",
    help="A picture of every Nth frame of a run; labels and motion are of all frames.",
)
@options.option(
    "--lidar",
    default="carla-ncap-lidar",
    metavar="MODEL",
    help="Scans next to each camera; none for none.",
)
@options.option(
    "--masks",
    is_flag=True,
    help="Also a picture of each frame's things, a colour each.",
)
@options.option(
    "--depth",
    is_flag=True,
    help="Also depths: 16 bits, centimetres, 0 where nothing is.",
)
@options.option(
    "--vehicles",
    is_flag=True,
    help="Also labels of vehicles, in frames with pictures.",
)
@options.option(
    "--vary",
    is_flag=True,
    help="Other clothes, paints and facades in each run, by seed; for training.",
)
@options.engine_options
@options.asking(*options.PICTURED, has_cache=False)
def dataset(
    job: QuestionCall,
    /,
    *,
    layout_names: tuple[str, ...],
    out: Path,
    engine: dict[str, Any],
    **wish: Any,
) -> None:
    """Write a dataset: what cameras see of all runs, with labels."""
    layout = load_one_layout(layout_names)
    job.start()
    from ..engine.start import EngineWish
    from .dataset import run_dataset
    from .drawing import DatasetWish

    drawn = DatasetWish(**wish)
    summary = run_dataset(
        job.question,
        layout=layout,
        wish=drawn,
        out=out,
        engine=EngineWish(workers=job.compute.workers, **engine),
        tell=job.announce,
        **job.means,
    )
    job.print(summary, lambda: _dataset_text(summary, drawn.format))


def _dataset_text(summary: "DatasetSummary", form: str) -> str:
    n_before = summary.pictures - summary.drawn
    if n_before:
        was_there = f", {n_before:,} of them were there before"
    else:
        was_there = ""
    lines = [
        f"{summary.pictures:,} pictures of {summary.units} cameras in"
        f" {summary.folder}{was_there}: {summary.frames:,} frames of"
        f" {summary.runs} runs."
    ]
    if summary.drawn:
        each = summary.seconds / summary.drawn
        lines.append(
            f"{summary.size_bytes / 1e9:.2f} GB written, {each:.2f} s per picture on"
            " all processors together."
        )
    if form == "carlancap":
        lines.append(f"Read it back: place-rsus evaluate --recording {summary.folder}")
    return "\n".join(line for text in lines for line in sentences(text))


@click.group()
def detector() -> None:
    """Response tables of detectors.

    What a detector finds, by height, cover, class and light.
    """


_FIT_EXAMPLES = """\b
Examples:
  place-rsus detector fit --detector cnn --layout carlancap-12 --out cnn
  place-rsus detector fit --detector net.onnx --layout carlancap-12 \\
      --weather day,night,rain --out mine
  place-rsus detector fit --recording ncap_data --out mine
  place-rsus detector fit --labels coco.json --results found.json --out mine
  place-rsus detector fit --labels gt.txt --results det.txt --frame-rate 7 \\
      --out mine
  place-rsus --budget 3 --detector mine/response.toml      plans with it"""


@detector.command(cls=options.SectionedCommand, epilog=_FIT_EXAMPLES)
@options.layout_option
@options.option(
    "--pictures",
    type=click.IntRange(min=50),
    default=1000,
    metavar="N",
    needs="layout_names",
    expected="a number of pictures, at least 50",
    help="With --detector: how many are rendered and looked at, about a second each.",
)
@options.option(
    "--recording",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Fit to labels and detections: the study's folder, or one of MOT challenge.",
)
@options.option(
    "--labels",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=(
        "Fit to annotations: coco.json of place-rsus dataset, MOT challenge, KITTI,"
        " CVML .."
    ),
)
@options.option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=(
        ".. and to what a detector found: COCO's list of results; MOT challenge, KITTI."
    ),
)
@options.option(
    "--frame-rate",
    "frame_rate_hz",
    type=click.FloatRange(min=1.0, max=1000.0),
    metavar="HZ",
    needs="labels",
    expected="frames per second, 1 to 1000",
    help="With --labels: of the recording; default: 10. The table holds for 10 Hz.",
)
@options.option(
    "--min-confidence",
    type=click.FloatRange(min=0.0, max=1.0),
    default=0.5,
    metavar="SHARE",
    expected="a confidence, 0 to 1",
    help="Detections below do not count.",
)
@options.option(
    "--classes",
    default="",
    metavar="NAMES",
    help=(
        "That the detector reports, with commas between: pedestrian, child, cyclist, "
        "motorcyclist, car. Default: as its results show. Others are not fitted."
    ),
)
@options.folder_option("response.toml, fit.json and calibration.png")
@options.asking(*options.PICTURED, has_cache=False)
def fit(
    job: QuestionCall,
    /,
    *,
    layout_names: tuple[str, ...],
    out: Path | None,
    classes: str,
    **wish: Any,
) -> None:
    """Fit a response table to what a detector really finds.

    The table is then what --detector mine/response.toml plans and judges with, in place
    of the built-in assumptions.
    """
    _check_one_source(layout_names, wish["recording"], wish["labels"], wish["results"])
    if layout_names:
        layout = load_one_layout(layout_names)
    else:
        layout = None
    job = job.begin()
    from placement.detectors import VRU_CLASSES

    from .fit import FitWish, run_detector_fit

    names = split_names(classes, "--classes")
    for name in names:
        check_one_of("--classes", name, VRU_CLASSES)
    asked = FitWish(layout=layout, classes=tuple(names), **wish)
    result = run_detector_fit(
        job.question, wish=asked, out=out, command=command_line(), **job.means
    )
    job.print(result, lambda: fit_text(result, out))


_OF_RULE = (
    *("deceleration_mps2", "build_up_s", "latency_s", "latency_budget"),
    *("n_confirmations", "track_memory_s"),
)


def _check_one_source(
    layout_names: tuple[str, ...],
    recording: Path | None,
    labels: Path | None,
    results: Path | None,
) -> None:
    """Refuse no source, several, and half of one.

    Raises click.UsageError: a source is missing, or there is one too many.
    """
    if (labels is None) != (results is None):
        if results is None:
            alone, other = ("--labels", "--results")
        else:
            alone, other = ("--results", "--labels")
        raise click.UsageError(f"{alone}: got it without {other}; expected both")
    given = {
        "--layout": bool(layout_names),
        "--recording": recording is not None,
        "--labels": labels is not None,
    }
    names = [name for name, is_there in given.items() if is_there]
    if len(names) != 1:
        got = " and ".join(names) or "no source"
        raise click.UsageError(
            f"detector fit: got {got}; expected one of --layout with --detector cnn or"
            " FILE.onnx, --recording, or --labels with --results"
        )
    driven = [
        name
        for name in options.PICTURED
        if name not in _OF_RULE and options.is_given(name)
    ]
    if driven and not layout_names:
        field = options.option_of(question_fields()[driven[0]])
        raise click.UsageError(
            f"{field}: got it with {names[0]}; expected it with --layout alone"
        )


def fit_text(result: "FitResult", out: Path | None) -> str:
    """How much was found, recall by group, the table, and false alarms."""
    share = percent(result.found / result.frames)
    lines = sentences(
        f"{share} of {result.frames} frames with a road user are detected"
        f" ({result.source})."
    )
    for name, n_labels in result.not_reported.items():
        lines += sentences(
            f"The detector reports no {name}: {n_labels} labelled frames are left out,"
            f" and how well a {name} is found is assumed. If it can report them, say so"
            " with --classes."
        )
    if result.unknown:
        lines += sentences(
            "Not known from them, and as in the built-in table:"
            f" {', '.join(result.unknown)}."
        )
    lines += ["", *sentences(_alarms_words(result.false_alarms)), ""]
    for kind, groups in result.groups.items():
        rows = [
            [
                group.name,
                f"{group.frames}",
                percent(group.recall.value),
                f"{percent(group.recall.low)} to {percent(group.recall.high)}",
                percent(group.expected),
            ]
            for group in groups
        ]
        lines += [
            *table(
                [kind, "frames", "detected", "95 % interval", "the table says"], rows
            ),
            "",
        ]
    rows = [
        [
            key,
            f"{one.value:.3g}",
            f"{one.low:.3g} to {one.high:.3g}" if one.low < one.high else "-",
        ]
        for key, one in result.table.items()
    ]
    lines += table(["response table", "value", "95 % interval (-: not fitted)"], rows)
    if out is not None:
        lines += [
            "",
            *sentences(
                f"Written to {out}: response.toml, fit.json and calibration.png. Plan"
                f" with it: place-rsus --budget 3 --detector {out}/response.toml"
            ),
        ]
    return "\n".join(lines)


def _alarms_words(alarms: "FalseAlarms") -> str:
    """False alarms per picture, and false tracks per hour, in sentences."""
    words = (
        f"{alarms.alarms} false alarms in {alarms.pictures} pictures: "
        f"{_rate(alarms.per_picture)} per picture."
    )
    if alarms.per_hour is None:
        return (
            f"{words} How many of them would be confirmed is unknown: no consecutive"
            " frames."
        )
    return (
        f"{words} {alarms.confirmed} false tracks were confirmed in"
        f" {alarms.chances} chances: {_rate(alarms.per_hour)} per hour and unit. Not"
        " each of them would brake a car: it must also seem to cross its path."
    )


def _rate(interval: "Interval") -> str:
    return f"{interval.value:.3g} (95 %: {interval.low:.3g} to {interval.high:.3g})"


_RENDER_EXAMPLES = """\b
Examples:
  place-rsus render --layout carlancap-12 --run CPNC-50/east/40 \\
      --frame -13 --unit RSU3
  place-rsus render --layout carlancap-12 --run CBNA/east/60/rain \\
      --frame -1 --unit VUT
  place-rsus render --layout results/latest/layout.json \\
      --run CPNC-50/east/55/night --frame -20 --unit RSU1 --out night.jpg
  place-rsus render --layout carlancap-12 --run CBLA/west/50 \\
      --frame -11 --unit VUT-LIDAR"""


@click.command(cls=options.SectionedCommand, epilog=_RENDER_EXAMPLES)
@options.layout_option
@options.option(
    "--run",
    "run_id",
    required=True,
    metavar="RUN",
    help=(
        "case/approach/speed or case/approach/speed/weather; away from the junction "
        "the position stands behind the approach: CPLA-50/east-15/40."
    ),
)
@options.option(
    "--frame",
    type=click.IntRange(min=-1000000000, max=1000000000),
    required=True,
    metavar="N",
    expected="a frame of the run, such as 40, or -1 for the last",
    help="Of the run, from 0; negative: from the end, -1 is at the impact.",
)
@options.option(
    "--unit",
    "unit_id",
    required=True,
    metavar="UNIT",
    help="One of the layout's, VUT or VUT-LIDAR.",
)
@options.option(
    "--weather",
    metavar="WEATHER",
    help="day, night, rain or fog; default: that of the run.",
)
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help=(
        "File to write, .png or .jpg; -instances.png and -depth.png are written next "
        "to it; of a LiDAR .ply, or .bin with float32 x, y, z, intensity; default: "
        "in results/renders."
    ),
)
@options.question_options(*options.OF_SCENE, has_file=False)
@options.quiet_option
@options.compute_options()
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
    question: Question,
    quiet: bool,
    compute: Compute,
) -> None:
    """Render what a camera sees in one frame (colours, instances, depths).

    Or scan by LiDAR.
    """
    layout = load_one_layout(layout_names)
    question = begin(progress, question, quiet=quiet)
    progress("lay the run", 0, 0)
    from geometry.scene_sources import load_scene
    from placement.evaluator.pictures import find_frame, find_viewpoint
    from placement.evaluator.pictures import render as render_frame
    from placement.layout import check_layout

    from ..export.watched import find_run
    from . import drawing as job

    around = load_scene(question.scene)
    check_layout(layout, around)
    run = find_run(run_id, around, weather=weather)
    frame_index = find_frame(run, frame)
    viewpoint = find_viewpoint(layout, unit_id, run, frame_index)
    suffix = job.suffixes_of(viewpoint.sensor)[0]
    path = out or _default_path(run, unit_id, frame_index, suffix)
    job.check_path(path, viewpoint.sensor)
    if out is not None and not out.parent.is_dir():
        raise unwritable(path, FileNotFoundError(ENOENT, os.strerror(ENOENT)))
    progress("render", 0, 0)
    seen = render_frame(around, run, frame_index, viewpoint, compute=compute)
    try:
        if out is None:
            path.parent.mkdir(parents=True, exist_ok=True)
        written = job.save(path, seen)
    except OSError as error:
        if not is_about(error, path):
            raise
        raise unwritable(path, error) from None
    progress.stop()
    for file in written:
        tell(f"Written to {file}.")
    tell(job.vru_sentence(seen))


def _default_path(run: Any, unit_id: str, frame_index: int, suffix: str) -> Path:
    from scenarios.positions import AT_ZERO

    if run.position == AT_ZERO.name:
        place = run.approach
    else:
        place = f"{run.approach}{run.position}"
    parts = [*run.case.name.split("/"), place, f"{run.vut_speed_kmh:g}", run.weather]
    name = "_".join([*parts, f"frame-{frame_index}", unit_id])
    return Path("results", "renders", name.replace(os.sep, "_") + suffix)
