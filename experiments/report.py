"""One self-contained HTML page: the answer, its proof, figures, and every run."""

import base64
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined, Template
from matplotlib.figure import Figure

from geometry.atomic_files import write_atomically
from geometry.errors import InputError, Unquoted
from placement.evaluation import Evaluation, apr, apr_by_case, detected_share
from placement.layout import Layout, layout_records
from placement.setting import Setting

from .exports import margin_s
from .figures import percent, plot_apr_by_case, plot_heatmap, to_png, unit_labels
from .plan import plot_plan
from .sentences import (
    NOTHING,
    STAGES,
    answer,
    assumptions,
    count_cameras,
    describe_cases,
    disagreement,
    number,
    proof,
    title,
)

FILE_NAME = "report.html"
GREEDY = "greedy"
_PLAN_RANGE_M = 35.0
_COMPASS = (
    "east",
    "north-east",
    "north",
    "north-west",
    "west",
    "south-west",
    "south",
    "south-east",
)


def write_report(
    folder: Path,
    summary: Mapping[str, Any],
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str] = (),
) -> Path:
    """Write :func:`render_report`'s page to ``report.html`` in `folder`, which must exist."""
    page = render_report(summary, setting, evaluations, command=command, heatmap_runs=heatmap_runs)
    path = folder / FILE_NAME
    write_atomically(path, lambda file: file.write(page.encode()))
    return path


def render_report(
    summary: Mapping[str, Any],
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str] = (),
) -> str:
    """A result as one HTML page that loads nothing from elsewhere.

    Parameters
    ----------
    summary : mapping
        As :mod:`experiments.summary` builds it. With "stages": an optimised layout; without: one
        layout evaluated, or several compared.
    setting : Setting
        What the layouts were evaluated in.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject. One named "greedy" appears in tables and
        bars only.
    command : str
        Command line that makes the result again.
    heatmap_runs : sequence of str
        Ids of the runs to draw; else of each case the run with the least time to spare.

    Returns
    -------
    page : str
        HTML.

    Raises
    ------
    InputError
        There is no evaluation, or a run is unknown.
    """
    if not evaluations:
        raise InputError("evaluations", Unquoted("none"), "at least one")
    subject_name, subject = next(iter(evaluations.items()))
    shown = {name: item for name, item in evaluations.items() if name != GREEDY}
    is_comparison = "stages" not in summary and len(evaluations) > 1
    detailed = shown if is_comparison else {subject_name: subject}
    run_indices = _heatmap_indices(subject, setting, heatmap_runs)
    return _template().render(
        title=title(summary, setting, evaluations),
        answer=answer(summary, shown),
        layouts=[
            {"caption": f"Cameras of {name}", "rows": _unit_rows(item.layout)}
            for name, item in detailed.items()
        ],
        plans=_plans(setting, detailed, [] if is_comparison else [*shown.values()][1:]),
        proof=proof(summary),
        stages=[_stage_row(stage) for stage in summary.get("stages", ())],
        solver=summary.get("solver", NOTHING),
        is_weighted=not np.allclose(subject.axis.weight, subject.axis.weight[0]),
        apr_columns=["sensing party", *dict.fromkeys(subject.axis.cases), "all runs"],
        apr_rows=_apr_rows(evaluations),
        apr_figure=_apr_figure(evaluations),
        alone=[_alone(name, item) for name, item in detailed.items()],
        heatmaps=[
            {"name": name, "figures": [_heatmap(item, index) for index in run_indices]}
            for name, item in detailed.items()
        ],
        heatmaps_are_hardest=not heatmap_runs,
        rule=setting.rule,
        disagreement=disagreement(summary),
        assumptions=assumptions(summary, setting),
        cases=describe_cases(setting),
        run_columns=["case", "approach", "speed (km/h)", "last moment (s)", *evaluations, "VUT"],
        run_rows=_run_rows(setting, evaluations),
        command=command,
        seconds=[(stage, f"{value:.1f}") for stage, value in summary.get("seconds", {}).items()],
        versions=list(summary.get("versions", {}).items()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Picture:
    """A figure as the template shows it."""

    title: str
    caption: str
    alt: str
    png: str
    width_px: int
    height_px: int


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    source = files(__package__) / "templates" / "report.html.j2"
    return environment.from_string(source.read_text(encoding="utf-8"))


def _picture(figure: Figure, *, title: str, caption: str, alt: str) -> _Picture:
    png = to_png(figure)
    width_px, height_px = struct.unpack(">II", png[16:24])  # of the header chunk
    return _Picture(
        title=title,
        caption=caption,
        alt=alt,
        png=base64.b64encode(png).decode(),
        width_px=width_px,
        height_px=height_px,
    )


# ---------------------------------------------------------------- tables


def _unit_rows(layout: Layout) -> list[list[str]]:
    labels = unit_labels(layout)
    return [
        [
            labels[record["id"]],
            record["id"],
            record["site"] or NOTHING,
            *(number(record[key]) for key in ("x_m", "y_m", "z_m")),
            number(record["yaw_deg"], 1),
            number(record["pitch_deg"], 1),
            _COMPASS[round(record["yaw_deg"] / 45.0) % 8],
            record["camera"],
        ]
        for record in layout_records(layout)
    ]


def _stage_row(stage: Mapping[str, Any]) -> list[str]:
    is_time = stage["name"].endswith("_s")

    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        return f"{number(value, 3)} s" if is_time else percent(value)

    gap = stage["gap"]
    return [
        STAGES.get(stage["name"], stage["name"]),
        shown(stage["objective"]),
        shown(stage["bound"]),
        NOTHING if gap is None or not math.isfinite(gap) else percent(gap),
        number(stage["seconds"], 1),
    ]


def _apr_rows(evaluations: Mapping[str, Evaluation]) -> list[list[str]]:
    subject = next(iter(evaluations.values()))
    verdicts = [
        *(
            (f"{name}: {count_cameras(item.units)}", item, item.rsu_all)
            for name, item in evaluations.items()
        ),
        ("car (VUT) alone", subject, subject.vut),
        *((f"car (VUT) and {name}", item, item.vut_and_rsus) for name, item in evaluations.items()),
    ]
    return [
        [
            name,
            *(percent(share) for share in apr_by_case(verdict, item.axis).values()),
            percent(apr(verdict, item.axis)),
        ]
        for name, item, verdict in verdicts
    ]


def _alone(name: str, evaluation: Evaluation) -> dict[str, Any]:
    axis, labels = evaluation.axis, unit_labels(evaluation.layout)
    return {
        "caption": f"APR of each camera of {name} by itself",
        "columns": [
            "mark",
            "id",
            *dict.fromkeys(axis.cases),
            "all runs",
            "frames in which it detects",
        ],
        "rows": [
            [
                labels[unit_id],
                unit_id,
                *(percent(share) for share in apr_by_case(verdict, axis).values()),
                percent(apr(verdict, axis)),
                percent(detected_share(verdict, axis)),
            ]
            for unit_id, verdict in evaluation.units.items()
        ],
    }


def _run_rows(setting: Setting, evaluations: Mapping[str, Evaluation]) -> list[list[str]]:
    subject = next(iter(evaluations.values()))
    axis = subject.axis
    verdicts = [*(item.rsu_all for item in evaluations.values()), subject.vut]
    margins = [margin_s(verdict, axis, setting.rule) for verdict in verdicts]
    return [
        [
            axis.cases[index],
            axis.approaches[index],
            f"{axis.vut_speed_kmh[index]:g}",
            number(axis.last_brake_time_s[index]),
            *(
                _outcome(bool(verdict.is_avoided[index]), float(margin[index]))
                for verdict, margin in zip(verdicts, margins, strict=True)
            ),
        ]
        for index in range(axis.n_runs)
    ]


def _outcome(is_avoided: bool, margin: float) -> str:
    if is_avoided:
        return f"avoided, {number(margin)} s"
    return f"HIT, {number(-margin)} s late" if math.isfinite(margin) else "HIT, not confirmed"


# ---------------------------------------------------------------- figures


def _plans(
    setting: Setting, detailed: Mapping[str, Evaluation], others: Sequence[Evaluation]
) -> list[_Picture]:
    return [
        _picture(
            plot_plan(
                setting,
                item.layout,
                others=[other.layout for other in others],
                max_range_m=_PLAN_RANGE_M,
            ),
            title=f"Plan of {setting.scene.name} with {name}",
            caption=(
                "Coloured outlines: the ground in each camera's image, up to "
                f"{_PLAN_RANGE_M:g} m; the cameras see farther. Walls and parked cars hide parts "
                "of it, which is taken into account in the numbers but not drawn here."
            ),
            alt="Plan of the junction, north up. "
            + " ".join(
                f"Camera {labels[unit.id]} at {number(unit.pose.position_m[0], 1)} m east, "
                f"{number(unit.pose.position_m[1], 1)} m north, looking to the "
                f"{_COMPASS[round(unit.pose.yaw_deg / 45.0) % 8]}."
                for unit in item.layout.units
            ),
        )
        for name, item in detailed.items()
        for labels in [unit_labels(item.layout)]
    ]


def _apr_figure(evaluations: Mapping[str, Evaluation]) -> _Picture:
    rows = _apr_rows(evaluations)
    return _picture(
        plot_apr_by_case(evaluations),
        title="Accident prevention ratio by case",
        caption="The same numbers as in the table above.",
        alt="Bars. Over all runs: " + "; ".join(f"{row[0]} {row[-1]}" for row in rows) + ".",
    )


def _heatmap_indices(evaluation: Evaluation, setting: Setting, run_ids: Sequence[str]) -> list[int]:
    axis = evaluation.axis
    for run_id in run_ids:
        if run_id not in axis.run_ids:
            raise InputError("heatmap run", run_id, "the id of a run")
    if run_ids:
        return [axis.run_ids.index(run_id) for run_id in run_ids]
    margin = margin_s(evaluation.rsu_all, axis, setting.rule)
    cases = np.array(axis.cases)
    return [
        int(min(np.flatnonzero(cases == case), key=lambda index: float(margin[index])))
        for case in dict.fromkeys(axis.cases)
    ]


def _heatmap(evaluation: Evaluation, run_index: int) -> _Picture:
    axis, labels = evaluation.axis, unit_labels(evaluation.layout)
    rows = {
        "the VUT": evaluation.vut,
        **{labels[unit_id]: verdict for unit_id, verdict in evaluation.units.items()},
        "all RSUs": evaluation.rsu_all,
    }
    run = (
        f"{axis.cases[run_index]} from the {axis.approaches[run_index]} at "
        f"{axis.vut_speed_kmh[run_index]:g} km/h"
    )
    last_moment = number(axis.last_brake_time_s[run_index])
    confirmed = [
        f"{name} at {number(verdict.confirmation_time_s[run_index], 1)} s"
        if math.isfinite(verdict.confirmation_time_s[run_index])
        else f"{name} never"
        for name, verdict in rows.items()
    ]
    return _picture(
        plot_heatmap(evaluation, run_index),
        title=run,
        caption=f"Detections in each frame; the last moment to brake is at {last_moment} s.",
        alt=f"Heatmap of {run}. Last moment to brake {last_moment} s. Confirmed by: "
        + ", ".join(confirmed)
        + ".",
    )
