"""What each junction of a city gets, and what there is to say of it."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from placement.city.choose import CityChoice, choose, city_front
from placement.city.fronts import Options, stack_bounds, stack_fronts
from placement.city.phases import Phases, plan_phases
from placement.layout import Layout
from placement.optimiser.steering import TOLERANCE
from placement.question import Question

from ..results.city import (
    FRONT,
    JUNCTIONS,
    CityFrontRecord,
    CityJunctionRecord,
    CityPointRecord,
    CityResult,
    CitySearchRecord,
    CityStepRecord,
    load_front,
)
from ..results.numbers import euros, percent, several
from ..results.record import StageRecord, build_stage_records
from .city_inputs import City, CityJunction, CitySearch, CityValues, CityWish

_CHOICE_S = 120.0
_MAX_STEPS = 200


def choose_for_city(
    out: Path,
    city: City,
    values: CityValues,
    done: dict[str, CityFrontRecord],
    *,
    question: Question,
    wish: CityWish,
    search: CitySearch,
    kept: dict[str, Layout],
) -> CityResult:
    """Choose a point of each junction's front; `done` has the fronts by their folders."""
    records = [done[one.folder] for one in city.junctions]
    solved = [index for index, record in enumerate(records) if not record.reason]
    if not solved:
        # One that another try could mend says what to change.
        failed = min(records, key=lambda record: record.is_final)
        told = f"no junction with a front; {failed.name or failed.id}: {failed.reason}"
        raise InputError(
            city.records[0].name,
            Unquoted(told),
            "one at which runs can be laid and sites can carry units"
            if failed.is_final
            else "more time or memory for each: --max-junction-seconds, --worker-memory",
        )
    weight = values.weight[solved]
    if not weight.sum() > 0.0:
        raise InputError(
            "--junction-weights",
            Unquoted("weights only of junctions that have no front"),
            "a weight above 0 for one that has",
        )
    fronts = [records[index].front for index in solved]
    options = stack_fronts(fronts)
    asked = values.wishes(wish, solved)
    choice = choose(
        options,
        weight,
        asked,
        bounds=stack_bounds(
            fronts,
            counts_units=asked.budget_units is not None,
            counts_cost=asked.budget_eur is not None,
        ),
        names=[city.junctions[index].label for index in solved],
        gap=search.gap,
        time_limit_s=_CHOICE_S,
    )
    first = np.flatnonzero(np.diff(options.junction, prepend=-1))
    share = weight / weight.sum()
    phases = _phases(options, choice, first, share, wish)
    by_cost = wish.budget_eur is not None
    got = {index: row for row, index in enumerate(solved)}
    total = values.weight.sum()
    junctions = []
    for index, (one, record) in enumerate(zip(city.junctions, records, strict=True)):
        x, y = (float(value) for value in one.surveyed.position)
        answer = CityJunctionRecord(
            id=one.surveyed.junction.id,
            name=one.surveyed.junction.name,
            map=one.roads.name,
            folder=f"{JUNCTIONS}/{one.folder}",
            x=x,
            y=y,
            weight=float(values.weight[index] / total),
            district=values.district_of(index),
            reason=record.reason,
        )
        if index in got:
            row, before = int(choice.rows[got[index]]), int(first[got[index]])
            chosen = record.points[row - before]
            if chosen.units or one.scene_name in kept:
                chosen = _with_layout(out, one, row - before)
            answer = msgspec.structs.replace(
                answer,
                units=chosen.units,
                cost_eur=chosen.cost_eur,
                apr_before=record.points[0].apr,
                apr=chosen.apr,
                apr_one_failed=chosen.apr_one_failed,
                layout=chosen.layout,
                kept=len(chosen.layout) - chosen.units,
                year=0 if phases is None else int(phases.year[got[index]]),
            )
        junctions.append(answer)
    steps = city_front(options, weight, by_cost=by_cost)
    stages = build_stage_records(choice.certificate)
    result = CityResult(
        command="",
        maps=city.records,
        budget_units=wish.budget_units,
        budget_eur=wish.budget_eur,
        weights=values.told,
        units=sum(one.units for one in junctions),
        cost_eur=sum(one.cost_eur for one in junctions),
        apr_before=float(share @ options.apr[first]),
        stages=stages,
        bound_of_fronts=choice.bound_of_points,
        solver=choice.certificate.solver,
        is_proven=choice.certificate.is_proven,
        junctions=tuple(junctions),
        not_done=len(records) - len(solved),
        computed=0,
        by="cost" if by_cost else "units",
        front=tuple(
            CityStepRecord(
                junction=city.junctions[solved[step.junction]].label,
                units=int(options.units[step.row]),
                taken=step.taken,
                apr=step.apr,
            )
            for step in steps[:_MAX_STEPS]
        ),
        cheapest=_cheapest(city, options, solved, share, first),
        gain_years=None if phases is None else phases.gain_years,
        purchases=(),
        search=CitySearchRecord(
            poses="coarse" if search.is_coarse else "fine",
            max_units=search.max_units,
            max_junction_seconds=search.max_junction_s,
            radius_m=search.radius_m,
            sites=search.sites,
        ),
        sentences=(),
        notes=(*city.notes, *values.notes),
        seconds={},
        versions={},
    )
    return msgspec.structs.replace(result, sentences=_sentences(result, wish, phases))


def _with_layout(out: Path, one: CityJunction, index: int) -> CityPointRecord:
    """A point of a junction's front as it stands in the folder."""
    path = out / JUNCTIONS / one.folder / FRONT
    record = load_front(path)
    if record is None or index >= len(record.points):
        raise InputError(str(path), Unquoted("a file that has changed"), "what was written")
    return record.points[index]


def _phases(
    options: Options, choice: CityChoice, first: IntArray, share: FloatArray, wish: CityWish
) -> Phases | None:
    if wish.units_per_year is None:
        return None
    gain = share * (options.apr[choice.rows] - options.apr[first])
    return plan_phases(
        options.units[choice.rows],
        np.maximum(gain, 0.0),
        units_per_year=wish.units_per_year,
        years=wish.years,
    )


def _cheapest(
    city: City,
    options: Options,
    solved: Sequence[int],
    share: FloatArray,
    first: IntArray,
) -> str:
    """What the cheapest useful option costs and buys."""
    gain = share[options.junction] * (options.apr - options.apr[first][options.junction])
    useful = np.flatnonzero(gain > TOLERANCE)
    if not len(useful):
        return "No unit at any junction prevents anything."
    order = np.lexsort((-gain[useful], options.units[useful], options.cost_eur[useful]))
    best = int(useful[order[0]])
    one = city.junctions[solved[int(options.junction[best])]]
    return (
        f"The cheapest useful choice is {several(int(options.units[best]), 'unit', 'units')} at "
        f"{one.label} for {euros(options.cost_eur[best])}: it would prevent "
        f"{percent(float(gain[best]))} of the city's accidents."
    )


def _sentences(result: CityResult, wish: CityWish, phases: Phases | None) -> tuple[str, ...]:
    """What matters, the first line first of all."""
    apr = result.stages[0]
    served = sum(one.units > 0 for one in result.junctions)
    n_fronts = len(result.junctions) - result.not_done
    of_all = sum(one.weight * one.apr for one in result.junctions)
    head = (
        f"{several(result.units, 'unit', 'units')} at {served} of {len(result.junctions)} "
        f"junctions for {euros(result.cost_eur)}: {percent(of_all)} of the accidents at all of "
        "them are prevented"
    )
    if result.units == 0:
        budget = (
            several(result.budget_units or 0, "unit", "units")
            if result.budget_eur is None
            else euros(result.budget_eur)
        )
        head = f"Nothing at {several(n_fronts, 'junction', 'junctions')} for at most {budget}"
    if result.not_done:
        head += f"; {several(result.not_done, 'junction is', 'junctions are')} not done"
    lines = [head + "."]
    if result.units == 0:
        lines.append(result.cheapest)
    lines.append(_proof(apr, result.bound_of_fronts))
    if result.apr_before > 0.0:
        lines.append(
            f"What hangs there already prevents {percent(result.apr_before)} of the accidents."
        )
    if phases is not None:
        n_years = int(phases.year.max(initial=0))
        lines.append(
            f"At most {wish.units_per_year} units a year: all hang after "
            f"{several(n_years, 'year', 'years')}, those that gain most per unit first"
            + (" (proven)." if phases.bound <= phases.gain_years else ".")
        )
    if result.not_done:
        lost = sum(one.weight for one in result.junctions if one.reason)
        lines.append(
            f"Junctions that are not done have {percent(lost)} of the accidents and count as if "
            f"nothing were prevented there; of those at the others {percent(apr.objective)} are "
            "prevented. The table says why."
        )
    return tuple(lines)


def _proof(apr: StageRecord, of_fronts: float) -> str:
    if apr.gap == 0.0:
        return (
            "Proven: no other units for the same budget, at these sites and in these poses, "
            "prevent more."
        )
    bound = percent(apr.bound)
    if of_fronts <= apr.objective + TOLERANCE:
        return (
            f"No choice prevents more than {bound}; among the layouts found this choice is the "
            "best one, what is open are the fronts of the junctions."
        )
    return (
        f"No choice prevents more than {bound}, none among the layouts found more than "
        f"{percent(of_fronts)}."
    )
