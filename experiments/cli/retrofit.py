"""``place-rsus retrofit``: what to remove, re-aim or add where units are mounted."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..parts import Part
from ..progress import StageProgress
from ..results.numbers import cars_words, several
from .options import (
    MOUNTED,
    SectionedCommand,
    fields_in,
    folder_option,
    job_options,
    layout_option,
    option,
)
from .pareto import front_options
from .running import begin, command_line, load_one_layout, print_result
from .terminal import answer_text, driven_lines

if TYPE_CHECKING:
    from ..parts.retrofit import RetrofitResult

# Existing units are --layout; what is added is asked for by money alone.
_ASKED = ("budget_cost", *fields_in(MOUNTED, but=("keep", "within", "force_site")))


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus retrofit --layout carlancap-12
  place-rsus retrofit --layout results/latest/layout.json --budget-cost 4000
  place-rsus retrofit --layout mine.json --sensors carla-ncap-lidar
  place-rsus retrofit --layout carlancap-12 --visit-cost 300 --json""",
)
@layout_option
@option(
    "--visit-cost",
    "visit_eur",
    type=click.FloatRange(min=0.0),
    metavar="EUR",
    expected="euros, at least 0",
    help="Of a re-aim or a removal; default: people and a lift, by the project's assumptions.",
)
@folder_option("retrofit.csv and retrofit.json")
@front_options(*_ASKED)
@job_options(has_cache=True)
@click.pass_obj
def retrofit(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    visit_eur: float | None,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """What to change about units that are mounted: remove, re-aim or add one, each priced.

    A unit keeps its pole, height and sensor when it is re-aimed. With --budget-cost, the best
    re-aims and additions together for the money, too.
    """
    question = begin(progress, question, quiet=quiet)
    layout = load_one_layout(layout_names, question)
    from ..parts.retrofit import run_retrofit

    summary = run_retrofit(
        question,
        layout=layout,
        visit_eur=visit_eur,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: retrofit_text(summary, out))


def retrofit_text(summary: "RetrofitResult", out: Path | None) -> str:
    """Possible changes: a row each, in groups."""
    from ..parts import retrofit

    labour = summary.labour
    parts = [
        Part(
            title=f"What to change about {summary.name} "
            f"({several(len(summary.layout), 'unit', 'units')}) on {summary.runs} runs, on "
            f"the detection table (fusion {summary.fusion}{cars_words(summary.cars)}):",
            table=retrofit.table(summary),
            notes=[
                "One fails: APR that is left when the most needed unit fails; proven: nothing of "
                f"its kind is better. A visit costs {labour.re_aim_eur:,.0f} EUR: {labour.source}."
            ],
        ),
        Part(words=summary.sentences),
    ]
    if out is not None:
        parts.append(Part(words=[f"Written to {out}: retrofit.csv and retrofit.json."]))
    head = driven_lines(summary.driven, summary.without_effect)
    return "\n".join([*head, "", answer_text(parts, is_verbose=True)])
