"""``place-rsus retrofit``: what to remove, re-aim or add where units are mounted."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from ..results.numbers import cars_words, percent, several
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
from .terminal import driven_lines, sentences, table

if TYPE_CHECKING:
    from ..parts.retrofit import ChangeRecord, RetrofitResult
    from ..results.record import LayoutValueRecord

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


_WORDS_WIDTH = 32


def retrofit_text(summary: "RetrofitResult", out: Path | None) -> str:
    """Possible changes: a row each, in groups, then the best of each in sentences."""
    labour = summary.labour
    rows = [_row("as it is", 0.0, summary.before)]
    for head, changes in (
        ("remove:", summary.removals),
        ("re-aim:", summary.re_aims),
        ("add:", [summary.addition]),
        ("together:", [summary.combination]),
    ):
        known = [change for change in changes if change is not None]
        if known:
            rows.append([head] + [""] * 5)
        for change in known:
            rows += _change_rows(change)
    lines = [
        *driven_lines(summary.driven, summary.without_effect),
        *sentences(
            f"What to change about {summary.name} "
            f"({several(len(summary.layout), 'unit', 'units')}) on {summary.runs} runs, on "
            f"the detection table (fusion {summary.fusion}{cars_words(summary.cars)}):"
        ),
        "",
        *table(["", "EUR", "APR", "one fails", "gained", "lost"], rows),
        "",
        *sentences(
            *summary.sentences,
            "One fails: APR that is left when the most needed unit fails. A visit costs "
            f"{labour.re_aim_eur:,.0f} EUR: {labour.source}.",
            indent=2,
            hanging=2,
        ),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: retrofit.csv and retrofit.json."]
    return "\n".join(lines)


def _change_rows(change: "ChangeRecord") -> list[list[str]]:
    """A row with the numbers, and the words that do not fit into it below."""
    words = [
        line for action in change.actions for line in textwrap.wrap(action.words, _WORDS_WIDTH)
    ]
    first, *others = words
    gained, lost = str(len(change.gained)), str(len(change.lost))
    row = _row(f"  {first}", change.price_eur, change, gained, lost)
    return [row, *([f"  {line}"] + [""] * 5 for line in others)]


def _row(
    words: str,
    price_eur: float,
    value: "LayoutValueRecord",
    gained: str = "",
    lost: str = "",
) -> list[str]:
    shares = (percent(value.apr), percent(value.apr_one_failed))
    return [words, f"{price_eur:,.0f}", *shares, gained, lost]
