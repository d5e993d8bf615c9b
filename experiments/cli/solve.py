"""``place-rsus solve``: a placement problem from a file."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..parts import Part
from . import options
from .running import Call
from .terminal import answer_text

if TYPE_CHECKING:
    from ..jobs.solve import PlacementSolution


def _target(text: str) -> float | None:
    """A share of the runs; None for all that can be avoided."""
    if text == "max":
        return None
    share = float(text)
    if not 0.0 <= share <= 1.0:
        raise ValueError
    return share


_EXAMPLES = """\b
Examples:
  place-rsus solve results/latest/instance.npz              the same question
  place-rsus solve results/latest/instance.npz --budget 4
  place-rsus solve results/latest/instance.npz --target 0.9"""


@click.command(cls=options.SectionedCommand, epilog=_EXAMPLES)
@click.argument("file", type=click.Path(path_type=Path))
@options.option(
    "--budget",
    "budget_units",
    type=click.IntRange(min=1),
    metavar="N",
    expected="a whole number of units, at least 1",
    help="Avoid as much as so many units can.",
)
@options.option(
    "--budget-cost",
    type=click.FloatRange(min=0.0),
    metavar="COST",
    expected="an amount of money, at least 0",
    help="Avoid as much as units for so much money can.",
)
@options.option(
    "--target",
    type=_target,
    metavar="max|SHARE",
    expected="max, or a share of the runs, 0 to 1",
    help=(
        "Avoid that share of the runs, or all that can be avoided (max), with the"
        " fewest units."
    ),
)
@options.option(
    "--track-memory",
    "track_memory_s",
    type=float,
    metavar="SECONDS",
    takes_infinity=True,
    expected="seconds, at least from one frame to the next, or inf",
    help=(
        "How long a track lives without detections, in place of the file's own; inf: "
        "for ever, as the study reads it."
    ),
)
@options.option(
    "--solver",
    default="auto",
    metavar="NAME",
    help="auto: what proves soonest; HIGHS: that solver alone; greedy: no proof.",
)
@options.option(
    "--time-limit",
    "time_limit_s",
    type=click.FloatRange(min=0.0, min_open=True),
    default=60.0,
    metavar="SECONDS",
    expected="seconds, more than 0",
    help="When it is up, the best answer found and its gap are given.",
)
@options.option(
    "--gap",
    type=click.FloatRange(min=0.0),
    default=0.0,
    show_default=True,
    metavar="SHARE",
    expected="a share, at least 0",
    help="Relative distance of objective and bound that is good enough.",
)
@options.calling
def solve(call: Call, /, *, file: Path, target: float | None, **asked: Any) -> None:
    """Solve a placement problem from a file, and prove it.

    The problem (instance.npz of a result folder) is solved as it was asked. A demand
    that is given here takes the place of the file's own; all its other demands hold. A
    target is reached with the fewest units, however many the file allows.
    """
    questions = {
        "budget_units": "--budget",
        "budget_cost": "--budget-cost",
        "target": "--target",
    }
    asked_for = [words for name, words in questions.items() if options.is_given(name)]
    if len(asked_for) > 1:
        known = ", ".join(questions.values())
        raise click.UsageError(
            f"{asked_for[1]}: got it beside {asked_for[0]}; expected one of {known}"
        )
    call.start()
    from ..jobs import solve

    is_all_there_is = target is None and options.is_given("target")
    solution = solve.run_solve(
        file,
        target=float("inf") if is_all_there_is else target,
        progress=call.progress,
        **asked,
    )
    call.print(solution, lambda: solution_text(solution))


def solution_text(summary: "PlacementSolution") -> str:
    """The answer to a placement problem, with its frames and windows."""
    from ..parts.proof import stage_conditions, stage_table

    lines = [f"asked: {'; '.join(summary.question)}; fusion {summary.fusion}"]
    if summary.replaced:
        lines.append(f"in place of the file's own: {'; '.join(summary.replaced)}")
    answer = Part(
        title=f"{summary.file}: {summary.goal} layout",
        words=lines,
        table=stage_table(summary.stages),
        notes=[
            *stage_conditions(summary.stages),
            f"chosen: {', '.join(summary.chosen_names)}",
            f"presolve: {summary.presolve_effect}",
            f"solver: {summary.solver}; {summary.seconds:.2f} s",
        ],
    )
    return answer_text([answer], is_verbose=True)
