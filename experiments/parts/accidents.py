"""Accidents prevented.

APR of every party and unit, what is driven, and how every run ends.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.catalogue import sensor_kind
from geometry.footprints import footprint_corners
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, apr, detected_share, run_outcome
from placement.setting import Setting
from scenarios.cases import Case
from scenarios.positions import load_position_rules
from scenarios.runs import FrameAxis, Run

from ..figures.axes import unit_labels
from ..language import localized, mark, tr, trn
from ..results.drives import describe_driven
from ..results.numbers import capital, number, percent, sensor_words
from ..results.tables import HEADS_OF_GROUPS, GroupedBy, RunGroup, groups_by, margin_s
from .section import Block, Box, Bullets, Section, Sketch, Subheading, Table

MAX_UNIT_COLUMNS = 24
"""Of more units, each is a row of the table of units by themselves."""
# A longer table is to unfold.
_MAX_FLAT_ROWS = 40


def is_weighted(axis: FrameAxis) -> bool:
    """Some runs count more than others."""
    return not np.allclose(axis.weight, axis.weight[0], rtol=1.0e-9, atol=0.0)


def count_sensors(units: Sequence[CandidatePose]) -> str:
    """'1 camera', '2 cameras and 1 LiDAR' and so on."""
    kinds = [sensor_kind(unit.sensor) for unit in units]
    return sensor_words(kinds.count("camera"), kinds.count("lidar"))


def accidents_section(
    evaluations: Mapping[str, Evaluation], *, is_optimised: bool
) -> Section:
    """The accident prevention ratio of every sensing party.

    The first evaluation is the subject.
    """
    axis = next(iter(evaluations.values())).axis
    meaning = tr(
        "The accident prevention ratio (APR) is the share of the runs in "
        "which the car brakes early enough not to touch the pedestrian or "
        "cyclist."
    )
    if is_weighted(axis):
        meaning = tr(
            "The accident prevention ratio (APR) is the share of the runs, by "
            "weight, in which the car brakes early enough not to touch the "
            "pedestrian or cyclist."
        )
    source = tr(
        "The numbers below come from the evaluator, which renders every "
        "camera's image and every LiDAR's scan frame by frame."
    )
    if is_optimised:
        source = tr(
            "The numbers below come from the evaluator, which renders every "
            "camera's image and every LiDAR's scan frame by frame; it does "
            "not use the detection table."
        )
    blocks: list[Block] = [
        f"{meaning} {source}",
        apr_table(evaluations),
        *apr_group_tables(evaluations),
    ]
    return Section("accidents", tr("Accidents prevented"), blocks)


def apr_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """APR of every sensing party.

    Evaluations on the same runs, the first one is the subject.

    A row for all runs, each case, and each weather where there are several. A column
    per layout, for the car alone and with each layout; and where road users announce
    themselves.
    """
    axis = next(iter(evaluations.values())).axis
    caption = tr("Accident prevention ratio by case")
    if several_weathers(axis):
        caption = tr("Accident prevention ratio by case and weather")
    parties = _parties(evaluations)
    return _table_of_parties(axis, parties, caption, _cases(axis), _groups(axis))


_APR_BY: dict[GroupedBy, str] = {
    "speed": mark("Accident prevention ratio by speed of the car"),
    "direction": mark(
        "Accident prevention ratio by direction from which the car comes"
    ),
    "position": mark(
        "Accident prevention ratio by place along the arms, in metres "
        "before (-) or behind (+) the junction"
    ),
}


def apr_group_tables(evaluations: Mapping[str, Evaluation]) -> list[Table]:
    """APR of the parties by speed, direction and position.

    Only what there are several of.
    """
    axis = next(iter(evaluations.values())).axis
    parties = _parties(evaluations)
    by: tuple[GroupedBy, ...] = ("speed", "direction", "position")
    tables = []
    for what in by:
        groups = [(tr(name), mask) for name, mask in groups_by(axis, what)]
        if what == "speed":
            groups = speed_groups(axis)
        if len(groups) > 1:
            caption = tr(_APR_BY[what])
            head = tr(HEADS_OF_GROUPS[what])
            table = _table_of_parties(axis, parties, caption, head, groups)
            tables.append(replace(table, summary=caption))
    return tables


def speed_groups(axis: FrameAxis) -> list[RunGroup]:
    """Groups of runs by the car's speed, ascending.

    A group has one speed where each place drives all speeds of its case. Else it has as
    many as lie between two that a place drives: each place counts once in each group,
    so that speeds and not places are compared. The slowest group may have fewer.
    """
    groups = groups_by(axis, "speed")
    speeds_kmh = axis.vut_speed_kmh.tolist()
    driven: dict[tuple[str, ...], set[float]] = {}
    wanted: dict[str, set[float]] = {}
    runs = zip(axis.cases, axis.approaches, axis.positions, speeds_kmh, strict=True)
    for case, approach, position, speed_kmh in runs:
        driven.setdefault((case, approach, position), set()).add(speed_kmh)
        wanted.setdefault(case, set()).add(speed_kmh)
    if all(found == wanted[place[0]] for place, found in driven.items()):
        return groups
    size = load_position_rules().every_nth_speed
    found = []
    for end in range(len(groups), 0, -size):
        part = groups[max(0, end - size) : end]
        name = part[0][0]
        if len(part) > 1:
            name = tr("{low} to {high}", low=name, high=part[-1][0])
        found.append((name, np.logical_or.reduce([mask for _, mask in part])))
    return found[::-1]


def layouts_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """APR of layouts on the same runs: the rows of :func:`apr_table`."""
    axis = next(iter(evaluations.values())).axis
    caption = tr("Accident prevention ratio by case")
    parties = _layouts(evaluations)
    return _table_of_parties(axis, parties, caption, _cases(axis), _groups(axis))


def _table_of_parties(
    axis: FrameAxis,
    parties: Mapping[str, Verdict],
    caption: str,
    head: str,
    groups: Sequence[RunGroup],
) -> Table:
    """A row per group of runs, a column per party."""
    return Table(
        caption=caption,
        columns=[head, *parties],
        rows=_apr_rows([*parties.values()], axis, groups),
        numeric=range(1, 1 + len(parties)),
    )


def _layouts(evaluations: Mapping[str, Evaluation]) -> dict[str, Verdict]:
    """All units of each layout together, by the heads of columns."""
    return {
        f"{tr(name)}: {count_sensors(item.layout.units)}": item.rsu_all
        for name, item in evaluations.items()
    }


def _parties(evaluations: Mapping[str, Evaluation]) -> dict[str, Verdict]:
    """Columns of a table of APR, by their heads."""
    subject = next(iter(evaluations.values()))
    layouts = [(tr(name), item) for name, item in evaluations.items()]
    parties = _layouts(evaluations) | {tr("car (VUT) alone"): subject.vut}
    parties |= {
        tr("car (VUT) and {name}", name=name): item.vut_and_rsus
        for name, item in layouts
    }
    # Who announces themselves does not depend on the layout.
    if "vam" in subject.others:
        parties[tr("road users' messages (VAM) alone")] = subject.others["vam"]
    return parties | {
        tr("car (VUT), {name} and VAM", name=name): item.others["all_sources"]
        for name, item in layouts
        if "all_sources" in item.others
    }


def unit_apr_table(name: str, evaluation: Evaluation) -> Table:
    """APR of each unit of a layout by itself.

    It has the rows of :func:`apr_table`.

    The last row: in what share of the frames the unit detects. Of more than
    ``MAX_UNIT_COLUMNS`` units each is a row instead, the best first; a long table is to
    unfold.
    """
    labels = unit_labels(evaluation.layout)
    axis = evaluation.axis
    units, verdicts = evaluation.units.items(), [*evaluation.units.values()]
    detected = [percent(detected_share(verdict, axis)) for verdict in verdicts]
    columns = [_cases(axis), *(labels[unit_id] for unit_id, _ in units)]
    caption = tr("APR of each unit of {name} by itself", name=name)
    rows = [
        *_apr_rows(verdicts, axis, _groups(axis)),
        [tr("frames in which it detects"), *detected],
    ]
    if len(labels) > MAX_UNIT_COLUMNS:
        caption = tr("APR of each unit of {name} by itself, best first", name=name)
        columns = [tr("unit"), *(row[0] for row in rows)]
        of_units = zip(units, zip(*(row[1:] for row in rows), strict=True), strict=True)
        # Stable: as in the layout where two are alike.
        best_first = sorted(
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


def _cases(axis: FrameAxis) -> str:
    if several_weathers(axis):
        return tr("case or weather")
    return tr("case")


def several_weathers(axis: FrameAxis) -> list[RunGroup]:
    """The weathers in the order in which they first appear.

    None where all runs have the same.
    """
    weathers = groups_by(axis, "weather")
    if len(weathers) > 1:
        return weathers
    return []


def _groups(axis: FrameAxis) -> list[RunGroup]:
    """Groups of runs: all, by case, and by weather if there are several."""
    every = (tr("all runs"), np.ones(axis.n_runs, dtype=bool))
    weathers = [
        (tr("weather: {weather}", weather=tr(name)), mask)
        for name, mask in several_weathers(axis)
    ]
    return [every, *groups_by(axis, "case"), *weathers]


def _apr_rows(
    verdicts: Sequence[Verdict], axis: FrameAxis, groups: Sequence[RunGroup]
) -> list[list[str]]:
    return [
        [name, *(percent(apr(verdict, axis, mask)) for verdict in verdicts)]
        for name, mask in groups
    ]


def cases_section(setting: Setting) -> Section:
    """Cases that are driven, and those that cannot be."""
    note = [
        tr(
            "Last moment: the latest time at which braking still avoids the impact"
            " (impact at 0 s). The table lists the earliest and latest among each"
            " case's runs."
        ),
        *describe_hopeless(setting),
    ]
    blocks: list[Block] = [" ".join(note), Box("cases", [case_table(setting)])]
    sketches = [
        sketch_case(setting.runs[rows[0]]) for rows in runs_by_case(setting).values()
    ]
    blocks += [
        tr(
            "Seen from above: the car drives upwards; the impact is where its line"
            " ends. Dashed: the other road user."
        ),
        Box("beside sketches", sketches),
    ]
    missing = describe_driven(setting)
    if missing:
        blocks += [Subheading(tr("Not simulated")), Bullets(missing)]
    return Section("cases", tr("Simulated runs"), blocks)


# Half the side of the ground that a sketch shows.
SKETCHED_M = 16.0
# Units of the drawing.
_PER_M = 10
# Radius of the mark of who is met.
_USER_M = 0.6


def case_words(case: Case) -> str:
    """What happens in a case, within a sentence; empty: the case does not say."""
    return tr(case.title).replace("VUT", tr("car"))


def case_titles(runs: Sequence[Run]) -> dict[str, str]:
    """What happens in the cases of some runs, by their names, within a sentence."""
    cases = {run.case.name: run.case for run in runs}
    return {name: case_words(case) for name, case in cases.items()}


def case_title(case: Case) -> str:
    """What happens in a case, for who knows no codes."""
    return capital(case_words(case) or case.name)


def sketch_case(run: Run) -> Sketch:
    """A sketch of the case of a run.

    The car drives upwards, and hits in the middle.
    """
    is_near = [
        (abs(places - run.vut_position_m[-1]).max(axis=1) <= SKETCHED_M)
        for places in (run.vut_position_m, run.vru_position_m)
    ]
    first = int(is_near[0].argmax())
    turn = np.radians(90.0 - run.vut_yaw_deg[first])
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def drawn(places_m: FloatArray) -> FloatArray:
        return np.asarray(
            (places_m - run.vut_position_m[-1]) @ rotation * (_PER_M, -_PER_M)
        )

    car = run.encounter.vut
    shape = {"length_m": car.length_m, "width_m": car.width_m}
    at_first = footprint_corners(
        run.vut_position_m[first], run.vut_yaw_deg[first], **shape
    )
    user = int(is_near[1].argmax())
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    circle = _USER_M * np.column_stack([np.cos(angle), np.sin(angle)])
    return Sketch(
        title=case_title(run.case),
        code=run.case.name,
        half=round(SKETCHED_M * _PER_M),
        paths=[
            *(
                ("body", _path(drawn(corners), is_closed=True))
                for corners in _bodies(run)
            ),
            ("way", _path(drawn(run.vut_position_m[first:]))),
            ("car", _path(drawn(at_first), is_closed=True)),
            ("user-way", _path(drawn(run.vru_position_m[user:]))),
            ("user", _path(drawn(run.vru_position_m[user] + circle), is_closed=True)),
        ],
    )


def _bodies(run: Run) -> list[FloatArray]:
    """Footprints of what hides somebody."""

    def is_near(body: PlacedActor) -> bool:
        away_m = body.pose.position_m[:2] - run.vut_position_m[-1]
        return bool(np.hypot(*away_m) <= 2.0 * SKETCHED_M)

    return [body.footprint_m for body in run.obstruction if is_near(body)]


def _path(
    places: Sequence[Sequence[float]] | FloatArray, *, is_closed: bool = False
) -> str:
    """Data of an SVG path through places (n, 2), whole numbers.

    Equal ones in a row once.
    """
    points = dict.fromkeys(f"{round(x)} {round(y)}" for x, y in np.asarray(places))
    return "M" + "L".join(points) + ("Z" if is_closed else "")


def runs_section(evaluations: Mapping[str, Evaluation]) -> Section:
    """How every run ends."""
    note = tr(
        "Avoided: the time to spare between the onset of braking and the last"
        " moment. Hit: the time by which braking comes too late. Lost again:"
        " confirmed early enough, but no longer tracked at the last moment."
    )
    return Section("runs", tr("Every run"), [note, run_table(evaluations)])


def case_table(setting: Setting) -> Table:
    """The cases that are driven.

    What, how fast, from where, how late braking may begin.

    A case's share of the weight is told where not every run counts the same.
    """
    has_weights = is_weighted(setting.axis)
    refused = [refusal.approach for refusal in setting.refusals]
    every = dict.fromkeys([*(run.approach for run in setting.runs), *refused])
    rows = []
    for name, indices in runs_by_case(setting).items():
        runs = [setting.runs[index] for index in indices]
        case = runs[0].case
        vru_speeds_kmh = sorted({run.case.vru_speed_kmh for run in runs})
        approaches = dict.fromkeys(run.approach for run in runs)
        last_s = [
            run.last_brake_time_s
            for run in runs
            if math.isfinite(run.last_brake_time_s)
        ]
        met = f"{tr(case.vru.name)}, {_steps(vru_speeds_kmh)}\N{NO-BREAK SPACE}km/h"
        speeds = _steps(sorted({run.vut_speed_kmh for run in runs}))
        is_all = len(approaches) == len(every) > 1
        if is_all:
            arms = tr("all")
        else:
            arms = ", ".join(map(tr, approaches))
        if has_weights:
            weight = [percent(float(setting.axis.weight[indices].sum()))]
        else:
            weight = []
        moments = [number(pick(last_s, default=None)) for pick in (min, max)]
        rows.append(
            [
                name,
                tr(case.title),
                met,
                speeds,
                arms,
                str(len(runs)),
                *weight,
                *moments,
            ]
        )
    columns = [
        *(
            tr("case"),
            tr("what happens"),
            tr("road user"),
            tr("car (km/h)"),
            tr("from"),
        ),
        tr("runs"),
        *([tr("weight")] if has_weights else []),
        *(tr("last moment, earliest (s)"), tr("latest (s)")),
    ]
    arms = ", ".join(map(tr, every))
    return Table(
        caption=(
            tr("Cases; from all: {arms}", arms=arms) if len(every) > 1 else tr("Cases")
        ),
        columns=columns,
        rows=rows,
        numeric=range(5, len(columns)),
    )


def _steps(values: Sequence[float]) -> str:
    """Ascending values in words.

    As a range where the steps between them are equal, else each.
    """
    steps = np.diff(values)
    if len(values) > 2 and np.allclose(steps, steps[0]):
        low, high, step = (
            localized(f"{value:g}") for value in (values[0], values[-1], steps[0])
        )
        return tr("{low} to {high} by {step}", low=low, high=high, step=step)
    return ", ".join(localized(f"{value:g}") for value in values)


def describe_hopeless(setting: Setting) -> list[str]:
    """Which cases have runs that no braking avoids, in sentences."""
    hopeless = [run for run in setting.runs if not math.isfinite(run.last_brake_time_s)]
    n_runs = Counter(run.case.name for run in hopeless)
    names = [name for name in runs_by_case(setting) if n_runs[name]]
    return [
        trn(
            "Braking cannot avoid the impact in {n} run of {case}.",
            "Braking cannot avoid the impact in {n} runs of {case}.",
            n_runs[name],
            case=name,
        )
        for name in names
    ]


def runs_by_case(setting: Setting) -> dict[str, list[int]]:
    """Indices of the runs of each case, cases as they first appear."""
    masks = groups_by(setting.axis, "case")
    return {name: np.flatnonzero(mask).tolist() for name, mask in masks}


def run_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """A row per run, those with the least time to spare first.

    Hits come before the rest.

    Evaluations by display name, on the same runs; the first one is the subject. Weather
    and weight have a column where they differ.
    """
    subject = next(iter(evaluations.values()))
    axis = subject.axis
    verdicts = [*(item.headline for item in evaluations.values()), subject.vut]
    margins = [margin_s(verdict, axis) for verdict in verdicts]
    has_weathers = bool(several_weathers(axis))
    has_weights = is_weighted(axis)
    rows = []
    for index in np.argsort(margins[0], kind="stable").tolist():
        if has_weathers:
            weather = [tr(axis.weathers[index])]
        else:
            weather = []
        if has_weights:
            weight = [percent(float(axis.weight[index]))]
        else:
            weight = []
        ends = [
            outcome(run_outcome(verdict, axis, index), float(margin[index]))
            for verdict, margin in zip(verdicts, margins, strict=True)
        ]
        last = number(axis.last_brake_time_s[index])
        rows.append([axis.run_ids[index], *weather, *weight, last, *ends])
    own = [
        *([tr("weather")] if has_weathers else []),
        *([tr("weight")] if has_weights else []),
    ]
    columns = [tr("run"), *own, tr("last moment (s)"), *map(tr, evaluations), tr("VUT")]
    n_hit = int((~subject.headline.is_avoided).sum())
    summary = tr("{n} runs, least time to spare first", n=len(rows))
    if n_hit:
        summary = tr(
            "{n} runs, {hit} with an impact, least time to spare first",
            n=len(rows),
            hit=n_hit,
        )
    caption = tr("Runs: case / from / speed in km/h")
    if has_weathers:
        caption = tr("Runs: case / from / speed in km/h / weather")
    return Table(
        caption=caption,
        columns=columns,
        rows=rows,
        numeric=range(1, len(columns)),
        summary=summary,
    )


def outcome(words: str, margin_s: float) -> str:
    """How a run ends, with the time to spare or too late."""
    if words == "avoided":
        return tr("avoided, {time} s", time=number(margin_s))
    if words == "lost again":
        return tr("HIT, lost again")
    if math.isfinite(margin_s):
        return tr("HIT, {time} s late", time=number(-margin_s))
    return tr("HIT, not confirmed")
