"""``place-rsus sheet``: the mounting sheet of a layout."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    SectionedCommand,
    job_options,
    layout_option,
    option,
    question_options,
)
from .running import begin, load_one_layout, print_result
from .terminal import sentences, table

if TYPE_CHECKING:
    from ..parts.sheet import SheetResult


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus sheet --layout mine.json --scene scene --out mounting.pdf --json""",
)
@layout_option
@option("--out", type=click.Path(path_type=Path), required=True, help="PDF file to write.")
@question_options(*JUDGED)
@job_options()
@click.pass_obj
def sheet(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    out: Path,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Write a PDF for whoever mounts the units: a page each.

    Where, how high, where it looks in words and degrees, what it will see (rendered), a plan, the
    nearest landmarks, and how many degrees and centimetres it may be off before a run is lost.
    """
    question = begin(progress, question, quiet=quiet)
    layout = load_one_layout(layout_names, question)
    from ..parts.sheet import run_sheet

    summary = run_sheet(question, layout=layout, out=out, compute=compute, progress=progress)
    print_result(summary, progress, as_json, lambda: sheet_text(summary))


def sheet_text(summary: "SheetResult") -> str:
    """Tolerances of each unit before a run is lost."""
    rows = []
    for unit in summary.units:
        (right, left), (down, up) = unit.yaw_deg, unit.pitch_deg
        lower_m, higher_m = unit.height_m
        degrees = [f"{value:g}\N{DEGREE SIGN}" for value in (left, right, up, down)]
        rows.append([unit.unit_id, *degrees, f"{100 * higher_m:.0f} cm", f"{100 * lower_m:.0f} cm"])
    lines = [
        *sentences(f"What the units of {summary.layout} may be off before a run is lost:"),
        *table(["unit", "left", "right", "up", "down", "higher", "lower"], rows),
        "  One thing at a time; the largest of the steps tried.",
        "",
        f"Written to {summary.written}.",
    ]
    return "\n".join(lines)
