"""Results on recorded detections as plain text for a terminal."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..report.explanation import explanation_text
from ..report.private_ground import private_sentences
from ..report.refinement import refinement_sentences
from ..report.sampled_worlds import uncertainty_sentences, uncertainty_text
from ..results.numbers import percent

# ---------- results on recorded detections as plain text for a terminal


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


# ---------- what a placement's result has beside layout and proof


_WIDTH = 80


def added_sentences(summary: Mapping[str, Any]) -> list[str]:
    """For the report's answer."""
    sentences: list[str] = []
    sentences += _private(summary)
    if "refinement" in summary:
        sentences += refinement_sentences(summary["refinement"])
    if "sampled" in summary:
        sentences += uncertainty_sentences(summary["sampled"])
    return sentences


def added_text(summary: Mapping[str, Any]) -> str:
    """For a terminal; empty where nothing is added."""
    parts = []
    if "front" in summary:
        parts.append(
            ["What each unit buys:", *_wrapped(summary["front"]["sentences"], indent="  ")]
        )
    if "explained" in summary:
        parts.append([explanation_text(summary["explained"])])
    if "private_ground" in summary:
        parts.append(_wrapped(_private(summary)))
    if "refinement" in summary:
        parts.append(_wrapped(refinement_sentences(summary["refinement"])))
    if "sampled" in summary:
        parts.append([uncertainty_text(summary["sampled"])])
    return "\n\n".join("\n".join(part) for part in parts)


def with_additions(summary: Mapping[str, Any], table: str) -> str:
    """A table for a terminal, below what is added to it."""
    return "\n\n".join(text for text in (added_text(summary), table) if text)


def _private(summary: Mapping[str, Any]) -> list[str]:
    """What cameras see of private ground; of each layout where several are compared."""
    if "private_ground" not in summary:
        return []
    sentences = private_sentences(summary["private_ground"])
    for other in summary.get("compared", ()):
        sentences += [
            f"{other['name']}: {sentence}"
            for sentence in private_sentences(other["private_ground"])
        ]
    return sentences


def _wrapped(sentences: list[str], indent: str = "") -> list[str]:
    return [
        line
        for sentence in sentences
        for line in textwrap.wrap(
            sentence, _WIDTH, initial_indent=indent, subsequent_indent=2 * indent
        )
    ]
