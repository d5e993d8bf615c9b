"""What refinement between the poses of the grid changed: as one plain object, in sentences."""

from collections.abc import Mapping, Sequence
from typing import Any

from placement.optimiser.objectives import COST_TOLERANCE_EUR, TOLERANCE

from ..results.numbers import number, percent
from .answer import STAGES

_SHARES = ("apr", "apr_one_failed", "apr_survived")
_MAX_DIGITS = 6


def refinement_sentences(summary: Mapping[str, Any]) -> list[str]:
    """What refinement changed, and what is proven of it.

    Parameters
    ----------
    summary : mapping
        By :func:`summarise_refinement`.

    Examples
    --------
    Of one unit at the study's junction: "Refinement turned U1 by -6.94 deg and raised it by
    0.22 m: smallest time to spare 0.33 s to 0.43 s, mean time to spare 3.81 s to 3.74 s."
    """
    n_tried, n_grid = summary["poses_tried"], summary["grid_candidates"]
    if not summary["is_improved"]:
        return [
            f"Refinement tried {n_tried} poses beside the {n_grid} candidates of the grid and "
            "found nothing better."
        ]
    proven = (
        f"No choice among the {n_grid} candidates of the grid is as good: that is proven."
        if summary["grid_is_proven"]
        else f"It is better than the best choice among the {n_grid} candidates of the grid that "
        "was found in the time given."
    )
    return [
        f"Refinement {_and([_deed(move) for move in summary['moves']])}: {_changes(summary)}.",
        f"{proven} The bounds of the refined layout hold for these and the {n_tried} poses tried "
        "beside them, not for every pose in between.",
    ]


def _deed(move: Mapping[str, Any]) -> str:
    """What was done to one unit."""
    if move["is"] is None:
        return f"removed {move['was']}"
    if move["was"] is None:
        return f"added {move['is']}"
    lift_m = move["lift_m"]
    amounts = (
        ("turned", move["turn_deg"], "\N{DEGREE SIGN}"),
        ("tilted", move["tilt_deg"], "\N{DEGREE SIGN}"),
        ("raised" if lift_m > 0.0 else "lowered", abs(lift_m), " m"),
        ("zoomed", move["zoom_deg"], "\N{DEGREE SIGN}"),
    )
    done = [(verb, f"by {number(amount)}{unit}") for verb, amount, unit in amounts if amount]
    name = move["is"] if move["is"] == move["was"] else f"{move['was']} (now {move['is']})"
    (verb, by), *others = done
    return _and([f"{verb} {name} {by}", *(f"{verb} it {by}" for verb, by in others)])


def _changes(summary: Mapping[str, Any]) -> str:
    """Objectives before and after, those that changed."""
    before, after = summary["before"], summary["after"]
    return ", ".join(
        f"{STAGES.get(name, name)} {_from_to(name, before[name], after[name])}"
        for name in before
        if abs(after[name] - before[name])
        > (COST_TOLERANCE_EUR if name == "cost_eur" else TOLERANCE)
    )


def _from_to(name: str, before: float, after: float) -> str:
    """Two values with as many digits as tell them apart."""
    if name in _SHARES and percent(before) != percent(after):
        return f"{percent(before)} to {percent(after)}"
    unit = {"cost_eur": " EUR", "units": "", "weighted": ""}.get(name, " s")
    scale, unit = (100.0, " %") if name in _SHARES else (1.0, unit)
    first = 0 if name in ("cost_eur", "units") else 2
    for digits in range(first, _MAX_DIGITS + 1):
        one, other = number(scale * before, digits), number(scale * after, digits)
        if one != other:
            break
    return f"{one}{unit} to {other}{unit}"


def _and(words: Sequence[str]) -> str:
    if len(words) == 1:
        return words[0]
    return f"{', '.join(words[:-1])} and {words[-1]}"
