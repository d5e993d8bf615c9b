"""Retrofit of mounted units.

The best change of every kind, with its price and effect.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Annotated, Literal

from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.junction import compass_bearing_deg
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.scene_sources import load_scene
from placement.candidates import above_ground, build_grid
from placement.compute import Compute
from placement.evaluator.evaluate import with_sight
from placement.layout import Layout, check_layout
from placement.optimiser import PlacementValue, apr, is_better
from placement.pipeline import assemble
from placement.question import Question
from placement.retrofit import (
    Change,
    Labour,
    RetrofitPoses,
    build_retrofit_poses,
    find_retrofit,
    load_labour,
)
from placement.wishes import assumed_prices

from ..export.json import to_json_text
from ..language import localized, mark, tr
from ..progress import StageProgress
from ..results.drives import DrivesRecord, build_drives_record, versions
from ..results.folders import expect_files, save_files
from ..results.numbers import euros, percent
from ..results.record import (
    LayoutValueRecord,
    Record,
    Share,
    StageRecord,
    UnitRecord,
    build_stage_records,
    build_unit_records,
    says,
)
from ..results.tables import records_csv
from .section import Table
from .units import tilt_words

_WORDS_WIDTH = 26
CSV_NAME = "retrofit.csv"
JSON_NAME = "retrofit.json"


class ActionRecord(Record, frozen=True, kw_only=True):
    """An action on one unit."""

    action: Literal["remove", "re-aim", "add"]
    unit: str
    words: str


class RetrofitValueRecord(LayoutValueRecord, frozen=True, kw_only=True):
    """Value of units, for cars that have their own camera too."""

    apr_cars_see: Annotated[
        Share | None,
        says("APR of these units and the cars' own sensors; null: a share of cars."),
    ]


class ChangeRecord(RetrofitValueRecord, frozen=True, kw_only=True):
    """A change, its price, its gains and losses, and the layout afterwards."""

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
    """Possible changes of a layout.

    ``retrofit.json``, and what ``--json`` prints.
    """

    name: str
    layout: tuple[UnitRecord, ...]
    before: RetrofitValueRecord
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
    if len(result.removals) == 1:
        unit = result.removals[0].actions[0].unit
        only = tr(
            "{unit} is the only unit: without it, only the car itself is left.",
            unit=unit,
        )
        sentences.append(only)
    if result.re_aims and not result.re_aims[0].is_better:
        sentences.append(tr("No re-aiming improves the current layout."))
    if result.addition is None and result.budget_eur is None:
        sentences.append(tr("No additional unit improves the current layout."))
    elif result.addition is None:
        none = mark("No additional unit within {price} improves the current layout.")
        sentences.append(tr(none, price=euros(result.budget_eur)))
    if result.budget_eur is not None and result.combination is None:
        sentences.append(
            tr(
                "No combination of re-aiming and additional units improves the current "
                "layout."
            )
        )
    return sentences


def _by_kind(result: RetrofitResult) -> dict[str, list[ChangeRecord]]:
    """Changes by the word that the file has for their kind."""
    return {
        "remove": [*result.removals],
        "re-aim": [*result.re_aims],
        "add": [result.addition] if result.addition else [],
        "combine": [result.combination] if result.combination else [],
    }


def table(result: RetrofitResult) -> Table:
    """Possible changes: a row each, the best of each kind first."""
    rows = [_row(tr("as it is"), 0.0, result.before, "", "")]
    for change in (one for kind in _by_kind(result).values() for one in kind):
        said = "; ".join(action.words for action in change.actions)
        if not change.is_proven:
            said = tr("{change} (open)", change=said)
        first, *others = textwrap.wrap(said, _WORDS_WIDTH)
        counts = str(len(change.gained)), str(len(change.lost))
        rows.append(_row(first, change.price_eur, change, *counts))
        rows += [[f"  {line}", *[""] * 6] for line in others]
    return Table(
        caption=tr("Changes"),
        columns=[
            "",
            "EUR",
            "APR",
            tr("cars see"),
            tr("one fails"),
            tr("gained"),
            tr("lost"),
        ],
        rows=rows,
        numeric=range(1, 7),
    )


def _row(
    text: str, price_eur: float, value: RetrofitValueRecord, *cells: str
) -> list[str]:
    shares = (value.apr, value.apr_cars_see, value.apr_one_failed)
    return [text, localized(f"{price_eur:,.0f}"), *map(percent, shares), *cells]


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

    Parameters
    ----------
    question : Question
        What is driven.
    question : Question
        What may be added, the money for all together, and how it is looked for.
    layout : Layout
        What hangs.
    visit_eur : float, optional
        Of a re-aim or a removal; by default by :func:`placement.retrofit.load_labour`.
        [EUR]
    out : Path, optional
        Folder that gets ``retrofit.csv`` and ``retrofit.json``; what else it holds
        stays.
    compute : Compute
        Seed, threads, cache; its progress is `progress`.
    command : str
        Command line that makes the result again.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        A unit hangs inside something, a word is unknown, or `out` cannot be written.
    """
    scene = load_scene(question.scene)
    expect_files(out, progress)
    check_layout(layout, scene)
    asked = replace(question, budget=None, budget_cost=None)
    plan = assemble(asked, scene=scene, counts_money=True, compute=compute)
    poses = build_retrofit_poses(layout, build_grid(question), plan.candidates)
    wishes = replace(plan.wishes, existing=tuple(unit.id for unit in layout.units))
    plan = replace(plan, candidates=poses.candidates, wishes=wishes)
    setting = plan.setting
    prices = wishes.prices
    problem = plan.problem
    progress(mark("retrofit"), 0, 0)
    if visit_eur is None:
        labour = load_labour()
    else:
        labour = _at_price(visit_eur)
    found = find_retrofit(
        problem,
        poses,
        labour=labour,
        budget_eur=question.budget_cost,
        effort=plan.effort,
    )

    # A share of cars that see is in the APR already.
    seeing = None
    if setting.cars in (0.0, 1.0):
        sighted = with_sight(replace(setting, cars=1.0), compute=compute)
        seeing = replace(problem, seen_by_vut=sighted.seen_by_vut)

    def apr_cars_see(pose_index: Sequence[int]) -> float | None:
        if seeing is None:
            return None
        return apr(seeing, pose_index)

    def record(change: Change) -> ChangeRecord:
        return _change_record(
            change,
            found.before,
            poses,
            scene=scene,
            apr_cars_see=apr_cars_see(change.pose_index),
        )

    result = RetrofitResult(
        name=layout.name,
        layout=build_unit_records(layout, setting.scene),
        before=RetrofitValueRecord(
            **found.before._asdict(), apr_cars_see=apr_cars_see(range(poses.n_units))
        ),
        candidates=len(poses.candidates),
        removals=tuple(record(change) for change in found.removals),
        re_aims=tuple(record(change) for change in found.re_aims),
        addition=None if found.addition is None else record(found.addition),
        combination=None if found.combination is None else record(found.combination),
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
    assumed = () if prices is None else assumed_prices(prices, scene.sites)
    result = replace_fields(result, sentences=(*words(result), *map(tr, assumed)))
    return save_files(
        result,
        out,
        progress,
        lambda done: {
            CSV_NAME: records_csv(change_rows(done)),
            JSON_NAME: to_json_text(done),
        },
    )


def change_rows(result: RetrofitResult) -> list[dict[str, object]]:
    """Fields of each change; the first row is what is mounted.

    Run ids have spaces between.
    """
    before = {
        name: value
        for name, value in fields_of(result.before).items()
        if name != "cost_eur"
    }
    rows: list[dict[str, object]] = [
        {"kind": "as it is", "change": "", "price_eur": 0.0, **before}
    ]
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
        for kind, changes in _by_kind(result).items()
        for change in changes
    ]
    return rows


def _at_price(visit_eur: float) -> Labour:
    """Labour at the user's price."""
    hours = {"travel_h": 0.0, "re_aim_h": 0.0, "remove_h": 0.0}
    per_visit = {"people": 0.0, "wage_eur_per_h": 0.0, "lift_eur": visit_eur}
    return Labour(**per_visit, **hours, source="--visit-cost")


def _change_record(
    change: Change,
    before: PlacementValue,
    poses: RetrofitPoses,
    *,
    scene: Scene,
    apr_cars_see: float | None,
) -> ChangeRecord:
    unit = poses.unit_index
    names = _names(change, poses)
    turned = {
        int(unit[row]): poses.candidates[row].pose for row in names if unit[row] >= 0
    }
    actions = []
    for row in change.removed:
        name = poses.candidates[row].id
        pose = turned.get(row)
        if pose is None:
            words = tr("remove {unit}", unit=name)
            actions.append(ActionRecord(action="remove", unit=name, words=words))
        else:
            words = tr(
                "re-aim {unit} to bearing {bearing}, tilt {tilt}",
                unit=name,
                **_aim_words(pose),
            )
            actions.append(ActionRecord(action="re-aim", unit=name, words=words))
    for row, name in names.items():
        if unit[row] < 0:
            new = poses.candidates[row]
            words = tr(
                "add {unit} at {place}, {height_m:g} m above ground, bearing {bearing},"
                " tilt {tilt} ({sensor})",
                unit=name,
                place=new.site_id or tr("a place of its own"),
                height_m=round(above_ground(new, scene).pose.position_m.item(2), 2),
                sensor=new.sensor.name,
                **_aim_words(new.pose),
            )
            actions.append(ActionRecord(action="add", unit=name, words=words))
    certificate = change.certificate
    mounted = tuple(
        replace(poses.candidates[row], id=names.get(row, poses.candidates[row].id))
        for row in change.pose_index
    )
    return ChangeRecord(
        actions=tuple(actions),
        price_eur=change.price_eur,
        **change.value._asdict(),
        apr_cars_see=apr_cars_see,
        gained=tuple(change.gained),
        lost=tuple(change.lost),
        is_better=is_better(
            change.value._replace(cost_eur=0.0), before._replace(cost_eur=0.0)
        ),
        is_proven=change.is_proven,
        compared=change.n_compared,
        stages=() if certificate is None else build_stage_records(certificate),
        solver=None if certificate is None else certificate.solver,
        layout=(
            build_unit_records(Layout(name="after", units=mounted)) if mounted else ()
        ),
    )


def _names(change: Change, poses: RetrofitPoses) -> dict[int, str]:
    """Names of the poses that come, by row.

    Re-aimed units keep theirs, new ones are numbered.
    """
    taken = {candidate.id for candidate in poses.candidates[: poses.n_units]}
    free = (name for number in count(1) if (name := f"N{number}") not in taken)
    old = {row: int(poses.unit_index[row]) for row in change.added}
    return {
        row: poses.candidates[unit].id if unit >= 0 else next(free)
        for row, unit in old.items()
    }


def _aim_words(pose: Pose) -> dict[str, str]:
    """Direction as the table of units has it: compass bearing, and tilt."""
    bearing = localized(f"{compass_bearing_deg(pose.yaw_deg):.1f}")
    return {"bearing": bearing, "tilt": tilt_words(pose.pitch_deg)}
