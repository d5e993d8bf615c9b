"""``place-rsus solve``: a placement problem from a file, solved and proven."""

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


@click.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["solve"])
@click.argument("file", type=click.Path(path_type=Path))
@options.from_table("solve", target={"type": _target})
@options.calling
def solve(call: Call, /, *, file: Path, target: float | None, **asked: Any) -> None:
    """Solve a placement problem from a file, and prove it.

    The problem (instance.npz of a result folder) is solved as it was asked, unless --budget,
    --budget-cost or --target asks something else, and with the file's own rule unless
    --track-memory changes it.
    """
    questions = {"budget_units": "--budget", "budget_cost": "--budget-cost", "target": "--target"}
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
    from ..parts.proof import stage_table

    answer = Part(
        title=f"{summary.file}: {summary.goal} layout, fusion {summary.fusion}",
        table=stage_table(summary.stages),
        notes=[
            f"chosen: {', '.join(summary.chosen_names)}",
            f"presolve: {summary.presolve_effect}",
            f"solver: {summary.solver}; {summary.seconds:.2f} s",
        ],
    )
    return answer_text([answer], is_verbose=True)
