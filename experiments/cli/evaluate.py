"""``place-rsus evaluate``: what a layout prevents."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    SectionedCommand,
    folder_option,
    job_options,
    layout_option,
    option,
    question_options,
)
from .recording import check_recording_options, recording_options, recording_table
from .running import begin, command_line, load_one_layout, print_answer, print_result

if TYPE_CHECKING:
    from placement.layout import Layout


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus evaluate --layout carlancap-12
  place-rsus evaluate --layout results/latest/layout.json --out results/mine
  place-rsus evaluate --recording ncap_data""",
)
@layout_option
@recording_options
@folder_option("a report")
@question_options("no_look", *JUDGED)
@job_options(has_cache=True)
@click.pass_obj
def evaluate(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    recording: Path | None,
    min_confidence: float,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Evaluate a layout by full perception and emergency braking, or recorded detections."""
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..parts import recording as recording_job

        summary = recording_job.run_recording(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=out,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recording_table(summary, out))
        return
    question = begin(progress, question, quiet=quiet)
    layout = load_one_layout(layout_names, question)
    from ..jobs import placement

    result = placement.run_evaluation(
        question,
        layout=layout,
        no_look=question.no_look,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    from .answers import evaluation_parts

    print_answer(result, progress, as_json, lambda: evaluation_parts(result, out))


# ---------- any number of layouts on the same runs


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus compare a.json b.json c.json --report results/abc
  place-rsus compare a.json b.json --samples 60     is the difference sure?""",
)
@click.argument("layouts", nargs=-1, metavar="LAYOUT...")
@option("--layout", "more_layouts", multiple=True, help="The same as an argument.")
@option(
    "--report",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    help="Folder for a report; else none.",
)
@question_options("samples", "uncertainty", "traffic", "no_look", *JUDGED)
@job_options(has_cache=True)
@click.pass_obj
def compare(
    progress: StageProgress,
    *,
    layouts: tuple[str, ...],
    more_layouts: tuple[str, ...],
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Compare layouts on the same runs: the first against each of the others.

    A layout is carlancap-12 or a layout file, such as layout.json in a folder of results. With
    --samples, differences have a 95 % interval.
    """
    names = (*layouts, *more_layouts)
    if len(names) < 2:
        given = "one layout" if names else "nothing"
        raise click.UsageError(f"LAYOUT: got {given}; expected two layouts or more")
    from placement.layout import find_layout

    found = _by_folder([find_layout(name, "LAYOUT") for name in names], names)
    question = begin(progress, question, quiet=quiet)
    from ..jobs import placement

    result = placement.run_comparison(
        question,
        layouts=found,
        samples=question.samples,
        uncertainty=question.uncertainty,
        no_look=question.no_look,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    from .answers import comparison_parts

    print_answer(result, progress, as_json, lambda: comparison_parts(result, out))


def _by_folder(layouts: Sequence["Layout"], files: Sequence[str]) -> list["Layout"]:
    """Layouts; where the same name stands in other folders, by these: "best-3 of latest"."""
    folders = [Path(file).resolve().parent.name for file in files]
    homes: dict[str, set[str]] = {}
    for layout, folder in zip(layouts, folders, strict=True):
        homes.setdefault(layout.name, set()).add(folder)
    return [
        replace(layout, name=f"{layout.name} of {folder}")
        if len(homes[layout.name]) > 1
        else layout
        for layout, folder in zip(layouts, folders, strict=True)
    ]
