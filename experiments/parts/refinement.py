"""Gains of refinement between the poses of the grid, in sentences."""

from collections.abc import Mapping
from typing import Annotated, cast

import msgspec

from placement.optimiser.problem import Objective
from placement.refinement import Move, Refinement

from ..results.numbers import joined, number, percent
from ..results.record import (
    Record,
    StageName,
    StageValues,
    says,
)


class MoveRecord(Record, frozen=True, kw_only=True):
    """Change of a unit by refinement; null where it is not at the same place."""

    was: Annotated[str | None, says("Id before; null: it is new.")]
    is_: Annotated[str | None, says("Id after; null: it is gone.")] = msgspec.field(name="is")
    is_same_place: Annotated[
        bool, says("Whether the same sensor is at the same place, maybe higher or lower.")
    ]
    turn_deg: Annotated[float | None, says("Change of the yaw, in degrees, counter-clockwise.")]
    tilt_deg: Annotated[float | None, says("Change of the pitch, in degrees, up.")]
    lift_m: Annotated[float | None, says("Change of the height, in metres, up.")]
    zoom_deg: Annotated[float | None, says("Change of the field of view, in degrees.")]


class RefinementRecord(Record, frozen=True, kw_only=True):
    """Search between the poses of the grid."""

    is_improved: Annotated[bool, says("Whether it found anything better.")]
    before: Annotated[StageValues, says("Of the best layout of the grid.")]
    after: Annotated[StageValues, says("Of the refined layout.")]
    moves: Annotated[tuple[MoveRecord, ...], says("What became of the units that changed.")]
    grid_candidates: Annotated[int, says("Candidate poses of the grid.", ge=0)]
    grid_is_proven: Annotated[bool, says("Whether the grid's layout is proven best.")]
    poses_tried: Annotated[int, says("Poses between those of the grid.", ge=0)]
    seconds: Annotated[float, says("Time spent, in seconds.", ge=0)]


def build_refinement_record(refinement: Refinement) -> RefinementRecord:
    """Changes by the search between the poses of the grid."""
    return RefinementRecord(
        is_improved=refinement.is_improved,
        before=_stage_values(refinement.before),
        after=_stage_values(refinement.after),
        moves=tuple(_move(move) for move in refinement.moves),
        grid_candidates=refinement.unrefined.problem.table.n_poses,
        grid_is_proven=refinement.unrefined.certificate.is_proven,
        poses_tried=refinement.n_tried,
        seconds=refinement.seconds,
    )


def _stage_values(values: Mapping[Objective, float]) -> StageValues:
    return {cast(StageName, name): value for name, value in values.items()}


def _move(move: Move) -> MoveRecord:
    is_same = move.is_same_place
    return MoveRecord(
        was=None if move.before is None else move.before.id,
        is_=None if move.after is None else move.after.id,
        is_same_place=is_same,
        turn_deg=move.turn_deg if is_same else None,
        tilt_deg=move.tilt_deg if is_same else None,
        lift_m=move.lift_m if is_same else None,
        zoom_deg=move.zoom_deg if is_same else None,
    )


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
