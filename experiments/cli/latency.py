"""``place-rsus latency``: what a layout prevents, however long it takes from sight to braking."""

from pathlib import Path

import click

from placement.compute import Compute
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
from .running import begin, load_one_layout, print_result


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus latency --layout carlancap-12
  place-rsus latency --layout carlancap-12 --budget cpm-100ms --out mine
  place-rsus latency --layout mine.json --budget mine.toml --json
  place-rsus latency --layout carlancap-12 --vut-latency 0.02 --max 2""",
)
@layout_option
@option(
    "--budget",
    metavar="NAME|FILE",
    help="study (one number, 25 ms), cpm-100ms, cpm-50ms, or a .toml file with parts of one's own; "
    "default: study.",
)
@option(
    "--vut-latency",
    "vut_latency_s",
    type=click.FloatRange(min=0.0),
    metavar="SECONDS",
    expected="seconds, at least 0",
    help="Of the VUT's own sensors, which wait for no message; default: that of all others.",
)
@option(
    "--max",
    "max_latency_s",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    expected="seconds, more than 0",
    help="Longest latency shown; default: 0.5, or as far as the budget and the curve need.",
)
@option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for latency.csv and latency.png; else none.",
)
@question_options(*(name for name in JUDGED if name != "latency_budget"))
@json_option
@quiet_option
@compute_options()
@click.pass_obj
def latency(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    budget: str | None,
    vut_latency_s: float | None,
    max_latency_s: float | None,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """How much latency a layout bears: accidents prevented against the time to braking.

    The layout is evaluated once. From the frame that confirms to the onset of braking it takes as
    long as the budget says: exposure, detector, the wait for the next collective perception
    message (CPM), radio, decision.
    """
    layout = load_one_layout(layout_names)
    begin(progress, quiet=quiet)
    from ..jobs.latency import latency_text, run_latency

    summary = run_latency(
        question,
        layout=layout,
        budget=budget,
        vut_latency_s=vut_latency_s,
        max_latency_s=max_latency_s,
        out=out,
        compute=compute,
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: latency_text(summary, out))
