"""``place-rsus latency``, and the options by which other commands take a latency budget."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress, load_one_layout, print_result, warn_of_slow_rays
from .options import (
    Number,
    OneOf,
    SectionedCommand,
    input_error,
    json_option,
    layout_option,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)

LATENCY_MODES = ("mean", "worst", "sampled")
_BUDGET_METAVAR = "NAME|FILE"


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
@click.option(
    "--budget",
    metavar=_BUDGET_METAVAR,
    help="study (one number, 25 ms), cpm-100ms, cpm-50ms, or a .toml file with parts of one's own; "
    "default: study.",
)
@click.option(
    "--vut-latency",
    "vut_latency_s",
    type=Number("SECONDS", "seconds", may_be_zero=True),
    help="Of the VUT's own sensors, which wait for no message; default: that of all others.",
)
@click.option(
    "--max",
    "max_latency_s",
    type=Number("SECONDS", "seconds"),
    help="Longest latency shown; default: 0.5, or as far as the budget and the curve need.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for latency.csv and latency.png; else none.",
)
@question_options()
@json_option
@quiet_option
@seed_option
@workers_option
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
    seed: int,
    workers: int,
) -> None:
    """How much latency a layout bears: accidents prevented against the time to braking.

    The layout is evaluated once. From the frame that confirms to the onset of braking it takes as
    long as the budget says: exposure, detector, the wait for the next collective perception
    message (CPM), radio, decision.
    """
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    from ..jobs.latency import latency_text, run_latency

    warn_of_slow_rays()
    summary = run_latency(
        question,
        layout=layout,
        budget=budget,
        vut_latency_s=vut_latency_s,
        max_latency_s=max_latency_s,
        out=out,
        compute=Compute(seed=seed, workers=workers, progress=progress),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: latency_text(summary, out))


def latency_budget_options(
    *, may_sample: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add ``--latency-budget`` and ``--latency-mode`` to a command that takes a `question`.

    Stands below :func:`experiments.cli.options.question_options`: the command gets a question whose
    latency is the budget's, and nothing else changes.

    Parameters
    ----------
    may_sample : bool
        Whether the command draws latencies. It then gets one more argument, `latency_draws`: the
        :class:`placement.latency.LatencyBudget` if the mode is "sampled" (the question has its
        mean), else None. A command that draws none refuses the mode.
    """
    drawn = "; sampled: drawn anew" if may_sample else ""
    options = (
        click.option(
            "--latency-budget",
            metavar=_BUDGET_METAVAR,
            help="In place of --latency: study, cpm-100ms, cpm-50ms, or a .toml file of parts.",
        ),
        click.option(
            "--latency-mode",
            type=OneOf(LATENCY_MODES),
            help=f"mean or worst of the latency budget{drawn}; default: mean.",
        ),
    )

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_latency(
            *args: Any,
            question: Question,
            latency_budget: str | None,
            latency_mode: str | None,
            **values: Any,
        ) -> Any:
            question, draws = apply_latency_budget(
                question, latency_budget, latency_mode, may_sample=may_sample
            )
            if may_sample:
                values["latency_draws"] = draws
            return command(*args, question=question, **values)

        for option in reversed(options):
            with_latency = option(with_latency)
        return with_latency

    return decorate


def apply_latency_budget(
    question: Question, budget: str | None, mode: str | None, *, may_sample: bool = False
) -> tuple[Question, Any]:
    """A question with the latency of a budget.

    Parameters
    ----------
    question : Question
        Its own latency must not be given beside a budget.
    budget : str, optional
        See :func:`placement.latency.load_latency_budget`; None: the question stays as it is.
    mode : str, optional
        One of ``LATENCY_MODES``; by default the mean.
    may_sample : bool
        Whether "sampled" is known to the command.

    Returns
    -------
    question : Question
        Its latency is the mean or the worst of the budget; the mean if latencies are drawn.
    draws : LatencyBudget or None
        What to draw from, if the mode is "sampled".

    Raises
    ------
    InputError
        ``--latency`` or a lone ``--latency-mode`` is given, the budget is unknown, or the command
        draws no latencies.
    """
    if budget is None and mode is None:
        return question, None
    from geometry.errors import Unquoted
    from placement.latency import load_latency_budget, pick_latency_s

    if budget is None:
        without = Unquoted("it without --latency-budget")
        raise input_error("--latency-mode", without, "both")
    if question.latency_s is not None:
        raise input_error("--latency", Unquoted("it beside --latency-budget"), "one of them")
    chosen = load_latency_budget(budget, where="--latency-budget")
    if mode == "sampled" and may_sample:
        return replace(question, latency_s=chosen.mean_s), chosen
    return replace(question, latency_s=pick_latency_s(chosen, mode or "mean")), None
