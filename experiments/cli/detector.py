"""``place-rsus detector``: response tables of detectors, measured instead of assumed."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question, question_fields

from ..progress import StageProgress
from ..results.numbers import percent
from .options import (
    PICTURED,
    SectionedCommand,
    folder_option,
    is_given,
    job_options,
    layout_option,
    option,
    question_options,
)
from .question_options import option_of
from .running import begin, command_line, load_one_layout, print_result
from .terminal import sentences, table

if TYPE_CHECKING:
    from ..results.detectors import DetectorFitResult, FalseAlarmsRecord, IntervalRecord


@click.group()
def detector() -> None:
    """Response tables of detectors: what a detector finds, by height, cover, class and light."""


@detector.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus detector fit --detector cnn --layout carlancap-12 --out cnn
  place-rsus detector fit --detector net.onnx --layout carlancap-12 \\
      --weather day,night,rain --out mine
  place-rsus detector fit --recording ncap_data --out mine
  place-rsus detector fit --labels coco.json --results found.json --out mine
  place-rsus --budget 3 --detector mine/response.toml      plans with it""",
)
@layout_option
@option(
    "--pictures",
    type=click.IntRange(min=50),
    default=1000,
    show_default=True,
    metavar="N",
    needs="layout_names",
    expected="a number of pictures, at least 50",
    help="With --detector: how many are rendered and looked at, about a second each.",
)
@option(
    "--recording",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Fit to the labels and detections of a recording in the study's folder format.",
)
@option(
    "--labels",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Fit to COCO's files: annotations, such as coco.json of place-rsus dataset ..",
)
@option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=".. and what a detector found: a list of image_id, category_id, bbox, score.",
)
@option(
    "--min-confidence",
    type=click.FloatRange(min=0.0, max=1.0),
    metavar="SHARE",
    expected="a confidence, 0 to 1",
    default=0.5,
    show_default=True,
    help="Detections below do not count.",
)
@folder_option("response.toml, fit.json and calibration.png")
@question_options(*PICTURED)
@job_options()
@click.pass_obj
def fit(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    pictures: int,
    recording: Path | None,
    labels: Path | None,
    results: Path | None,
    min_confidence: float,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Fit a response table to what a detector really finds.

    The table is then what --detector mine/response.toml plans and judges with, in place of the
    built-in assumptions.
    """
    _check_one_source(layout_names, recording, labels, results)
    layout = load_one_layout(layout_names) if layout_names else None
    question = begin(progress, question, quiet=quiet)
    from ..jobs import detector as job

    result = job.run_detector_fit(
        question,
        wish=job.FitWish(
            layout=layout,
            pictures=pictures,
            recording=recording,
            labels=labels,
            results=results,
            min_confidence=min_confidence,
        ),
        out=out,
        command=command_line(),
        compute=compute,
        progress=progress,
    )
    print_result(result, progress, as_json, lambda: fit_text(result, out))


_OF_RULE = ("deceleration_mps2", "build_up_s", "latency_s", "latency_budget") + (
    "n_confirmations",
    "track_memory_s",
)


def _check_one_source(
    layout_names: tuple[str, ...], recording: Path | None, labels: Path | None, results: Path | None
) -> None:
    """Refuse no source, several, and half of one.

    Raises
    ------
    click.UsageError
        What is missing or too much.
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
    driven = [name for name in PICTURED if name not in _OF_RULE and is_given(name)]
    if driven and not layout_names:
        field = option_of(question_fields()[driven[0]])
        raise click.UsageError(f"{field}: got it with {names[0]}; expected it with --layout alone")


def fit_text(result: "DetectorFitResult", out: Path | None) -> str:
    """How much was found, recall by group, the table, and false alarms."""
    share = percent(result.found / result.frames)
    lines = [
        *sentences(
            f"{share} of {result.frames} frames with a road user are detected ({result.source})."
        ),
    ]
    if result.unknown:
        lines += sentences(
            f"Not told by them, and as in the built-in table: {', '.join(result.unknown)}."
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


def _alarms_words(alarms: "FalseAlarmsRecord") -> str:
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


def _rate(interval: "IntervalRecord") -> str:
    return f"{interval.value:.3g} (95 %: {interval.low:.3g} to {interval.high:.3g})"
