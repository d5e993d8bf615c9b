"""Results on recorded detections as plain text for a terminal."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .tables import percent

ALL_UNITS = "RSU_all"

_WIDTH, _COLUMN, _NAME = 80, 12, 18
_NOTE = (
    "Unit folder 3 is RSU3, car is the VUT's camera. In Eval, cam_index is a unit's folder; "
    "12 (where no unit has that number) and -1 mean car, too. The last moment follows from speeds "
    "and distances alone: a VUT that turns is taken as crossing."
)


def recording_table(summary: Mapping[str, Any], out: Path | None) -> str:
    """The result of :func:`run_recording` for a terminal."""
    lines = [
        *textwrap.wrap(f"{summary['recording']} on {summary['runs']} drives:", _WIDTH),
        *_parties_text(summary["evaluation"], summary["detected_share"], summary["cases"]),
        *_footer(summary, out),
    ]
    return "\n".join(lines)


def recorded_placement_table(summary: Mapping[str, Any], out: Path | None) -> str:
    """The result of :func:`run_recorded_placement` for a terminal."""
    chosen = ", ".join(unit["id"] for unit in summary["layout"])
    head = (
        f"Best {len(summary['layout'])} of {summary['candidates']} recorded units on "
        f"{summary['runs']} drives (fusion {summary['fusion']}): {chosen}"
    )
    lines = [
        *textwrap.wrap(head, _WIDTH),
        "",
        f"  {'stage':<24} {'found':>9} {'bound':>9} {'gap':>8}",
    ]
    for stage in summary["stages"]:
        is_time = stage["name"].endswith("_s")
        found, bound = (
            f"{stage[key]:.3f} s" if is_time else percent(stage[key])
            for key in ("objective", "bound")
        )
        gap = "proven" if stage["gap"] == 0.0 else percent(min(stage["gap"], 9.99))
        lines.append(f"  {stage['name']:<24} {found:>9} {bound:>9} {gap:>8}")
    everything = summary["baseline"]["rsu_all"]
    lines += [
        "",
        *_parties_text(summary["evaluation"], summary["detected_share"], summary["cases"]),
        f"  {ALL_UNITS} of all {summary['candidates']} recorded units: "
        f"{percent(everything['all'])} of the accidents prevented.",
        *_footer(summary, out),
    ]
    return "\n".join(lines)


def _parties_text(
    evaluation: Mapping[str, Any], shares: Mapping[str, Any], cases: Sequence[str]
) -> list[str]:
    """A row per party; APR over all drives, share of frames, and APR by case as columns."""
    rows = [(name, evaluation["units"][name], shares["units"][name]) for name in shares["units"]]
    rows += [
        (name, evaluation[key], shares[key])
        for key, name in (
            ("rsu_all", ALL_UNITS),
            ("vut", "car"),
            ("vut_and_rsus", f"car + {ALL_UNITS}"),
        )
        if evaluation[key] is not None
    ]
    columns = [("accidents", "prevented"), ("frames", "detected")]
    columns += [(head, kind) for head, _, kind in (case.rpartition("-") for case in cases)]
    cells = [
        [ratios["all"], share, *(ratios["by_case"][case] for case in cases)]
        for _, ratios, share in rows
    ]
    lines: list[str] = []
    per_block = (_WIDTH - _NAME) // _COLUMN
    for start in range(0, len(columns), per_block):
        block = range(start, min(start + per_block, len(columns)))
        lines += [""] if lines else []
        for line in (0, 1):
            lines.append(
                " " * _NAME + "".join(f"{columns[column][line]:>{_COLUMN}}" for column in block)
            )
        for (name, *_), values in zip(rows, cells, strict=True):
            lines.append(
                f"  {name:<{_NAME - 2}}"
                + "".join(f"{percent(values[column]):>{_COLUMN}}" for column in block)
            )
    return lines


def _footer(summary: Mapping[str, Any], out: Path | None) -> list[str]:
    """What was read, what was left out and why."""
    frames = summary["frames"]
    read = (
        f"Read: {frames['recorded']} frames; {summary['runs']} drives with {frames['in_drives']} "
        f"frames, {frames['missing_in_drives']} of them missing and so not detected."
    )
    if frames["several_vrus_in_view"]:
        read += (
            f" In {frames['several_vrus_in_view']} frames a roadside unit has several VRUs of the "
            "drive's class in view: they count only if each of them is detected."
        )
    skipped = "; ".join(f"{number} {reason}" for reason, number in summary["skipped"].items())
    lines = [
        "",
        *textwrap.wrap(read, _WIDTH),
        *textwrap.wrap(f"Skipped: {skipped or 'nothing'}.", _WIDTH),
    ]
    lines += textwrap.wrap(_NOTE, _WIDTH)
    if out is not None:
        lines += ["", f"Written to {out}: summary.json."]
    return lines
