"""What a layout misses, and what refinement changed.

Sentences, tables, sections.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, cast

import msgspec

from placement.candidates import CandidatePose
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.explain.contributions import NextUnit
from placement.explain.unavoided import Cause, Reason, Unavoided, find_unavoided
from placement.optimiser.problem import Objective
from placement.pipeline import Placement
from placement.refinement import Move, Refinement
from placement.setting import Setting

from ..language import mark, tr, trn
from ..results.numbers import NOTHING, count_runs, joined, number, percent, points
from ..results.record import (
    Record,
    StageName,
    StageValues,
    says,
)
from .section import Block, Section, Table, tabulate

_MAX_REASONS = 2
# Rows of a table that is unfolded from the start.
_MAX_UNFOLDED = 12
_MAX_DIGITS = 6


class ExplainedRecord(Record, frozen=True, kw_only=True):
    """What the units miss, and why, on the detection table.

    Runs of weight 0 do not count.
    """

    not_avoided: Annotated[
        tuple[Unavoided, ...], says("Runs not avoided, in their order.")
    ]
    runs_without_weight: Annotated[
        int, says("How many are left out with weight 0.", ge=0)
    ]


def build_explained_record(
    placement: Placement,
    setting: Setting,
    candidates: Sequence[CandidatePose],
    *,
    compute: Compute = DEFAULT_COMPUTE,
) -> ExplainedRecord:
    """Explanation of a placement; `candidates` are the rows of its table.

    Runs that are not avoided are those of the world as planned; where worlds were
    sampled, nobody looks for what would save them.
    """
    chosen = placement.pose_index
    nominal = placement.nominal
    table = placement.problem.table
    names = {
        table.pose_ids[pose]: unit.id
        for pose, unit in zip(chosen, placement.layout.units, strict=True)
    }
    is_all = nominal.table.n_poses == table.n_poses
    missed = find_unavoided(
        setting,
        nominal,
        candidates if is_all else [candidates[pose] for pose in chosen],
        placement.nominal_index,
        compute=compute,
    )
    return ExplainedRecord(
        not_avoided=tuple(
            replace(entry, unit=names.get(entry.unit, entry.unit)) for entry in missed
        ),
        runs_without_weight=int((nominal.table.axis.weight == 0.0).sum()),
    )


def missed_sentences(explained: ExplainedRecord) -> list[str]:
    """Sentences on the runs that are not avoided, and on what hides them."""
    missed = explained.not_avoided
    n_without = explained.runs_without_weight
    counts = Counter(entry.outcome for entry in missed)
    outcomes = ", ".join(
        f"{count} {outcome_words(name)}" for name, count in counts.most_common()
    )
    if len(counts) == 1:
        only = "{outcome}" if len(missed) == 1 else mark("all {outcome}")
        outcomes = tr(only, outcome=outcome_words(missed[0].outcome))
    if missed:
        sentences = [
            trn(
                "On the detection table, {n} run is not avoided: {outcomes}.",
                "On the detection table, {n} runs are not avoided: {outcomes}.",
                len(missed),
                outcomes=outcomes,
            )
        ]
    elif n_without:
        sentences = [tr("On the detection table, every run that counts is avoided.")]
    else:
        sentences = [tr("On the detection table, every run is avoided.")]
    if n_without:
        left_out = mark("Left out: {runs} of weight 0.")
        sentences.append(tr(left_out, runs=count_runs(n_without)))
    return [*sentences, *causes_and_remedies(missed)]


def causes_and_remedies(missed: Sequence[Unavoided]) -> list[str]:
    """Why runs are missed most often, and what a further unit would save."""
    sentences = []
    causes = Counter(cause(entry.reasons[0]) for entry in missed if entry.reasons)
    if causes:
        words, n_runs = causes.most_common(1)[0]
        if len(missed) == 1:
            sentences.append(tr("The main cause: {cause}.", cause=words))
        elif len(causes) == 1 or n_runs > 1:
            # Else each run has a cause of its own.
            most = mark("The most frequent cause: {cause}, in {runs}.")
            sentences.append(tr(most, cause=words, runs=count_runs(n_runs)))
    n_saved = sum(entry.rescue is not None for entry in missed)
    if n_saved and n_saved == len(missed):
        sentences.append(
            trn(
                "It could be avoided with one more unit.",
                "Each of them could be avoided with one more unit.",
                n_saved,
            )
        )
    elif n_saved:
        sentences.append(
            trn(
                "{n} run could be avoided with one more unit.",
                "{n} runs could each be avoided with one more unit.",
                n_saved,
            )
        )
    return sentences


_CAUSES: dict[Cause, str] = {
    "hidden": mark("hidden by {thing}"),
    "out of view": mark("out of view"),
    "cut off": mark("cut off by the edge of the view"),
    "too dark": mark("too little contrast in light and weather"),
    "too far": mark("road user too small in the image, or too little of it visible"),
    "otherwise": mark("not detected on the table"),
}
_OUTCOMES = {
    "hopeless": mark("too short for any unit"),
    "never seen": mark("never seen"),
    "never confirmed": mark("seen, but never long enough"),
    "lost again": mark("confirmed, but lost again before the last moment"),
    "too late": mark("confirmed too late"),
}


def cause(reason: Reason) -> str:
    """Why a unit does not detect the road user, in words."""
    return tr(_CAUSES[reason.cause], thing=tr(reason.thing))


def outcome_words(outcome: str) -> str:
    """How a run ends that is not avoided, in words."""
    return tr(_OUTCOMES[outcome])


def missed_table(explained: ExplainedRecord) -> Table:
    """Runs that are not avoided, why, and what would save them.

    A row each, to unfold.
    """
    n_runs = len(explained.not_avoided)
    return tabulate(
        tr("Runs that are not avoided, on the detection table"),
        explained.not_avoided,
        {
            tr("run"): lambda entry: entry.run,
            tr("outcome"): lambda entry: (
                tr("confirmed too late, by {late} s", late=number(entry.late_s))
                if entry.outcome == "too late"
                else outcome_words(entry.outcome)
            ),
            tr("why"): _why,
            tr("nearest additional unit that would avoid it"): _rescue,
        },
        summary=trn(
            "{n} run: why, and what would avoid it",
            "{n} runs: why, and what would avoid them",
            n_runs,
        ),
        is_open=n_runs <= _MAX_UNFOLDED,
    )


def _why(entry: Unavoided) -> str:
    if entry.outcome == "hopeless":
        return tr("the road user appears too late to be confirmed in time")
    seen = mark("{cause} in {n} of {n_frames} frames")
    reasons = "; ".join(
        tr(seen, cause=cause(reason), n=reason.frames, n_frames=entry.frames_in_time)
        for reason in entry.reasons[:_MAX_REASONS]
    )
    if not reasons:
        return tr("seen, but with gaps")
    return tr("for {unit}: {reasons}", unit=entry.unit, reasons=reasons)


def _rescue(entry: Unavoided) -> str:
    rescue = entry.rescue
    if rescue is None:
        return NOTHING
    spare = number(rescue.margin_s)
    away = number(rescue.distance_m, 1)
    where = mark("{unit}, {away} m away, {spare} s to spare")
    if rescue.distance_m == 0.0:
        where = mark("{unit}, at the same mount, {spare} s to spare")
    return tr(where, unit=rescue.unit, away=away, spare=spare)


def missed_section(explained: ExplainedRecord) -> Section:
    """What the poses miss, and why."""
    missed: list[Block] = [" ".join(missed_sentences(explained))]
    if explained.not_avoided:
        missed += [
            missed_table(explained),
            tr(
                "Reasons are those of the nearest unit that looks towards the road "
                "user, in frames early enough to brake. “Hidden by” names the object "
                "that most blocked rays hit first; without it, the road user would be "
                "detected. An additional unit is one more of the candidate poses, "
                "next to those chosen; its price is ignored."
            ),
        ]
    return Section("missed", tr("Runs that are not avoided"), missed)


class MoveRecord(Record, frozen=True, kw_only=True):
    """Change of a unit by refinement; null where it is not at the same place."""

    was: Annotated[str | None, says("Id before; null: it is new.")]
    is_: Annotated[str | None, says("Id after; null: it is gone.")] = msgspec.field(
        name="is"
    )
    is_same_place: Annotated[bool, says("The same sensor, at most higher or lower.")]
    turn_deg: Annotated[
        float | None, says("Change of the yaw, in degrees, counter-clockwise.")
    ]
    tilt_deg: Annotated[float | None, says("Change of the pitch, in degrees, up.")]
    lift_m: Annotated[float | None, says("Change of the height, in metres, up.")]
    zoom_deg: Annotated[float | None, says("Change of the field of view, in degrees.")]


class RefinementRecord(Record, frozen=True, kw_only=True):
    """Search between the poses of the grid."""

    is_improved: Annotated[bool, says("Whether it found anything better.")]
    before: Annotated[StageValues, says("Of the best layout of the grid.")]
    after: Annotated[StageValues, says("Of the refined layout.")]
    moves: Annotated[
        tuple[MoveRecord, ...], says("What became of the units that changed.")
    ]
    grid_candidates: Annotated[int, says("Candidate poses of the grid.", ge=0)]
    grid_is_proven: Annotated[bool, says("Whether the grid's layout is proven best.")]
    poses_tried: Annotated[int, says("Poses between those of the grid.", ge=0)]
    seconds: Annotated[float, says("Time spent, in seconds.", ge=0)]


def build_refinement_record(refinement: Refinement) -> RefinementRecord:
    """Changes by the search between the poses of the grid."""
    return RefinementRecord(
        is_improved=refinement.is_improved,
        before={
            cast(StageName, name): value for name, value in refinement.before.items()
        },
        after={
            cast(StageName, name): value for name, value in refinement.after.items()
        },
        moves=tuple(_move(move) for move in refinement.moves),
        grid_candidates=refinement.unrefined.problem.table.n_poses,
        grid_is_proven=refinement.unrefined.certificate.is_proven,
        poses_tried=refinement.n_tried,
        seconds=refinement.seconds,
    )


def _move(move: Move) -> MoveRecord:
    names = ("turn_deg", "tilt_deg", "lift_m", "zoom_deg")
    return MoveRecord(
        was=None if move.before is None else move.before.id,
        is_=None if move.after is None else move.after.id,
        is_same_place=move.is_same_place,
        **{name: getattr(move, name) if move.is_same_place else None for name in names},
    )


def refinement_sentences(found: RefinementRecord) -> list[str]:
    """What refinement changed, and what is proven of it.

    Of one unit at the study's junction: "Refinement turned U1 by -6.94 deg and raised
    it by 0.22 m: smallest time to spare 0.33 s to 0.43 s, mean time to spare 3.81 s to
    3.74 s."
    """
    n_tried = found.poses_tried
    n_grid = found.grid_candidates
    if not found.is_improved:
        return [
            tr(
                "Refinement tried {n} poses between the {n_grid} candidates of "
                "the grid and found nothing better.",
                n=n_tried,
                n_grid=n_grid,
            )
        ]
    better = tr(
        "It is better than the best choice found in time among the {n} grid "
        "candidates.",
        n=n_grid,
    )
    if found.grid_is_proven:
        better = tr(
            "Proven: no choice among the {n} grid candidates is as good.",
            n=n_grid,
        )
    deeds = joined([_deed(move) for move in found.moves])
    bounds = tr(
        "The bounds of the refined layout hold for these and the {n} poses tried "
        "between them, but not for every possible pose.",
        n=n_tried,
    )
    return [
        tr("Refinement {deeds}: {changes}.", deeds=deeds, changes=_changes(found)),
        f"{better} {bounds}",
    ]


_DEEDS = {
    "turned": mark("turned {unit} by {amount}°"),
    "tilted": mark("tilted {unit} by {amount}°"),
    "raised": mark("raised {unit} by {amount} m"),
    "lowered": mark("lowered {unit} by {amount} m"),
    "zoomed": mark("zoomed {unit} by {amount}°"),
}
_DEEDS_GOING_ON = {
    "turned": mark("turned it by {amount}°"),
    "tilted": mark("tilted it by {amount}°"),
    "raised": mark("raised it by {amount} m"),
    "lowered": mark("lowered it by {amount} m"),
    "zoomed": mark("zoomed it by {amount}°"),
}
"""What else was done to a unit that has been named."""


def _deed(move: MoveRecord) -> str:
    """Words for the change of one unit."""
    if move.is_ is None:
        return tr("removed {unit}", unit=move.was)
    if move.was is None:
        return tr("added {unit}", unit=move.is_)
    lift_m = move.lift_m or 0.0
    amounts = {"turned": move.turn_deg, "tilted": move.tilt_deg}
    amounts |= {
        "raised" if lift_m > 0.0 else "lowered": abs(lift_m),
        "zoomed": move.zoom_deg,
    }
    name = move.is_
    if move.is_ != move.was:
        name = tr("{was} (now {now})", was=move.was, now=move.is_)
    done = [(verb, number(amount)) for verb, amount in amounts.items() if amount]
    return joined(
        [
            tr(
                _DEEDS_GOING_ON[verb] if order else _DEEDS[verb],
                unit=name,
                amount=amount,
            )
            for order, (verb, amount) in enumerate(done)
        ]
    )


def _changes(found: RefinementRecord) -> str:
    """Objectives before and after, those that changed."""
    values = [
        (Objective(name), before, found.after[name])
        for name, before in found.before.items()
    ]
    return ", ".join(
        f"{tr(objective.label)} {_from_to(objective, before, after)}"
        for objective, before, after in values
        if abs(after - before) > objective.tolerance
    )


def _from_to(objective: Objective, before: float, after: float) -> str:
    """Two values with as many digits as tell them apart."""
    is_share = objective.value.startswith("apr")
    if is_share and percent(before) != percent(after):
        return tr("{first} to {last}", first=percent(before), last=percent(after))
    if is_share:
        scale, unit = (100.0, " %")
    else:
        scale, unit = (1.0, f" {objective.unit}".rstrip())
    first = 0 if objective.is_minimised else 2
    for digits in range(first, _MAX_DIGITS + 1):
        one, other = (
            f"{number(scale * value, digits)}{unit}" for value in (before, after)
        )
        if one != other:
            break
    return tr("{first} to {last}", first=one, last=other)


def next_unit_sentence(unit: NextUnit | None) -> str:
    """Gain of one more unit; empty where none fits."""
    if unit is None:
        return ""
    # What rounding leaves.
    if unit.gain < 0.5e-9:
        return tr("One more unit adds nothing in the planning model")
    return tr(
        "One more unit adds {points} in the planning model: {pose}",
        points=points(unit.gain),
        pose=unit.pose,
    )
