"""``place-rsus evaluate``: what a layout prevents."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..results.numbers import grouped
from . import options
from .recording import evaluate_recording
from .running import QuestionCall, command_line

if TYPE_CHECKING:
    from placement.layout import Layout


_EVALUATE_EXAMPLES = """\b
Examples:
  place-rsus evaluate --layout carlancap-12
  place-rsus evaluate --layout results/latest/layout.json --out results/mine
  place-rsus evaluate --recording ncap_data"""

_COMPARED = (
    "samples",
    "uncertainty",
    "traffic",
    "no_look",
    "decision",
    *options.JUDGED,
)
"""Fields of a question that layouts are compared under."""


@click.command(cls=options.SectionedCommand, epilog=_EVALUATE_EXAMPLES)
@options.layout_option
@options.recording_options
@options.folder_option("a report")
@options.sign_option
@options.asking("no_look", "decision", *options.JUDGED)
def evaluate(
    job: QuestionCall,
    *,
    layout_names: tuple[str, ...],
    recording: Path | None,
    min_confidence: float,
    out: Path | None,
    sign: Path | None,
) -> None:
    """Evaluate a layout by perception and braking, or recorded detections."""
    if recording is not None:
        asked = {"folder": recording, "min_confidence": min_confidence, "sign": sign}
        evaluate_recording(job, out=out, **asked)
        return
    asked_question = job.question
    job = job.begin()
    layout = job.layout(layout_names)
    from ..jobs import evaluation

    result = evaluation.run_evaluation(
        job.question,
        layout=layout,
        out=out,
        command=command_line(),
        asked=asked_question,
        sign=sign,
        **job.means,
    )
    from .answers import evaluation_parts

    job.print_answer(result, lambda: evaluation_parts(result, out))


_COMPARE_EXAMPLES = """\b
Examples:
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus compare a.json b.json c.json --report results/abc
  place-rsus compare a.json b.json --samples 60     is the difference sure?"""


@click.command(cls=options.SectionedCommand, epilog=_COMPARE_EXAMPLES)
@click.argument("layouts", nargs=-1, metavar="LAYOUT...")
@options.option(
    "--report",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    help="Folder for a report; else none.",
)
@options.sign_option
@options.asking(*_COMPARED)
def compare(
    job: QuestionCall,
    *,
    layouts: tuple[str, ...],
    out: Path | None,
    sign: Path | None,
) -> None:
    """Compare layouts on the same runs: the first against each of the others.

    A layout is carlancap-12 or a layout file, such as layout.json in a folder of
    results. With --samples, differences have a 95 % interval.
    """
    if len(layouts) < 2:
        if layouts:
            given = "one layout"
        else:
            given = "nothing"
        raise click.UsageError(f"LAYOUT: got {given}; expected two layouts or more")
    from placement.layout import find_layout

    found = _by_folder([find_layout(name, "LAYOUT") for name in layouts], layouts)
    asked_question = job.question
    job = job.begin()
    from ..jobs import evaluation

    result = evaluation.run_comparison(
        job.question,
        layouts=found,
        out=out,
        command=command_line(),
        asked=asked_question,
        sign=sign,
        **job.means,
    )
    from .answers import comparison_parts

    job.print_answer(result, lambda: comparison_parts(result, out))


def _by_folder(layouts: Sequence["Layout"], files: Sequence[str]) -> list["Layout"]:
    """Layouts; where the same name stands in other folders, by these.

    "best-3 of latest".
    """
    folders = [Path(file).resolve().parent.name for file in files]
    homes = grouped(
        (one.name, folder) for one, folder in zip(layouts, folders, strict=True)
    )
    return [
        (
            replace(layout, name=f"{layout.name} of {folder}")
            if len(set(homes[layout.name])) > 1
            else layout
        )
        for layout, folder in zip(layouts, folders, strict=True)
    ]
