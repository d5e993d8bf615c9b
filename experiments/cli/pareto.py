"""``place-rsus pareto``: what each further unit, or more money, buys."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..language import mark, tr, trn
from ..parts import Part
from . import options
from .driven import closing_lines
from .running import QuestionCall, command_line
from .terminal import answer_text, basis

if TYPE_CHECKING:
    from ..jobs.pareto import FrontResult
    from ..parts.retrofit import RetrofitResult


_TIME_LIMIT_S = 60.0
# Several layouts are looked for: each in nominal conditions, on the grid.
_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
# A front has every APR and every number of units: what asks for one of them has no
# place here.
_ASKED = options.fields_in(
    options.ASKED,
    options.MOUNTED,
    but=("budget", "target", "least", "survive", "give_up", "located_m"),
)


def front_options(*asked: str) -> options.Decorator:
    """Options of commands that look for several layouts.

    Each layout has a time limit of its own.
    """
    return options.asking(
        *asked, *_SOUGHT, *options.JUDGED, defaults={"time_limit_s": _TIME_LIMIT_S}
    )


_PARETO_EXAMPLES = """\b
Examples:
  place-rsus pareto --max 8                        what each further unit buys
  place-rsus pareto --by cost --site-cost 2000     what more money buys
  place-rsus pareto --keep carlancap-12 --max 3    what more units buy there
  place-rsus pareto --max 5 --out results/pareto --json"""


@click.command(cls=options.SectionedCommand, epilog=_PARETO_EXAMPLES)
@options.option(
    "--max",
    "max_units",
    type=click.IntRange(min=1),
    default=8,
    metavar="N",
    expected="a whole number of units, at least 1",
    help="Most units, beside those of --keep.",
)
@options.option(
    "--by",
    type=click.Choice(["units", "cost"]),
    default="units",
    help="What there is more and more of: units, or money for units and sites.",
)
@options.folder_option("pareto.csv, pareto.json and pareto.png")
@front_options(*_ASKED)
def pareto(job: QuestionCall, *, out: Path | None, **asked: Any) -> None:
    """What each further unit, or more money, buys.

    The best layouts, each with its proof.

    For 1, 2, 3 .. units, or from the cheapest useful layout upwards: the highest share
    of accidents prevented (APR), and the highest that is left when any one unit fails.
    """
    job = job.begin()
    from ..jobs.pareto import run_pareto

    summary = run_pareto(
        job.question, out=out, command=command_line(), **asked, **job.means
    )
    job.print(summary, lambda: front_text(summary, out))


def front_text(summary: "FrontResult", out: Path | None) -> str:
    """A front: a row per layout, and what is proven of it."""
    from ..parts import front

    title = mark(
        "The best of {poses} poses on {runs} runs (fusion {fusion}{cars}), and the"
        " gain from more units:"
    )
    if summary.by == "cost":
        title = mark(
            "The best of {poses} poses on {runs} runs (fusion {fusion}{cars}), and"
            " the gain from more money:"
        )
    title = tr(title, poses=summary.candidates, **basis(summary))
    parts = [
        Part(
            title=title,
            table=front.table(summary),
            notes=front.notes(summary),
        ),
        Part(words=summary.sentences),
    ]
    return _with_driven(
        summary, parts, out, ("pareto.csv", "pareto.json", "pareto.png")
    )


def _with_driven(
    summary: "FrontResult | RetrofitResult",
    parts: list[Part],
    out: Path | None,
    files: Sequence[str],
) -> str:
    """An answer, then what is driven, and the files that were written."""
    closing = closing_lines(summary.driven, summary.without_effect, out, files)
    return "\n".join([answer_text(parts, is_verbose=True), *closing])


# Existing units are --layout; what is added is asked for by money alone.
_ADDED = (
    "budget_cost",
    *options.fields_in(options.MOUNTED, but=("keep", "within", "force_site")),
)


_RETROFIT_EXAMPLES = """\b
Examples:
  place-rsus retrofit --layout carlancap-12
  place-rsus retrofit --layout results/latest/layout.json --budget-cost 4000
  place-rsus retrofit --layout mine.json --sensors carla-ncap-lidar
  place-rsus retrofit --layout carlancap-12 --visit-cost 300 --json"""


@click.command(cls=options.SectionedCommand, epilog=_RETROFIT_EXAMPLES)
@options.layout_option
@options.option(
    "--visit-cost",
    "visit_eur",
    type=click.FloatRange(min=0.0),
    metavar="EUR",
    expected="euros, at least 0",
    help=(
        "Of a re-aim or a removal; default: people and a lift, by the project's"
        " assumptions."
    ),
)
@options.folder_option("retrofit.csv and retrofit.json")
@front_options(*_ADDED)
def retrofit(
    job: QuestionCall, *, layout_names: tuple[str, ...], out: Path | None, **asked: Any
) -> None:
    """What to change about units that are mounted.

    Remove, re-aim or add one, each priced.

    A unit keeps its pole, height and sensor when it is re-aimed. With --budget-cost,
    the best re-aims and additions together for the money, too.
    """
    job = job.begin()
    layout = job.layout(layout_names)
    from ..parts.retrofit import run_retrofit

    asked |= {"layout": layout, "command": command_line()}
    summary = run_retrofit(job.question, out=out, **asked, **job.means)
    job.print(summary, lambda: retrofit_text(summary, out))


def retrofit_text(summary: "RetrofitResult", out: Path | None) -> str:
    """Possible changes: a row each, in groups."""
    from ..parts import retrofit

    labour = summary.labour
    parts = [
        Part(
            title=trn(
                "Changes to {name} ({n} unit) on {runs} runs, on the detection table"
                " (fusion {fusion}{cars}):",
                "Changes to {name} ({n} units) on {runs} runs, on the detection"
                " table (fusion {fusion}{cars}):",
                len(summary.layout),
                name=summary.name,
                **basis(summary),
            ),
            table=retrofit.table(summary),
            notes=[
                tr(
                    "Cars see: APR for cars with their own camera. One fails:"
                    " remaining APR if the most important unit fails. Bearings are"
                    " clockwise from north. Except in open rows, no change of the"
                    " same kind is better. A visit costs {cost:,.0f} EUR: {source}.",
                    cost=labour.re_aim_eur,
                    source=tr(labour.source),
                )
            ],
        ),
        Part(words=summary.sentences),
    ]
    return _with_driven(summary, parts, out, ("retrofit.csv", "retrofit.json"))
