"""Gains of refinement between the poses of the grid, in sentences."""

from placement.optimiser.objectives import Objective

from ..results.numbers import joined, number, percent
from .front import MoveRecord, RefinementRecord

_MAX_DIGITS = 6


def refinement_sentences(found: RefinementRecord) -> list[str]:
    """Sentences on the changes by refinement and their proof.

    Of one unit at the study's junction: "Refinement turned U1 by -6.94 deg and raised it by
    0.22 m: smallest time to spare 0.33 s to 0.43 s, mean time to spare 3.81 s to 3.74 s."
    """
    n_tried, n_grid = found.poses_tried, found.grid_candidates
    if not found.is_improved:
        return [
            f"Refinement tried {n_tried} poses between the {n_grid} candidates of the grid and "
            "found nothing better."
        ]
    proven = (
        f"No choice among the {n_grid} candidates of the grid is as good: that is proven."
        if found.grid_is_proven
        else f"It is better than the best choice among the {n_grid} candidates of the grid that "
        "was found in the time given."
    )
    return [
        f"Refinement {joined([_deed(move) for move in found.moves])}: {_changes(found)}.",
        f"{proven} The bounds of the refined layout hold for these and the {n_tried} poses tried "
        "between them, not for every pose there is.",
    ]


def _deed(move: MoveRecord) -> str:
    """Words for the change of one unit."""
    if move.is_ is None:
        return f"removed {move.was}"
    if move.was is None:
        return f"added {move.is_}"
    lift_m = move.lift_m or 0.0
    amounts = (
        ("turned", move.turn_deg, "\N{DEGREE SIGN}"),
        ("tilted", move.tilt_deg, "\N{DEGREE SIGN}"),
        ("raised" if lift_m > 0.0 else "lowered", abs(lift_m), " m"),
        ("zoomed", move.zoom_deg, "\N{DEGREE SIGN}"),
    )
    done = [(verb, f"by {number(amount)}{unit}") for verb, amount, unit in amounts if amount]
    name = move.is_ if move.is_ == move.was else f"{move.was} (now {move.is_})"
    (verb, by), *others = done
    return joined([f"{verb} {name} {by}", *(f"{verb} it {by}" for verb, by in others)])


def _changes(found: RefinementRecord) -> str:
    """Objectives before and after, those that changed."""
    values = [(Objective(name), before, found.after[name]) for name, before in found.before.items()]
    return ", ".join(
        f"{objective.label} {_from_to(objective, before, after)}"
        for objective, before, after in values
        if abs(after - before) > objective.tolerance
    )


def _from_to(objective: Objective, before: float, after: float) -> str:
    """Two values with as many digits as tell them apart."""
    is_share = objective.value.startswith("apr")
    if is_share and percent(before) != percent(after):
        return f"{percent(before)} to {percent(after)}"
    scale, unit = (100.0, " %") if is_share else (1.0, f" {objective.unit}".rstrip())
    first = 0 if objective.is_minimised else 2
    for digits in range(first, _MAX_DIGITS + 1):
        one, other = number(scale * before, digits), number(scale * after, digits)
        if one != other:
            break
    return f"{one}{unit} to {other}{unit}"
