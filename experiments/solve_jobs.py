"""What ``place-rsus solve`` does: read an instance, solve and prove it, tell what was found."""

import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from placement.optimiser.covering import (
    CoveringInstance,
    CoveringSolution,
    solve_lscp,
    solve_mclp,
)
from placement.optimiser.instance_files import load_instance, save_instance

from .progress import WRITING, StageProgress

_WIDTH, _COLUMN = 80, 12


def run_solve(
    path: Path,
    *,
    format_name: str | None,
    budget_units: int | None,
    budget_cost: float | None,
    target: float | None,
    solver: str,
    time_limit_s: float,
    gap: float,
    out: Path | None,
    progress: StageProgress,
) -> dict[str, Any]:
    """Read an instance and solve it.

    Parameters
    ----------
    path : Path
        The instance.
    format_name : str or None
        Of the file; None: told from its content.
    budget_units, budget_cost : int, float or None
        With one of them it is a maximal covering problem.
    target : float or None
        Without a budget: share of the weight to cover; None: all that can be covered.
    solver, time_limit_s, gap
        See :func:`placement.optimiser.covering.solve_lscp`.
    out : Path or None
        Where to write the instance in this program's own format.
    progress : StageProgress
        Shows what happens.

    Returns
    -------
    summary : dict
        Plain values; columns are numbered as in the file.

    Raises
    ------
    InputError
        The file holds no instance, or the question has no answer.
    OSError
        `out` cannot be written.
    """
    progress("read", 0, 0)
    instance = load_instance(path, format_name=format_name)
    if out is not None:
        progress(WRITING, 0, 0)
        save_instance(out, instance)
        progress.kept = f"{out} was written"
    progress("solve", 0, 0)
    if budget_units is None and budget_cost is None:
        solution = solve_lscp(
            instance, target=target, solver=solver, time_limit_s=time_limit_s, gap=gap
        )
    else:
        solution = solve_mclp(
            instance,
            budget_units=budget_units,
            budget_cost=budget_cost,
            solver=solver,
            time_limit_s=time_limit_s,
            gap=gap,
        )
    question = {"budget": budget_units, "budget_cost": budget_cost, "target": target}
    return _summary(path, instance, solution, question)


def _summary(
    path: Path,
    instance: CoveringInstance,
    solution: CoveringSolution,
    question: Mapping[str, float | None],
) -> dict[str, Any]:
    has_budget = question["budget"] is not None or question["budget_cost"] is not None
    chosen = [int(column) for column in solution.chosen]
    return {
        "file": path.name,
        "problem": "maximal covering" if has_budget else "set covering",
        **question,
        "objective": solution.objective,
        "bound": solution.bound,
        "gap": solution.gap,
        "chosen": [column + instance.numbered_from for column in chosen],
        "numbered_from": instance.numbered_from,
        "chosen_names": [instance.names[column] for column in chosen] if instance.names else None,
        "seconds": round(solution.seconds, 4),
        "is_proven": solution.is_proven,
        "solver": solution.solver,
        "cost": solution.cost,
        "covered_weight": solution.covered_weight,
        "coverable_weight": solution.coverable_weight,
        "total_weight": solution.total_weight,
        "columns": instance.n_columns,
        "rows": instance.n_rows,
        "presolve": asdict(solution.presolve),
        "presolve_effect": str(solution.presolve),
    }


def solution_text(summary: Mapping[str, Any]) -> str:
    """What :func:`run_solve` found, for a terminal."""
    names = summary["chosen_names"] or [str(column) for column in summary["chosen"]]
    gap = "proven" if summary["is_proven"] else f"gap {_percent(summary['gap'])}"
    chosen = f"{len(names)} of {summary['columns']} columns"
    entries = {
        _objective_words(summary): _number(summary["objective"]),
        "bound": f"{_number(summary['bound'])}, {gap}",
        "chosen": f"{chosen}: {', '.join(names)}" if names else "none",
        **_other_side(summary),
        "presolve": summary["presolve_effect"],
        "solver": f"{summary['solver']}; {summary['seconds']:.2f} s",
    }
    lines = textwrap.wrap(f"{summary['file']}: {_question_words(summary)}", _WIDTH)
    for head, text in entries.items():
        lines += textwrap.wrap(
            text,
            _WIDTH,
            initial_indent=f"  {head:<{_COLUMN}}",
            subsequent_indent=" " * (_COLUMN + 2),
            break_on_hyphens=False,
        )
    return "\n".join(lines)


def _question_words(summary: Mapping[str, Any]) -> str:
    if summary["budget"] is not None:
        return f"the most that {summary['budget']} columns cover (maximal covering)"
    if summary["budget_cost"] is not None:
        return f"the most that {_number(summary['budget_cost'])} buys (maximal covering)"
    if summary["target"] is not None:
        return f"the least cost that covers {_percent(summary['target'])} (set covering)"
    return "the least cost that covers all that can be covered (set covering)"


def _objective_words(summary: Mapping[str, Any]) -> str:
    return "cost" if summary["problem"] == "set covering" else "covered"


def _other_side(summary: Mapping[str, Any]) -> dict[str, str]:
    """Cost where the objective is coverage, coverage where it is cost."""
    total, coverable = summary["total_weight"], summary["coverable_weight"]
    covered = f"{_number(summary['covered_weight'])} of {_number(total)}"
    if coverable < total:
        covered += f"; {_number(total - coverable)} cannot be covered"
    if _objective_words(summary) == "cost":
        return {"covers": covered}
    return {
        "of": f"{_number(total)}, {_number(coverable)} coverable",
        "costs": _number(summary["cost"]),
    }


def _number(value: float) -> str:
    return f"{value:.10g}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.4g} %" if share < float("inf") else "open"
