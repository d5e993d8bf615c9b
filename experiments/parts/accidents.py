"""Accidents prevented: APR of every sensing party, and of each unit alone."""

from collections.abc import Mapping, Sequence

import numpy as np

from geometry.catalogue import sensor_kind
from placement.evaluation import Evaluation, Verdict, apr, apr_by_case, detected_share
from placement.layout import Layout
from scenarios.runs import FrameAxis

from ..figures.axes import unit_labels
from ..results.numbers import percent, several
from ..results.tables import groups_by
from .section import Block, Section, Table

MAX_UNIT_COLUMNS = 24
"""Of more units, each is a row of the table of units by themselves."""
_MAX_FLAT_ROWS = 40  # a longer table is to unfold


def is_weighted(axis: FrameAxis) -> bool:
    """Some runs count more than others."""
    return not np.allclose(axis.weight, axis.weight[0], rtol=1.0e-9, atol=0.0)


def count_sensors(layout: Layout) -> str:
    """'1 camera', '2 cameras and 1 LiDAR' and so on."""
    kinds = [sensor_kind(unit.sensor) for unit in layout.units]
    return " and ".join(
        several(kinds.count(kind), one, many)
        for kind, one, many in (("camera", "camera", "cameras"), ("lidar", "LiDAR", "LiDARs"))
        if kind in kinds
    )


def accidents_section(evaluations: Mapping[str, Evaluation], *, is_optimised: bool) -> Section:
    """The accident prevention ratio of every sensing party; the first evaluation is the subject."""
    axis = next(iter(evaluations.values())).axis
    by_weight = ", by weight," if is_weighted(axis) else ""
    apart = "; it does not use the detection table" if is_optimised else ""
    meaning = (
        f"The accident prevention ratio (APR) is the share of the runs{by_weight} in which the car "
        "brakes early enough not to touch the pedestrian or cyclist. The numbers below come from "
        "the evaluator, which renders every camera's image and every LiDAR's scan frame by "
        f"frame{apart}."
    )
    blocks: list[Block] = [meaning, apr_table(evaluations), *apr_group_tables(evaluations)]
    return Section("accidents", "Accidents prevented", blocks)


def alone_section(detailed: Mapping[str, Evaluation]) -> Section:
    """APR of each unit of some layouts by itself."""
    tables = [unit_apr_table(name, item) for name, item in detailed.items()]
    return Section("alone", "What each unit achieves alone", tables)


def apr_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """APR of every sensing party; evaluations on the same runs, the first one is the subject.

    A row for all runs, each case, and each weather where there are several. A column per layout,
    for the car alone and with each layout; and where road users announce themselves.
    """
    axis = next(iter(evaluations.values())).axis
    parties = _parties(evaluations)
    return Table(
        caption=f"Accident prevention ratio by {_groups(axis, 'and')}",
        columns=[_groups(axis, "or"), *parties],
        rows=_apr_rows([*parties.values()], axis),
        numeric=range(1, 1 + len(parties)),
    )


def apr_group_tables(evaluations: Mapping[str, Evaluation]) -> list[Table]:
    """APR of these parties by speed, direction and position, where there are several."""
    axis, parties = next(iter(evaluations.values())).axis, _parties(evaluations)
    along = groups_by(axis, "position")
    groupings = [
        ("speed of the car", "speed (km/h)", groups_by(axis, "speed")),
        ("direction from which the car comes", "from", groups_by(axis, "direction")),
        ("place along the arms, in metres before (-) or behind (+) the junction", "at", along),
    ]
    return [
        Table(
            caption=f"Accident prevention ratio by {words}",
            columns=[head, *parties],
            rows=[
                [group, *(percent(apr(verdict, axis, mask)) for verdict in parties.values())]
                for group, mask in groups
            ],
            numeric=range(1, 1 + len(parties)),
        )
        for words, head, groups in groupings
        if len(groups) > 1
    ]


def _parties(evaluations: Mapping[str, Evaluation]) -> dict[str, Verdict]:
    """Columns of a table of APR, by their heads."""
    subject = next(iter(evaluations.values()))
    layouts = evaluations.items()
    parties = {f"{name}: {count_sensors(item.layout)}": item.rsu_all for name, item in layouts}
    parties |= {"car (VUT) alone": subject.vut}
    parties |= {f"car (VUT) and {name}": item.vut_and_rsus for name, item in layouts}
    # Who announces themselves does not depend on the layout.
    if "vam" in subject.others:
        parties["road users' messages (VAM) alone"] = subject.others["vam"]
    return parties | {
        f"car (VUT), {name} and VAM": item.others["all_sources"]
        for name, item in layouts
        if "all_sources" in item.others
    }


def unit_apr_table(name: str, evaluation: Evaluation) -> Table:
    """APR of each unit of a layout by itself, with the rows of :func:`apr_table`.

    The last row: in what share of the frames the unit detects. Of more than ``MAX_UNIT_COLUMNS``
    units each is a row instead, the best first; a long table is to unfold.
    """
    labels, axis = unit_labels(evaluation.layout), evaluation.axis
    units, verdicts = evaluation.units.items(), [*evaluation.units.values()]
    detected = [percent(detected_share(verdict, axis)) for verdict in verdicts]
    columns = [_groups(axis, "or"), *(labels[unit_id] for unit_id, _ in units)]
    caption = f"APR of each unit of {name} by itself"
    rows = [*_apr_rows(verdicts, axis), ["frames in which it detects", *detected]]
    if len(labels) > MAX_UNIT_COLUMNS:
        caption += ", best first"
        columns = ["unit", *(row[0] for row in rows)]
        of_units = zip(units, zip(*(row[1:] for row in rows), strict=True), strict=True)
        best_first = sorted(  # stable: as in the layout where two are alike
            of_units,
            key=lambda pair: (apr(pair[0][1], axis), detected_share(pair[0][1], axis)),
            reverse=True,
        )
        rows = [[labels[unit_id], *cells] for (unit_id, _), cells in best_first]
    return Table(
        caption=caption,
        columns=columns,
        rows=rows,
        numeric=range(1, len(columns)),
        summary=caption if len(rows) > _MAX_FLAT_ROWS else "",
    )


def _groups(axis: FrameAxis, conjunction: str) -> str:
    return f"case {conjunction} weather" if several_weathers(axis) else "case"


def several_weathers(axis: FrameAxis) -> list[str]:
    """The weathers in the order in which they first appear; none where all runs have the same."""
    weathers = list(dict.fromkeys(axis.weathers))
    return weathers if len(weathers) > 1 else []


def _apr_rows(verdicts: Sequence[Verdict], axis: FrameAxis) -> list[list[str]]:
    of_weather = np.array(axis.weathers)
    by_case = [apr_by_case(verdict, axis) for verdict in verdicts]
    rows = [["all runs", *(percent(apr(verdict, axis)) for verdict in verdicts)]]
    for case in dict.fromkeys(axis.cases):
        rows.append([case, *(percent(shares[case]) for shares in by_case)])
    for weather in several_weathers(axis):
        shares = (apr(verdict, axis, of_weather == weather) for verdict in verdicts)
        rows.append([f"weather: {weather}", *map(percent, shares)])
    return rows
