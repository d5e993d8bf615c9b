"""``place-rsus evaluate``: what a layout prevents."""

from pathlib import Path
from typing import Any

import click

from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    SectionedCommand,
    compute_options,
    json_option,
    layout_option,
    option,
    question_options,
    quiet_option,
)
from .recording import check_recording_options, recording_options, recording_table
from .running import begin, command_line, load_one_layout, print_result


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
@option("--out", type=click.Path(path_type=Path), help="Folder for a report; else none.")
@question_options("no_look", *JUDGED)
@json_option
@quiet_option
@compute_options()
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
    compute: Any,
) -> None:
    """Evaluate a layout by full perception and emergency braking, or recorded detections."""
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..jobs import recording as recording_job

        summary = recording_job.run_recording(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=out,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recording_table(summary, out))
        return
    layout = load_one_layout(layout_names)
    begin(progress, quiet=quiet)
    from ..jobs import placement

    summary = placement.run_evaluation(
        question,
        layout=layout,
        no_look=question.no_look,
        out=out,
        **compute,
        command=command_line(),
        progress=progress,
    )
    print_result(
        summary,
        progress,
        as_json,
        lambda: with_additions(summary, evaluation_table(summary, out)),
    )
