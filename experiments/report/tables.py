"""Tables of the HTML report, as text: a caption, the columns' heads, rows of cells."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_by_case,
    detected_share,
)
from placement.layout import Layout, layout_records
from placement.setting import Setting
from scenarios.runs import FrameAxis

from ..figures.axes import unit_labels
from ..figures.sensors import compass_word
from ..results.numbers import NOTHING, number, percent
from ..results.tables import groups_by_direction, groups_by_speed, margin_s
from .answer import STAGES, count_sensors, is_weighted, outcome, runs_by_case


def unit_table(name: str, layout: Layout) -> dict[str, Any]:
    """The units of a layout: its caption and a row each; the template has the columns' heads."""
    labels = unit_labels(layout)
    rows = [
        [
            labels[record["id"]],
            record["id"],
            record["site"] or NOTHING,
            *(number(record[key]) for key in ("x_m", "y_m", "z_m")),
            number(record["yaw_deg"], 1),
            number(record["pitch_deg"], 1),
            compass_word(unit),
            record.get("camera") or record["lidar"],
        ]
        for unit, record in zip(layout.units, layout_records(layout), strict=True)
    ]
    return {"caption": f"Units of {name}", "rows": rows}


_AMOUNTS = ("units", "cost_eur", "weighted")
"""Objectives that are neither a share nor a time."""


def stage_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """The optimiser's objectives, best value and bound; none where nothing was optimised."""
    return [_stage_row(stage) for stage in summary.get("stages", ())]


def _stage_row(stage: Mapping[str, Any]) -> list[str]:
    is_time = stage["name"].endswith("_s")

    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        if stage["name"] in _AMOUNTS:
            return number(value, 2)
        return f"{number(value, 3)} s" if is_time else percent(value)

    gap = stage["gap"]
    return [
        STAGES.get(stage["name"], stage["name"]),
        shown(stage["objective"]),
        shown(stage["bound"]),
        NOTHING if gap is None or not math.isfinite(gap) else percent(gap),
        number(stage["seconds"], 1),
    ]


def disagreement_rows(summary: Mapping[str, Any]) -> list[list[Any]]:
    """Runs that detection table and evaluator judge differently, a row each."""
    return [
        [
            entry["run_id"],
            entry["party"],
            "table" if entry["on_table"] else "evaluator",
            entry["n_frames"],
            entry["cause"],
        ]
        for entry in summary.get("disagreements", ())
    ]


# ---------------------------------------------------------------- accident prevention ratios


def apr_table(evaluations: Mapping[str, Evaluation]) -> dict[str, Any]:
    """APR of every sensing party.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By display name, on the same runs; the first one is the subject.

    Returns
    -------
    table : dict
        Caption, columns and rows. A row for all runs, for each case, and for each weather where
        there are several. A column per layout, for the car alone, for the car with each layout;
        where road users announce themselves, for them alone and for all sources with each layout.
    """
    subject = next(iter(evaluations.values()))
    verdicts = _parties(evaluations)
    return {
        "caption": f"Accident prevention ratio by {_groups(subject.axis, 'and')}",
        "columns": [_groups(subject.axis, "or"), *(name for name, _, _ in verdicts)],
        "rows": _apr_rows([(item, verdict) for _, item, verdict in verdicts]),
    }


def apr_group_tables(evaluations: Mapping[str, Evaluation]) -> list[dict[str, Any]]:
    """APR of every sensing party by the car's speed, and by the direction from which it comes.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By display name, on the same runs; the first one is the subject.

    Returns
    -------
    tables : list of dict
        Caption, columns - those of :func:`apr_table` - and rows; none where all runs have the same
        speed or direction.
    """
    verdicts = _parties(evaluations)
    axis = verdicts[0][1].axis
    groupings = [
        ("speed of the car", "speed (km/h)", groups_by_speed(axis)),
        ("direction from which the car comes", "from", groups_by_direction(axis)),
    ]
    return [
        {
            "caption": f"Accident prevention ratio by {words}",
            "columns": [head, *(name for name, _, _ in verdicts)],
            "rows": [
                [
                    group,
                    *(percent(apr(verdict, item.axis, mask)) for _, item, verdict in verdicts),
                ]
                for group, mask in groups
            ],
        }
        for words, head, groups in groupings
        if len(groups) > 1
    ]


def _parties(evaluations: Mapping[str, Evaluation]) -> list[tuple[str, Evaluation, Verdict]]:
    """What the columns of a table of APR are about: head, evaluation, verdict."""
    subject = next(iter(evaluations.values()))
    parties = [
        *(
            (f"{name}: {count_sensors(item.layout)}", item, item.rsu_all)
            for name, item in evaluations.items()
        ),
        ("car (VUT) alone", subject, subject.vut),
        *((f"car (VUT) and {name}", item, item.vut_and_rsus) for name, item in evaluations.items()),
    ]
    # Who announces themselves does not depend on the layout.
    if "vam" in subject.others:
        parties.append(("road users' messages (VAM) alone", subject, subject.others["vam"]))
    parties += [
        (f"car (VUT), {name} and VAM", item, item.others["all_sources"])
        for name, item in evaluations.items()
        if "all_sources" in item.others
    ]
    return parties


def unit_apr_table(name: str, evaluation: Evaluation) -> dict[str, Any]:
    """APR of each unit of a layout by itself, with the rows of :func:`apr_table`.

    Parameters
    ----------
    name : str
        The layout's display name.
    evaluation : Evaluation
        Of the layout.

    Returns
    -------
    table : dict
        Caption, columns and rows; the last row: in what share of the frames the unit detects. Of
        more than ``MAX_UNIT_COLUMNS`` units each is a row instead, the best first.
    """
    labels = unit_labels(evaluation.layout)
    units = evaluation.units.items()
    detected = [percent(detected_share(verdict, evaluation.axis)) for _, verdict in units]
    head = _groups(evaluation.axis, "or")
    caption = f"APR of each unit of {name} by itself"
    rows = [
        *_apr_rows([(evaluation, verdict) for _, verdict in units]),
        ["frames in which it detects", *detected],
    ]
    if len(labels) <= MAX_UNIT_COLUMNS:
        columns = [head, *(labels[unit_id] for unit_id, _ in units)]
        return {"caption": caption, "columns": columns, "rows": rows}
    by_unit = [*zip(*(row[1:] for row in rows), strict=True)]
    best_first = sorted(
        units, key=lambda item: _rank(item[1], evaluation.axis), reverse=True
    )  # stable: as in the layout where two are alike
    place = {unit_id: index for index, (unit_id, _) in enumerate(units)}
    return {
        "caption": f"{caption}, best first",
        "columns": ["unit", *(row[0] for row in rows)],
        "rows": [[labels[unit_id], *by_unit[place[unit_id]]] for unit_id, _ in best_first],
    }


MAX_UNIT_COLUMNS = 24
"""Of more units, each is a row of the table of units by themselves."""


def _rank(verdict: Verdict, axis: FrameAxis) -> tuple[float, float]:
    return apr(verdict, axis), detected_share(verdict, axis)


def _groups(axis: FrameAxis, conjunction: str) -> str:
    return f"case {conjunction} weather" if _several_weathers(axis) else "case"


def _several_weathers(axis: FrameAxis) -> list[str]:
    """The weathers in the order in which they first appear; none where all runs have the same."""
    weathers = list(dict.fromkeys(axis.weathers))
    return weathers if len(weathers) > 1 else []


def _apr_rows(verdicts: Sequence[tuple[Evaluation, Verdict]]) -> list[list[str]]:
    axis = verdicts[0][0].axis
    of_weather = np.array(axis.weathers)
    by_case = [apr_by_case(verdict, item.axis) for item, verdict in verdicts]
    return [
        ["all runs", *(percent(apr(verdict, item.axis)) for item, verdict in verdicts)],
        *(
            [case, *(percent(shares[case]) for shares in by_case)]
            for case in dict.fromkeys(axis.cases)
        ),
        *(
            [
                f"weather: {weather}",
                *(
                    percent(apr(verdict, item.axis, of_weather == weather))
                    for item, verdict in verdicts
                ),
            ]
            for weather in _several_weathers(axis)
        ),
    ]


# ---------------------------------------------------------------- cases and runs


def case_table(setting: Setting) -> dict[str, Any]:
    """The cases that are driven: what, how fast, from where, how late braking may begin.

    Parameters
    ----------
    setting : Setting
        Runs and their weights.

    Returns
    -------
    table : dict
        Caption, columns and rows: one row per case. A case's share of the weight is told where
        not every run counts the same.
    """
    has_weights = is_weighted(setting.axis)
    every = dict.fromkeys(
        [
            *(run.approach for run in setting.runs),
            *(refusal.approach for refusal in setting.refusals),
        ]
    )
    rows = []
    for name, indices in runs_by_case(setting).items():
        runs = [setting.runs[index] for index in indices]
        case = runs[0].case
        approaches = dict.fromkeys(run.approach for run in runs)
        last_s = [run.last_brake_time_s for run in runs if math.isfinite(run.last_brake_time_s)]
        rows.append(
            [
                name,
                case.title,
                f"{case.vru.name}, {case.vru_speed_kmh:g}\N{NO-BREAK SPACE}km/h",
                _steps(sorted({run.vut_speed_kmh for run in runs})),
                "all" if len(approaches) == len(every) > 1 else ", ".join(approaches),
                str(len(runs)),
                *([percent(float(setting.axis.weight[indices].sum()))] if has_weights else []),
                number(min(last_s, default=None)),
                number(max(last_s, default=None)),
            ]
        )
    return {
        "caption": "Cases" + (f"; from all: {', '.join(every)}" if len(every) > 1 else ""),
        "columns": [
            "case",
            "what happens",
            "road user",
            "car (km/h)",
            "from",
            "runs",
            *(["weight"] if has_weights else []),
            "last moment, earliest (s)",
            "latest (s)",
        ],
        "rows": rows,
    }


def _steps(values: Sequence[float]) -> str:
    """Ascending values: as a range where the steps between them are equal, else each."""
    steps = np.diff(values)
    if len(values) > 2 and np.allclose(steps, steps[0]):
        return f"{values[0]:g} to {values[-1]:g} by {steps[0]:g}"
    return ", ".join(f"{value:g}" for value in values)


def run_table(evaluations: Mapping[str, Evaluation]) -> dict[str, Any]:
    """A row per run, those with the least time to spare first: hits come before the rest.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By display name, on the same runs; the first one is the subject.

    Returns
    -------
    table : dict
        Caption, columns and rows. Weather and weight have a column where they differ.
    """
    subject = next(iter(evaluations.values()))
    axis = subject.axis
    verdicts = [*(item.rsu_all for item in evaluations.values()), subject.vut]
    margins = [margin_s(verdict, axis) for verdict in verdicts]
    has_weathers, has_weights = bool(_several_weathers(axis)), is_weighted(axis)
    rows = [
        [
            axis.run_ids[index],
            *([axis.weathers[index]] if has_weathers else []),
            *([percent(float(axis.weight[index]))] if has_weights else []),
            number(axis.last_brake_time_s[index]),
            *(
                outcome(bool(verdict.is_avoided[index]), float(margin[index]))
                for verdict, margin in zip(verdicts, margins, strict=True)
            ),
        ]
        for index in np.argsort(margins[0], kind="stable")
    ]
    return {
        "caption": "Runs: case / from / speed in km/h" + (" / weather" if has_weathers else ""),
        "columns": [
            "run",
            *(["weather"] if has_weathers else []),
            *(["weight"] if has_weights else []),
            "last moment (s)",
            *evaluations,
            "VUT",
        ],
        "rows": rows,
    }
