"""``place-rsus latency``: what a layout prevents at each latency."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..language import localized, mark, tr
from ..results.numbers import percent
from . import options
from .driven import closing_lines
from .running import QuestionCall
from .terminal import sentences, table

if TYPE_CHECKING:
    from placement.latency import LatencyBudget

    from ..parts.latency import LatencyResult


_EXAMPLES = """\b
Examples:
  place-rsus latency --layout carlancap-12
  place-rsus latency --layout carlancap-12 --budget cpm-100ms --out mine
  place-rsus latency --layout mine.json --budget mine.toml --json
  place-rsus latency --layout carlancap-12 --vut-latency 0.02 --max 2"""


@click.command(cls=options.SectionedCommand, epilog=_EXAMPLES)
@options.layout_option
@options.option(
    "--budget",
    metavar="NAME|FILE",
    help=(
        "study (one number, 25 ms), cpm-100ms, cpm-50ms, or a .toml file with parts "
        "of one's own; default: study."
    ),
)
@options.option(
    "--vut-latency",
    "vut_latency_s",
    type=click.FloatRange(min=0.0),
    metavar="SECONDS",
    expected="seconds, at least 0",
    help=(
        "Of the VUT's own sensors, which wait for no message; default: that of all"
        " others."
    ),
)
@options.option(
    "--max",
    "max_latency_s",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    expected="seconds, more than 0",
    help="Longest latency shown; default: 0.5, or as far as the budget reaches.",
)
@options.folder_option("latency.csv and latency.png")
@options.asking(
    *(name for name in options.JUDGED if name not in ("latency_budget", "cars")),
    has_cache=False,
)
def latency(
    job: QuestionCall, *, layout_names: tuple[str, ...], out: Path | None, **asked: Any
) -> None:
    """How much latency a layout bears.

    Accidents prevented against the time to braking.

    The layout is evaluated once. From the frame that confirms to the onset of braking
    it takes as long as the budget says: exposure, detector, the wait for the next
    collective perception message (CPM), radio, decision.
    """
    job = job.begin()
    layout = job.layout(layout_names)
    from ..parts.latency import run_latency

    summary = run_latency(job.question, layout=layout, out=out, **asked, **job.means)
    job.print(summary, lambda: latency_text(summary, out))


_COLUMNS = {
    "rsu_all": mark("RSUs, fused"),
    "vut_and_rsus": mark("VUT and RSUs"),
    "vut": mark("VUT alone"),
}
_OTHERS = {"vam": mark("VAM alone"), "all_sources": mark("all and VAM")}
_SHOWN_S = (0.0, 0.025, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)


def latency_text(summary: "LatencyResult", out: Path | None) -> str:
    """APR by latency, latencies that leave some APR, and the budget's effect."""
    from ..parts.latency import APR_LEVELS, STEP_S

    parties = summary.parties
    budget = summary.budget
    latencies_s = summary.latencies_s
    main = [parties[name] for name in _COLUMNS]
    rows = [round(latency_s / STEP_S) for latency_s in _SHOWN_S]
    at = [
        [_ms(latencies_s[row]), *(percent(party.apr[row]) for party in main)]
        for row in rows
        if row < len(latencies_s)
    ]
    longest = [
        [
            localized(f"{100.0 * level:g} %"),
            *(_longest(one.longest_s(latencies_s, level)) for one in main),
        ]
        for level in APR_LEVELS
    ]
    names = _COLUMNS | {
        name: _OTHERS.get(name, name) for name in parties if name not in _COLUMNS
    }
    columns = [*map(tr, _COLUMNS.values())]
    within = [
        [tr(words), *map(percent, (party.at_best, party.at_mean, party.at_worst))]
        for name, words in names.items()
        for party in [parties[name]]
    ]
    lines = [
        *sentences(tr("{name} on {runs} runs:", name=summary.name, runs=summary.runs)),
        *table([tr("APR at a latency of"), *columns], at),
        "",
        *table([tr("longest latency that still gives an APR of"), *columns], longest),
        "",
        *_budget_lines(budget),
        "",
        *table(
            [
                tr("APR within the budget"),
                tr("minimum"),
                tr("mean"),
                tr("maximum"),
            ],
            within,
        ),
        *sentences(
            " ".join(
                [
                    tr(
                        "fused: a frame counts as detected if any unit detects. A"
                        " run counts as avoided if its last moment to brake is not"
                        " over and a confirmed track exists at that moment."
                    ),
                    *_own_latencies(summary),
                ]
            ),
            indent=2,
        ),
    ]
    files = ("latency.csv", "latency.png")
    lines += closing_lines(summary.driven, summary.without_effect, out, files)
    return "\n".join(lines)


def _ms(latency_s: float) -> str:
    return localized(f"{1000.0 * latency_s:.4g} ms")


def _longest(latency_s: float) -> str:
    if math.isinf(latency_s):
        if latency_s > 0.0:
            return tr("all shown")
        return tr("none")
    return _ms(latency_s)


def _budget_lines(budget: "LatencyBudget") -> list[str]:
    rows = [
        [
            (
                tr("{part} (assumption)", part=tr(part.name))
                if part.is_assumption
                else tr(part.name)
            ),
            *map(_ms, (part.low_s, 0.5 * (part.low_s + part.high_s), part.high_s)),
        ]
        for part in budget.parts
    ]
    if len(rows) > 1:
        rows.append(
            [
                tr("all together"),
                *map(_ms, (budget.best_s, budget.mean_s, budget.worst_s)),
            ]
        )
    head = tr("latency budget {name}", name=budget.name)
    return table([head, tr("least"), tr("mean"), tr("most")], rows)


def _own_latencies(summary: "LatencyResult") -> list[str]:
    own = {
        unit.id: unit.latency_s for unit in summary.layout if unit.latency_s is not None
    }
    if summary.vut_latency_s is not None:
        own[tr("the VUT")] = summary.vut_latency_s
    notes = []
    if summary.vut_latency_s is None:
        notes.append(tr("The VUT's own sensors take as long; see --vut-latency."))
    if own:
        words = ", ".join(f"{name} {_ms(latency_s)}" for name, latency_s in own.items())
        notes.append(
            tr(
                "Units with a latency of their own keep it: {latencies}.",
                latencies=words,
            )
        )
    return notes
