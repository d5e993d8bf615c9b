"""``place-rsus solve``: covering instances from files, solved and proven."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geometry.files import is_about

from ..parts import Part
from . import options
from .running import Call, unwritable
from .terminal import answer_text, sentences

if TYPE_CHECKING:
    from ..jobs.solve import CoveringResult, PlacementSolution


def _target(text: str) -> float | None:
    """A share of the rows; None for all that can be covered."""
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
def solve(
    call: Call,
    /,
    *,
    file: Path,
    target: float | None,
    track_memory_s: float | None,
    format_name: str,
    out: Path | None,
    **asked: Any,
) -> None:
    """Solve a covering or placement problem from a file, and prove it.

    Placement problems (instance.npz of a result folder) are solved as they were asked, unless
    --budget, --budget-cost or --target asks something else, and with the file's own rule unless
    --track-memory changes it.

    Chosen columns are numbered as in the file: from 1 in OR-Library's and Steiner triples, else
    from 0; --json says so in numbered_from.
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

    if format_name == "auto" and solve.is_placement_problem(file):
        if out is not None:
            raise click.UsageError(f"--out: got {out}; expected it with covering problems only")
        solution = solve.run_solve_windows(
            file,
            target=float("inf") if target is None and options.is_given("target") else target,
            track_memory_s=track_memory_s,
            progress=call.progress,
            **asked,
        )
        call.print(solution, lambda: window_text(solution))
        return
    if track_memory_s is not None:
        raise click.UsageError(
            f"--track-memory: got {track_memory_s:g}; expected it with placement problems only"
        )
    try:
        summary = solve.run_solve(
            file,
            format_name=None if format_name == "auto" else format_name,
            target=target,
            out=out,
            progress=call.progress,
            **asked,
        )
    except OSError as error:
        if out is None or not is_about(error, out):
            raise
        raise unwritable(out, error) from None
    call.print(summary, lambda: solution_text(summary))


def solution_text(summary: "CoveringResult") -> str:
    """The answer to a covering problem."""
    names = [str(column) for column in summary.chosen]
    gap = "proven" if summary.is_proven else f"gap {_percent(summary.gap)}"
    chosen = f"{len(names)} of {summary.columns} columns"
    is_cost = summary.problem == "set covering"
    entries = {
        "cost" if is_cost else "covered": _number(summary.objective),
        "bound": f"{_number(summary.bound)}, {gap}",
        "chosen": f"{chosen}: {', '.join(names)}" if names else "none",
    }
    if is_cost:
        n_left = summary.rows - summary.coverable
        more = f"; {n_left} cannot be covered" if n_left > 0 else ""
        entries["covers"] = f"{summary.covered} of {summary.rows} rows{more}"
    else:
        entries["of"] = f"{summary.rows} rows, {summary.coverable} coverable"
        entries["costs"] = _number(summary.cost)
    entries["solver"] = f"{summary.solver}; {summary.seconds:.2f} s"
    lines = sentences(f"{summary.file}: {_question_words(summary)}")
    for head, text in entries.items():
        lines += sentences(text, head=f"{head:<12}", indent=2, hanging=12)
    return "\n".join(lines)


def window_text(summary: "PlacementSolution") -> str:
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


def _question_words(summary: "CoveringResult") -> str:
    if summary.budget is not None:
        return f"the most that {summary.budget} columns cover (maximal covering)"
    if summary.budget_cost is not None:
        return f"the most that {_number(summary.budget_cost)} buys (maximal covering)"
    what = "all that can be covered" if summary.target is None else _percent(summary.target)
    return f"the least cost that covers {what} (set covering)"


def _number(value: float) -> str:
    return f"{value:.10g}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.4g} %" if share < float("inf") else "open"
