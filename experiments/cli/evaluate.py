"""``place-rsus evaluate``: what a layout prevents."""

from pathlib import Path

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
    question_options,
)
from .recording import check_recording_options, recording_options, recording_table
from .running import begin, command_line, load_one_layout, print_answer, print_result


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
