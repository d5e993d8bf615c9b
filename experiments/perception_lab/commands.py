"""Commands of the perception lab: ``place-rsus dataset``, ``detector`` and ``render``."""

import os
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geometry.files import is_about
from placement.compute import Compute
from placement.question import question_fields

from ..cli import options
from ..cli.running import Job, command_line, load_one_layout, unwritable
from ..cli.terminal import sentences, table
from ..progress import StageProgress, tell
from ..results.numbers import percent

if TYPE_CHECKING:
    from placement.detectors.evidence import Interval
    from placement.detectors.fitting import FalseAlarms

    from .dataset import DatasetSummary
    from .fit import FitResult


@click.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["dataset"])
@options.layout_option
@options.from_table("dataset")
@options.asking(*options.PICTURED, has_cache=False)
def dataset(job: Job, /, *, layout_names: tuple[str, ...], out: Path, **wish: Any) -> None:
    """Write a dataset: what the cameras of a layout see of all runs, with labels."""
    layout = load_one_layout(layout_names)
    job.start()
    from .dataset import run_dataset
    from .drawing import DatasetWish

    drawn = DatasetWish(**wish)
    summary = run_dataset(
        job.question, layout=layout, wish=drawn, out=out, tell=job.announce, **job.means
    )
    job.print(summary, lambda: _dataset_text(summary, drawn.format))


def _dataset_text(summary: "DatasetSummary", form: str) -> str:
    n_before = summary.pictures - summary.drawn
    was_there = f", {n_before:,} of them were there before" if n_before else ""
    lines = [
        f"{summary.pictures:,} pictures of {summary.units} cameras in {summary.folder}{was_there}: "
        f"{summary.frames:,} frames of {summary.runs} runs."
    ]
    if summary.drawn:
        each = summary.seconds / summary.drawn
        lines.append(
            f"{summary.size_bytes / 1e9:.2f} GB written, {each:.2f} s per picture on all "
            "processors together."
        )
    if form == "carlancap":
        lines.append(f"Read it back: place-rsus evaluate --recording {summary.folder}")
    return "\n".join(line for text in lines for line in sentences(text))


@click.group()
def detector() -> None:
    """Response tables of detectors: what a detector finds, by height, cover, class and light."""


@detector.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["fit"])
@options.layout_option
@options.from_table("fit")
@options.folder_option("response.toml, fit.json and calibration.png")
@options.asking(*options.PICTURED, has_cache=False)
def fit(job: Job, /, *, layout_names: tuple[str, ...], out: Path | None, **wish: Any) -> None:
    """Fit a response table to what a detector really finds.

    The table is then what --detector mine/response.toml plans and judges with, in place of the
    built-in assumptions.
    """
    _check_one_source(layout_names, wish["recording"], wish["labels"], wish["results"])
    layout = load_one_layout(layout_names) if layout_names else None
    job = job.begin()
    from .fit import FitWish, run_detector_fit

    asked = FitWish(layout=layout, **wish)
    result = run_detector_fit(
        job.question, wish=asked, out=out, command=command_line(), **job.means
    )
    job.print(result, lambda: fit_text(result, out))


_OF_RULE = (
    *("deceleration_mps2", "build_up_s", "latency_s", "latency_budget"),
    *("n_confirmations", "track_memory_s"),
)


def _check_one_source(
    layout_names: tuple[str, ...], recording: Path | None, labels: Path | None, results: Path | None
) -> None:
    """Refuse no source, several, and half of one.

    Raises click.UsageError: a source is missing, or there is one too many.
    """
    if (labels is None) != (results is None):
        alone, other = ("--labels", "--results") if results is None else ("--results", "--labels")
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
            f"detector fit: got {got}; expected one of --layout with --detector cnn or FILE.onnx, "
            "--recording, or --labels with --results"
        )
    driven = [name for name in options.PICTURED if name not in _OF_RULE and options.is_given(name)]
    if driven and not layout_names:
        field = options.option_of(question_fields()[driven[0]])
        raise click.UsageError(f"{field}: got it with {names[0]}; expected it with --layout alone")


def fit_text(result: "FitResult", out: Path | None) -> str:
    """How much was found, recall by group, the table, and false alarms."""
    share = percent(result.found / result.frames)
    lines = sentences(
        f"{share} of {result.frames} frames with a road user are detected ({result.source})."
    )
    if result.unknown:
        lines += sentences(
            f"Not known from them, and as in the built-in table: {', '.join(result.unknown)}."
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
        lines += [*table([kind, "frames", "detected", "95 % interval", "the table says"], rows), ""]
    rows = [
        [key, f"{one.value:.3g}", f"{one.low:.3g} to {one.high:.3g}" if one.low < one.high else "-"]
        for key, one in result.table.items()
    ]
    lines += table(["response table", "value", "95 % interval (-: not fitted)"], rows)
    if out is not None:
        lines += [
            "",
            *sentences(
                f"Written to {out}: response.toml, fit.json and calibration.png. Plan with it: "
                f"place-rsus --budget 3 --detector {out}/response.toml"
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
        return f"{words} How many of them would be confirmed is unknown: no consecutive frames."
    return (
        f"{words} {alarms.confirmed} false tracks were confirmed in {alarms.chances} chances: "
        f"{_rate(alarms.per_hour)} per hour and unit. Not each of them would brake a car: it must "
        "also seem to cross its path."
    )


def _rate(interval: "Interval") -> str:
    return f"{interval.value:.3g} (95 %: {interval.low:.3g} to {interval.high:.3g})"


@click.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["render"])
@options.layout_option
@options.from_table("render")
@options.scene_option
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
    scene: str,
    quiet: bool,
    compute: Compute,
) -> None:
    """Render what a camera sees in one frame (colours, instances, depths), or scan by LiDAR."""
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    progress("lay the run", 0, 0)
    from geometry.scene_files import load_scene
    from placement.evaluator.pictures import find_frame, find_viewpoint
    from placement.evaluator.pictures import render as render_frame
    from placement.layout import check_layout

    from ..export.watched import find_run
    from . import drawing as job

    around = load_scene(scene)
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

    place = run.approach if run.position == AT_ZERO.name else f"{run.approach}{run.position}"
    parts = [*run.case.name.split("/"), place, f"{run.vut_speed_kmh:g}", run.weather]
    name = "_".join([*parts, f"frame-{frame_index}", unit_id])
    return Path("results", "renders", name.replace(os.sep, "_") + suffix)
