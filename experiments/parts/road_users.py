"""Who is protected: accidents prevented by the road user that is met."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation, Verdict, apr, mean_impact_speed_kmh
from placement.setting import Setting
from scenarios.cases import ROAD_USER_GROUPS

from ..language import mark, tr, trn
from ..results.drives import unprotected_cases
from ..results.numbers import finite_or_none, number, percent
from ..results.record import Record, mixed, says
from .section import Block, Section, Table, tabulate

_WHO = {
    "on foot": mark("Pedestrians"),
    "bicycle": mark("Cyclists"),
    "motorcycle": mark("Motorcyclists"),
    "car": mark("Cars"),
}
"""Road users as sentences name them, by the group of ``ROAD_USER_GROUPS``."""


class RoadUserScore(Record, frozen=True, kw_only=True):
    """A sensing party on the runs that meet one group of road users.

    By the evaluator.
    """

    name: Annotated[str, says('Of the layout, or "VUT alone".')]
    runs_avoided: Annotated[int, says("How many runs.")]
    apr: Annotated[
        float | None, says("By weight; None where none of these runs counts.")
    ]
    mean_impact_speed_kmh: Annotated[
        float | None, says("By weight, avoided 0, in km/h; or null.")
    ]


class RoadUserGroup(Record, frozen=True, kw_only=True):
    """Runs in which one group of road users is met."""

    road_user: Annotated[str, says('"on foot", "bicycle", "motorcycle" or "car".')]
    runs: Annotated[int, says("How many.")]
    weight: Annotated[float, says("Their share of the weight of all runs.")]
    parties: Annotated[
        tuple[RoadUserScore, ...], says("The layouts, then the vehicle alone.")
    ]


class RoadUserGroups(Record, frozen=True, kw_only=True):
    """Whose runs count, and who is left out."""

    groups: Annotated[
        tuple[RoadUserGroup, ...], says("At least one, those on foot first.")
    ]
    unprotected: Annotated[
        tuple[str, ...], says("Cases left out (--protect all has them).")
    ] = ()


def build_road_users(
    setting: Setting, evaluations: Mapping[str, Evaluation]
) -> RoadUserGroups:
    """Runs by the road user that is met.

    Evaluations by display name, the subject first.
    """
    first = next(iter(evaluations.values()))
    verdicts = {
        name: (item.rsu_all, item.vut_and_rsus) for name, item in evaluations.items()
    }
    verdicts |= {"VUT alone": (first.vut, first.vut)}
    met = np.array([run.road_user for run in setting.runs])
    axis = first.axis

    def score(name: str, verdict: Verdict, mask: BoolArray) -> RoadUserScore:
        return RoadUserScore(
            name=name,
            runs_avoided=int(verdict.is_avoided[mask].sum()),
            apr=finite_or_none(apr(verdict, axis, mask)),
            mean_impact_speed_kmh=finite_or_none(
                mean_impact_speed_kmh(verdict, axis, mask)
            ),
        )

    groups = []
    for road_user in ROAD_USER_GROUPS:
        mask = met == road_user
        if not mask.any():
            continue
        parties = tuple(
            mixed(score(name, blind, mask), score(name, seeing, mask), first.cars)
            for name, (blind, seeing) in verdicts.items()
        )
        weight = float(axis.weight[mask].sum() / axis.weight.sum())
        n_runs = int(mask.sum())
        groups.append(
            RoadUserGroup(
                road_user=road_user, runs=n_runs, weight=weight, parties=parties
            )
        )
    return RoadUserGroups(
        groups=tuple(groups), unprotected=tuple(unprotected_cases(setting))
    )


def words(record: RoadUserGroups) -> list[str]:
    """Shares prevented by road user, and who is left out.

    None where all runs meet the same and nobody is left out.
    """
    if len(record.groups) < 2 and not record.unprotected:
        return []
    sentences = [
        trn(
            "{road_user}: {share} of {n} run.",
            "{road_user}: {share} of {n} runs.",
            group.runs,
            road_user=tr(_WHO[group.road_user]),
            share=percent(group.parties[0].apr),
        )
        for group in record.groups
    ]
    if record.unprotected:
        sentences.append(
            trn(
                "Left out: {n} case in which a car is hit.",
                "Left out: {n} cases in which a car is hit.",
                len(record.unprotected),
            )
        )
    return sentences


def table(record: RoadUserGroups) -> Table:
    """A row per group and sensing party."""
    return tabulate(
        tr("Accidents prevented by type of road user (evaluator)"),
        [(group, party) for group in record.groups for party in group.parties],
        {
            tr("road user"): lambda row: tr(row[0].road_user),
            tr("runs"): lambda row: str(row[0].runs),
            tr("share of weight"): lambda row: percent(row[0].weight),
            tr("by"): lambda row: tr(row[1].name),
            tr("avoided"): lambda row: str(row[1].runs_avoided),
            "APR": lambda row: percent(row[1].apr),
            tr("mean speed at contact (km/h)"): lambda row: number(
                row[1].mean_impact_speed_kmh, 1
            ),
        },
        numeric=(1, 2, 4, 5, 6),
    )


def section(record: RoadUserGroups | None) -> Section | None:
    """Whose runs count.

    None where all runs meet the same and nobody is left out.
    """
    if record is None or not words(record):
        return None
    blocks: list[Block] = [*words(record)]
    if record.unprotected:
        blocks.append(
            tr(
                "By default, runs with pedestrians, cyclists and motorcyclists count. "
                "Left out because the other party is a car: {cases}. Use --protect all "
                "to count them.",
                cases=", ".join(record.unprotected),
            )
        )
    if len(record.groups) > 1:
        blocks.append(table(record))
    return Section("road-users", tr("Who is protected"), blocks)
