"""Fronts and refinements as results have them."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal, cast

import msgspec

from placement.candidates import CandidatePose
from placement.optimiser import PlacementProblem
from placement.optimiser.front import Front, FrontPoint
from placement.optimiser.presolve import PresolveStatistics
from placement.pipeline import pick_layout
from placement.refinement.poses import Move
from placement.refinement.refine import Refinement

from .record import (
    LayoutValueRecord,
    Record,
    StageName,
    StageRecord,
    StageValues,
    UnitRecord,
    build_stage_records,
    build_unit_records,
    says,
)


class RefusedSizeRecord(Record, frozen=True, kw_only=True):
    """A size with which the wishes cannot be met."""

    units: Annotated[int, says("Units.", ge=0)]
    reason: Annotated[str, says("Why, in words.")]


class FrontPointRecord(LayoutValueRecord, frozen=True, kw_only=True):
    """The best layout of a size."""

    units: Annotated[int, says("Units allowed.", ge=0)]
    is_proven: Annotated[bool, says("Whether the gaps of all stages are closed.")]
    stages: Annotated[tuple[StageRecord, ...], says("What was optimised, in order.")]
    solver: Annotated[str, says("What the proof rests on.")]
    layout: Annotated[tuple[UnitRecord, ...], says("The units.")]
    pose_ids: Annotated[tuple[str, ...], says("Names of the candidate poses, in the same order.")]


class FrontRecord(Record, frozen=True, kw_only=True):
    """The best layout of each smaller size, and the gain of each unit."""

    by: Annotated[Literal["units", "cost"], says("What there is more and more of.")]
    optimised: Annotated[
        Literal["first", "all"],
        says("first: APR, and APR if a unit fails; all: margins and cost, too."),
    ]
    candidates: Annotated[int, says("Candidate poses.", ge=0)]
    runs: Annotated[int, says("Runs on the detection table, in all sampled worlds together.", ge=0)]
    fusion: Annotated[Literal["any", "single"], says("As at the top.")]
    kept: Annotated[int, says("Units that are mounted already.", ge=0)]
    settled: Annotated[
        float | None, says("Units, or EUR, from which on nothing grows; null: unknown.")
    ]
    is_proven: Annotated[bool, says("Whether every point is.")]
    presolve: Annotated[
        PresolveStatistics | None, says("Once for all points; null: each was solved by itself.")
    ]
    refused: Annotated[tuple[RefusedSizeRecord, ...], says("Sizes that cannot be.")]
    points: Annotated[tuple[FrontPointRecord, ...], says("In ascending order.")]
    sentences: Annotated[tuple[str, ...], says("What each unit buys, in words.")]


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
    rounds: Annotated[int, says("Rounds of the search.", ge=0)]
    seconds: Annotated[float, says("Time spent, in seconds.", ge=0)]


def build_front_record(
    front: Front,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    *,
    sentences: Sequence[str],
    n_kept: int = 0,
) -> FrontRecord:
    """A front, with the units of every point.

    Parameters
    ----------
    candidates : sequence of CandidatePose
        Rows of the problem's table.
    sentences : sequence of str
        Of what each unit, or more money, buys.
    n_kept : int
        Units that are mounted already.
    """
    return FrontRecord(
        by=front.by,
        optimised=front.stages,
        candidates=problem.table.n_poses,
        runs=problem.table.axis.n_runs,
        fusion=problem.fusion,
        kept=n_kept,
        settled=front.settled,
        is_proven=front.is_proven,
        presolve=front.presolve,
        refused=tuple(RefusedSizeRecord(units=units, reason=why) for units, why in front.refused),
        points=tuple(_point(point, candidates) for point in front.points),
        sentences=tuple(sentences),
    )


def _point(point: FrontPoint, candidates: Sequence[CandidatePose]) -> FrontPointRecord:
    layout = pick_layout(candidates, point.pose_index, f"front-{point.units}")
    return FrontPointRecord(
        units=point.units,
        **point.value._asdict(),
        is_proven=point.is_proven,
        stages=build_stage_records(point.certificate),
        solver=point.certificate.solver,
        layout=build_unit_records(layout),
        pose_ids=tuple(candidates[index].id for index in point.pose_index),
    )


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
        rounds=refinement.n_rounds,
        seconds=refinement.seconds,
    )


def _stage_values(values: Iterable[tuple[str, float]]) -> StageValues:
    return {cast(StageName, name): value for name, value in values}


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
