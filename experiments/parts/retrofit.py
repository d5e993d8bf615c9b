"""Retrofit of mounted units: the best change of every kind, with its price and effect."""

import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.scene_files import load_scene
from placement.candidates import CandidatePose, build_grid
from placement.compute import Compute
from placement.layout import Layout, check_layout
from placement.optimiser import PlacementValue, is_better
from placement.pipeline import assemble
from placement.question import Question
from placement.retrofit import (
    Change,
    Labour,
    Retrofit,
    RetrofitPoses,
    build_retrofit_poses,
    find_retrofit,
    load_labour,
)
from placement.setting import Setting
from placement.wishes import assumed_prices

from ..export.json import to_json_text
from ..progress import WRITING, StageProgress
from ..results.drives import DrivesRecord, build_drives_record, versions
from ..results.folders import check_folder, write_files
from ..results.numbers import euros, percent
from ..results.record import (
    LayoutValueRecord,
    Record,
    StageRecord,
    UnitRecord,
    build_stage_records,
    build_unit_records,
)
from ..results.tables import csv_text
from .section import Table

if TYPE_CHECKING:
    import pandas as pd
_WORDS_WIDTH = 32
CSV_NAME, JSON_NAME = "retrofit.csv", "retrofit.json"


class ActionRecord(Record, frozen=True, kw_only=True):
    """An action on one unit."""

    action: Literal["remove", "re-aim", "add"]
    unit: str
    words: str


class ChangeRecord(LayoutValueRecord, frozen=True, kw_only=True):
    """A change, its price, its gains and losses, and what is mounted afterwards and its value."""

    actions: tuple[ActionRecord, ...]
    price_eur: float
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    is_better: bool
    is_proven: bool
    compared: int
    stages: tuple[StageRecord, ...]
    solver: str | None
    layout: tuple[UnitRecord, ...]


class RetrofitResult(DrivesRecord, frozen=True, kw_only=True):
    """Possible changes of a layout: ``retrofit.json``, and what ``--json`` prints."""

    name: str
    layout: tuple[UnitRecord, ...]
    before: LayoutValueRecord
    candidates: int
    removals: tuple[ChangeRecord, ...]
    re_aims: tuple[ChangeRecord, ...]
    addition: ChangeRecord | None
    combination: ChangeRecord | None
    runs: int
    fusion: str
    budget_eur: float | None
    labour: Labour
    command: str
    sentences: tuple[str, ...]
    seconds: dict[str, float]
    versions: dict[str, str]


def words(result: RetrofitResult) -> list[str]:
    """What is not worth changing; the table has all else."""
    sentences = []
    limit = "" if result.budget_eur is None else f" within {euros(result.budget_eur)}"
    if len(result.removals) == 1:
        unit = result.removals[0].actions[0].unit
        sentences.append(f"{unit} is the only unit: without it, only the car itself is left.")
    if result.re_aims and not result.re_aims[0].is_better:
        sentences.append("No re-aim is better than to leave all as it is.")
    if result.addition is None:
        sentences.append(f"No unit that can be added{limit} is better than none.")
    if result.budget_eur is not None and result.combination is None:
        sentences.append("Re-aims and additions together are no better than to leave all as it is.")
    return sentences


def table(result: RetrofitResult) -> Table:
    """Possible changes: a row each, in groups, the best of each kind first."""
    rows = [_row("as it is", 0.0, result.before)]
    for head, changes in (
        ("remove:", result.removals),
        ("re-aim:", result.re_aims),
        ("add:", [result.addition]),
        ("together:", [result.combination]),
    ):
        known = [change for change in changes if change is not None]
        rows += [[head, *[""] * 6]] if known else []
        for change in known:
            first, *others = [
                line
                for action in change.actions
                for line in textwrap.wrap(action.words, _WORDS_WIDTH)
            ]
            counts = str(len(change.gained)), str(len(change.lost))
            proof = "proven" if change.is_proven else "open"
            rows.append(_row(f"  {first}", change.price_eur, change, *counts, proof))
            rows += [[f"  {line}", *[""] * 6] for line in others]
    return Table(
        caption="Changes",
        columns=["", "EUR", "APR", "one fails", "gained", "lost", "proof"],
        rows=rows,
        numeric=range(1, 7),
    )


def _row(
    text: str,
    price_eur: float,
    value: LayoutValueRecord,
    gained: str = "",
    lost: str = "",
    proof: str = "",
) -> list[str]:
    shares = (percent(value.apr), percent(value.apr_one_failed))
    return [text, f"{price_eur:,.0f}", *shares, gained, lost, proof]


def run_retrofit(
    question: Question,
    *,
    layout: Layout,
    visit_eur: float | None,
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> RetrofitResult:
    """Find what to remove, re-aim or add, and write it to `out` if asked to.

    The question says what may be added, the money for all together, and how long to search. A visit
    is by default priced as :func:`placement.retrofit.load_labour` does. Raises InputError if a unit
    is inside something, a word is unknown, or `out` cannot be written.
    """
    scene = load_scene(question.scene)
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"
    check_layout(layout, scene)
    plan = assemble(
        replace(question, budget=None, budget_cost=None),
        scene=scene,
        counts_money=True,
        compute=compute,
    )
    poses = build_retrofit_poses(layout, build_grid(question), plan.candidates)
    wishes = replace(plan.wishes, existing=tuple(unit.id for unit in layout.units))
    plan = replace(plan, candidates=poses.candidates, wishes=wishes)
    setting, prices, problem = plan.setting, wishes.prices, plan.problem
    progress("retrofit", 0, 0)
    labour = load_labour() if visit_eur is None else _at_price(visit_eur)
    retrofit = find_retrofit(
        problem, poses, labour=labour, budget_eur=question.budget_cost, effort=plan.effort
    )
    result = _build_result(
        retrofit, poses, layout, setting, question, labour=labour, command=command
    )
    assumed = () if prices is None else assumed_prices(prices, scene.sites)
    result = replace_fields(result, sentences=(*words(result), *assumed))
    if out is None:
        return replace_fields(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    csv = csv_text(retrofit_table(result))
    result = replace_fields(result, seconds=progress.finish())
    json = to_json_text(result)
    write_files(out, {CSV_NAME: csv.encode(), JSON_NAME: json.encode()})
    progress.kept = f"the results are in {out}"
    return result


def _build_result(
    retrofit: Retrofit,
    poses: RetrofitPoses,
    layout: Layout,
    setting: Setting,
    question: Question,
    *,
    labour: Labour,
    command: str,
) -> RetrofitResult:
    """The result without sentences and seconds."""

    def record(change: Change) -> ChangeRecord:
        return _change_record(change, retrofit.before, poses)

    return RetrofitResult(
        name=layout.name,
        layout=build_unit_records(layout, setting.scene),
        before=LayoutValueRecord(**retrofit.before._asdict()),
        candidates=len(poses.candidates),
        removals=tuple(record(change) for change in retrofit.removals),
        re_aims=tuple(record(change) for change in retrofit.re_aims),
        addition=None if retrofit.addition is None else record(retrofit.addition),
        combination=None if retrofit.combination is None else record(retrofit.combination),
        runs=setting.axis.n_runs,
        fusion=question.fusion,
        budget_eur=question.budget_cost,
        labour=labour,
        command=command,
        **fields_of(build_drives_record(setting)),
        sentences=(),
        seconds={},
        versions=versions(),
    )


def retrofit_table(result: RetrofitResult) -> "pd.DataFrame":
    """A row per change, the first one for what is mounted; run ids have spaces between."""
    before = {name: value for name, value in fields_of(result.before).items() if name != "cost_eur"}
    changes = [
        *(("remove", change) for change in result.removals),
        *(("re-aim", change) for change in result.re_aims),
        *(("add", change) for change in [result.addition] if change is not None),
        *(("combine", change) for change in [result.combination] if change is not None),
    ]
    rows: list[dict[str, object]] = [{"kind": "as it is", "change": "", "price_eur": 0.0, **before}]
    rows += [
        {
            "kind": kind,
            "change": "; ".join(action.words for action in change.actions),
            "price_eur": change.price_eur,
            **{name: getattr(change, name) for name in before},
            "gained": " ".join(change.gained),
            "lost": " ".join(change.lost),
            "is_better": change.is_better,
            "is_proven": change.is_proven,
        }
        for kind, change in changes
    ]
    import pandas as pd

    return pd.DataFrame(rows)


def _at_price(visit_eur: float) -> Labour:
    """Labour at the user's price."""
    return Labour(
        people=0.0,
        wage_eur_per_h=0.0,
        travel_h=0.0,
        lift_eur=visit_eur,
        re_aim_h=0.0,
        remove_h=0.0,
        source="--visit-cost",
    )


def _change_record(change: Change, before: PlacementValue, poses: RetrofitPoses) -> ChangeRecord:
    after = _named(change, poses)
    unit = poses.unit_index
    turned = {int(unit[row]): row for row in change.added if unit[row] >= 0}
    actions = []
    for row in change.removed:
        old = poses.candidates[row]
        if row in turned:
            new = poses.candidates[turned[row]]
            words = f"re-aim {old.id} to yaw {_degrees(new.pose.yaw_deg)}, pitch " + _degrees(
                new.pose.pitch_deg
            )
            actions.append(ActionRecord(action="re-aim", unit=old.id, words=words))
        else:
            actions.append(ActionRecord(action="remove", unit=old.id, words=f"remove {old.id}"))
    for row, name in zip(change.added, _names(change, poses), strict=True):
        if unit[row] < 0:
            words = f"add {name} at {_pose_words(poses.candidates[row])}"
            actions.append(ActionRecord(action="add", unit=name, words=words))
    is_improved = is_better(change.value._replace(cost_eur=0.0), before._replace(cost_eur=0.0))
    certificate = change.certificate
    return ChangeRecord(
        actions=tuple(actions),
        price_eur=change.price_eur,
        **change.value._asdict(),
        gained=tuple(change.gained),
        lost=tuple(change.lost),
        is_better=is_improved,
        is_proven=change.is_proven,
        compared=change.n_compared,
        stages=() if certificate is None else build_stage_records(certificate),
        solver=None if certificate is None else certificate.solver,
        layout=build_unit_records(Layout(name="after", units=after)) if after else (),
    )


def _names(change: Change, poses: RetrofitPoses) -> list[str]:
    """Names of the poses that come: re-aimed units keep theirs, new ones are numbered."""
    taken = {candidate.id for candidate in poses.candidates[: poses.n_units]}
    names: list[str] = []
    number = 0
    for row in change.added:
        unit = int(poses.unit_index[row])
        if unit >= 0:
            names.append(poses.candidates[unit].id)
            continue
        number += 1
        while f"N{number}" in taken:
            number += 1
        names.append(f"N{number}")
    return names


def _named(change: Change, poses: RetrofitPoses) -> tuple[CandidatePose, ...]:
    """Units after a change, under names of its own."""
    names = dict(zip(change.added, _names(change, poses), strict=True))
    return tuple(
        replace(poses.candidates[row], id=names.get(row, poses.candidates[row].id))
        for row in change.pose_index
    )


def _pose_words(candidate: CandidatePose) -> str:
    pose = candidate.pose
    place = candidate.site_id or "a place of its own"
    return (
        f"{place}, {float(pose.position_m[2]):g} m, yaw {_degrees(pose.yaw_deg)}, pitch "
        f"{_degrees(pose.pitch_deg)} ({candidate.sensor.name})"
    )


def _degrees(angle_deg: float) -> str:
    return f"{round(angle_deg, 1) + 0.0:g}"
