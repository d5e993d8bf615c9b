"""What units add, unit by unit: next to a car's own sensors, and without any."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from placement.evaluation import Evaluation, unit_arrivals_s
from placement.setting import Setting
from scenarios.cases import ROAD_USER_GROUPS
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from ..language import tr
from ..results.numbers import in_points, percent
from ..results.record import Record, says
from ..results.tables import groups_by
from .section import Box, Section, Table

MAX_UNITS = 24
"""Of larger layouts units are not told one by one."""


class AddedUnit(Record, frozen=True, kw_only=True):
    """A unit that joins the VUT and the units before it."""

    unit: Annotated[str, says("Its id.")]
    apr: Annotated[float, says("APR with it. 0..1.")]
    gain: Annotated[float, says("How much higher that is than without.")]


class AddedGroup(Record, frozen=True, kw_only=True):
    """What units add in some runs."""

    kind: Annotated[str, says('"all", "case", "position" or "road user".')]
    name: Annotated[str, says("Of the group.")]
    vut: Annotated[
        float | None, says("APR of the VUT alone, 0..1; null: no run has weight.")
    ]
    with_units: Annotated[float | None, says("APR of the VUT with all units.")]
    gain: Annotated[float | None, says("What the units add: the difference.")]


class Added(Record, frozen=True, kw_only=True):
    """What the units of a layout add to a VUT that sees, by the evaluator."""

    groups: Annotated[
        tuple[AddedGroup, ...], says("All runs, then each case, place, road user.")
    ]
    units: Annotated[
        tuple[AddedUnit, ...],
        says(
            "The one first that adds most; empty where there are too many. A run counts"
            " here as avoided where braking sets in before its last moment."
        ),
    ]
    alone: Annotated[
        tuple[AddedUnit, ...],
        says("The same for cars that rely on the roadside alone."),
    ] = ()


def build_added(
    setting: Setting, evaluation: Evaluation, *, fusion: str = "any"
) -> Added:
    """What a layout adds under the fusion that it was chosen with."""
    axis = evaluation.axis
    own = evaluation.vut.is_avoided
    together = evaluation.vut_and_rsus.is_avoided
    if fusion == "single":
        each = np.array([unit.is_avoided for unit in evaluation.units.values()])
        together = own | each.any(axis=0)
    met = np.array([run.road_user for run in setting.runs])
    groups: list[tuple[str, str, BoolArray]] = [
        ("all", "all runs", np.ones(len(met), dtype=bool))
    ]
    for kind, found in (
        ("case", groups_by(axis, "case")),
        ("position", groups_by(axis, "position")),
        (
            "road user",
            [(name, met == name) for name in ROAD_USER_GROUPS if name in met],
        ),
    ):
        groups += [(kind, name, mask) for name, mask in found if len(found) > 1]

    def group(kind: str, name: str, mask: BoolArray) -> AddedGroup:
        weight = axis.weight * mask
        alone = None
        both = None
        gain = None
        if weight.any():
            alone = weight_share(own, weight)
            both = weight_share(together, weight)
            gain = both - alone
        return AddedGroup(kind=kind, name=name, vut=alone, with_units=both, gain=gain)

    rule = setting.rule
    own_s = np.where(evaluation.vut.detected, axis.time_s + rule.latency_s, np.inf)
    # Cars that rely on the roadside detect nothing by themselves.
    blind_s = np.full(own_s.shape, np.inf)
    return Added(
        groups=tuple(group(*one) for one in groups),
        units=_one_by_one(setting, evaluation, fusion, own_s),
        alone=_one_by_one(setting, evaluation, fusion, blind_s),
    )


def _one_by_one(
    setting: Setting, evaluation: Evaluation, fusion: str, own_s: FloatArray
) -> tuple[AddedUnit, ...]:
    """Units in the order of greedy choice.

    `own_s` (n_runs, n_frames) are the times at which the car's own detections arrive,
    in seconds; infinite where it has none.
    """
    axis = evaluation.axis
    rule = setting.rule
    names = [unit.id for unit in evaluation.layout.units]
    if len(names) > MAX_UNITS or not axis.weight.any():
        return ()
    arrivals_s = unit_arrivals_s(evaluation, rule)

    def in_time(arrival_s: FloatArray) -> BoolArray:
        return find_onsets(arrival_s, axis, rule=rule).is_in_time

    avoided = in_time(own_s)
    before = weight_share(avoided, axis.weight)
    left = list(range(len(names)))
    found = []
    while left:
        if fusion == "single":
            with_each = [avoided | in_time(arrivals_s[unit]) for unit in left]
        else:
            with_each = [in_time(np.minimum(own_s, arrivals_s[unit])) for unit in left]
        shares = [weight_share(each, axis.weight) for each in with_each]
        # Of equal ones the first.
        place = int(np.argmax(shares))
        apr = shares[place]
        unit = left.pop(place)
        found.append(AddedUnit(unit=names[unit], apr=apr, gain=apr - before))
        avoided = with_each[place]
        before = apr
        own_s = np.minimum(own_s, arrivals_s[unit])
    return tuple(found)


def section(record: Added | None) -> Section | None:
    """What the units add, one after the other, for both kinds of cars.

    None where that is not known, or they are many.
    """
    if record is None or not record.units:
        return None
    seeing = _unit_table(
        tr("For cars with their own sensors, the most useful unit first"), record.units
    )
    blind = _unit_table(
        tr("For cars that rely on the roadside alone, the most useful unit first"),
        record.alone,
    )
    return Section("added", tr("What the units add"), [Box("beside", [blind, seeing])])


def _unit_table(caption: str, units: Sequence[AddedUnit]) -> Table:
    return Table(
        caption=caption,
        columns=[tr("unit"), tr("APR with it"), tr("adds (points)")],
        rows=[[unit.unit, percent(unit.apr), in_points(unit.gain)] for unit in units],
        numeric=(1, 2),
    )
